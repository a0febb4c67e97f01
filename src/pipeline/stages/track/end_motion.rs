//! Motion of track pieces over the ground at their ends, and agreement of two pieces.
//!
//! The motion at the end of one piece predicts the position of the next one.

use std::collections::BTreeMap;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::motion::View;
use crate::pipeline::stages::motion::World;
use crate::scene::{BoundingBox, FrameId, Mask};

/// Duration of a piece's beginning or end from which its motion there is estimated, seconds.
const END_S: f64 = 1.0;
/// Minimum number of frames of that estimate, where the piece has them.
const MIN_END_FRAMES: usize = 6;
/// Share of the largest mask's area below which a mask is partly occluded.
const MIN_WHOLE_SHARE: f64 = 0.75;
/// Tolerance of the predicted position without a gap, sides of the object: the next car at the curb is more than one
/// side away.
const TOLERATED_SIDES: f64 = 0.6;
/// Growth of the tolerance with the gap, sides of the object per second.
const TOLERATED_SIDES_PER_S: f64 = 0.1;
/// Growth of the tolerance with the predicted displacement, as a share of it: vehicles brake and turn.
const TOLERATED_SHARE: f64 = 0.2;

/// Maximum angle between the directions of two views of one vehicle that must have points in common, radians: features
/// of a car are recognized up to some 40°.
const MAX_TURN: f64 = 0.7;

/// Agreement of a piece with the one that it may continue.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Distance from the predicted position, as a share of the tolerance.
    pub(super) place: f64,
    /// Ratio of areas at one distance.
    pub(super) size: f64,
    /// True if the views show different sides of the vehicle.
    pub(super) is_turned: bool,
}

/// Position of an object in one frame, by its mask.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MaskObservation {
    pub(super) frame: FrameId,
    pub(super) time_s: f64,
    bounds: BoundingBox,
    area: f64,
}

impl MaskObservation {
    /// `None` for an empty mask.
    pub(super) fn of(frame: FrameId, time_s: f64, mask: &Mask) -> Option<Self> {
        Some(Self { frame, time_s, bounds: mask.bounding_box()?, area: mask.area_px2() as f64 })
    }

    /// Contact point: the middle of its lower side, pixels.
    fn contact_point(&self) -> [f64; 2] {
        [f64::from(self.bounds.x0 + self.bounds.x1) / 2.0, f64::from(self.bounds.y1)]
    }

    /// Side of a square as large as its box, pixels.
    pub(super) fn side_px(&self) -> f64 {
        (f64::from(self.bounds.width()) * f64::from(self.bounds.height())).sqrt()
    }
}

/// Motion of a track at one of its ends.
#[derive(Clone, Debug)]
pub(super) struct EndMotion {
    /// The fully visible observation nearest to the end, as far as sizes show it.
    pub(super) observation: MaskObservation,
    /// The largest observation near the end.
    pub(super) largest: MaskObservation,
    /// Position on the ground there and velocity, in the background's frame and per second.
    on_ground: Option<(Point3<f64>, Vector3<f64>)>,
}

impl EndMotion {
    /// Position on the ground when it was largest.
    fn largest_on_ground(&self) -> Option<Point3<f64>> {
        let (place, velocity) = self.on_ground?;
        Some(place + velocity * (self.largest.time_s - self.observation.time_s))
    }
}

/// Frames of a piece from which its motion at an end is estimated.
///
/// * `frames` – id and time of those with a mask, from the end on.
pub(super) fn end_frames(frames: &[(FrameId, f64)]) -> &[(FrameId, f64)] {
    let is_near = |k: usize| k < MIN_END_FRAMES || (frames[k].1 - frames[0].1).abs() <= END_S;
    &frames[..(0..frames.len()).take_while(|k| is_near(*k)).count()]
}

