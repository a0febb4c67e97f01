//! Two reconstructions of the same images, held against one another.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::cameras::{CameraErrors, compare_cameras};
use super::figures::Outcome;
use super::registration::{self, Registration};
use crate::scene::Reconstruction;

/// How far reconstruction B is from reconstruction A. Lengths are in the unit of A.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// The first, which sets frame and unit.
    pub a: ModelFigures,
    /// The second.
    pub b: ModelFigures,
    /// Images that both have registered, by name.
    pub num_common_images: usize,
    /// Similarity from B to A; "metres" in it are units of A.
    pub a_from_b: Outcome<Registration>,
    /// Differences between the common cameras; "metres" in it are units of A.
    pub cameras: Outcome<CameraErrors>,
    /// Centre RMSE over the spread of A's common centres: comparable between scenes of any unit.
    pub relative_center_rmse: Option<f64>,
}

/// Size and quality of one reconstruction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelFigures {
    /// Registered images.
    pub num_images: usize,
    /// Points.
    pub num_points: usize,
    /// Observations of points.
    pub num_observations: usize,
    /// Mean observations per point; `None` without points.
    pub mean_track_length: Option<f64>,
    /// Mean reprojection error over observations, pixels; `None` without points.
    pub mean_reprojection_error_px: Option<f64>,
}

impl ModelFigures {
    /// Of one reconstruction.
    pub fn new(model: &Reconstruction) -> Self {
        let num_observations: usize = model.points.values().map(|p| p.track.len()).sum();
        let num_points = model.points.len();
        Self {
            num_images: model.images.len(),
            num_points,
            num_observations,
            mean_track_length: (num_points > 0).then(|| num_observations as f64 / num_points as f64),
            mean_reprojection_error_px: model.mean_reprojection_error_px(),
        }
    }
}

/// Compares two reconstructions by the images that both have, paired by name; the similarity is found as for an
/// evaluation ([`registration`]), with the up and forward vectors as long as A's centres are spread.
pub fn compare(a: &Reconstruction, b: &Reconstruction) -> Comparison {
    let names: std::collections::BTreeMap<_, _> =
        a.images.values().map(|image| (image.name.as_str(), image.cam_from_world)).collect();
    let pair = |image: &crate::scene::Image| Some((image.cam_from_world, *names.get(image.name.as_str())?));
    let pairs: Vec<_> = b.images.values().filter_map(pair).collect();
    let spread = registration::spread(&pairs.iter().map(|(_, cam)| cam.center()).collect::<Vec<_>>());
    let a_from_b = Outcome::from(registration::register_with(&pairs, spread));
    let cameras = compare_cameras(&pairs, a_from_b.as_ref());
    let relative_center_rmse = cameras.as_ref().ok().map(|c| c.center_rmse_m / spread);
    let num_common_images = pairs.len();
    Comparison {
        a: ModelFigures::new(a),
        b: ModelFigures::new(b),
        num_common_images,
        a_from_b,
        cameras,
        relative_center_rmse,
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let number = |v: Option<f64>| v.map_or("–".into(), |v| format!("{v:.3}"));
        let mut row = |label: &str, a: String, b: String| writeln!(f, "{label:<24}{a:>14}{b:>14}");
        let (a, b) = (&self.a, &self.b);
        row("", "A".into(), "B".into())?;
        row("images", a.num_images.to_string(), b.num_images.to_string())?;
        row("points", a.num_points.to_string(), b.num_points.to_string())?;
        row("observations", a.num_observations.to_string(), b.num_observations.to_string())?;
        row("mean track length", number(a.mean_track_length), number(b.mean_track_length))?;
        row("mean error, px", number(a.mean_reprojection_error_px), number(b.mean_reprojection_error_px))?;
        writeln!(f, "\ncommon images           {:>14}", self.num_common_images)?;
        match (self.a_from_b.as_ref(), self.cameras.as_ref()) {
            (Ok(registration), Ok(cameras)) => {
                writeln!(f, "scale, A per B          {:>14.6}", registration.world_from_background.scale)?;
                writeln!(f, "centre RMSE, units of A {:>14.6}", cameras.center_rmse_m)?;
                writeln!(
                    f,
                    "  over A's spread       {:>14}",
                    number(self.relative_center_rmse.map(|r| 100.0 * r)) + " %"
                )?;
                writeln!(f, "rotation, mean          {:>13.4}°", cameras.rotation_mean_deg)?;
                writeln!(f, "rotation, at most       {:>13.4}°", cameras.rotation_max_deg)
            }
            (Err(reason), _) | (_, Err(reason)) => writeln!(f, "cannot be aligned: {reason}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion, Vector3};

    use super::*;
    use crate::math::{Rigid3, Sim3};
    use crate::scene::{CameraId, Image, ImageId};

    fn flight(num_images: u32, center: impl Fn(f64) -> Point3<f64>) -> Reconstruction {
        let mut model = Reconstruction::default();
        for k in 0..num_images {
            let t = f64::from(k);
            let rotation = UnitQuaternion::from_euler_angles(0.1 * t, -0.05 * t, 0.02 * t);
            let cam_from_world = Rigid3::from_rotation_and_center(rotation, center(t));
            let name = format!("{k:06}.jpg");
            let image = Image { name, camera: CameraId(1), cam_from_world, observations: vec![] };
            model.images.insert(ImageId(k + 1), image);
        }
        model
    }

    #[test]
    fn a_similarity_apart_is_no_difference() {
        let a = flight(12, |t| Point3::new(1000.0 * t, 40.0 * t * t, 500.0 * t.sin()));
        let mut b = a.clone();
        let moved = Sim3::new(1e-4, UnitQuaternion::from_euler_angles(1.0, 2.0, 0.3), Vector3::new(1.0, 2.0, 3.0));
        b.transform(&moved);
        b.images.remove(&ImageId(3));
        let comparison = compare(&a, &b);
        assert_eq!((comparison.num_common_images, comparison.a.num_images), (11, 12));
        assert!((comparison.a_from_b.as_ref().unwrap().world_from_background.scale - 1e4).abs() < 1e-6);
        assert!(comparison.relative_center_rmse.unwrap() < 1e-12);
        assert!(comparison.cameras.as_ref().unwrap().rotation_max_deg < 1e-5);
        assert!(comparison.to_string().contains("common images"));
    }

    #[test]
    fn a_tiny_scene_on_a_line_is_aligned_too() {
        let a = flight(6, |t| Point3::new(1e-4 * t, 0.0, 0.0));
        let mut b = a.clone();
        b.transform(&Sim3::new(7.0, UnitQuaternion::from_euler_angles(0.4, 0.0, 1.0), Vector3::zeros()));
        let comparison = compare(&a, &b);
        assert!(comparison.relative_center_rmse.unwrap() < 1e-9);
        assert!(comparison.cameras.as_ref().unwrap().rotation_max_deg < 1e-5);
    }

    #[test]
    fn what_has_nothing_in_common_says_so() {
        let a = flight(5, |t| Point3::new(t, t * t, 0.0));
        let comparison = compare(&a, &Reconstruction::default());
        assert!(comparison.a_from_b.as_ref().is_err() && comparison.cameras.as_ref().is_err());
        assert!(comparison.to_string().contains("cannot be aligned"));
        let json = serde_json::to_string(&comparison).unwrap();
        assert_eq!(serde_json::from_str::<Comparison>(&json).unwrap(), comparison);
    }
}
