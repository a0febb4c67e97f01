//! Tests of the point tracker on synthetic images with known motion.

use ::image::{GrayImage, Pixel as _, RgbImage};
use rand::Rng as _;

use super::*;
use crate::math::seeded_rng;

const SIZE: (u32, u32) = (240, 160);
/// Columns with a different texture in every image.
const FLICKERS: std::ops::Range<u32> = 100..160;

/// Random gray levels in cells of five pixels.
fn texture(seed: u64) -> GrayImage {
    let mut rng = seeded_rng(seed, 0);
    let cells = GrayImage::from_fn(80, 40, |_, _| ::image::Luma([rng.random_range(20..235)]));
    ::image::imageops::resize(&cells, 400, 200, ::image::imageops::FilterType::Triangle)
}

/// The wall moves to the left by two pixels per frame; the middle has another texture in every image.
fn image(wall: &GrayImage, k: u32) -> RgbImage {
    let other = texture(100 + u64::from(k));
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        let pixel = if FLICKERS.contains(&x) { other.get_pixel(x, y) } else { wall.get_pixel(x + 2 * k, y) };
        pixel.to_rgb()
    })
}

fn follower() -> PointFollower {
    PointFollower::new(SIZE)
}

#[test]
fn points_follow_their_texture() {
    let (wall, mut follower) = (texture(1), follower());
    (0..12).for_each(|k| follower.push(&Picture::new(&image(&wall, k))).unwrap());
    let tracks = follower.finish();
    let is_right = |track: &PointTrack| {
        let [x, y] = track.pixels[0];
        let at = |k: usize| [x - 2.0 * k as f32, y];
        track.pixels.iter().enumerate().all(|(k, p)| (p[0] - at(k)[0]).hypot(p[1] - at(k)[1]) < 0.3)
    };
    let num_right = tracks.iter().filter(|track| is_right(track)).count();
    assert!(tracks.len() > 100 && num_right as f64 > 0.95 * tracks.len() as f64, "{num_right} of {}", tracks.len());
}

#[test]
fn only_cells_whose_points_are_lost_soon_are_blocked() {
    let (wall, mut follower) = (texture(1), follower());
    (0..6).for_each(|k| follower.push(&Picture::new(&image(&wall, k))).unwrap());
    let (cols, rows) = follower.grid();
    let blocked = |columns: std::ops::Range<usize>| {
        let cells = (0..rows).flat_map(|row| columns.clone().map(move |col| row * cols + col));
        cells.filter(|cell| follower.blocked_until[*cell] >= follower.num_frames).count() as f64
            / (rows * columns.len()) as f64
    };
    assert!(blocked(10..16) > 0.5, "{}", blocked(10..16));
    assert!(blocked(17..24) < 0.1, "{}", blocked(17..24));
}
