//! Tracking tests in a synthetic 2D scene with exact masks and flow.

use super::world::{HEIGHT, Thing, WIDTH, World};
use super::*;
use crate::networks::{KnownMasks, PerceptionError};
use crate::scene::Detection;

const RED: [u8; 3] = [200, 30, 30];
const BLUE: [u8; 3] = [30, 40, 210];

fn all(_: usize, detections: Vec<Detection>) -> Vec<Detection> {
    detections
}

/// Provisional id of the mask that overlaps a thing best in a frame, by more than half.
fn follower(world: &World, frames: &[Vec<TrackedMask>], t: usize, thing: usize) -> Option<ObjectId> {
    let truth = world.mask(t, thing);
    frames[t].iter().find(|m| m.mask.iou(&truth) > 0.5).map(|m| m.object)
}

#[test]
fn a_car_gets_one_id_from_its_first_frame() {
    let world = World::still(vec![Thing::car(RED, |t| (10 + 6 * t as i64, 30))]);
    let (frames, tracks) = world.track(20, all);
    assert_eq!(tracks.len(), 1);
    let track = &tracks[0];
    assert_eq!((track.id, track.class.as_str(), track.found.detected()), (ObjectId(1), "car", 20));
    assert_eq!((track.first, track.last, track.num_carried), (FrameId(0), FrameId(19), 0));
    for t in 0..20 {
        assert_eq!(follower(&world, &frames, t, 0), Some(track.provisional));
    }
}

#[test]
fn two_cars_of_one_color_cross_and_keep_their_ids() {
    for color in [RED, BLUE] {
        let world = World::still(vec![
            Thing::car(RED, |t| (5 + 7 * t as i64, 30)),
            Thing::car(color, |t| (170 - 7 * t as i64, 33)),
        ]);
        let (frames, tracks) = world.track(23, all);
        assert_eq!(tracks.len(), 2, "{tracks:#?}");
        for thing in 0..2 {
            let before = follower(&world, &frames, 2, thing);
            assert!(before.is_some());
            assert_eq!(before, follower(&world, &frames, 22, thing), "thing {thing} in colour {color:?}");
        }
    }
}

#[test]
fn missed_detections_are_bridged_by_the_propagated_mask() {
    let world = World::still(vec![Thing::car(RED, |t| (10 + 5 * t as i64, 30))]);
    let (frames, tracks) = world.track(20, |t, found| if (8..13).contains(&t) { Vec::new() } else { found });
    assert_eq!((tracks.len(), tracks[0].found.detected(), tracks[0].num_carried), (1, 15, 5));
    for t in 8..13 {
        let [tracked] = &frames[t][..] else { panic!("one mask in frame {t}") };
        assert_eq!((tracked.evidence, tracked.object), (Evidence::Carried, tracks[0].provisional));
        assert!(tracked.mask.iou(&world.mask(t, 0)) > 0.9);
    }
}

#[test]
fn an_occluded_car_is_linked_after_the_wall() {
    // Occluded for about ten frames, longer than masks are propagated.
    let world = World::still(vec![Thing::car(RED, |t| (5 + 5 * t as i64, 30)), Thing::wall(60, 60)]);
    let (frames, tracks) = world.track(32, all);
    let [before, after] = &tracks[..] else { panic!("two pieces: {tracks:#?}") };
    assert_eq!(after.after.map(|after| after.provisional), Some(before.provisional));
    let ids = [3, 31].map(|t| follower(&world, &frames, t, 0));
    assert_eq!(ids, [Some(before.provisional), Some(after.provisional)]);
    // Nothing is reported while the car is occluded.
    let occluded = (0..32).filter(|&t| world.mask(t, 0).area_px2() == 0);
    assert!(occluded.clone().count() >= 6);
    assert!(occluded.into_iter().all(|t| frames[t].is_empty()));
}

#[test]
fn an_occluded_car_is_linked_while_the_camera_pans() {
    // The car does not move in the image while the background moves past it.
    let mut wall = Thing::wall(120, 30);
    wall.at = Box::new(|t| (120 - 4 * t as i64, 0));
    let world = World { things: vec![Thing::car(RED, |_| (60, 30)), wall], pan: (-4, 0) };
    let (frames, tracks) = world.track(40, all);
    let ids = [3, 39].map(|t| follower(&world, &frames, t, 0));
    let piece = tracks.iter().find(|track| Some(track.provisional) == ids[1]);
    let before = piece.and_then(|track| track.after).map(|after| after.provisional).or(ids[1]);
    assert!(ids[0].is_some() && before == ids[0], "{tracks:#?}");
}

#[test]
fn a_brief_occlusion_is_a_gap_of_one_object() {
    let world = World::still(vec![Thing::car(RED, |t| (5 + 8 * t as i64, 30)), Thing::wall(80, 30)]);
    let (_, tracks) = world.track(22, all);
    let [track] = &tracks[..] else { panic!("one object: {tracks:#?}") };
    let [gap] = &track.gaps[..] else { panic!("one gap: {track:#?}") };
    assert!(gap.last < gap.first && gap.first.0 - gap.last.0 <= 6, "{gap:?}");
    assert!(gap.evidence.place.is_some_and(|place| place < 1.0));
}

