//! One set of tests for all estimators: every method is exact where its assumption is true, near the truth with noise,
//! and undetermined where the camera makes it blind.

use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use rand::Rng as _;
use rand_distr::StandardNormal;

use super::motion::Motion;
use super::ozden_heading::Heading;
use super::*;
use crate::math::seeded_rng;
use crate::scene::FrameId;
use crate::trajectory::View;

/// Background units per object unit.
const RATIO: f64 = 0.7;
const NUM_FRAMES: u32 = 60;
/// From the rear axle to the center of the box, meters (the background's unit).
const AXLE: f64 = 1.3;

/// Motion of a camera and a vehicle.
#[derive(Clone, Copy, Debug)]
enum World {
    /// The vehicle turns on a plane; the camera moves freely.
    Curve,
    /// The camera follows the vehicle at a constant distance.
    Following,
    /// The vehicle turns; the camera keeps its height.
    LevelCamera,
    /// Ground planes are above the camera.
    WrongPlanes,
}

impl World {
    /// Position on the map and heading of the vehicle.
    fn vehicle(self, t: f64) -> ([f64; 2], f64) {
        let s = t / f64::from(NUM_FRAMES);
        match self {
            Self::Curve | Self::LevelCamera | Self::WrongPlanes => {
                let (sin, cos) = (1.5 * s).sin_cos();
                // The rear axle is on the circle.
                ([20.0 * sin + AXLE * cos, 20.0 * (1.0 - cos) + AXLE * sin], 1.5 * s)
            }
            Self::Following => ([30.0 * s, 0.0], 0.0),
        }
    }

    fn camera(self, t: f64) -> Vector3<f64> {
        let s = t / f64::from(NUM_FRAMES);
        let free = Vector3::new(
            -15.0 + 25.0 * s + 2.0 * (0.9 * t).sin(),
            -18.0 - 6.0 * (0.5 * t + 1.0).cos(),
            12.0 + 5.0 * s + 1.5 * (0.7 * t).cos(),
        );
        match self {
            Self::Following => Vector3::new(30.0 * s - 14.0, -9.0, 8.0),
            Self::LevelCamera => Vector3::new(free.x, free.y, 12.0),
            _ => free,
        }
    }

    /// Views of a box of 4.3 × 1.8 × 1.4 m on its wheels.
    ///
    /// * `noise` – 1: directions 0.0001 of the distance, attitudes and normals 0.05°, heights 1 cm; the object's size
    ///   drifts by 0.2 %.
    fn views(self, noise: f64, seed: u64) -> Views {
        let rng = &mut seeded_rng(seed, 0x6d6f_7469);
        let mut normal = || noise * rng.sample::<f64, _>(StandardNormal);
        let mut vector = |size: f64| Vector3::new(normal(), normal(), normal()) * size;
        let object_axes = UnitQuaternion::from_euler_angles(0.4, -1.1, 2.0);
        let corner = |k: usize| {
            let sign = |bit: usize| if k >> bit & 1 == 0 { -0.5 } else { 0.5 };
            Vector3::new(4.3 * sign(0), 1.8 * sign(1), 1.4 * sign(2))
        };
        let middle = Point3::new(5.0, -2.0, 1.0);
        let points = (0..8).map(|k| middle + object_axes * corner(k) / RATIO).collect();
        let mut drift = 0.0;
        let view = |k: u32| {
            let t = f64::from(k);
            let ([x, y], heading) = self.vehicle(t);
            let (object, camera) = (Vector3::new(x, y, 0.7), self.camera(t));
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), heading);
            let attitude = UnitQuaternion::from_rotation_matrix(&turn) * object_axes.inverse();
            let attitude = UnitQuaternion::from_scaled_axis(vector(0.001)) * attitude;
            let distance = (object - camera).norm();
            drift += vector(0.002 / f64::from(NUM_FRAMES).sqrt()).x;
            let offset = ((object - camera) * (1.0 + drift) + vector(1e-4) * distance) / RATIO;
            let plane = (Vector3::z() + vector(0.001)).normalize();
            let height = camera.z + vector(0.01).x;
            View {
                frame: FrameId(k),
                camera_height: if matches!(self, Self::WrongPlanes) { -height } else { height },
                normal_in_object: attitude.inverse() * plane,
                center_in_object: middle - attitude.inverse() * offset,
                center_in_background: camera.into(),
                background_from_object: attitude,
                height_std: 0.01 * noise,
            }
        };
        let views: Vec<View> = (0..NUM_FRAMES).map(view).collect();
        Views {
            num_paired: views.len(),
            num_planes: views.len(),
            views,
            points,
            plane_std: 0.0,
            max_drift: 0.0,
            camera_hovers: false,
        }
    }
}

fn estimate(method: ScaleMethod, views: &Views) -> Result<Estimate, ScaleError> {
    super::estimate(method, views, &Options::default())
}

