use super::*;

use nalgebra::Point3;
use rand::Rng as _;
use rand_distr::StandardNormal;

use crate::math::{Rng, median, seeded_rng};

fn camera() -> Camera {
    Camera::with_focal(960, 540, 800.0)
}

/// Segments of a street with walls below a camera 30 m above it: kerbs along it and across it, and verticals; one in
/// ten has a random direction.
pub(crate) fn street(camera: &Camera, up: &Vector3<f64>, slope: f64, rng: &mut Rng) -> Vec<[Point2<f64>; 2]> {
    let angles = Vector2::new((-up.z).atan2(-up.y), up.x.asin());
    let heading = rng.random_range(0.2..1.3);
    let [along, across] = [0.0, std::f64::consts::FRAC_PI_2].map(|turn| level(angles, heading + turn));
    let vertical = (up + along * slope).normalize();
    let ahead = level(angles, std::f64::consts::FRAC_PI_2);
    let mut found = Vec::new();
    while found.len() < 160 {
        let middle = ahead * (30.0 / angles.x.tan() + rng.random_range(-25.0..25.0))
            + level(angles, 0.0) * rng.random_range(-25.0..25.0)
            - up * rng.random_range(18.0..30.0);
        let any = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal)).normalize();
        let direction = match found.len() % 10 {
            0..4 => along,
            4..6 => across,
            6..9 => vertical,
            _ => any,
        };
        let half = direction * rng.random_range(1.0..3.0);
        let ends = [middle - half, middle + half].map(|end| camera.pixel_from_cam(Point3::from(end)));
        let [Some(from), Some(to)] = ends else { continue };
        if camera.contains(from) && camera.contains(to) && (to - from).norm() > 24.0 {
            let mut noise = || Vector2::from_fn(|_, _| 0.3 * rng.sample::<f64, _>(StandardNormal));
            found.push([from + noise(), to + noise()]);
        }
    }
    found
}

fn in_first(segments: &[[Point2<f64>; 2]]) -> ViewSegments<'_> {
    (UnitQuaternion::identity(), segments)
}

#[test]
fn lines_of_a_street_show_the_ground_and_the_focal_length() {
    let mut rng = seeded_rng(3, 0);
    for (pitch, roll, guess) in [(0.35, 0.01, 1.3), (0.7, -0.02, 0.8), (1.0, 0.0, 1.0)] {
        let up = up_in_cam(Vector2::new(pitch, roll));
        let mut offs: [Vec<f64>; 3] = Default::default();
        for _ in 0..5 {
            let segments = street(&camera(), &up, 0.0, &mut rng);
            let initial = Camera::with_focal(960, 540, 800.0 * guess);
            let found = horizon(&[in_first(&segments)], &initial, 0.25).unwrap();
            let (normal, [log_focal, std]) = found;
            assert!(normal.covariance.trace().sqrt() < 0.06 && std < 0.12, "{pitch}: {found:?}");
            assert!((log_focal + f64::ln(guess)).abs() < 1.5 * std, "{pitch}: {found:?}");
            let held = horizon(&[in_first(&segments)], &camera(), 0.0).unwrap();
            assert!(held.1[0].abs() < 1e-9, "{held:?}");
            // The same street by a camera that has turned.
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, 0.05, -0.01));
            let in_turned = |end| camera().pixel_from_cam(Point3::from(turn.inverse() * camera().ray_from_pixel(end)));
            let turned = segments.iter().map(|ends| ends.map(|end| in_turned(end).unwrap()));
            let turned: Vec<[Point2<f64>; 2]> = turned.collect();
            let both = horizon(&[in_first(&segments), (turn.inverse(), &turned)], &camera(), 0.0).unwrap();
            let found = [found, held, both].map(|(normal, _)| normal.normal_in_world.angle(&up));
            offs.iter_mut().zip(found).for_each(|(offs, off)| offs.push(off));
        }
        for offs in offs {
            let largest = offs.iter().copied().fold(0.0, f64::max);
            assert!(median(offs.clone()).unwrap() < 0.01 && largest < 0.02, "{pitch}: {offs:?}");
        }
    }
}

#[test]
fn the_slope_of_a_street_is_within_sigma() {
    let mut rng = seeded_rng(4, 0);
    let angles = Vector2::new(0.6, 0.0);
    for slope in [-0.04, -0.02, 0.02, 0.04] {
        let (normal, log_focal) =
            horizon(&[in_first(&street(&camera(), &up_in_cam(angles), slope, &mut rng))], &camera(), 0.25).unwrap();
        let off = normal.normal_in_world.angle(&up_in_cam(angles)) / normal.covariance.trace().sqrt();
        let of_focal = log_focal[0].abs() / log_focal[1];
        assert!(off < 1.5 && of_focal < 1.5, "{slope}: {off} {of_focal}");
    }
}

#[test]
fn lines_of_random_directions_are_rejected() {
    let mut rng = seeded_rng(5, 0);
    for num in [20, 60, 200] {
        let mut segment = || {
            let middle = Point2::new(rng.random_range(40.0..920.0), rng.random_range(40.0..500.0));
            let angle: f64 = rng.random_range(0.0..std::f64::consts::PI);
            let half = Vector2::new(angle.cos(), angle.sin()) * rng.random_range(12.0..30.0);
            [middle - half, middle + half]
        };
        let segments: Vec<_> = (0..num).map(|_| segment()).collect();
        assert_eq!(horizon(&[in_first(&segments)], &camera(), 0.25), None, "{num}");
    }
}

#[test]
fn lines_from_straight_above_are_rejected() {
    let mut rng = seeded_rng(5, 0);
    for (pitch, focal_std) in [(1.45, 0.4), (1.5, 0.4), (1.57, 0.4), (1.57, 0.0)] {
        for _ in 0..4 {
            let segments = street(&camera(), &up_in_cam(Vector2::new(pitch, 0.0)), 0.0, &mut rng);
            let found = horizon(&[in_first(&segments)], &camera(), focal_std);
            assert_eq!(found, None, "{pitch}");
        }
    }
}
