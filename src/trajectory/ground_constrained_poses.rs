//! Where the cameras stand about a vehicle, from nothing but the ground: it stands on it, and points where it goes.
//!
//! Where an object is small next to its distance, its pictures are nearly parallel projections. Two of those leave open
//! how far it turned between them (the bas-relief ambiguity; J. J. Koenderink and A. J. van Doorn, *Affine structure
//! from motion*, JOSA A 1991), and more of them its mirror image, so that which model a pair of views starts is chance.
//! The ground knows what the pictures do not. With the plane of frame i, n_i · x + h_i = 0, the vehicle is at the point
//! p_i where the ray through its middle in the picture meets the plane, and its frame is
//!
//! ```text
//! z = n_i,   x = the direction of the path p at i, level,   y = z × x,
//! ```
//!
//! so that the poses of all cameras about it follow without a look at its surface. They are rough, since the middle of
//! what is seen is not one point of the vehicle, but right to a few degrees, and nothing in them is chance.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::math::{Rigid3, median};
use crate::scene::{FrameId, GroundPlane, ObjectImage, Reconstruction};

/// Lengths of the vehicle over which the direction of its path is taken: its places are off by a tenth of one.
const STEP: f64 = 2.0;

/// Poses of the cameras in the frame of an object that stands on the ground: origin below its middle, x forward, y to
/// the left, z up, in units of the background.
///
/// A vehicle that moves by less than two of its lengths keeps one direction, whichever; one that backs up is taken to
/// turn nowhere.
///
/// * `planes` – the ground below the object, in the background's frame.
/// * `sights` – where the object is seen.
///
/// Returns camera from object for all frames that have a camera, a plane and a sight, and whose ray meets the plane
/// before the camera.
pub fn ground_constrained_poses(
    background: &Reconstruction,
    planes: &BTreeMap<FrameId, GroundPlane>,
    sights: &BTreeMap<FrameId, ObjectImage>,
) -> BTreeMap<FrameId, Rigid3> {
    let cameras = background.images.iter().map(|(id, image)| (id.frame(), image));
    let places: Vec<ObjectPosition> = cameras
        .filter_map(|(frame, image)| {
            let (plane, sight) = (planes.get(&frame)?, sights.get(&frame)?);
            let camera = background.camera_of(image);
            let ray = image.cam_from_world.rotation.inverse() * camera.ray_from_pixel(sight.middle);
            let center = image.cam_from_world.center();
            let reach = -plane.signed_distance(center) / plane.normal.dot(&ray);
            let foot = center + ray * reach;
            let depth = (image.cam_from_world * foot).z;
            let length = sight.extent_px * depth / camera.mean_focal();
            let is_usable = reach > 0.0 && depth > 0.0 && length > 0.0 && (reach + length).is_finite();
            is_usable.then_some(ObjectPosition {
                frame,
                cam_from_world: image.cam_from_world,
                foot,
                up: plane.normal,
                length,
            })
        })
        .collect();
    let Some(length) = median(places.iter().map(|place| place.length).collect()) else { return BTreeMap::new() };
    let forward = directions(&places, STEP * length);
    places.iter().zip(forward).map(|(place, forward)| (place.frame, place.cam_from_object(&forward))).collect()
}

/// Where the object is in a frame.
struct ObjectPosition {
    frame: FrameId,
    cam_from_world: Rigid3,
    foot: Point3<f64>,
    up: Vector3<f64>,
    /// Apparent length, in units of the background.
    length: f64,
}

