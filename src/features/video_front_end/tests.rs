//! Lost and re-detected points, on images with known motion.

use nalgebra::Vector2;
use rand::Rng as _;

use super::*;
use crate::math::seeded_rng;
use crate::scene::FrameId;

/// Random gray values, coarse and fine together: corners everywhere, no two alike.
fn texture() -> GrayImage {
    let mut rng = seeded_rng(5, 0);
    let mut layer = |cell: u32| {
        let cells = GrayImage::from_fn(880 / cell, 480 / cell, |_, _| ::image::Luma([rng.random_range(10..245)]));
        ::image::imageops::resize(&cells, 880, 480, ::image::imageops::FilterType::Triangle)
    };
    let (coarse, fine) = (layer(20), layer(4));
    GrayImage::from_fn(880, 480, |x, y| {
        let [a, b] = [&coarse, &fine].map(|layer| u16::from(layer.get_pixel(x, y).0[0]));
        ::image::Luma([((a + b) / 2) as u8])
    })
}

/// Tracks of a window that moves over the texture; its corners, whole pixels, by frame. One frame may be occluded.
fn tracked(corners: &[[u32; 2]], occluded: Option<u32>) -> TrackTable {
    tracked_with(VideoOptions::object(), corners, occluded)
}

fn tracked_with(options: VideoOptions, corners: &[[u32; 2]], occluded: Option<u32>) -> TrackTable {
    tracked_while(options, corners, occluded, |_| {})
}

/// As [`tracked_with`]; `then` follows every frame.
fn tracked_while(
    options: VideoOptions,
    corners: &[[u32; 2]],
    occluded: Option<u32>,
    mut then: impl FnMut(&mut VideoFrontEnd),
) -> TrackTable {
    const SIZE: [u32; 2] = [320, 240];
    let texture = texture();
    let mut front_end = VideoFrontEnd::new(options, Camera::prior(SIZE[0], SIZE[1]));
    for (k, [x, y]) in (0u32..).zip(corners) {
        let window = ::image::imageops::crop_imm(&texture, *x, *y, SIZE[0], SIZE[1]).to_image();
        let image = RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| ::image::Rgb([window.get_pixel(x, y).0[0]; 3]));
        let frame = Frame { id: FrameId(k), name: format!("{k}.png"), time_s: f64::from(k) };
        let mask = Mask::from_fn(SIZE[0], SIZE[1], |_, _| occluded != Some(k));
        front_end.push(&frame, &Picture::new(&image), &mask).unwrap();
        then(&mut front_end);
    }
    front_end.finish()
}

#[test]
fn dropped_views_leave_the_other_tracks_as_they_are() {
    let corners: Vec<[u32; 2]> = (0..12).map(|k| [2 * k, k]).collect();
    let whole = tracked(&corners, None);
    let kept = tracked_while(VideoOptions::object(), &corners, None, |front_end| {
        let now = front_end.table().views.len();
        front_end.retain_views(|view, _| view + 4 >= now || view == 0);
    });
    assert_eq!(kept.views.len(), 5);
    let names = |table: &TrackTable| -> Vec<String> { table.views.iter().map(|view| view.name.clone()).collect() };
    assert_eq!(names(&kept), ["0.png", "8.png", "9.png", "10.png", "11.png"]);
    let ends = |table: &TrackTable| -> Vec<Point2<f64>> {
        let last = table.views.len() as u32 - 1;
        let spans = table.tracks.iter().filter(|track| track[0].view == 0 && track[track.len() - 1].view == last);
        spans.flat_map(|track| [track[0], track[track.len() - 1]].map(|feature| table.pixel(feature))).collect()
    };
    assert!(ends(&kept).len() > 50 && ends(&kept) == ends(&whole), "{}", ends(&kept).len());
}

/// Maximum distance of a track's features from the texture's true positions, pixels.
fn drift(table: &TrackTable, corners: &[[u32; 2]], track: &Track) -> f64 {
    let place = |f: &Feature| {
        let [x, y] = corners[f.view as usize].map(f64::from);
        table.pixel(*f).coords + Vector2::new(x, y)
    };
    let first = place(&track[0]);
    track.iter().map(|f| (place(f) - first).norm()).fold(0.0, f64::max)
}

fn crossing(table: &TrackTable, first: u32, then: u32) -> Vec<&Track> {
    let has = |track: &Track, view: u32| track.iter().any(|f| f.view == view);
    table.tracks.iter().filter(|track| has(track, first) && has(track, then)).collect()
}

#[test]
fn another_place_is_not_matched() {
    let corners: Vec<[u32; 2]> = (0..6).map(|k| [2 * k, k]).chain((0..5).map(|k| [540 + 2 * k, 200 + k])).collect();
    assert!(crossing(&tracked(&corners, Some(5)), 4, 6).is_empty());
}

#[test]
fn a_loop_closure_lasts_for_a_few_views() {
    let here = |k: u32| [2 * k, k];
    let elsewhere = (0..105).map(|k| [500 + k / 2, 200]);
    let corners: Vec<[u32; 2]> = (0..5).map(here).chain(elsewhere).chain((2..16).map(here)).collect();
    let table = tracked(&corners, None);
    let after_long = |track: &Track| track.windows(2).position(|w| w[1].view >= w[0].view + 100);
    let returned: Vec<(&Track, usize)> =
        table.tracks.iter().filter_map(|track| Some((track, track.len() - 1 - after_long(track)?))).collect();
    assert!(returned.len() >= 20, "{}", returned.len());
    let mut drifts: Vec<f64> = Vec::new();
    for (track, num_later) in returned {
        assert!(num_later <= 8, "{num_later} views after {:?}", track[0]);
        drifts.push(drift(&table, &corners, track));
    }
    // One re-detection in five may be wrong (docs/sfm.md).
    let num_right = drifts.iter().filter(|drift| **drift < 0.5).count();
    assert!(5 * num_right >= 4 * drifts.len(), "{drifts:?}");
}

#[test]
fn re_detection_uses_the_matching_options() {
    let here = |k: u32| [2 * k, k];
    let elsewhere = (0..3).map(|k| [500 + k, 200]);
    let corners: Vec<[u32; 2]> = (0..5).map(here).chain(elsewhere).chain((5..8).map(here)).collect();
    let num_found = |matching: MatchOptions| {
        let options = VideoOptions { matching, ..VideoOptions::object() };
        crossing(&tracked_with(options, &corners, None), 3, 9).len()
    };
    assert!(num_found(MatchOptions::default()) >= 20);
    // A few points survive by tracking alone.
    assert!(num_found(MatchOptions { max_ratio: -1.0, ..MatchOptions::default() }) < 10);
}