/// Motion of an object at the end of its track.
///
/// * `observations` – in the frames that [`end_frames`] selects, from the end on.
pub(super) fn estimate_end(observations: &[MaskObservation], world: Option<&Ground<'_>>) -> Option<EndMotion> {
    let largest = *observations.iter().max_by(|a, b| a.area.total_cmp(&b.area))?;
    let whole: Vec<MaskObservation> =
        observations.iter().filter(|observation| observation.area >= MIN_WHOLE_SHARE * largest.area).copied().collect();
    let observation = *whole.first()?;
    let positions = whole.iter().filter_map(|s| Some((s.time_s - observation.time_s, world?.position(s)?)));
    Some(EndMotion { observation, largest, on_ground: fit_line(&positions.collect::<Vec<_>>()) })
}

/// Position at time zero and velocity, by least squares; the velocity is zero for a single position.
fn fit_line(positions: &[(f64, Point3<f64>)]) -> Option<(Point3<f64>, Vector3<f64>)> {
    let n = positions.len() as f64;
    let time = positions.iter().map(|(t, _)| t).sum::<f64>() / n;
    let place = positions.iter().fold(Vector3::zeros(), |sum, (_, p)| sum + p.coords) / n;
    let spread = positions.iter().map(|(t, _)| (t - time).powi(2)).sum::<f64>();
    let moment = positions.iter().fold(Vector3::zeros(), |sum, (t, p)| sum + (p.coords - place) * (t - time));
    let velocity = if spread > 0.0 { moment / spread } else { Vector3::zeros() };
    (!positions.is_empty()).then(|| (Point3::from(place - velocity * time), velocity))
}

/// Cameras and ground of the background, by frame.
pub(super) struct Ground<'a> {
    pub(super) world: &'a World,
    pub(super) index: &'a BTreeMap<FrameId, usize>,
}

impl Ground<'_> {
    fn view(&self, frame: FrameId) -> Option<&View> {
        self.world.views.get(*self.index.get(&frame)?)?.as_ref()
    }

    fn position(&self, observation: &MaskObservation) -> Option<Point3<f64>> {
        self.world.ground.as_ref()?.intersect(self.view(observation.frame)?, observation.contact_point())
    }

    /// Pixel and depth of a position in a frame.
    fn project(&self, place: Point3<f64>, frame: FrameId) -> Option<([f64; 2], f64)> {
        let view = self.view(frame)?;
        let in_cam = view.cam_from_world * place;
        let pixel = view.camera.pixel_from_cam(in_cam)?;
        Some(([pixel.x, pixel.y], in_cam.z))
    }

    /// Compares two pieces; `None` where ground or cameras are missing.
    pub(super) fn fit(&self, before: &EndMotion, after: &EndMotion) -> Option<Fit> {
        let forward = self.relative_offset(before, after)?;
        let backward = self.relative_offset(after, before)?;
        let depth =
            |end_motion: &EndMotion| Some(self.project(end_motion.largest_on_ground()?, end_motion.largest.frame)?.1);
        let at_one_distance = (depth(after)? / depth(before)?).powi(2);
        let size = at_one_distance * after.largest.area / before.largest.area;
        Some(Fit { place: 0.5 * (forward + backward), size, is_turned: self.view_angle(before, after)? > MAX_TURN })
    }

    /// Angle between the directions from which the largest views of two pieces show the vehicle, in its own frame.
    fn view_angle(&self, before: &EndMotion, after: &EndMotion) -> Option<f64> {
        let ray = |end_motion: &EndMotion| {
            Some(end_motion.largest_on_ground()? - self.view(end_motion.largest.frame)?.cam_from_world.center())
        };
        let ((_, first), (_, second)) = (before.on_ground?, after.on_ground?);
        // A parked vehicle has no direction of motion, and does not turn.
        let turned = UnitQuaternion::rotation_between(&first, &second).unwrap_or_default();
        Some((turned * ray(before)?).angle(&ray(after)?))
    }

    /// Distance of one piece from the prediction by another, in the image, as a share of the tolerance.
    fn relative_offset(&self, from: &EndMotion, to: &EndMotion) -> Option<f64> {
        let ((place, own), (_, other)) = (from.on_ground?, to.on_ground?);
        let elapsed_s = to.observation.time_s - from.observation.time_s;
        let (expected, _) = self.project(place + along_chord(own, other) * elapsed_s, to.observation.frame)?;
        let (at_rest, _) = self.project(place, to.observation.frame).unwrap_or((expected, 0.0));
        let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let sides = TOLERATED_SIDES + TOLERATED_SIDES_PER_S * elapsed_s.abs();
        let tolerated = sides * to.observation.side_px() + TOLERATED_SHARE * distance(expected, at_rest);
        Some(distance(expected, to.observation.contact_point()) / tolerated)
    }
}

