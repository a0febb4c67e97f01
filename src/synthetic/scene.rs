//! A static scene seen by a moving camera: poses and points are the truth, pixels are exact or noisy.

use std::collections::BTreeMap;

use nalgebra::{Point2, Point3, Rotation3, UnitQuaternion, Vector3};
use rand::Rng as _;
use rand_distr::StandardNormal;

use crate::camera::Camera;
use crate::math::{Rigid3, Rng, seeded_rng};
use crate::scene::{CameraId, Image, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

/// Motion of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraMotion {
    /// On an arc of 120 degrees and radius 6 about a ball of points of radius 2, looking at its middle: every camera
    /// sees every point.
    Arc,
    /// Sideways past a wall of points 5 units away, half a unit per image: neighbours in time see common points,
    /// distant images do not.
    Flight,
}

/// Which scene to make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Images, one unit of time apart.
    pub num_images: u32,
    /// Points before those that fewer than two images see are dropped.
    pub num_points: u32,
    /// Motion of the camera.
    pub path: CameraMotion,
    /// Intrinsics of all images.
    pub camera: Camera,
    /// True if each image has a camera id of its own (with the same intrinsics).
    pub camera_per_image: bool,
    /// Standard deviation of each pixel coordinate.
    pub noise_px: f64,
    /// Part of the observations that lie anywhere in the image.
    pub outliers: f64,
    /// Of everything random.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            num_images: 8,
            num_points: 100,
            path: CameraMotion::Arc,
            camera: Camera { radial: [-0.05, 0.01], ..Camera::with_focal(960, 540, 800.0) },
            camera_per_image: false,
            noise_px: 0.0,
            outliers: 0.0,
            seed: 0,
        }
    }
}

/// Makes the scene. Image ids count from 1 in time, point ids from 1.
pub fn static_scene(options: &Options) -> Reconstruction {
    let mut points = points(options);
    let mut images: BTreeMap<ImageId, Image> = (0..options.num_images).map(|i| image(options, i)).collect();
    observe(options, &mut images, &mut points);
    let num_cameras = if options.camera_per_image { options.num_images } else { 1 };
    let cameras = (1..=num_cameras).map(|id| (CameraId(id), options.camera)).collect();
    Reconstruction { cameras, images, points, ..Reconstruction::default() }
}

/// Moves every pose and point at random: rotations by `rotation` radians about a random axis, camera centres and points
/// by `distance` in every coordinate (standard deviations).
pub fn disturb(model: &mut Reconstruction, rotation: f64, distance: f64, seed: u64) {
    let mut rng = seeded_rng(seed, 17);
    for image in model.images.values_mut() {
        let turn = UnitQuaternion::from_scaled_axis(normal3(&mut rng) * rotation);
        let center = image.cam_from_world.center() + normal3(&mut rng) * distance;
        image.cam_from_world = Rigid3::from_rotation_and_center(turn * image.cam_from_world.rotation, center);
    }
    for point in model.points.values_mut() {
        point.position += normal3(&mut rng) * distance;
    }
}

fn normal3(rng: &mut Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.sample(StandardNormal))
}

fn points(options: &Options) -> BTreeMap<Point3dId, Point3d> {
    let mut rng = seeded_rng(options.seed, 1);
    let mut coordinate = |half: f64| rng.random_range(-half..half);
    let point = |id: u64| {
        let position = match options.path {
            CameraMotion::Arc => Point3::new(coordinate(2.0), coordinate(2.0), coordinate(2.0)),
            CameraMotion::Flight => {
                let half = f64::from(options.num_images) * 0.25 + 2.0;
                Point3::new(coordinate(half), coordinate(2.0), 5.0 + coordinate(1.0))
            }
        };
        (Point3dId(id), Point3d { position, rgb: [128; 3], error_px: 0.0, track: Vec::new() })
    };
    (1..=u64::from(options.num_points)).map(point).collect()
}

fn image(options: &Options, index: u32) -> (ImageId, Image) {
    let mut rng = seeded_rng(options.seed, 1000 + u64::from(index));
    let time = f64::from(index) / f64::from(options.num_images.max(2) - 1) - 0.5;
    let (center, forward) = match options.path {
        CameraMotion::Arc => {
            let angle = time * 120f64.to_radians();
            let center = Point3::new(6.0 * angle.sin(), 0.4 * (3.0 * angle).sin(), -6.0 * angle.cos());
            (center, -center.coords)
        }
        CameraMotion::Flight => {
            let x = (f64::from(index) - f64::from(options.num_images - 1) / 2.0) * 0.5;
            (Point3::new(x, 0.3 * (0.7 * x).sin(), 0.2 * (0.4 * x).cos()), Vector3::z())
        }
    };
    let shake = UnitQuaternion::from_scaled_axis(normal3(&mut rng) * 0.02);
    // y of the world points down, as in a camera that stands upright.
    let world_from_cam = Rotation3::face_towards(&forward, &Vector3::y());
    let rotation = shake * UnitQuaternion::from_rotation_matrix(&world_from_cam.inverse());
    let camera = CameraId(if options.camera_per_image { index + 1 } else { 1 });
    let cam_from_world = Rigid3::from_rotation_and_center(rotation, center);
    (ImageId(index + 1), Image { name: format!("{index:06}.jpg"), camera, cam_from_world, observations: Vec::new() })
}

fn observe(options: &Options, images: &mut BTreeMap<ImageId, Image>, points: &mut BTreeMap<Point3dId, Point3d>) {
    let mut rng = seeded_rng(options.seed, 2);
    let sees = |image: &Image, p: &Point3d| {
        options.camera.pixel_from_cam(image.cam_from_world * p.position).filter(|pixel| options.camera.contains(*pixel))
    };
    points.retain(|_, p| images.values().filter(|image| sees(image, p).is_some()).count() >= 2);
    for (image_id, image) in images {
        for (id, point) in points.iter_mut() {
            let Some(exact) = sees(image, point) else { continue };
            let noise = Vector3::from(normal3(&mut rng)).xy() * options.noise_px;
            let (width, height) = (f64::from(options.camera.width), f64::from(options.camera.height));
            let anywhere = Point2::new(rng.random_range(0.0..width), rng.random_range(0.0..height));
            let pixel = if rng.random::<f64>() < options.outliers { anywhere } else { exact + noise };
            let observation_idx = image.observations.len() as u32;
            image.observations.push(Observation { pixel, point: Some(*id) });
            point.track.push(TrackElement { image: *image_id, observation_idx });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_scenes_project_onto_their_observations() {
        for path in [CameraMotion::Arc, CameraMotion::Flight] {
            let scene = static_scene(&Options { path, num_images: 40, ..Options::default() });
            assert!(scene.points.len() > 50);
            for image in scene.images.values() {
                assert!(image.observations.len() > 3, "{path:?}");
                for o in &image.observations {
                    let point = &scene.points[&o.point.unwrap()];
                    let seen = scene.camera_of(image).pixel_from_cam(image.cam_from_world * point.position).unwrap();
                    assert!((seen - o.pixel).norm() < 1e-9);
                }
            }
            assert!(scene.points.values().all(|p| p.track.len() >= 2));
        }
    }

    #[test]
    fn a_seed_repeats_a_scene() {
        let options = Options { noise_px: 1.0, outliers: 0.1, ..Options::default() };
        assert_eq!(static_scene(&options), static_scene(&options));
        assert_ne!(static_scene(&options), static_scene(&Options { seed: 1, ..options }));
    }
}
