//! Degenerate and weak motion: detection and report.
//!
//! - A **stationary** camera displaces no point.
//! - A camera that only **rotates** displaces all points by one homography, H = K R K⁻¹: K⁻¹ H K is a rotation for some
//!   focal length. Five-point geometry fits such pairs as well, with any translation, and points far away; they must
//!   not initialize a map.
//! - A **plane** is displaced by a homography too, but not by one of that kind. With known intrinsics it is
//!   reconstructed like any other scene; without, the focal length is weakly determined.
//! - **Forward** motion is reconstructed, but points near the image center are far less certain in depth.

use std::fmt;

use nalgebra::{Matrix3, Vector3};

use super::Intrinsics;
use super::map::Map;
use crate::geometry::two_view::TwoViewGeometry;
use crate::math::{lower_quantile, symmetric_eigen};

/// Class of the motion between two views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairMotion {
    /// No displacement.
    Stationary,
    /// Pure rotation of the camera.
    PureRotation,
    /// Any other motion.
    General,
}

/// Classifies a pair with displacement by its homography.
pub fn classify(geometry: &TwoViewGeometry, intrinsics: Intrinsics) -> PairMotion {
    // The rest are outliers of the homography, as any estimate has.
    let turn = geometry.homography.is_some_and(|h| geometry.homography_share >= 0.9 && is_rotation(&h, intrinsics));
    if turn { PairMotion::PureRotation } else { PairMotion::General }
}

/// Returns true if a homography between normalized positions is a rotation, for the given or for any focal length.
fn is_rotation(homography: &Matrix3<f64>, intrinsics: Intrinsics) -> bool {
    // Search range of the focal length's logarithm, prior standard deviations: two and a margin, from 0.4 to 2.5 times
    // a guess.
    const SPAN: f64 = 2.29;
    // Step of the focal length's logarithm: 40 to either side of a guess.
    const STEP: f64 = 0.022907;
    let steps = (SPAN * intrinsics.focal / STEP).round() as i32;
    let scales: Vec<f64> = (-steps..=steps).map(|k| (STEP * f64::from(k)).exp()).collect();
    let residual = |&scale: &f64| {
        let s = Matrix3::from_diagonal(&Vector3::new(scale, scale, 1.0));
        let Some(inverse) = s.try_inverse() else { return f64::INFINITY };
        let m = inverse * homography * s;
        let determinant = m.determinant();
        let m = m / determinant.cbrt();
        (m.transpose() * m - Matrix3::identity()).norm()
    };
    // For a plane that is observed from two directions it is about their angle: this is half a degree.
    scales.iter().map(residual).fold(f64::INFINITY, f64::min) <= 0.008
}

/// Number of pairs of views by their motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Survey {
    stationary: usize,
    rotating: usize,
    total: usize,
}

impl Survey {
    /// Counts a pair.
    pub fn add(&mut self, motion: PairMotion) {
        self.total += 1;
        match motion {
            PairMotion::Stationary => self.stationary += 1,
            PairMotion::PureRotation => self.rotating += 1,
            PairMotion::General => (),
        }
    }

    /// Reason that no map can be initialized, if it is the motion.
    pub fn failure(&self) -> Option<String> {
        // A clear majority of the pairs tried.
        let is_most = |count: usize| count > 0 && count as f64 >= 0.7 * self.total as f64;
        if is_most(self.stationary) {
            Some(format!(
                "camera stationary: no motion in {} of {} pairs of frames; the camera must move around the target",
                self.stationary, self.total
            ))
        } else if is_most(self.rotating) || is_most(self.rotating + self.stationary) {
            Some(format!(
                "camera only rotates ({} of {} pairs of frames), which gives no depth; it must translate",
                self.rotating, self.total
            ))
        } else {
            None
        }
    }
}

/// Weakness of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ModelWeakness {
    /// All points lie near one plane.
    PlanarScene {
        /// True if the focal length was to be estimated from it.
        intrinsics_refined: bool,
    },
    /// The camera moves along its line of sight.
    ForwardMotion,
    /// The motion hardly determines the focal length.
    LooseFocalLength {
        /// Standard deviation, percent.
        percent: f64,
    },
}

impl fmt::Display for ModelWeakness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PlanarScene { intrinsics_refined: false } => write!(f, "all points are near one plane"),
            Self::PlanarScene { intrinsics_refined: true } => {
                write!(f, "all points are near one plane, where the focal length is uncertain; give --intrinsics")
            }
            Self::ForwardMotion => {
                write!(f, "camera moves along its line of sight: points near the image center have uncertain depth")
            }
            Self::LooseFocalLength { percent } => {
                // Beyond this the number itself means nothing.
                if *percent < 20.0 {
                    write!(f, "focal length uncertain (±{percent:.1} %)")?;
                } else {
                    write!(f, "focal length almost undetermined by the motion")?;
                }
                write!(f, ": higher distortion terms are not estimated; give --intrinsics")
            }
        }
    }
}

