//! The chain of fallbacks: what is taken for the ground below an object, and how sure it is.
//!
//! First come the ground points round the object: labelled ones where there are enough, else those found without
//! labels. Where it drives, the points on its path correct what they say ([`super::driven`]). In a drive with a camera
//! that is fixed to a vehicle the road below that camera ([`Mount`]) is a second source: it judges the ground found
//! without labels, which has to agree with it, and it is taken where fewer points than asked for are there and it is
//! surer. Where the points of all frames bear it out it is taken wherever it is the steadier: few points make a plane
//! that trembles from frame to frame. Frames that are left get the dominant plane of the whole place, with a deviation
//! that says how uneven the place is.

use std::collections::BTreeMap;

use nalgebra::Point2;

use super::Options;
use super::camera_mount::Mount;
use super::dominant::DominantPlane;
use super::driven::on_driven_ground;
use super::hovering::HoveringGround;
use super::local::{LocalPlanes, local_planes, lowest_foot, object_pixels};
use super::road::Road;
use super::vehicle_trajectory::BodyShape;
use crate::math::{STD_PER_MAD, median};
use crate::scene::{
    FrameId, GroundPlane, Image, ImageId, ObjectId, Observation, PlaneBasis, Point3dId, Reconstruction,
};

/// Knowledge of the ground at a position.
#[derive(Clone, Copy, Debug)]
pub struct GroundChain<'a> {
    /// The background.
    pub background: &'a Reconstruction,
    /// Points that labels call ground, ascending; empty without labels.
    pub labelled: &'a [Point3dId],
    /// The ground that was found without labels.
    pub dominant: Option<&'a DominantPlane>,
    /// The road below a camera that is fixed to a vehicle.
    pub mount: Option<&'a Mount>,
    /// The ground below a camera that does not translate; there is no other then.
    pub hovering: Option<&'a HoveringGround>,
    /// Assumptions on vehicles.
    pub shape: BodyShape,
}

