//! Where objects go over the ground: where a piece of a track leads, and whether another one comes from there.

use std::collections::BTreeMap;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::motion::View;
use crate::pipeline::stages::motion::World;
use crate::scene::{BoundingBox, FrameId, Mask};

/// Length of a piece's beginning or end from which its motion there is estimated, seconds.
const END_S: f64 = 1.0;
/// Minimum number of frames of that estimate, where the piece has them.
const MIN_END_FRAMES: usize = 6;
/// Share of the largest mask's area below which a mask is partly occluded.
const MIN_WHOLE_SHARE: f64 = 0.75;
/// Tolerance of the predicted position without a gap, sides of the object: the next car at the kerb is more than one
/// side away.
const TOLERATED_SIDES: f64 = 0.6;
/// Growth of the tolerance with the gap, sides of the object per second.
const TOLERATED_SIDES_PER_S: f64 = 0.1;
/// Growth of the tolerance with the predicted displacement, as a share of it: vehicles brake and turn.
const TOLERATED_SHARE: f64 = 0.2;

/// Two views of one vehicle from directions that are this far apart, radians, need have no points in common: features
/// of a car are recognized up to some 40°.
const MAX_TURN: f64 = 0.7;

/// Agreement of a course with the one that it continues.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Distance from the predicted position, as a share of the tolerance.
    pub(super) place: f64,
    /// Ratio of areas at one distance.
    pub(super) size: f64,
    /// The views show different sides of the vehicle.
    pub(super) is_turned: bool,
}

/// Position of an object by its mask.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spot {
    pub(super) frame: FrameId,
    pub(super) time_s: f64,
    bounds: BoundingBox,
    area: f64,
}

impl Spot {
    /// `None` for an empty mask.
    pub(super) fn of(frame: FrameId, time_s: f64, mask: &Mask) -> Option<Self> {
        Some(Self { frame, time_s, bounds: mask.bounding_box()?, area: mask.area_px2() as f64 })
    }

    /// Where it stands: the middle of its lower side, pixels.
    fn foot(&self) -> [f64; 2] {
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
    /// Its sight nearest to the end of which nothing is hidden, as far as sizes tell.
    pub(super) spot: Spot,
    /// The largest one near the end.
    pub(super) largest: Spot,
    /// Position on the ground there and velocity, in the background's frame and per second.
    on_ground: Option<(Point3<f64>, Vector3<f64>)>,
}

impl EndMotion {
    /// Position on the ground when it was largest.
    fn largest_on_ground(&self) -> Option<Point3<f64>> {
        let (place, velocity) = self.on_ground?;
        Some(place + velocity * (self.largest.time_s - self.spot.time_s))
    }
}

/// Which of a piece's frames say how it moves at an end of it.
///
/// * `frames` – id and time of those with a mask, from the end on.
pub(super) fn near(frames: &[(FrameId, f64)]) -> &[(FrameId, f64)] {
    let is_near = |k: usize| k < MIN_END_FRAMES || (frames[k].1 - frames[0].1).abs() <= END_S;
    &frames[..(0..frames.len()).take_while(|k| is_near(*k)).count()]
}

/// Motion of an object at the end of its track.
///
/// * `spots` – of the frames that [`near`] names, from the end on.
pub(super) fn course(spots: &[Spot], world: Option<&Ground<'_>>) -> Option<EndMotion> {
    let largest = *spots.iter().max_by(|a, b| a.area.total_cmp(&b.area))?;
    let whole: Vec<Spot> = spots.iter().filter(|spot| spot.area >= MIN_WHOLE_SHARE * largest.area).copied().collect();
    let spot = *whole.first()?;
    let places = whole.iter().filter_map(|s| Some((s.time_s - spot.time_s, world?.place(s)?)));
    Some(EndMotion { spot, largest, on_ground: line(&places.collect::<Vec<_>>()) })
}

/// Position at time zero and velocity, by least squares; at rest where there is one place only.
fn line(places: &[(f64, Point3<f64>)]) -> Option<(Point3<f64>, Vector3<f64>)> {
    let n = places.len() as f64;
    let time = places.iter().map(|(t, _)| t).sum::<f64>() / n;
    let place = places.iter().fold(Vector3::zeros(), |sum, (_, p)| sum + p.coords) / n;
    let spread = places.iter().map(|(t, _)| (t - time).powi(2)).sum::<f64>();
    let moment = places.iter().fold(Vector3::zeros(), |sum, (t, p)| sum + (p.coords - place) * (t - time));
    let velocity = if spread > 0.0 { moment / spread } else { Vector3::zeros() };
    (!places.is_empty()).then(|| (Point3::from(place - velocity * time), velocity))
}

/// The background's cameras and its ground, by frame.
pub(super) struct Ground<'a> {
    pub(super) world: &'a World,
    pub(super) index: &'a BTreeMap<FrameId, usize>,
}