/// Weaknesses of a finished map by its scene and its motion.
pub fn remarks_on(map: &Map<'_>) -> Vec<ModelWeakness> {
    let mut out = Vec::new();
    if is_planar(map) {
        out.push(ModelWeakness::PlanarScene { intrinsics_refined: map.unknown_cameras().next().is_some() });
    }
    if is_forward(map) {
        out.push(ModelWeakness::ForwardMotion);
    }
    out
}

/// Returns true if nine points in ten are within a hundredth of the median distance from a plane.
fn is_planar(map: &Map<'_>) -> bool {
    let mut points: Vec<Vector3<f64>> =
        (0..map.tracks.len()).filter_map(|t| Some(map.point(t)?.position.coords)).collect();
    let Some(center) = map.registered().next().and_then(|v| map.poses[v]).map(|pose| pose.center().coords) else {
        return false;
    };
    if points.len() < 20 {
        return false;
    }
    let mut distances: Vec<f64> = points.iter().map(|p| (p - center).norm()).collect();
    let distance = lower_quantile(&mut distances, 0.5).unwrap_or_default();
    // Three rounds of fitting, each on the nearest nine tenths: points far off the plane would tilt it.
    let mut thickness = f64::INFINITY;
    for _ in 0..3 {
        let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        let scatter = points.iter().fold(Matrix3::zeros(), |s, p| s + (p - mean) * (p - mean).transpose());
        let Some(eigen) = symmetric_eigen(scatter) else { return false };
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        let off: Vec<f64> = points.iter().map(|p| (p - mean).dot(&normal).abs()).collect();
        let Some(limit) = lower_quantile(&mut off.clone(), 0.9) else { return false };
        thickness = thickness.min(limit);
        points = points.iter().zip(&off).filter(|(_, d)| **d <= 3.0 * limit).map(|(p, _)| *p).collect();
    }
    // Points within a hundredth of their distance are a plane as far as a pair of views shows.
    thickness <= 0.01 * distance
}

/// Returns true if nearly all displacements from view to view are along the line of sight.
fn is_forward(map: &Map<'_>) -> bool {
    let poses: Vec<_> = map.registered().filter_map(|v| map.poses[v]).collect();
    let steps: Vec<Vector3<f64>> = poses.windows(2).map(|w| w[1].center() - w[0].center()).collect();
    let longest = steps.iter().map(Vector3::norm).fold(0.0, f64::max);
    let along = poses.iter().zip(&steps).filter(|(_, step)| step.norm() > 0.1 * longest).map(|(pose, step)| {
        let forward = pose.rotation.inverse() * Vector3::z();
        let angle = forward.angle(step);
        // Eleven degrees: parallax is then a fifth of that of sideways motion, at most.
        angle.min(std::f64::consts::PI - angle) <= 0.2
    });
    let along: Vec<bool> = along.collect();
    along.len() >= 2 && along.iter().filter(|&&a| a).count() as f64 >= 0.9 * along.len() as f64
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Unit};

    use super::*;

    #[test]
    fn a_homography_is_a_rotation_only_for_the_right_focal_length() {
        let turn = *Rotation3::from_axis_angle(&Unit::new_normalize(Vector3::new(0.2, 1.0, 0.1)), 0.3).matrix();
        assert!(is_rotation(&turn, Intrinsics::FIXED));
        // Normalized with a focal length that is 1.4 times too short.
        let s = Matrix3::from_diagonal(&Vector3::new(1.4, 1.4, 1.0));
        let guessed = s * turn * s.try_inverse().unwrap();
        assert!(!is_rotation(&guessed, Intrinsics::FIXED) && is_rotation(&guessed, Intrinsics::GUESSED));
        // A plane two units away, the camera moved aside by a tenth of a unit, and turned.
        let normal = Vector3::new(0.1, 0.2, 1.0).normalize();
        let plane = turn + Vector3::new(0.1, 0.02, 0.0) * normal.transpose() / 2.0;
        assert!(!is_rotation(&plane, Intrinsics::FIXED) && !is_rotation(&plane, Intrinsics::GUESSED));
    }

    #[test]
    fn the_motion_is_the_reason_only_where_most_pairs_agree() {
        let of = |stationary: usize, rotating: usize, total: usize| Survey { stationary, rotating, total }.failure();
        assert!(of(9, 0, 10).unwrap().contains("camera stationary"));
        assert!(of(1, 8, 10).unwrap().contains("only rotates"));
        assert!(of(2, 3, 10).is_none() && of(0, 0, 0).is_none());
    }

    #[test]
    fn remarks_read_well() {
        let loose = |percent| ModelWeakness::LooseFocalLength { percent }.to_string();
        assert!(loose(2.31).starts_with("focal length uncertain (±2.3 %):"));
        assert!(loose(100.0).starts_with("focal length almost undetermined by the motion:"));
    }
}
