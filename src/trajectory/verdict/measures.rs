//! Measures of a trajectory, computed once for all checks.

use nalgebra::{Point3, Vector3};

use super::Candidate;
use crate::math::{median, quantile};
use crate::scene::{FrameId, GroundPlane, Image, ImageId, ObjectPose, Reconstruction, Rect};
use crate::trajectory::assemble::HALF_WINDOW_S;
use crate::trajectory::heading::forward_axis;
use crate::trajectory::object_center;
use crate::trajectory::views::common_height_std;

/// Quantile of the points' heights that is the vehicle's bottom: a few points are stray.
const BOTTOM: f64 = 0.02;
/// Quantile of the points that is its top, and the end of its length.
const MOST: f64 = 0.95;

/// Measures of a trajectory. Lengths are in units of the background; `None` if unknown.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Measures {
    /// Height of the vehicle's top over the ground: the median over the frames with a plane.
    pub(super) height: Option<f64>,
    /// Height of its bottom over the ground: the median over the same frames.
    pub(super) bottom: Option<f64>,
    /// Standard deviation of the planes' height that all frames share: the median.
    pub(super) ground_std: f64,
    /// Height of its center over the ground in the frames whose plane is accurate enough, ascending in time.
    pub(super) center_heights: Vec<f64>,
    /// Longest extent: twice the distance from their center within which nearly all points are.
    pub(super) length: Option<f64>,
    /// Longer side of the box around its points in the image, pixels: the median over frames.
    pub(super) pixels: Option<f64>,
    /// Longest extent over the apparent extent in the image at its distance: the median over frames.
    ///
    /// About 1 from the side, length over width from behind; more for a model stretched along the line of sight.
    pub(super) stretch: Option<f64>,
    /// Sine of the angle between the line of sight and the vehicle's ground: the median over frames; 0 where no plane
    /// is known.
    pub(super) dip_sine: f64,
    /// Lengths of the raw and of the smoothed path.
    pub(super) path_lengths: [f64; 2],
    /// Maximum distance of a position from the first one.
    pub(super) reach: f64,
    /// Share of the path that leads backward, against the heading; `None` without a heading.
    pub(super) backwards: Option<f64>,
    /// Median distance of a position from the smoothed path.
    pub(super) jitter: Option<f64>,
    /// Median length of a step between consecutive positions.
    pub(super) step: f64,
    /// The most prominent step.
    pub(super) jump: Jump,
    /// The most prominent turn, radians.
    pub(super) turn: Jump,
    /// Median speed, units of the background per unit of time.
    pub(super) speed: Option<f64>,
}

/// Step, or turn, that is larger than its neighbors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Jump {
    /// Excess over the step expected from the largest rate of the four neighbors; 0 for none.
    pub(super) beyond: f64,
    /// The frames before and after.
    pub(super) frames: [u32; 2],
}

impl Measures {
    pub(super) fn of(candidate: &Candidate) -> Self {
        let (poses, object) = (&candidate.trajectory.poses, candidate.object);
        let points = object.finite_positions();
        let over_ground = over_ground(candidate, &points);
        let column = |k: usize| over_ground.iter().map(|(_, heights)| heights[k]).collect::<Vec<f64>>();
        let height = median(column(2));
        let positions: Vec<Vector3<f64>> = poses.iter().map(|pose| Vector3::from(pose.position)).collect();
        let steps: Vec<f64> = positions.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
        let smooth = smoothed(poses, &positions);
        Self {
            height,
            bottom: median(column(0)),
            ground_std: common_height_std(poses.iter().filter_map(|pose| candidate.planes.get(&pose.frame))),
            center_heights: center_heights(candidate, &over_ground, height.unwrap_or(0.0)),
            length: length(&points).map(|length| length * candidate.trajectory.scale.ratio),
            stretch: length(&points).and_then(|length| stretch(object, length)),
            dip_sine: dip_sine(candidate),
            pixels: median(object.images.values().filter_map(longer_side).collect()),
            path_lengths: [steps.iter().sum(), smooth.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()],
            reach: positions.iter().map(|position| (position - positions[0]).norm()).fold(0.0, f64::max),
            backwards: backwards(poses),
            jitter: median(
                positions.iter().zip(&smooth).map(|(position, smooth)| (position - smooth).norm()).collect(),
            ),
            jump: jump(poses, ObjectPose::distance_to),
            turn: jump(poses, |a, b| a.world_from_object.rotation.angle_to(&b.world_from_object.rotation)),
            speed: speed(poses, &steps),
            step: median(steps).unwrap_or(0.0),
        }
    }