/// World in which a method's assumption is true, its maximum errors there without and with noise, and a world in which
/// it is blind. `None` for the adjustment, which needs images and has tests of its own.
fn case(method: ScaleMethod) -> Option<(World, f64, f64, World)> {
    use ScaleMethod as M;
    Some(match method {
        M::Joint => return None,
        M::ConstantDistance => (World::Curve, 1e-9, 0.02, World::LevelCamera),
        M::RobustLeastSquares => (World::Curve, 1e-9, 0.02, World::LevelCamera),
        M::Intersection => (World::Curve, 1e-9, 0.02, World::WrongPlanes),
        M::CameraHeight => (World::Following, 1e-9, 0.02, World::WrongPlanes),
        M::OzdenPlane => (World::Curve, 1e-6, 0.02, World::Following),
        M::OzdenAxis => (World::Curve, 1e-9, 0.05, World::LevelCamera),
        M::OzdenHeading => (World::Curve, 1e-6, 0.02, World::Following),
        M::Yuan | M::YuanLocal => (World::Curve, 1e-9, 0.05, World::LevelCamera),
    })
}

#[test]
fn exact_motions_give_the_exact_ratio() {
    let mut faults = Vec::new();
    for method in ScaleMethod::ALL {
        let Some((world, tolerance, ..)) = case(method) else { continue };
        match estimate(method, &world.views(0.0, 0)) {
            Ok(found) if (found.ratio / RATIO - 1.0).abs() < tolerance => {}
            other => faults.push(format!("{}, {world:?}: {other:?}", method.name())),
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn noise_moves_the_ratio_by_little() {
    let mut faults = Vec::new();
    for method in ScaleMethod::ALL {
        let Some((world, _, tolerance, _)) = case(method) else { continue };
        for seed in 0..4 {
            let found = estimate(method, &world.views(1.0, seed));
            let error = found.as_ref().map(|found| (found.ratio / RATIO - 1.0).abs());
            if !error.is_ok_and(|error| error < tolerance) {
                faults.push(format!("{}, {world:?}, seed {seed}: {found:?}", method.name()));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// A ratio whose own standard deviation is a tenth of it or more counts as undetermined, as in a run.
#[test]
fn blind_cameras_leave_the_ratio_undetermined() {
    let mut faults = Vec::new();
    for method in ScaleMethod::ALL {
        let Some((.., world)) = case(method) else { continue };
        for seed in 0..4 {
            let views = world.views(1.0, seed);
            let found = crate::trajectory::estimate_scale(&views, method, &Options::default());
            if !found.as_ref().map_or(true, |found| found.degenerate) {
                faults.push(format!("{}, {world:?}, seed {seed}: {found:?}", method.name()));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn missing_frames_and_points_give_errors_or_valid_ratios() {
    let (all, none) = (World::Curve.views(1.0, 1), Views { points: Vec::new(), ..World::Curve.views(1.0, 1) });
    for method in ScaleMethod::ALL {
        assert!(estimate(method, &none).is_err(), "{}", method.name());
        let mut gaps = all.clone();
        gaps.views.retain(|view| view.frame.0 % 7 != 3 && !(20..26).contains(&view.frame.0));
        if let Ok(found) = estimate(method, &gaps) {
            assert!(found.ratio.is_finite() && found.ratio > 0.0, "{}: {found:?}", method.name());
        }
        for count in 0..12 {
            let few = Views { views: all.views[..count].to_vec(), ..all.clone() };
            let found = estimate(method, &few);
            assert!(found.is_err() || found.is_ok_and(|found| found.ratio > 0.0), "{}, {count} frames", method.name());
        }
    }
}

#[test]
fn contact_is_as_uncertain_as_the_clearance() {
    let views = World::Following.views(0.0, 0);
    let found = estimate(ScaleMethod::CameraHeight, &views).unwrap();
    let [mean, spread] = Options::default().joint.contact.lowest;
    // A box of 1.4 m from 8 m above the ground.
    let expected = mean.hypot(spread) * 1.4 / 8.0;
    assert!((found.std.unwrap() / found.ratio / expected - 1.0).abs() < 1e-6, "{found:?}, {expected}");
}

/// Ratios of the same noisy motions by an independent implementation in Python of the same equations.
#[test]
fn an_independent_implementation_agrees() {
    let motion = Motion::new(&World::Curve.views(1.0, 1)).unwrap();
    let heading = Heading { guess: RATIO, axle: [AXLE, 1.5], step: 4 }.solve(&motion).unwrap();
    let found = [
        (ozden_plane::ratio(&motion, RATIO).unwrap(), 0.6999602468461339, 1e-6),
        (ozden_axis::ratio(&motion).unwrap(), 0.6999301493016326, 1e-9),
        (heading, 0.7003274815454447, 1e-6),
        (yuan::ratio(&motion).unwrap(), 0.7000714698923379, 1e-12),
        (yuan::local_ratio(&motion).unwrap(), 0.7001272003063905, 1e-12),
    ];
    for (k, (own, other, tolerance)) in found.into_iter().enumerate() {
        assert!((own / other - 1.0).abs() < tolerance, "{k}: {own}, {other}");
    }
}