#[test]
fn another_car_from_behind_the_wall_is_another_object() {
    let world = World::still(vec![
        Thing::car(RED, |t| ((5 + 5 * t as i64).min(75), 30)),
        Thing::car(BLUE, |t| ((75 + 5 * (t as i64 - 20)).max(75), 30)),
        Thing::wall(60, 60),
    ]);
    let (_, tracks) = world.track(36, all);
    assert_eq!(tracks.len(), 2, "{tracks:#?}");
    assert!(tracks[0].last < tracks[1].first && tracks[1].after.is_none());
}

#[test]
fn a_car_that_stops_and_starts_keeps_its_id() {
    let world = World::still(vec![Thing::car(RED, |t| (10 + 6 * (t.min(8) + t.saturating_sub(28)) as i64, 30))]);
    let (_, tracks) = world.track(40, all);
    assert_eq!((tracks.len(), tracks[0].found.detected()), (1, 40));
}

#[test]
fn one_leaves_and_another_enters() {
    let world = World::still(vec![
        Thing::car(RED, |t| (120 + 8 * t as i64, 30)),
        Thing::car(BLUE, |t| (-90 + 8 * t as i64, 30)),
    ]);
    let (frames, tracks) = world.track(30, all);
    assert_eq!(tracks.len(), 2);
    assert!(tracks[0].last < tracks[1].last && tracks[0].first < tracks[1].first);
    assert!(frames[29].iter().all(|m| m.object == tracks[1].provisional));
}

#[test]
fn a_false_alarm_gets_no_final_id_and_ids_are_dense() {
    let world = World::still(vec![Thing::car(RED, |t| (10 + 5 * t as i64, 50))]);
    let alarm = |t: usize, mut found: Vec<Detection>| {
        if t.is_multiple_of(7) {
            let mask =
                Mask::from_fn(WIDTH, HEIGHT, |x, y| (20 + 20 * t as u32 / 7..).take(15).any(|u| u == x) && y < 12);
            found.push(Detection { class: "car".into(), confidence: 0.6, mask });
        }
        found
    };
    let (frames, tracks) = world.track(22, alarm);
    assert_eq!(tracks.iter().map(|t| t.id).collect::<Vec<_>>(), [ObjectId(1)]);
    let is_alarm = |m: &&TrackedMask| m.mask.bounding_box().is_some_and(|bounds| (bounds.x0, bounds.y0) == (40, 0));
    let alarm = frames[7].iter().find(is_alarm).expect("the alarm is reported");
    assert!(tracks.iter().all(|track| track.provisional != alarm.object));
}

#[test]
fn one_car_that_is_called_car_and_truck_is_one_object() {
    let world = World::still(vec![Thing::car(RED, |t| (10 + 5 * t as i64, 30))]);
    let twice = |t: usize, mut found: Vec<Detection>| {
        let mut truck = found[0].clone();
        truck.class = "truck".into();
        truck.confidence = if t.is_multiple_of(3) { 0.95 } else { 0.4 };
        found.push(truck);
        found
    };
    let (frames, tracks) = world.track(15, twice);
    assert_eq!((tracks.len(), tracks[0].class.as_str()), (1, "car"));
    assert!(frames.iter().all(|masks| masks.len() == 1));
}

#[test]
fn classes_that_are_not_tracked_are_skipped() {
    let world = World::still(vec![Thing { class: Some("person"), ..Thing::car(RED, |_| (10, 30)) }]);
    let (frames, tracks) = world.track(6, all);
    assert!(tracks.is_empty() && frames.iter().all(Vec::is_empty));
}

#[test]
fn the_same_input_gives_the_same_result() {
    let world = World::still(vec![
        Thing::car(RED, |t| (5 + 7 * t as i64, 30)),
        Thing::car(BLUE, |t| (170 - 7 * t as i64, 33)),
        Thing::wall(90, 20),
    ]);
    assert_eq!(world.track(25, all), world.track(25, all));
}

#[test]
fn sizes_and_order_are_checked() {
    let world = World::still(vec![Thing::car(RED, |_| (10, 30))]);
    let mut tracker = Tracker::new(TrackerOptions::default());
    let image = world.image(0);
    let small = Detection { class: "car".into(), confidence: 0.9, mask: Mask::from_fn(5, 5, |_, _| true) };
    let mut advance = |t: usize, detections: Vec<Detection>| {
        let (found, mut known) = (DetectedBox::of_masks(&detections), KnownMasks::new(detections));
        let input = FrameInput { found, by: BoxSource::Detector, segmenter: Some(&mut known) };
        tracker.advance(&World::frame(t), &image, input, None)
    };
    assert!(matches!(advance(3, vec![small]), Err(PerceptionError::SizeMismatch { .. })));
    advance(3, world.detections(0)).unwrap();
    let again = advance(3, Vec::new());
    assert!(matches!(again, Err(PerceptionError::FrameOrder { .. })));
    let nothing = || FrameInput { found: Vec::new(), by: BoxSource::Motion, segmenter: None };
    let other = tracker.advance(&World::frame(4), &::image::RgbImage::new(9, 9), nothing(), None);
    assert!(matches!(other, Err(PerceptionError::SizeMismatch { .. })));
    // A tracker continues after invalid input.
    assert_eq!(tracker.advance(&World::frame(5), &image, nothing(), Some(&world.flow(1))).unwrap().len(), 1);
}

#[test]
fn invalid_options_are_named() {
    let options = TrackerOptions { min_detections: 0, ..TrackerOptions::default() };
    assert!(options.check().unwrap_err().to_string().contains("min_detections"));
    let options = TrackerOptions { min_overlap: f64::NAN, ..TrackerOptions::default() };
    assert!(options.check().unwrap_err().to_string().contains("min_overlap"));
}
