//! Which planes go with those of their neighbours in time.
//!
//! A vehicle moves smoothly, and so do the planes under it, where they are right. Here the way is smoothed, so that
//! errors of the vehicle's own place do not count, and the heights of its places over their planes are compared with
//! those of the frames next to them. What a plane is off by against these is its own error (docs/maths/scale.md).

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point3, Vector3};

use super::views::lever;
use super::{Options, object_center};
use crate::math::{STD_PER_MAD, median};
use crate::scene::{FrameId, GroundPlane, Image, Reconstruction};

/// A frame with the object's camera in both reconstructions.
type Pair<'a> = (FrameId, &'a Image, &'a Image);

/// Robust standard deviations beyond which a plane stands out.
const STANDS_OUT: f64 = 3.0;

/// Consistency of the planes under an object.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Steadiness {
    /// Frames whose planes stand out from their neighbours', by more than errors of angles explain.
    pub(super) outlying: BTreeSet<FrameId>,
    own_stds: BTreeMap<FrameId, f64>,
    /// Frames whose planes are less sure than that.
    vague: BTreeSet<FrameId>,
}

impl Steadiness {
    /// * `planes` – of each frame, in the background's frame.
    /// * `ratio` – about right.
    /// * `options` – `least_squares.neighbours` and `joint.sigma_distance` are used.
    pub(super) fn of(
        background: &Reconstruction,
        object: &Reconstruction,
        planes: &BTreeMap<FrameId, GroundPlane>,
        ratio: f64,
        options: &Options,
    ) -> Self {
        if !options.joint.compare_planes {
            return Self::default();
        }
        let (neighbours, max_drift) = (options.least_squares.neighbours, options.joint.max_drift());
        let middle = object_center(object);
        let pairs = background.paired_images(object).into_iter();
        let places: Vec<ObjectOverPlane> =
            pairs.filter_map(|pair| ObjectOverPlane::new(pair, planes.get(&pair.0)?, &middle, ratio)).collect();
        let near = |k: usize| k.saturating_sub(neighbours)..places.len().min(k + neighbours + 1);
        let all = 0..places.len();
        let height = |k: usize| places[k].plane.signed_distance(on_line(&places[near(k)], places[k].frame));
        let heights: Vec<f64> = all.clone().map(height).collect();
        let step = |k: usize| heights[k] - median(heights[near(k)].to_vec()).unwrap_or(heights[k]);
        let steps: Vec<f64> = all.clone().map(step).collect();
        let sigma = typical(&steps);
        let stands_out = |k: &usize| steps[*k].abs() > STANDS_OUT * sigma.max(max_drift * places[*k].lever());
        let own_stds: Vec<f64> = all.clone().map(|k| typical(&steps[near(k)]).max(steps[k].abs())).collect();
        let is_vague = |k: &usize| own_stds[*k].max(places[*k].plane.own_height_std()) > max_drift * places[*k].lever();
        let frames = |which: &dyn Fn(&usize) -> bool| all.clone().filter(which).map(|k| places[k].frame).collect();
        Self {
            outlying: frames(&stands_out),
            vague: frames(&is_vague),
            own_stds: all.clone().map(|k| (places[k].frame, own_stds[k])).collect(),
        }
    }

    /// The planes for those who weigh all of them alike: without those that stand out or are less sure than errors of
    /// angles explain; all where that would be less than half of them.
    pub(super) fn telling(&self, planes: &BTreeMap<FrameId, GroundPlane>) -> BTreeMap<FrameId, GroundPlane> {
        let tells = |frame: &FrameId| !self.outlying.contains(frame) && !self.vague.contains(frame);
        let telling: BTreeMap<FrameId, GroundPlane> =
            planes.iter().filter(|(frame, _)| tells(frame)).map(|(frame, plane)| (*frame, *plane)).collect();
        if 2 * telling.len() < planes.len() { planes.clone() } else { telling }
    }

    /// Standard deviation of a plane's own height, units of the background: by how much planes differ from frame to
    /// frame near it, and at least by how much it does; 0 where there is no plane.
    pub(super) fn own_std(&self, frame: FrameId) -> f64 {
        self.own_stds.get(&frame).copied().unwrap_or(0.0)
    }
}

/// An object over its plane.
struct ObjectOverPlane<'a> {
    frame: FrameId,
    plane: &'a GroundPlane,
    camera: Point3<f64>,
    /// Of the object's middle.
    position: Point3<f64>,
}

