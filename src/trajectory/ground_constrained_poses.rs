//! Camera poses relative to a vehicle, from the ground alone: the vehicle is on the ground and its heading is the
//! direction of motion.
//!
//! Images of an object that is small compared with its distance are nearly parallel projections. Two of those do not
//! determine its rotation between them (the bas-relief ambiguity; J. J. Koenderink and A. J. van Doorn, *Affine
//! structure from motion*, JOSA A 1991), and more of them do not exclude its mirror image, so that a map initialized
//! from a pair of views is arbitrary. The ground removes both ambiguities. With the plane of frame i, n_i · x + h_i =
//! 0, the vehicle is at the point p_i where the ray to the ground below its center intersects the plane, and its frame
//! is
//!
//! ```text
//! z = n_i,   x = the direction of the path p at i, level,   y = z × x.
//! ```
//!
//! The poses are right to a few degrees and a tenth of the vehicle's length. Derivation: docs/maths/scale.md.

use std::collections::BTreeMap;

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};

use crate::camera::Camera;
use crate::math::{Rigid3, any_across, median};
use crate::scene::{FrameId, GroundPlane, Reconstruction, Rect};

/// Poses of the cameras in the frame of an object on the ground.
///
/// The origin is below the object's center, x is forward, y to the left, z up, in units of the background. A vehicle
/// that moves by less than one of its lengths keeps one arbitrary direction; one that reverses does not turn.
///
/// * `planes` – the ground below the object, in the background's frame.
/// * `boxes` – the object in the images, including occluded parts.
///
/// Returns camera from object for all frames that have a camera, a plane and a box, and whose ray intersects the plane
/// in front of the camera.
pub fn ground_constrained_poses(
    background: &Reconstruction,
    planes: &BTreeMap<FrameId, GroundPlane>,
    boxes: &BTreeMap<FrameId, Rect>,
) -> BTreeMap<FrameId, Rigid3> {
    let cameras = background.images.iter().map(|(id, image)| (id.frame(), image));
    let (lines, rough): (Vec<LineOfSight>, Vec<ObjectPosition>) = cameras
        .filter_map(|(frame, image)| {
            let (plane, bounds) = (planes.get(&frame)?, boxes.get(&frame)?);
            let camera = background.camera_of(image);
            let ray = ray_to_ground(bounds, camera, &(image.cam_from_world.rotation * plane.normal));
            let line = LineOfSight {
                frame,
                cam_from_world: image.cam_from_world,
                ray: image.cam_from_world.rotation.inverse() * ray,
                plane: *plane,
                angle: bounds.extent_px() / camera.mean_focal(),
            };
            let position = line.position_on(&line.plane)?;
            Some((line, position))
        })
        .unzip();
    // The direction of the path is computed over a length of the vehicle to either side: positions have errors of a
    // tenth of one.
    let Some(step) = median(rough.iter().map(|position| position.length).collect()) else { return BTreeMap::new() };
    let positions: Vec<ObjectPosition> = (0..lines.len())
        .map(|k| lines[k].position_on(&plane_near(&lines, &rough, k, step)).unwrap_or(rough[k]))
        .collect();
    let forward = directions(&positions, step);
    let poses = positions.iter().zip(forward).map(|(position, forward)| position.world_from_object(&forward));
    lines.iter().zip(poses).map(|(line, pose)| (line.frame, line.cam_from_world * pose)).collect()
}

/// Ray, in camera coordinates, to the point of the ground below the center of an object.
///
/// For a box of height H and depth D in a view from the elevation angle φ, the center of the image box is the center of
/// the object. Its lower edge is (H cos φ + D sin φ) / 2 below, and the ground point H cos φ / 2.
fn ray_to_ground(bounds: &Rect, camera: &Camera, up_in_cam: &Vector3<f64>) -> Vector3<f64> {
    let middle = camera.ray_from_pixel(bounds.center().into());
    let sin = -up_in_cam.dot(&middle);
    let across = -(up_in_cam + middle * sin);
    let (cos, Some(down)) = (across.norm(), across.try_normalize(1e-9)) else { return middle };
    let half = 0.5 * Vector2::new(bounds.width(), bounds.height());
    let edge_px = down.xy().abs().dot(&half);
    // Depth over height: from 1.2 of a car from the side to 3 of one from behind.
    let share = cos / (cos + 2.0 * sin.max(0.0));
    middle + down * (share * edge_px / camera.mean_focal())
}

