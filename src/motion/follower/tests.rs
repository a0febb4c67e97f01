//! Points on pictures whose motion is known.

use ::image::{GrayImage, Pixel as _, RgbImage};
use rand::Rng as _;

use super::*;
use crate::math::seeded_rng;

const SIZE: (u32, u32) = (240, 160);
/// Where every picture shows something else.
const FLICKERS: std::ops::Range<u32> = 100..160;

/// Random grey in cells of five pixels.
fn texture(seed: u64) -> GrayImage {
    let mut rng = seeded_rng(seed, 0);
    let cells = GrayImage::from_fn(80, 40, |_, _| ::image::Luma([rng.random_range(20..235)]));
    ::image::imageops::resize(&cells, 400, 200, ::image::imageops::FilterType::Triangle)
}

/// The wall moves two pixels a frame to the left; in the middle every picture shows another one.
fn picture(wall: &GrayImage, k: u32) -> RgbImage {
    let other = texture(100 + u64::from(k));
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        let shown = if FLICKERS.contains(&x) { other.get_pixel(x, y) } else { wall.get_pixel(x + 2 * k, y) };
        shown.to_rgb()
    })
}

fn follower() -> PointFollower {
    PointFollower::new(SIZE)
}

#[test]
fn points_stay_on_what_they_were_found_on() {
    let (wall, mut follower) = (texture(1), follower());
    (0..12).for_each(|k| follower.push(&Picture::new(&picture(&wall, k))).unwrap());
    let tracks = follower.finish();
    let right = |track: &PointTrack| {
        let [x, y] = track.pixels[0];
        let at = |k: usize| [x - 2.0 * k as f32, y];
        track.pixels.iter().enumerate().all(|(k, p)| (p[0] - at(k)[0]).hypot(p[1] - at(k)[1]) < 0.3)
    };
    let num_right = tracks.iter().filter(|track| right(track)).count();
    assert!(tracks.len() > 100 && num_right as f64 > 0.95 * tracks.len() as f64, "{num_right} of {}", tracks.len());
}

#[test]
fn cells_rest_whose_points_do_not_last_and_no_others() {
    let (wall, mut follower) = (texture(1), follower());
    (0..6).for_each(|k| follower.push(&Picture::new(&picture(&wall, k))).unwrap());
    let (cols, rows) = follower.grid();
    let resting = |columns: std::ops::Range<usize>| {
        let cells = (0..rows).flat_map(|row| columns.clone().map(move |col| row * cols + col));
        cells.filter(|cell| follower.rested[*cell] >= follower.num_frames).count() as f64
            / (rows * columns.len()) as f64
    };
    assert!(resting(10..16) > 0.5, "{}", resting(10..16));
    assert!(resting(17..24) < 0.1, "{}", resting(17..24));
}
