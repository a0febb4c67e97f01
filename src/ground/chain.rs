//! Chain of fallbacks for the ground plane below an object, with its uncertainty.
//!
//! The first source is the ground points around the object: labeled points where there are enough, otherwise those of
//! the dominant plane. Where the object drives, the points on its path correct these planes ([`super::driven`]). With a
//! vehicle-mounted camera, the road below that camera ([`Mount`]) is a second source. A dominant plane that disagrees
//! with the road is ignored. The road replaces planes of fewer than `num_neighbors` points where its standard deviation
//! is smaller. Where the points of all frames confirm the road, it replaces all planes that vary more from frame to
//! frame: a plane of few points is noisy. The remaining frames get the dominant plane of the whole background, with the
//! RMS distance of all ground points as its standard deviation.

use std::collections::BTreeMap;

use nalgebra::Point2;

use super::Options;
use super::camera_mount::Mount;
use super::dominant::DominantPlane;
use super::driven::corrected_by_path;
use super::hovering::HoveringGround;
use super::local::{LocalPlanes, contact_point, local_planes, object_pixels};
use super::road::Road;
use super::vehicle_trajectory::BodyShape;
use crate::math::{STD_PER_MAD, median};
use crate::scene::{
    FrameId, GroundPlane, Image, ImageId, ObjectId, Observation, PlaneBasis, Point3dId, Reconstruction,
};

/// Sources of ground planes.
#[derive(Clone, Copy, Debug)]
pub struct GroundChain<'a> {
    /// The background.
    pub background: &'a Reconstruction,
    /// Points labeled as ground, ascending; empty without labels.
    pub labeled: &'a [Point3dId],
    /// Ground found without labels.
    pub dominant: Option<&'a DominantPlane>,
    /// Road below a vehicle-mounted camera.
    pub mount: Option<&'a Mount>,
    /// Ground below a camera that does not translate; it excludes all other sources.
    pub hovering: Option<&'a HoveringGround>,
    /// Assumptions on vehicles.
    pub shape: BodyShape,
}