impl GroundChain<'_> {
    /// The plane below one object in every frame that is registered in both models, from the surest source that has
    /// one. The same seed gives the same planes, on any number of threads.
    pub fn planes(&self, object: ObjectId, model: &Reconstruction, options: &Options, seed: u64) -> LocalPlanes {
        if let Some(ground) = self.hovering {
            return ground.planes(self.background, model);
        }
        let local = |points: &[Point3dId]| local_planes(self.background, points, object, model, options, seed);
        let dominant =
            self.dominant.filter(|ground| self.mount.is_none_or(|mount| mount.agrees(self.background, ground)));
        let mut labelled = local(self.labelled);
        labelled.planes.values_mut().for_each(|plane| plane.basis = PlaneBasis::LabelledPoints);
        let num_frames = (labelled.planes.len() + labelled.skipped.len()) as f64;
        let (mut found, points) = match dominant {
            // Labeled points give a plane to less than half of the object's frames.
            Some(ground) if (labelled.planes.len() as f64) < 0.5 * num_frames => {
                (local(&ground.point_ids), ground.point_ids.as_slice())
            }
            _ => (labelled, self.labelled),
        };
        if options.vehicle_path {
            found.planes = on_driven_ground(self.background, points, model, found.planes, options, &self.shape);
        }
        if let Some(mount) = self.mount {
            self.prefer_surer(&mut found, mount, model, options);
        }
        if let Some(dominant) = dominant {
            self.fill(&mut found, dominant, model);
        }
        found.skipped.retain(|skip| !found.planes.contains_key(&skip.frame));
        found
    }

    /// The plane below an object of which only outlines are known, in every registered frame with one; as [`planes`]
    /// otherwise.
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
        // Without points of its own it has no path over the ground.
        let options = Options { vehicle_path: false, ..*options };
        self.planes(object, &self.stand_in(outlines), &options, seed)
    }

    /// Images that observe an object at the given pixels, without its points.
    fn stand_in(&self, outlines: &BTreeMap<FrameId, Vec<Point2<f64>>>) -> Reconstruction {
        let observed = |pixel: &Point2<f64>| Observation { pixel: *pixel, point: Some(Point3dId(0)) };
        let with_outline = |(id, image): (&ImageId, &Image)| {
            let observations = outlines.get(&id.frame())?.iter().map(observed).collect();
            Some((*id, Image { name: image.name.clone(), observations, ..*image }))
        };
        let images = self.background.images.iter().filter_map(with_outline).collect();
        Reconstruction { images, ..Reconstruction::default() }
    }

    /// Takes the road below the camera where it is surer than points of which there are fewer than asked for; where the
    /// points of all frames bear it out, wherever it wanders less from frame to frame than they do.
    fn prefer_surer(&self, found: &mut LocalPlanes, mount: &Mount, model: &Reconstruction, options: &Options) {
        let roads = self.road(mount, model);
        let is_borne_out = bear_out(&self.gaps(&found.planes, &roads, model));
        for (frame, road) in roads {
            // A steadier road may be less sure in all by a factor of two.
            let stays = |plane: &GroundPlane| match is_borne_out {
                true => plane.own_height_std() < road.own_height_std() || 2.0 * plane.height_std < road.height_std,
                false => plane.num_points >= options.num_neighbors || plane.height_std <= road.height_std,
            };
            if !found.planes.get(&frame).is_some_and(stays) {
                found.planes.insert(frame, road);
            }
        }
    }

    /// Distances of planes of points from the road, below the object.
    fn gaps(
        &self,
        points: &BTreeMap<FrameId, GroundPlane>,
        roads: &BTreeMap<FrameId, GroundPlane>,
        model: &Reconstruction,
    ) -> Vec<Gap> {
        let compared = |(frame, image, in_object): (FrameId, &Image, &Image)| {
            let (plane, road) = (points.get(&frame)?, roads.get(&frame)?);
            let height = road.signed_distance(image.cam_from_world.center());
            let foot = lowest_foot(self.background, image, &object_pixels(in_object), (&road.normal, height))?;
            Some(Gap {
                height: plane.signed_distance(foot),
                own_std: plane.own_height_std().hypot(road.own_height_std()),
                common_std: plane.common_height_std.hypot(road.common_height_std),
            })
        };
        self.background.paired_images(model).into_iter().filter_map(compared).collect()
    }

    /// The road below the object in every frame.
    fn road(&self, mount: &Mount, model: &Reconstruction) -> BTreeMap<FrameId, GroundPlane> {
        let road = Road::new(self.background, mount);
        let below = |(frame, image, in_object): (FrameId, &Image, &Image)| {
            Some((frame, road.plane_below(frame, image, &object_pixels(in_object))?))
        };
        self.background.paired_images(model).into_iter().filter_map(below).collect()
    }

    /// The dominant plane where there is no other; what has none either stays skipped.
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
        // Without a foot nothing is known of where the object is on the plane.
        let foot = lowest_foot(self.background, image, pixels, (&normal, height)).filter(|_| height > spread)?;
        let reach = (foot - image.cam_from_world.center()).norm().max(height);
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

/// Height of the road above a plane of points in one frame, with the standard deviations of both for the frame alone
/// and for all frames.
struct Gap {
    height: f64,
    own_std: f64,
    common_std: f64,
}

/// Returns true if the points lie on the road: on average, and from frame to frame, within three standard deviations.
fn bear_out(gaps: &[Gap]) -> bool {
    let median_of = |value: &dyn Fn(&Gap) -> f64| median(gaps.iter().map(value).collect()).unwrap_or(f64::INFINITY);
    let middle = median_of(&|gap| gap.height);
    let spread = STD_PER_MAD * median_of(&|gap| (gap.height - middle).abs());
    let (own, common) = (median_of(&|gap| gap.own_std), median_of(&|gap| gap.common_std));
    // Fewest frames in which planes of points and the road are compared.
    gaps.len() >= 5 && spread <= 3.0 * own && middle.abs() <= 3.0 * common.hypot(own)
}