impl Ground<'_> {
    fn view(&self, frame: FrameId) -> Option<&View> {
        self.world.views.get(*self.index.get(&frame)?)?.as_ref()
    }

    fn place(&self, spot: &Spot) -> Option<Point3<f64>> {
        self.world.ground.as_ref()?.meets(self.view(spot.frame)?, spot.foot())
    }

    /// Pixel and depth of a place in a frame.
    fn seen(&self, place: Point3<f64>, frame: FrameId) -> Option<([f64; 2], f64)> {
        let view = self.view(frame)?;
        let in_cam = view.cam_from_world * place;
        let pixel = view.camera.pixel_from_cam(in_cam)?;
        Some(([pixel.x, pixel.y], in_cam.z))
    }

    /// Compares two courses; `None` where ground or cameras are missing.
    pub(super) fn fit(&self, before: &EndMotion, after: &EndMotion) -> Option<Fit> {
        let forth = self.off(before, after)?;
        let back = self.off(after, before)?;
        let depth = |course: &EndMotion| Some(self.seen(course.largest_on_ground()?, course.largest.frame)?.1);
        let at_one_distance = (depth(after)? / depth(before)?).powi(2);
        let size = at_one_distance * after.largest.area / before.largest.area;
        Some(Fit { place: 0.5 * (forth + back), size, is_turned: self.turn(before, after)? > MAX_TURN })
    }

    /// Angle between the directions from which the largest views of two courses show the vehicle, in its own frame.
    fn turn(&self, before: &EndMotion, after: &EndMotion) -> Option<f64> {
        let sight = |course: &EndMotion| {
            Some(course.largest_on_ground()? - self.view(course.largest.frame)?.cam_from_world.center())
        };
        let ((_, first), (_, second)) = (before.on_ground?, after.on_ground?);
        // A parked vehicle has no direction of motion, and does not turn.
        let turned = UnitQuaternion::rotation_between(&first, &second).unwrap_or_default();
        Some((turned * sight(before)?).angle(&sight(after)?))
    }

    /// Distance of one course from the prediction by another, in the image, as a share of the tolerance.
    fn off(&self, from: &EndMotion, to: &EndMotion) -> Option<f64> {
        let ((place, own), (_, other)) = (from.on_ground?, to.on_ground?);
        let elapsed_s = to.spot.time_s - from.spot.time_s;
        let (expected, _) = self.seen(place + along_chord(own, other) * elapsed_s, to.spot.frame)?;
        let (at_rest, _) = self.seen(place, to.spot.frame).unwrap_or((expected, 0.0));
        let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let sides = TOLERATED_SIDES + TOLERATED_SIDES_PER_S * elapsed_s.abs();
        let tolerated = sides * to.spot.side_px() + TOLERATED_SHARE * distance(expected, at_rest);
        Some(distance(expected, to.spot.foot()) / tolerated)
    }
}

/// A course's velocity turned towards where a vehicle gets that turns steadily until it has the other velocity: the
/// chord of its path halves the angle. One that is to turn by more than 120° is another vehicle, and keeps its own.
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

    fn spot(frame: u32, width: u32) -> Spot {
        let bounds = BoundingBox { x0: 10 * frame, y0: 5, x1: 10 * frame + width, y1: 25 };
        Spot { frame: FrameId(frame), time_s: f64::from(frame) / 10.0, bounds, area: f64::from(width * 20) }
    }

    #[test]
    fn a_course_leaves_out_what_is_partly_hidden() {
        // From the end on: half, two thirds and all of the object.
        let spots = [spot(9, 20), spot(8, 27), spot(7, 40), spot(6, 40), spot(5, 41)];
        let course = course(&spots, None).unwrap();
        assert_eq!((course.spot.frame, course.largest.frame), (FrameId(7), FrameId(5)));
        assert!(super::course(&[], None).is_none());
    }

    #[test]
    fn a_line_goes_through_what_moves_steadily() {
        let at = |t: f64| Point3::new(2.0 + 3.0 * t, -t, 0.5);
        let places: Vec<_> = [0.0, -0.1, -0.2, -0.5].map(|t| (t, at(t))).to_vec();
        let (place, velocity) = line(&places).unwrap();
        assert!((place - at(0.0)).norm() < 1e-12 && (velocity.x - 3.0).abs() < 1e-12);
        assert_eq!(line(&[(0.0, at(1.0))]), Some((at(1.0), Vector3::zeros())));
        assert_eq!(line(&[]), None);
    }

    #[test]
    fn a_vehicle_that_turns_while_it_is_hidden_goes_along_the_chord() {
        // A quarter of a circle of radius 1 in one second.
        let speed = std::f64::consts::FRAC_PI_2;
        let (first, last) = (Vector3::y() * speed, -Vector3::x() * speed);
        let chord = Vector3::new(-1.0, 1.0, 0.0);
        for way in [along_chord(first, last), along_chord(last, first)] {
            assert!((way - chord).norm() < 0.2, "{way}");
        }
        // One that stands or comes the other way says nothing of where the first one goes.
        for other in [Vector3::zeros(), -first] {
            assert_eq!(along_chord(first, other), first);
        }
    }

    #[test]
    fn the_ends_of_a_piece_are_looked_at_for_a_second_or_some_frames() {
        let frames: Vec<(FrameId, f64)> = (0..90).rev().map(|k| (FrameId(k), f64::from(k) / 32.0)).collect();
        let end = near(&frames);
        assert_eq!((end[0].0, end.len()), (FrameId(89), 33));
        let slow: Vec<(FrameId, f64)> = (0..20).map(|k| (FrameId(k), f64::from(k))).collect();
        assert_eq!(near(&slow).len(), MIN_END_FRAMES);
        assert!(near(&[]).is_empty());
    }
}