impl<'a> ObjectOverPlane<'a> {
    /// `None` where a number is not finite.
    fn new(pair: Pair, plane: &'a GroundPlane, middle: &Point3<f64>, ratio: f64) -> Option<Self> {
        let (frame, in_background, in_object) = pair;
        let in_cam = (in_object.cam_from_world * *middle).coords * ratio;
        let position = in_background.cam_from_world.inverse() * Point3::from(in_cam);
        let place = Self { frame, plane, camera: in_background.cam_from_world.center(), position };
        let is_finite = position.coords.iter().all(|x| x.is_finite()) && place.lever().is_finite();
        is_finite.then_some(place)
    }

    fn lever(&self) -> f64 {
        lever(self.plane.signed_distance(self.camera), (self.position - self.camera).norm())
    }
}

/// The standard deviation, by the median.
fn typical(steps: &[f64]) -> f64 {
    STD_PER_MAD * median(steps.iter().map(|step| step.abs()).collect()).unwrap_or(0.0)
}

/// Where the line through the places is at a frame.
fn on_line(places: &[ObjectOverPlane], at: FrameId) -> Point3<f64> {
    let count = places.len() as f64;
    let times = places.iter().map(|place| f64::from(place.frame.0));
    let mean_time = times.clone().sum::<f64>() / count;
    let mean = places.iter().map(|place| place.position.coords).sum::<Vector3<f64>>() / count;
    let spread: f64 = times.clone().map(|t| (t - mean_time).powi(2)).sum();
    let along: Vector3<f64> =
        places.iter().zip(times).map(|(place, t)| (place.position.coords - mean) * (t - mean_time)).sum();
    let slope = if spread > 0.0 { along / spread } else { Vector3::zeros() };
    Point3::from(mean + slope * (f64::from(at.0) - mean_time))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rigid3;
    use crate::synthetic::drive::{Drive, Noise, Options, drive};

    fn of(world: &Drive) -> Steadiness {
        let options = crate::trajectory::Options::default();
        Steadiness::of(&world.background, &world.object, &world.planes, world.ratio, &options)
    }

    fn median_own_std(world: &Drive, found: &Steadiness) -> f64 {
        median(world.planes.keys().map(|frame| found.own_std(*frame)).collect()).unwrap()
    }

    #[test]
    fn planes_that_stand_out_are_found() {
        let mut world = drive(&Options::default(), 3);
        assert!(of(&world).outlying.is_empty());
        let wrong: BTreeSet<FrameId> = (20..24).chain([57]).map(FrameId).collect();
        let by = 3.0 / Options::default().background_unit_m;
        for plane in world.planes.iter_mut().filter(|(frame, _)| wrong.contains(frame)).map(|(_, plane)| plane) {
            plane.point += plane.normal * by;
        }
        let found = of(&world);
        assert_eq!(found.outlying, wrong);
        assert!(wrong.iter().all(|frame| found.own_std(*frame) > 0.7 * by), "{found:?}");
        assert_eq!(found.own_std(FrameId(1000)), 0.0);
        // Neither do those tell that are next to them or say that they are not sure, unless that is most.
        world.planes.get_mut(&FrameId(40)).unwrap().height_std = by;
        let telling: Vec<u32> = of(&world).telling(&world.planes).into_keys().map(|frame| frame.0).collect();
        assert!(!telling.contains(&40) && !telling.contains(&21) && telling.len() > 45, "{telling:?}");
        world.planes.values_mut().for_each(|plane| plane.height_std = by);
        assert_eq!(of(&world).telling(&world.planes), world.planes);
    }

    #[test]
    fn noise_of_planes_is_measured_and_that_of_the_object_is_not() {
        let noise = Noise { plane_height_m: 0.05, ..Noise::default() };
        let noisy = drive(&Options { noise, ..Options::default() }, 4);
        let found = median_own_std(&noisy, &of(&noisy)) * Options::default().background_unit_m;
        assert!((0.03..0.08).contains(&found), "{found}");
        // To and fro along the line of sight, by as much as would lift it by half a metre.
        let mut world = drive(&Options::default(), 4);
        let center = object_center(&world.object);
        for (k, image) in world.object.images.values_mut().enumerate() {
            let away = image.cam_from_world.center() - center;
            let share = if k % 2 == 0 { 1.03 } else { 0.97 };
            image.cam_from_world =
                Rigid3::from_rotation_and_center(image.cam_from_world.rotation, center + away * share);
        }
        let found = median_own_std(&world, &of(&world)) * Options::default().background_unit_m;
        assert!(found < 0.15, "{found}");
    }
}