/// Ray to the ground below the object in a frame.
struct LineOfSight {
    frame: FrameId,
    cam_from_world: Rigid3,
    /// In the background's frame.
    ray: Vector3<f64>,
    plane: GroundPlane,
    /// Longer side of the box over the focal length.
    angle: f64,
}

impl LineOfSight {
    /// Intersection with a plane; `None` unless it is in front of the camera.
    fn position_on(&self, plane: &GroundPlane) -> Option<ObjectPosition> {
        let center = self.cam_from_world.center();
        let reach = -plane.signed_distance(center) / plane.normal.dot(&self.ray);
        let ground_point = center + self.ray * reach;
        let depth = (self.cam_from_world * ground_point).z;
        let length = self.angle * depth;
        let is_usable = reach > 0.0 && depth > 0.0 && length > 0.0 && (reach + length).is_finite();
        is_usable.then_some(ObjectPosition { ground_point, up: plane.normal, length })
    }
}

/// Ground plane at a position: the median of the planes around it, since single ones may be wrong.
fn plane_near(lines: &[LineOfSight], positions: &[ObjectPosition], k: usize, step: f64) -> GroundPlane {
    let [before, after] = neighbors(positions, k, step);
    let near = || lines[before..=after].iter().map(|line| &line.plane);
    let middle = |of: &dyn Fn(&GroundPlane) -> f64| median(near().map(of).collect()).unwrap_or_default();
    let normal = Vector3::from_fn(|axis, _| middle(&|plane| plane.normal[axis])).normalize();
    let ground_point = positions[k].ground_point;
    let height = middle(&|plane| plane.signed_distance(ground_point));
    GroundPlane { normal, point: ground_point - normal * height, ..lines[k].plane }
}

/// Position of the object in a frame.
#[derive(Clone, Copy)]
struct ObjectPosition {
    ground_point: Point3<f64>,
    up: Vector3<f64>,
    /// Apparent length, in units of the background.
    length: f64,
}

impl ObjectPosition {
    fn world_from_object(&self, forward: &Vector3<f64>) -> Rigid3 {
        let left = self.up.cross(forward).normalize();
        let rotation = UnitQuaternion::from_basis_unchecked(&[left.cross(&self.up), left, self.up]);
        Rigid3::new(rotation, self.ground_point.coords)
    }
}

/// Headings of the object, from its path.
///
/// Where it hardly moves, the last or the next one; one arbitrary direction if it does not move at all.
fn directions(positions: &[ObjectPosition], step: f64) -> Vec<Vector3<f64>> {
    let mut found: Vec<Option<Vector3<f64>>> = (0..positions.len()).map(|k| direction(positions, k, step)).collect();
    let first = found.iter().position(Option::is_some);
    let mut last = match first {
        Some(first) => found[first],
        None => positions.first().map(|position| any_across(&position.up)),
    };
    for direction in &mut found {
        // It does not turn around from one frame to the next, but reverses.
        let turned = direction.map(|d| if last.is_some_and(|last| last.dot(&d) < 0.0) { -d } else { d });
        *direction = turned.or(last);
        last = *direction;
    }
    found.into_iter().flatten().collect()
}

/// Direction of the path at a position; `None` where the object hardly moves.
///
/// It is the tangent of the parabola through the position and its neighbors, which may be at unequal distances.
fn direction(positions: &[ObjectPosition], k: usize, step: f64) -> Option<Vector3<f64>> {
    let [before, after] =
        neighbors(positions, k, step).map(|other| positions[other].ground_point - positions[k].ground_point);
    let (a, b) = (before.norm(), after.norm());
    let along = match (a >= step, b >= step) {
        (true, true) => after * (a / b) - before * (b / a),
        (false, false) => return None,
        _ => after - before,
    };
    (along - positions[k].up * positions[k].up.dot(&along)).try_normalize(0.0)
}