impl ObjectPosition {
    fn cam_from_object(&self, forward: &Vector3<f64>) -> Rigid3 {
        let left = self.up.cross(forward).normalize();
        let axes = Matrix3::from_columns(&[left.cross(&self.up), left, self.up]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        self.cam_from_world * Rigid3::new(rotation, self.foot.coords)
    }
}

/// Where the object points at every place: along the chord of `step` round it, as before or as next where it hardly
/// moves, and anywhere, but always there, where it does not move at all.
fn directions(places: &[ObjectPosition], step: f64) -> Vec<Vector3<f64>> {
    let mut found: Vec<Option<Vector3<f64>>> = (0..places.len()).map(|k| chord(places, k, step)).collect();
    let first = found.iter().position(Option::is_some);
    let mut last = match first {
        Some(first) => found[first],
        None => places.first().map(|place| any_across(&place.up)),
    };
    for direction in &mut found {
        // It does not turn round from one frame to the next, but backs up.
        let turned = direction.map(|d| if last.is_some_and(|last| last.dot(&d) < 0.0) { -d } else { d });
        *direction = turned.or(last);
        last = *direction;
    }
    found.into_iter().flatten().collect()
}

/// The direction of the shortest chord round a place that is long enough; `None` where there is none.
fn chord(places: &[ObjectPosition], k: usize, step: f64) -> Option<Vector3<f64>> {
    let ends = |reach: usize| (k.saturating_sub(reach), (k + reach).min(places.len() - 1));
    let chord = |reach: usize| {
        let (first, last) = ends(reach);
        let chord = places[last].foot - places[first].foot;
        (chord - places[k].up * places[k].up.dot(&chord)).try_normalize(0.0).filter(|_| chord.norm() >= step)
    };
    (1..places.len()).find_map(chord)
}

fn any_across(normal: &Vector3<f64>) -> Vector3<f64> {
    let axis = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    normal.cross(&axis).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Image;
    use crate::synthetic::drive::{Drive, Options, Route, Terrain, drive};
    use nalgebra::Point2;

    fn sights(world: &Drive) -> BTreeMap<FrameId, ObjectImage> {
        let sight = |image: &Image| {
            let seen = |axis: usize| image.observations.iter().map(move |o| o.pixel[axis]);
            let ends = [0, 1].map(|axis| (seen(axis).fold(f64::MAX, f64::min), seen(axis).fold(f64::MIN, f64::max)));
            let middle = Point2::from(ends.map(|(least, most)| 0.5 * (least + most)));
            ObjectImage { middle, extent_px: ends.map(|(least, most)| most - least).into_iter().fold(0.0, f64::max) }
        };
        world.object.images.iter().map(|(id, image)| (id.frame(), sight(image))).collect()
    }

    /// Turns from the true pose of each camera to the one found, but for the turn that all have in common.
    fn turns(world: &Drive, found: &BTreeMap<FrameId, Rigid3>) -> Vec<f64> {
        let relative: Vec<UnitQuaternion<f64>> = found
            .iter()
            .map(|(frame, pose)| {
                let truth = &world.object.images[&(*frame).into()].cam_from_world;
                pose.rotation.inverse() * truth.rotation
            })
            .collect();
        relative.iter().map(|turn| turn.angle_to(&relative[relative.len() / 2]).to_degrees()).collect()
    }

    #[test]
    fn poses_about_a_far_vehicle_are_right_to_a_few_degrees() {
        for route in [Route::Straight, Route::Curve { radius_m: 30.0 }] {
            for terrain in [Terrain::Flat, Terrain::Slope { gradient: [0.08, 0.02] }] {
                let options =
                    Options { route, terrain, distance_m: [120.0, 150.0], camera_height_m: 60.0, ..Options::default() };
                let world = drive(&options, 3);
                let found = ground_constrained_poses(&world.background, &world.planes, &sights(&world));
                assert_eq!(found.len(), 60);
                let turns = turns(&world, &found);
                // At the ends the path leads on in one direction only.
                assert!(turns.iter().all(|turn| *turn < 8.0), "{turns:?}");
                assert!(turns[5..55].iter().all(|turn| *turn < 2.0), "{turns:?}");
            }
        }
    }

    #[test]
    fn a_vehicle_that_stands_keeps_its_direction() {
        let world = drive(&Options { speed_m_s: 0.0, ..Options::default() }, 3);
        let found = ground_constrained_poses(&world.background, &world.planes, &sights(&world));
        assert_eq!(found.len(), 60);
        assert!(turns(&world, &found).iter().all(|turn| *turn < 0.5));
    }

    #[test]
    fn what_is_not_known_has_no_pose() {
        let mut world = drive(&Options { num_frames: 8, ..Options::default() }, 3);
        let all = sights(&world);
        assert!(ground_constrained_poses(&world.background, &world.planes, &BTreeMap::new()).is_empty());
        world.planes.pop_first();
        assert_eq!(ground_constrained_poses(&world.background, &world.planes, &all).len(), 7);
        // Planes above the cameras are met behind them, or not at all.
        for plane in world.planes.values_mut() {
            plane.point += plane.normal * 1e3;
        }
        let found = ground_constrained_poses(&world.background, &world.planes, &all);
        assert!(found.values().all(|pose| pose.translation.iter().all(|x| x.is_finite())));
    }
}
