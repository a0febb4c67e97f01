//! Difference between two runs of the same clip, where no truth is known.
//!
//! The unit of each run is arbitrary: that of the second is taken to the first by the spreads of the camera centres
//! that both have. A vehicle of one run is that of the other which is seen in the same direction. What is compared is
//! its distance from the camera, ln(d₂ / d₁), the median over the frames, against √(σ₁² + σ₂²) of the stated relative
//! deviations. Errors that both runs have in common do not show: the spread is a lower bound of the error.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::math::{Rigid3, centroid, median};
use crate::scene::{FrameId, ObjectId, ObjectTrajectory, Trajectories, Trust};

/// Frames that two trajectories must have in common.
const LEAST_FRAMES: usize = 3;
/// Angle between the directions in which the same vehicle is seen, radians: half a degree.
const SAME_DIRECTION: f64 = 0.009;

/// Result of a run.
#[derive(Clone, Debug)]
pub struct RunResult {
    /// Its cameras.
    pub cam_from_world: BTreeMap<FrameId, Rigid3>,
    /// Its trajectories.
    pub trajectories: Trajectories,
}

/// A vehicle in two runs of one clip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Name of the clip.
    pub clip: String,
    /// Name of the variant that is compared with the clip as it is.
    pub variant: String,
    /// The vehicle in the clip as it is, and in the variant.
    pub objects: [ObjectId; 2],
    /// Frames in which both runs place it.
    pub num_frames: usize,
    /// ln(d₂ / d₁), the median over the frames.
    pub difference: f64,
    /// √(σ₁² + σ₂²); `None` where one of the runs states none.
    pub relative_std: Option<f64>,
    /// True if one of the runs marks its ratio as undetermined.
    pub degenerate: bool,
    /// The worse one of the two verdicts.
    pub verdict: Option<Trust>,
}

impl Spread {
    /// The difference in stated deviations; `None` where one of the runs makes no statement.
    pub fn deviations(&self) -> Option<f64> {
        let std = self.relative_std.filter(|std| *std > 0.0 && !self.degenerate)?;
        Some(self.difference.abs() / std)
    }
}

/// The vehicles that both runs place. Names of clip and variant are the caller's to fill in.
pub fn spreads(first: &RunResult, second: &RunResult) -> Vec<Spread> {
    let Some(unit) = first_per_second(first, second) else { return Vec::new() };
    let best = |object: &ObjectTrajectory| {
        let others = second.trajectories.objects.iter();
        let pairs = others.filter_map(|other| Some((other, RelativeVehicle::new(first, second, object, other)?)));
        let same = pairs.filter(|(_, sighted)| sighted.angle < SAME_DIRECTION);
        let (other, sighted) =
            same.max_by_key(|(other, sighted)| (sighted.ratios.len(), std::cmp::Reverse(other.id)))?;
        let num_frames = sighted.ratios.len();
        let difference = (unit * median(sighted.ratios)?).ln();
        difference.is_finite().then(|| spread(object, other, num_frames, difference))
    };
    first.trajectories.objects.iter().filter_map(best).collect()
}

fn spread(object: &ObjectTrajectory, other: &ObjectTrajectory, num_frames: usize, difference: f64) -> Spread {
    let std = |object: &ObjectTrajectory| object.scale.std.map(|std| std / object.scale.ratio);
    let state = |object: &ObjectTrajectory| object.verdict.as_ref().map(|verdict| verdict.state);
    Spread {
        clip: String::new(),
        variant: String::new(),
        objects: [object.id, other.id],
        num_frames,
        difference,
        relative_std: std(object).zip(std(other)).map(|(a, b)| a.hypot(b)).filter(|std| std.is_finite()),
        degenerate: object.scale.degenerate || other.scale.degenerate,
        verdict: state(object).max(state(other)),
    }
}

/// Units of the first run per unit of the second one.
fn first_per_second(first: &RunResult, second: &RunResult) -> Option<f64> {
    let both = || first.cam_from_world.keys().filter(|id| second.cam_from_world.contains_key(*id));
    let spread = |found: &RunResult| {
        let centers: Vec<Point3<f64>> = both().map(|id| found.cam_from_world[id].center()).collect();
        let mean = centroid(&centers);
        centers.iter().map(|center| (center - mean).norm_squared()).sum::<f64>().sqrt()
    };
    let unit = spread(first) / spread(second);
    (both().count() >= LEAST_FRAMES && unit.is_finite() && unit > 0.0).then_some(unit)
}

