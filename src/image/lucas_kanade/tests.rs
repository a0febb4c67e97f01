//! Comparison with ground truth of synthetic images, and with OpenCV if its module `video` is available.

#[cfg(feature = "perception")]
mod opencv;

use rand::Rng as _;

use super::*;
use crate::image::warp_gray;
use crate::math::seeded_rng;

const METHOD: LucasKanade =
    LucasKanade { window_radius_px: 7, num_smaller: 3, max_steps: 20, converged_px: 0.03, min_eigenvalue: 1e-4 };

/// A smooth random texture.
fn texture(seed: u64) -> GrayImage {
    let mut rng = seeded_rng(seed, 0);
    let coarse = GrayImage::from_fn(60, 40, |_, _| ::image::Luma([rng.random_range(20..235)]));
    ::image::imageops::resize(&coarse, 300, 200, ::image::imageops::FilterType::CatmullRom)
}

/// Waves of 9 to 40 pixels in all directions, shifted to the right and down.
fn waves(seed: u64, [right, down]: [f64; 2]) -> GrayImage {
    let mut rng = seeded_rng(seed, 0);
    let waves: Vec<[f64; 3]> = (0..16)
        .map(|_| {
            let (length, angle) = (rng.random_range(9.0..40.0), rng.random_range(0.0..std::f64::consts::TAU));
            let step = std::f64::consts::TAU / length;
            [step * f64::cos(angle), step * f64::sin(angle), rng.random_range(0.0..std::f64::consts::TAU)]
        })
        .collect();
    GrayImage::from_fn(300, 200, |x, y| {
        let (x, y) = (f64::from(x) - right, f64::from(y) - down);
        let sum: f64 = waves.iter().map(|[across, along, phase]| (across * x + along * y + phase).sin()).sum();
        ::image::Luma([(128.0 + 7.0 * sum).round().clamp(0.0, 255.0) as u8])
    })
}

/// The image shifted to the right and down.
fn moved(picture: &GrayImage, [x, y]: [f64; 2]) -> GrayImage {
    let map = nalgebra::Matrix2x3::new(1.0, 0.0, -x, 0.0, 1.0, -y);
    warp_gray(picture, &map, picture.width(), picture.height()).unwrap()
}

fn grid(spacing: usize, margin: usize) -> Vec<Point2<f32>> {
    let columns = move |y| (margin..300 - margin).step_by(spacing).map(move |x| Point2::new(x as f32, y as f32));
    (margin..200 - margin).step_by(spacing).flat_map(columns).collect()
}

fn pyramids(first: &GrayImage, second: &GrayImage) -> (Pyramid, Pyramid) {
    (Pyramid::new(first.clone(), 3).unwrap(), Pyramid::new(second.clone(), 3).unwrap())
}

#[test]
fn a_shift_is_found_to_a_few_hundredths_of_a_pixel() {
    for (seed, shift) in [(1, [0.3, -0.6]), (2, [7.25, 4.5]), (3, [-12.0, 9.4])] {
        let (from, to) = pyramids(&waves(seed, [0.0; 2]), &waves(seed, shift));
        let points = grid(11, 30);
        let returned = METHOD.there_and_back(&from, &to, &points, &points);
        let is_right = |(point, returned): &(&Point2<f32>, &Option<Returned>)| {
            returned.is_some_and(|found| {
                let error = found.position - **point - nalgebra::Vector2::new(shift[0] as f32, shift[1] as f32);
                error.norm() < 0.06 && found.round_trip_px < 0.1 && found.difference < 3.0
            })
        };
        let num_right = points.iter().zip(&returned).filter(is_right).count();
        assert!(num_right as f64 > 0.85 * points.len() as f64, "{shift:?}: {num_right} of {}", points.len());
    }
}

#[test]
fn a_guess_saves_the_smaller_pictures() {
    let first = texture(4);
    let (from, to) = pyramids(&first, &moved(&first, [22.0, -17.0]));
    let points = grid(13, 40);
    let guesses: Vec<_> = points.iter().map(|p| p + nalgebra::Vector2::new(21.0, -16.0)).collect();
    let is_right = |(p, found): (&Point2<f32>, &Option<TrackedPoint>)| {
        found.is_some_and(|found| (found.position - p - nalgebra::Vector2::new(22.0, -17.0)).norm() < 0.1)
    };
    let count = |found: Vec<Option<TrackedPoint>>| points.iter().zip(&found).filter(|(p, f)| is_right((p, f))).count();
    assert!(count(METHOD.near().follow(&from, &to, &points, &guesses)) as f64 > 0.97 * points.len() as f64);
    assert!(count(METHOD.near().follow(&from, &to, &points, &points)) < points.len() / 10);
}

#[test]
fn what_shows_nothing_or_lies_beside_the_picture_is_not_found() {
    let plain = GrayImage::from_pixel(300, 200, ::image::Luma([90]));
    let (from, to) = pyramids(&plain, &plain);
    assert!(METHOD.follow(&from, &to, &grid(40, 20), &grid(40, 20)).iter().all(Option::is_none));
    let (from, to) = pyramids(&texture(5), &texture(5));
    let beside = [[-40.0, 10.0], [10.0, 300.0], [f32::NAN, 5.0], [1e12, 5.0], [5.0, f32::INFINITY]];
    let points: Vec<_> = beside.map(|[x, y]| Point2::new(x, y)).into();
    assert!(METHOD.follow(&from, &to, &points, &points).iter().all(Option::is_none));
    let inside = vec![Point2::new(150.0, 100.0); points.len()];
    assert!(METHOD.follow(&from, &to, &inside, &points).iter().all(Option::is_none));
    for (width, height) in [(0, 0), (1, 1), (3, 40), (40, 2)] {
        let tiny = GrayImage::from_fn(width, height, |x, y| ::image::Luma([(x * 40 + y * 9) as u8]));
        let (from, to) = pyramids(&tiny, &tiny);
        METHOD.follow(&from, &to, &[Point2::new(1.0, 1.0)], &[Point2::new(1.0, 1.0)]);
    }
}