/// Nearest positions before and after a position that are a step away from it, or those at the ends.
fn neighbors(positions: &[ObjectPosition], k: usize, step: f64) -> [usize; 2] {
    let is_away = |other: &usize| (positions[*other].ground_point - positions[k].ground_point).norm() >= step;
    let before = (0..k).rev().find(is_away).unwrap_or(0);
    [before, (k + 1..positions.len()).find(is_away).unwrap_or(positions.len() - 1)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Image;
    use crate::synthetic::drive::{Drive, Noise, Options, Route, Terrain, drive};

    fn boxes(world: &Drive) -> BTreeMap<FrameId, Rect> {
        let bounds = |image: &Image| Rect::around(image.observations.iter().map(|seen| &seen.pixel));
        let images = world.object.images.iter();
        images.filter_map(|(id, image)| Some((id.frame(), bounds(image)?))).collect()
    }

    /// Rotation angles between true and estimated poses of each camera, without the rotation common to all, degrees.
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
                let found = ground_constrained_poses(&world.background, &world.planes, &boxes(&world));
                assert_eq!(found.len(), 60);
                let turns = turns(&world, &found);
                // At the ends the path continues in one direction only.
                assert!(turns.iter().all(|turn| *turn < 8.0), "{turns:?}");
                assert!(turns[5..55].iter().all(|turn| *turn < 2.0), "{turns:?}");
            }
        }
    }

    /// Errors of the object's positions, as shares of the distance from the camera.
    fn position_errors(world: &Drive, found: &BTreeMap<FrameId, Rigid3>) -> Vec<f64> {
        let error = |(frame, pose): (&FrameId, &Rigid3)| {
            let cam_from_world = &world.background.images[&(*frame).into()].cam_from_world;
            let position = (cam_from_world.inverse() * *pose) * Point3::origin();
            let points = world.object.points.values().map(|p| (world.world_from_object[frame] * p.position).coords);
            let middle = points.sum::<Vector3<f64>>() / world.object.points.len() as f64;
            let plane = &world.planes[frame];
            let truth = middle - plane.normal * plane.signed_distance(Point3::from(middle));
            (position.coords - truth).norm() / (cam_from_world.center().coords - truth).norm()
        };
        found.iter().map(error).collect()
    }

    #[test]
    fn positions_are_on_the_ground_below_the_center_for_low_and_high_cameras() {
        for camera_height_m in [1.4, 5.0, 20.0] {
            let options =
                Options { camera_height_m, camera_climb_m: 0.0, distance_m: [22.0, 30.0], ..Options::default() };
            let world = drive(&options, 3);
            let found = ground_constrained_poses(&world.background, &world.planes, &boxes(&world));
            assert_eq!(found.len(), 60);
            let errors = position_errors(&world, &found);
            assert!(errors.iter().all(|error| *error < 0.15), "{camera_height_m} m: {errors:?}");
        }
    }

    #[test]
    fn a_wrong_plane_does_not_move_a_vehicle() {
        let noise = Noise { bad_planes: 0.2, ..Noise::default() };
        let [world, noisy] = [Noise::default(), noise].map(|noise| drive(&Options { noise, ..Options::default() }, 3));
        let [exact, found] =
            [&world, &noisy].map(|world| ground_constrained_poses(&world.background, &world.planes, &boxes(world)));
        assert_eq!(found.len(), 60);
        let far = exact.iter().filter(|(frame, exact)| {
            let moved = (found[frame].center() - exact.center()).norm();
            moved > 0.1 * exact.translation.norm()
        });
        let far: Vec<_> = far.map(|(frame, _)| *frame).collect();
        assert!(far.is_empty(), "{far:?}");
    }

    #[test]
    fn a_stationary_vehicle_keeps_its_direction() {
        let world = drive(&Options { speed_m_s: 0.0, ..Options::default() }, 3);
        let found = ground_constrained_poses(&world.background, &world.planes, &boxes(&world));
        assert_eq!(found.len(), 60);
        assert!(turns(&world, &found).iter().all(|turn| *turn < 0.5));
    }

    #[test]
    fn frames_without_plane_or_box_have_no_pose() {
        let mut world = drive(&Options { num_frames: 8, ..Options::default() }, 3);
        let all = boxes(&world);
        assert!(ground_constrained_poses(&world.background, &world.planes, &BTreeMap::new()).is_empty());
        world.planes.pop_first();
        assert_eq!(ground_constrained_poses(&world.background, &world.planes, &all).len(), 7);
        // Rays intersect planes above the cameras behind them, or not at all.
        for plane in world.planes.values_mut() {
            plane.point += plane.normal * 1e3;
        }
        let found = ground_constrained_poses(&world.background, &world.planes, &all);
        assert!(found.values().all(|pose| pose.translation.iter().all(|x| x.is_finite())));
    }
}