/// A vehicle of each run as their cameras see it.
struct RelativeVehicle {
    /// Median angle between both directions.
    angle: f64,
    /// Distance in the second run over that in the first one, frame by frame, each in its own unit.
    ratios: Vec<f64>,
}

impl RelativeVehicle {
    fn new(first: &RunResult, second: &RunResult, object: &ObjectTrajectory, other: &ObjectTrajectory) -> Option<Self> {
        let (one, two) = (in_camera(first, object), in_camera(second, other));
        let both: Vec<(&Vector3<f64>, &Vector3<f64>)> =
            one.iter().filter_map(|(id, place)| Some((place, two.get(id)?))).collect();
        let angle = median(both.iter().map(|(a, b)| a.angle(b)).filter(|angle| angle.is_finite()).collect())?;
        let ratios: Vec<f64> = both.iter().map(|(a, b)| b.norm() / a.norm()).filter(|r| r.is_finite()).collect();
        (ratios.len() >= LEAST_FRAMES).then_some(Self { angle, ratios })
    }
}

/// Where a vehicle is in the frame of the camera, frame by frame.
fn in_camera(found: &RunResult, object: &ObjectTrajectory) -> BTreeMap<FrameId, Vector3<f64>> {
    let place = |frame: &FrameId, position: [f64; 3]| {
        let camera = found.cam_from_world.get(frame)?;
        Some((*frame, (*camera * Point3::from(position)).coords))
    };
    object.poses.iter().filter_map(|pose| place(&pose.frame, pose.position)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Sim3;
    use crate::scene::{ObjectPose, ScaleEstimate, ScaleMethod, Unit};
    use nalgebra::UnitQuaternion;

    /// A camera that drives along x, and a car ahead; lengths in this unit, the car's distance wrong by a factor.
    fn found(unit: f64, error: f64) -> RunResult {
        let camera = |k: u32| Point3::new(f64::from(k) * unit, 0.0, 0.0);
        let pose = |k: u32| {
            let ahead = Vector3::new(1.0, 0.2, 20.0 + 0.3 * f64::from(k)) * unit * error;
            ObjectPose {
                frame: FrameId(k),
                name: String::new(),
                time_s: 0.0,
                position: (camera(k).coords + ahead).into(),
                world_from_object: Sim3::identity(),
                metric: None,
            }
        };
        let scale = ScaleEstimate { std: Some(0.06), ..ScaleEstimate::new(2.0, ScaleMethod::Joint) };
        let poses = (0..8).map(pose).collect();
        let car = ObjectTrajectory { poses, ..ObjectTrajectory::new(ObjectId(1), "car", 1.0, scale) };
        let cameras =
            (0..8).map(|k| (FrameId(k), Rigid3::from_rotation_and_center(UnitQuaternion::identity(), camera(k))));
        let trajectories =
            Trajectories { unit: Unit::Background, metric: None, objects: vec![car], ground_tracks: Vec::new() };
        RunResult { cam_from_world: cameras.collect(), trajectories }
    }

    #[test]
    fn units_do_not_count_and_distances_do() {
        let found = spreads(&found(1.0, 1.0), &found(7.0, 1.1));
        assert_eq!(found.len(), 1);
        assert!((found[0].difference - 1.1f64.ln()).abs() < 1e-9, "{found:?}");
        assert_eq!(found[0].num_frames, 8);
        let std = found[0].relative_std.unwrap();
        assert!((std - 0.03 * 2f64.sqrt()).abs() < 1e-12);
        assert!((found[0].deviations().unwrap() - 1.1f64.ln() / std).abs() < 1e-9);
    }

    #[test]
    fn other_vehicles_and_other_clips_are_not_compared() {
        let (one, mut two) = (found(1.0, 1.0), found(1.0, 1.0));
        for pose in &mut two.trajectories.objects[0].poses {
            pose.position[0] += 3.0;
        }
        assert!(spreads(&one, &two).is_empty());
        two.cam_from_world.clear();
        assert!(spreads(&one, &two).is_empty());
    }
}