    /// A length in vehicle heights over the ground; `None` unless that height is positive.
    pub(super) fn in_heights(&self, length: f64) -> Option<f64> {
        let height = self.height.filter(|height| *height > 0.0)?;
        Some(length / height).filter(|multiple| multiple.is_finite())
    }
}

/// Heights of bottom, center and top over the ground, for every frame with a plane.
fn over_ground(candidate: &Candidate, points: &[Point3<f64>]) -> Vec<(FrameId, [f64; 3])> {
    let is_by_camera_path = candidate.trajectory.scale.camera_path.is_some();
    let of_frame = |pose: &ObjectPose| {
        let plane: &GroundPlane = candidate.planes.get(&pose.frame)?;
        let height = |point: &Point3<f64>| plane.signed_distance(pose.world_from_object * *point);
        let mut heights: Vec<f64> = points.iter().map(height).collect();
        let [bottom, middle, top] = [BOTTOM, 0.5, MOST].map(|share| finite_quantile(&mut heights, share));
        let (bottom, middle, top) = (bottom?, middle?, top?);
        // A vehicle placed by the camera path may be lower than the ground around it (a terrace, a curb).
        let ground = if is_by_camera_path { bottom.min(0.0) } else { 0.0 };
        Some((pose.frame, [bottom, middle, top].map(|height| height - ground)))
    };
    candidate.trajectory.poses.iter().filter_map(of_frame).collect()
}

/// Heights of the center over the planes whose own standard deviation is a small share of the height of the top.
fn center_heights(candidate: &Candidate, over_ground: &[(FrameId, [f64; 3])], height: f64) -> Vec<f64> {
    let own_std = |frame: &FrameId| candidate.planes.get(frame).map_or(0.0, GroundPlane::own_height_std);
    // Standard deviation of a plane's own height, as a share of the height of the vehicle's top, beyond which it does
    // not show whether the vehicle rises or sinks.
    let tells = |frame: &FrameId| !(own_std(frame) > 0.08 * height);
    over_ground.iter().filter(|(frame, _)| tells(frame)).map(|(_, [_, middle, _])| *middle).collect()
}

/// Quantile; `None` of no values, or if one is not finite.
fn finite_quantile(values: &mut [f64], share: f64) -> Option<f64> {
    values.iter().all(|value| value.is_finite()).then(|| quantile(values, share))?
}

/// Twice the distance from the center within which nearly all points are, in the frame of the points.
fn length(points: &[Point3<f64>]) -> Option<f64> {
    let along = |axis: usize| median(points.iter().map(|point| point[axis]).collect());
    let middle = Point3::new(along(0)?, along(1)?, along(2)?);
    let mut distances: Vec<f64> = points.iter().map(|point| (point - middle).norm()).collect();
    Some(2.0 * finite_quantile(&mut distances, MOST)?)
}

/// Longer side of the box around the points observed in an image, pixels; `None` for fewer than three.
fn longer_side(image: &Image) -> Option<f64> {
    let seen = || image.observations.iter().filter(|seen| seen.point.is_some()).map(|seen| &seen.pixel);
    let bounds = Rect::around(seen()).filter(|_| seen().count() >= 3)?;
    Some(bounds.extent_px()).filter(|side| side.is_finite())
}