impl GroundChain<'_> {
    /// Returns the plane below one object in every frame that is registered in both models.
    ///
    /// Each plane is that of the best source that has one. The same seed gives the same planes, on any number of
    /// threads.
    pub fn planes(&self, object: ObjectId, model: &Reconstruction, options: &Options, seed: u64) -> LocalPlanes {
        if let Some(ground) = self.hovering {
            return ground.planes(self.background, model);
        }
        let local = |points: &[Point3dId]| local_planes(self.background, points, object, model, options, seed);
        let dominant =
            self.dominant.filter(|ground| self.mount.is_none_or(|mount| mount.agrees(self.background, ground)));
        let mut labeled = local(self.labeled);
        labeled.planes.values_mut().for_each(|plane| plane.basis = PlaneBasis::LabelledPoints);
        let num_frames = (labeled.planes.len() + labeled.skipped.len()) as f64;
        let (mut found, points) = match dominant {
            // Labeled points give planes in less than half of the object's frames.
            Some(ground) if (labeled.planes.len() as f64) < 0.5 * num_frames => {
                (local(&ground.point_ids), ground.point_ids.as_slice())
            }
            _ => (labeled, self.labeled),
        };
        if options.vehicle_path {
            found.planes = corrected_by_path(self.background, points, model, found.planes, options, &self.shape);
        }
        if let Some(mount) = self.mount {
            self.replace_by_road(&mut found, mount, model, options);
        }
        if let Some(dominant) = dominant {
            self.fill(&mut found, dominant, model);
        }
        found.skipped.retain(|skip| !found.planes.contains_key(&skip.frame));
        found
    }

    /// Returns the planes below an object without a model, in every registered frame with an outline; see [`planes`].
    ///
    /// * `outlines` – by frame, pixels on the object's outline.
    ///
    /// [`planes`]: Self::planes
    pub fn planes_below(
        &self,
        object: ObjectId,
        outlines: &BTreeMap<FrameId, Vec<Point2<f64>>>,
        options: &Options,
        seed: u64,
    ) -> LocalPlanes {
        // Without a model there is no path over the ground.
        let options = Options { vehicle_path: false, ..*options };
        self.planes(object, &self.model_of_outlines(outlines), &options, seed)
    }

    /// Model without points, whose images observe an object at the given pixels.
    fn model_of_outlines(&self, outlines: &BTreeMap<FrameId, Vec<Point2<f64>>>) -> Reconstruction {
        let observed = |pixel: &Point2<f64>| Observation { pixel: *pixel, point: Some(Point3dId(0)) };
        let with_outline = |(id, image): (&ImageId, &Image)| {
            let observations = outlines.get(&id.frame())?.iter().map(observed).collect();
            Some((*id, Image { name: image.name.clone(), observations, ..*image }))
        };
        let images = self.background.images.iter().filter_map(with_outline).collect();
        Reconstruction { images, ..Reconstruction::default() }
    }

    /// Replaces planes of points by the road below the camera.
    ///
    /// By default these are planes of fewer than `num_neighbors` points with a larger standard deviation. Where the
    /// points of all frames confirm the road, these are all planes with a larger standard deviation from frame to
    /// frame.
    fn replace_by_road(&self, found: &mut LocalPlanes, mount: &Mount, model: &Reconstruction, options: &Options) {
        let roads = self.road(mount, model);
        let is_confirmed = confirm_road(&self.road_heights(&found.planes, &roads, model));
        for (frame, road) in roads {
            // The total standard deviation of a road with less noise per frame may be up to twice as large.
            let is_kept = |plane: &GroundPlane| match is_confirmed {
                true => plane.own_height_std() < road.own_height_std() || 2.0 * plane.height_std < road.height_std,
                false => plane.num_points >= options.num_neighbors || plane.height_std <= road.height_std,
            };
            if !found.planes.get(&frame).is_some_and(is_kept) {
                found.planes.insert(frame, road);
            }
        }
    }

    /// Heights of the road over the planes of points, below the object.
    fn road_heights(
        &self,
        points: &BTreeMap<FrameId, GroundPlane>,
        roads: &BTreeMap<FrameId, GroundPlane>,
        model: &Reconstruction,
    ) -> Vec<RoadHeight> {
        let compared = |(frame, image, in_object): (FrameId, &Image, &Image)| {
            let (plane, road) = (points.get(&frame)?, roads.get(&frame)?);
            let height = road.signed_distance(image.cam_from_world.center());
            let contact = contact_point(self.background, image, &object_pixels(in_object), (&road.normal, height))?;
            Some(RoadHeight {
                height: plane.signed_distance(contact),
                own_std: plane.own_height_std().hypot(road.own_height_std()),
                common_std: plane.common_height_std.hypot(road.common_height_std),
            })
        };
        self.background.paired_images(model).into_iter().filter_map(compared).collect()
    }

    /// Road below the object in every frame.
    fn road(&self, mount: &Mount, model: &Reconstruction) -> BTreeMap<FrameId, GroundPlane> {
        let road = Road::new(self.background, mount);
        let below = |(frame, image, in_object): (FrameId, &Image, &Image)| {
            Some((frame, road.plane_below(frame, image, &object_pixels(in_object))?))
        };
        self.background.paired_images(model).into_iter().filter_map(below).collect()
    }

    /// Inserts the dominant plane in frames without a plane; frames without either stay skipped.
    fn fill(&self, found: &mut LocalPlanes, dominant: &DominantPlane, model: &Reconstruction) {
        let spread = dominant.spread(self.background);
        for (frame, image, in_object) in self.background.paired_images(model) {
            if !found.planes.contains_key(&frame)
                && let Some(plane) = self.dominant_below(dominant, spread, image, &object_pixels(in_object))
            {
                found.planes.insert(frame, plane);
            }
        }
    }

    fn dominant_below(
        &self,
        dominant: &DominantPlane,
        spread: f64,
        image: &Image,
        pixels: &[Point2<f64>],
    ) -> Option<GroundPlane> {
        let normal = dominant.normal;
        let height = normal.dot(&(image.cam_from_world.center() - dominant.point));
        // Without a contact point the object's position on the plane is unknown.
        let contact = contact_point(self.background, image, pixels, (&normal, height)).filter(|_| height > spread)?;
        let reach = (contact - image.cam_from_world.center()).norm().max(height);
        Some(GroundPlane {
            normal,
            point: dominant.point,
            num_points: dominant.point_ids.len(),
            num_inliers: dominant.num_on_plane,
            rms: spread,
            basis: PlaneBasis::Dominant,
            height_std: spread,
            common_height_std: spread,
            tilt_std: (spread / reach).atan(),
        })
    }
}

/// Height of the road over a plane of points in one frame.
///
/// The standard deviations, of both together, are those of the frame alone and those common to all frames.
struct RoadHeight {
    height: f64,
    own_std: f64,
    common_std: f64,
}

/// Returns true if the points confirm the road (eq. 19a): within 3σ on average, and from frame to frame.
fn confirm_road(road_heights: &[RoadHeight]) -> bool {
    let median_of =
        |value: &dyn Fn(&RoadHeight) -> f64| median(road_heights.iter().map(value).collect()).unwrap_or(f64::INFINITY);
    let middle = median_of(&|road| road.height);
    let spread = STD_PER_MAD * median_of(&|road| (road.height - middle).abs());
    let (own, common) = (median_of(&|road| road.own_std), median_of(&|road| road.common_std));
    // Minimum number of frames in which planes of points and the road are compared.
    road_heights.len() >= 5 && spread <= 3.0 * own && middle.abs() <= 3.0 * common.hypot(own)
}