/// Velocity turned to the chord of the path of a vehicle that turns steadily.
///
/// The vehicle turns until it has the other velocity, and the chord halves the angle. A turn by more than 120° would be
/// that of another vehicle: the velocity stays its own.
fn along_chord(own: Vector3<f64>, other: Vector3<f64>) -> Vector3<f64> {
    let sum = own + other;
    match own.dot(&other) > -0.5 * own.norm() * other.norm() {
        true => sum * (own.norm() / sum.norm()),
        false => own,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observation(frame: u32, width: u32) -> MaskObservation {
        let bounds = BoundingBox { x0: 10 * frame, y0: 5, x1: 10 * frame + width, y1: 25 };
        MaskObservation { frame: FrameId(frame), time_s: f64::from(frame) / 10.0, bounds, area: f64::from(width * 20) }
    }

    #[test]
    fn partly_occluded_masks_are_excluded_from_the_end_motion() {
        // From the end on: half, two thirds and all of the object.
        let observations =
            [observation(9, 20), observation(8, 27), observation(7, 40), observation(6, 40), observation(5, 41)];
        let end_motion = estimate_end(&observations, None).unwrap();
        assert_eq!((end_motion.observation.frame, end_motion.largest.frame), (FrameId(7), FrameId(5)));
        assert!(super::estimate_end(&[], None).is_none());
    }

    #[test]
    fn a_line_fits_uniform_motion() {
        let at = |t: f64| Point3::new(2.0 + 3.0 * t, -t, 0.5);
        let positions: Vec<_> = [0.0, -0.1, -0.2, -0.5].map(|t| (t, at(t))).to_vec();
        let (place, velocity) = fit_line(&positions).unwrap();
        assert!((place - at(0.0)).norm() < 1e-12 && (velocity.x - 3.0).abs() < 1e-12);
        assert_eq!(fit_line(&[(0.0, at(1.0))]), Some((at(1.0), Vector3::zeros())));
        assert_eq!(fit_line(&[]), None);
    }

    #[test]
    fn a_vehicle_that_turns_while_occluded_is_predicted_along_the_chord() {
        // A quarter of a circle of radius 1 in one second.
        let speed = std::f64::consts::FRAC_PI_2;
        let (first, last) = (Vector3::y() * speed, -Vector3::x() * speed);
        let chord = Vector3::new(-1.0, 1.0, 0.0);
        for velocity in [along_chord(first, last), along_chord(last, first)] {
            assert!((velocity - chord).norm() < 0.2, "{velocity}");
        }
        // A stationary or an oncoming vehicle does not predict the turn.
        for other in [Vector3::zeros(), -first] {
            assert_eq!(along_chord(first, other), first);
        }
    }

    #[test]
    fn end_frames_cover_a_second_or_a_minimum_number() {
        let frames: Vec<(FrameId, f64)> = (0..90).rev().map(|k| (FrameId(k), f64::from(k) / 32.0)).collect();
        let end = end_frames(&frames);
        assert_eq!((end[0].0, end.len()), (FrameId(89), 33));
        let slow: Vec<(FrameId, f64)> = (0..20).map(|k| (FrameId(k), f64::from(k))).collect();
        assert_eq!(end_frames(&slow).len(), MIN_END_FRAMES);
        assert!(end_frames(&[]).is_empty());
    }
}