fn dip_sine(candidate: &Candidate) -> f64 {
    let of_frame = |pose: &ObjectPose| {
        let plane = candidate.planes.get(&pose.frame)?;
        let image = candidate.background.images.get(&ImageId::from(pose.frame))?;
        let ray = Vector3::from(pose.position) - image.cam_from_world.center().coords;
        Some((-plane.normal.dot(&ray) / ray.norm()).clamp(0.0, 1.0))
    };
    median(candidate.trajectory.poses.iter().filter_map(of_frame).collect()).unwrap_or(0.0)
}

/// Ratio of the object's length to its apparent length.
///
/// * `length` – in the object's unit.
fn stretch(object: &Reconstruction, length: f64) -> Option<f64> {
    let middle = object_center(object);
    let of_image = |image: &Image| {
        let distance = (image.cam_from_world * middle).coords.norm();
        let apparent = longer_side(image)? / object.camera_of(image).mean_focal() * distance;
        Some(length / apparent).filter(|stretch| stretch.is_finite())
    };
    median(object.images.values().filter_map(of_image).collect())
}

/// Moving average of the positions: those within half a second and at least the next two, symmetric in number.
fn smoothed(poses: &[ObjectPose], positions: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let near = |i: usize, k: usize| i.abs_diff(k) <= 2 || (poses[i].time_s - poses[k].time_s).abs() <= HALF_WINDOW_S;
    let smooth = |k: usize| {
        let before = (0..k).rev().take_while(|&i| near(i, k)).count();
        let after = (k + 1..positions.len()).take_while(|&i| near(i, k)).count();
        // The same number on either side, otherwise the ends would be moved inwards.
        let reach = before.min(after);
        let window = &positions[k - reach..=k + reach];
        window.iter().sum::<Vector3<f64>>() / window.len() as f64
    };
    (0..positions.len()).map(smooth).collect()
}

/// Share of the path that leads against the heading.
fn backwards(poses: &[ObjectPose]) -> Option<f64> {
    let forward = forward_axis(poses)?;
    let ahead = |pair: &[ObjectPose]| {
        let step = Vector3::from(pair[1].position) - Vector3::from(pair[0].position);
        step.dot(&(pair[0].world_from_object.rotation * forward.into_inner()))
    };
    let steps: Vec<f64> = poses.windows(2).map(ahead).collect();
    let total: f64 = steps.iter().map(|step| step.abs()).sum();
    let back: f64 = steps.iter().filter(|step| **step < 0.0).map(|step| -step).sum();
    (total > 0.0).then(|| back / total).filter(|share| share.is_finite())
}

/// The most prominent step.
///
/// * `between` – distance between two poses.
fn jump(poses: &[ObjectPose], between: impl Fn(&ObjectPose, &ObjectPose) -> f64) -> Jump {
    let duration = |pair: &[ObjectPose]| f64::from((pair[1].frame.0 - pair[0].frame.0).max(1));
    let steps: Vec<(f64, f64)> = poses.windows(2).map(|pair| (between(&pair[0], &pair[1]), duration(pair))).collect();
    let jump = |k: usize| {
        let neighbors = (k.saturating_sub(2)..(k + 3).min(steps.len())).filter(|&i| i != k);
        let expected = neighbors.map(|i| steps[i].0 / steps[i].1).fold(0.0, f64::max) * steps[k].1;
        Jump { beyond: steps[k].0 - expected, frames: [poses[k].frame.0, poses[k + 1].frame.0] }
    };
    let jumps = (0..steps.len()).map(jump).filter(|jump| steps.len() > 2 && jump.beyond > 0.0);
    jumps.max_by(|a, b| a.beyond.total_cmp(&b.beyond)).unwrap_or_default()
}

/// Median speed of all steps with a positive duration.
fn speed(poses: &[ObjectPose], steps: &[f64]) -> Option<f64> {
    let times = poses.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).zip(steps).filter(|(time, _)| *time > 0.0);
    median(times.map(|(time, step)| step / time).filter(|speed| speed.is_finite()).collect())
}
