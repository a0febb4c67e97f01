//! Tracking tests with boxes in all frames and masks in some.

use super::world::{HEIGHT, Thing, WIDTH, World, found_boxes};
use super::*;
use crate::networks::BoxMask;
use crate::scene::{DetectionSource, Rect};

const RED: [u8; 3] = [200, 30, 30];
const BLUE: [u8; 3] = [30, 40, 210];

fn honest(_: usize, answer: BoxMask) -> Option<BoxMask> {
    Some(answer)
}

/// A car that crosses the image in 40 frames.
fn one_car() -> World {
    World::still(vec![Thing::car(RED, |t| (4 + 4 * t as i64, 30))])
}

/// Number of frames in which the object's own mask, between its first and last frame, overlaps a thing by more than
/// 0.7.
fn followed(world: &World, frames: &[Vec<TrackedMask>], track: &TrackSummary, thing: usize) -> usize {
    let life = track.first.0 as usize..=track.last.0 as usize;
    let is_tracked = |t: &usize| {
        let truth = world.mask(*t, thing);
        frames[*t].iter().any(|m| m.object == track.provisional && m.mask.iou(&truth) > 0.7)
    };
    life.filter(is_tracked).count()
}

#[test]
fn a_car_is_tracked_at_any_segmentation_interval() {
    let world = one_car();
    for every in [1, 5, 10] {
        let (frames, tracks) = world.track_boxes(40, every, |t| world.boxes(t, DetectionSource::Detector), &honest);
        let [track] = &tracks[..] else { panic!("one track, every {every}: {tracks:#?}") };
        assert_eq!((track.class.as_str(), track.found.detector, track.outline), ("car", 40, Outline::Network));
        assert_eq!((track.first, track.last, track.num_looks), (FrameId(0), FrameId(39), 40));
        assert_eq!(followed(&world, &frames, track, 0), 40, "every {every}");
        assert!(track.mask_quality.is_some_and(|quality| (quality - 0.9).abs() < 1e-9));
    }
}

#[test]
fn frames_without_the_detector_do_not_count_as_missed() {
    let world = one_car();
    for every in [5, 10, 20] {
        let mut tracker = Tracker::new(TrackerOptions { min_detections: 2, ..TrackerOptions::default() });
        for t in 0..40 {
            let flow = (t > 0).then(|| world.flow(t));
            let mut segmenter = world::WorldSegmenter { world: &world, t, num_prompts: 0, spoil: &honest };
            let input = match t % every {
                0 => FrameInput {
                    found: found_boxes(world.boxes(t, DetectionSource::Detector)),
                    by: BoxSource::Detector,
                    segmenter: Some(&mut segmenter),
                },
                _ => FrameInput { found: Vec::new(), by: BoxSource::Motion, segmenter: None },
            };
            let masks = tracker.advance(&World::frame(t), &world.image(t), input, flow.as_ref()).unwrap();
            assert!(masks.len() == 1 && masks[0].mask.iou(&world.mask(t, 0)) > 0.9, "frame {t}, every {every}");
        }
        let tracks = tracker.finish();
        assert_eq!((tracks.len(), tracks[0].num_detector_looks, tracks[0].found.detector), (1, 40 / every, 40 / every));
        assert_eq!((tracks[0].found.carried, tracks[0].last), (40 - 40 / every, FrameId(39)));
    }
}

#[test]
fn a_car_without_usable_flow_is_propagated_with_its_boxes() {
    let world = one_car();
    let mut tracker = Tracker::new(TrackerOptions::default());
    for t in 0..40 {
        let flow = (t > 0).then(|| {
            let (mut flow, before) = (world.flow(t), world.mask(t - 1, 0));
            let is_of_it = |at: usize| before.get((at as u32 % WIDTH).into(), (at as u32 / WIDTH).into());
            flow.consistent.iter_mut().enumerate().filter(|(at, _)| is_of_it(*at)).for_each(|(_, c)| *c = false);
            flow
        });
        // A motion box contains a shadow, too.
        let mut found = world.boxes(t, DetectionSource::Motion);
        found.iter_mut().for_each(|found| found.rect.x0 -= 6.0);
        let mut segmenter = world::WorldSegmenter { world: &world, t, num_prompts: 0, spoil: &honest };
        let segmenter = t.is_multiple_of(10).then_some(&mut segmenter as &mut dyn BoxSegmenter);
        let input = FrameInput { found: found_boxes(found), by: BoxSource::Motion, segmenter };
        let masks = tracker.advance(&World::frame(t), &world.image(t), input, flow.as_ref()).unwrap();
        assert!(masks.len() == 1 && masks[0].mask.iou(&world.mask(t, 0)) > 0.9, "frame {t}");
    }
    let [track] = &tracker.finish()[..] else { panic!("one track") };
    assert_eq!((track.first, track.last, track.found.motion), (FrameId(0), FrameId(39), 40));
}

#[test]
fn a_new_mask_corrects_the_frames_nearer_to_it_than_to_the_last_one() {
    let world = one_car();
    // The first mask lacks a quarter of the car.
    let narrow = |t: usize, answer: BoxMask| {
        let end = answer.mask.bounding_box().map_or(0, |b| if t == 0 { b.x1 - b.width() / 4 } else { b.x1 });
        let mask = Mask::from_fn(WIDTH, HEIGHT, |x, y| x < end && answer.mask.get(x.into(), y.into()));
        Some(BoxMask { mask, ..answer })
    };
    let mut tracker = Tracker::new(TrackerOptions::default());
    let mut corrected = Vec::new();
    for t in 0..=8 {
        let flow = (t > 0).then(|| world.flow(t));
        let mut segmenter = world::WorldSegmenter { world: &world, t, num_prompts: 0, spoil: &narrow };
        let segmenter = t.is_multiple_of(8).then_some(&mut segmenter as &mut dyn BoxSegmenter);
        let input = FrameInput {
            found: found_boxes(world.boxes(t, DetectionSource::Detector)),
            by: BoxSource::Detector,
            segmenter,
        };
        let masks = tracker.advance(&World::frame(t), &world.image(t), input, flow.as_ref()).unwrap();
        assert_eq!(masks[0].mask.iou(&world.mask(t, 0)) > 0.9, t == 8, "frame {t}");
        corrected.extend(tracker.take_corrections());
    }
    assert_eq!(corrected.iter().map(|c| c.frame.0).collect::<Vec<_>>(), [7, 6, 5]);
    assert!(corrected.iter().all(|c| c.mask == world.mask(c.frame.0 as usize, 0)));
}

#[test]
fn a_car_on_a_falsely_detected_patch_of_road_is_a_separate_object() {
    // The detector takes the road for a car until the car appears on it, in colors like those of the road.
    let road = Thing { at: Box::new(|_| (20, 10)), size: (100, 60), color: [120, 120, 120], class: Some("car") };
    let car = Thing { size: (44, 36), ..Thing::car([120, 120, 120], |t| (if t < 12 { 300 } else { 46 }, 22)) };
    let world = World::still(vec![road, car]);
    let boxes = |t: usize| {
        let found = world.boxes(t, DetectionSource::Detector);
        found.into_iter().filter(|found| (found.rect.width() < 60.0) == (t >= 12)).collect::<Vec<_>>()
    };
    let network = |t: usize, answer: BoxMask| Some(answer).filter(|answer| t < 12 || answer.mask.area_px2() < 2000);
    let (frames, tracks) = world.track_boxes(40, 1, boxes, &network);
    let car = tracks.iter().find(|track| track.last == FrameId(39)).unwrap();
    // The mask of the road is propagated for three frames.
    assert_eq!((car.first, followed(&world, &frames, car, 1)), (FrameId(15), 25), "{tracks:#?}");
}

#[test]
fn detection_rates_count_only_frames_with_the_detector() {
    let world = one_car();
    let mut tracker = Tracker::new(TrackerOptions::default());
    for t in 0..40 {
        let flow = (t > 0).then(|| world.flow(t));
        let mut segmenter = world::WorldSegmenter { world: &world, t, num_prompts: 0, spoil: &honest };
        let segmenter = t.is_multiple_of(4).then_some(&mut segmenter as &mut dyn BoxSegmenter);
        let input = match t % 2 {
            0 => FrameInput {
                found: found_boxes(world.boxes(t, DetectionSource::Detector)),
                by: BoxSource::Detector,
                segmenter,
            },
            _ => FrameInput { found: Vec::new(), by: BoxSource::Motion, segmenter },
        };
        tracker.advance(&World::frame(t), &world.image(t), input, flow.as_ref()).unwrap();
    }
    let [track] = &tracker.finish()[..] else { panic!("one track") };
    assert_eq!((track.num_looks, track.num_detector_looks, track.found.detector), (40, 20, 20));
}

#[test]
fn a_stationary_object_is_prompted_less_often_until_it_moves_or_is_occluded() {
    let prompted_frames = |world: &World| {
        let prompted = std::cell::RefCell::new(std::collections::BTreeSet::new());
        let note = |t: usize, answer: BoxMask| {
            prompted.borrow_mut().insert(t);
            Some(answer)
        };
        let (frames, tracks) = world.track_boxes(64, 4, |t| world.boxes(t, DetectionSource::Detector), &note);
        assert_eq!(tracks.len(), 1, "{tracks:#?}");
        (prompted.take().into_iter().collect::<Vec<_>>(), followed(world, &frames, &tracks[0], 0))
    };
    // It moves with the background until it drives off.
    let left = |t: usize| 20 + t as i64 + 4 * t.saturating_sub(40) as i64;
    let world = World { things: vec![Thing::car(RED, move |t| (left(t), 30))], pan: (1, 0) };
    assert_eq!(prompted_frames(&world), (vec![0, 4, 16, 28, 40, 44, 48, 52, 56, 60], 64));
    // A pole occludes a part of it.
    let pole = Thing { at: Box::new(|t| (180 - 2 * t as i64, 0)), ..Thing::wall(0, 5) };
    let world = World { things: vec![Thing::car(RED, |_| (90, 30)), pole], pan: (0, 0) };
    let before: Vec<usize> = (0..64).step_by(4).filter(|t| world.mask(*t, 0) != world.mask(0, 0)).collect();
    let (prompted, num_followed) = prompted_frames(&world);
    assert!(num_followed >= 58, "{num_followed}");
    assert!(prompted.len() < 14 && before.iter().all(|t| prompted.contains(t)), "{prompted:?}, occluded at {before:?}");
}

#[test]
fn detections_in_one_frame_of_ten_suffice() {
    let world = one_car();
    for every in [1, 5, 10] {
        // Never in a frame with segmentation, unless all frames have it.
        let sometimes = |t: usize| if t % 10 == 3 { world.boxes(t, DetectionSource::Detector) } else { Vec::new() };
        let (frames, tracks) = world.track_boxes(40, every, sometimes, &honest);
        let [track] = &tracks[..] else { panic!("one track, every {every}: {tracks:#?}") };
        let start = 3_usize.next_multiple_of(every);
        assert_eq!(track.first, FrameId(start as u32));
        assert_eq!((track.found.detector, followed(&world, &frames, track, 0)), (4, 40 - start), "every {every}");
    }
}

#[test]
fn motion_detects_an_object_and_the_detector_classifies_it() {
    let world = one_car();
    let both = |t: usize| {
        let mut found = world.boxes(t, DetectionSource::Motion);
        if t == 25 {
            found.extend(world.boxes(t, DetectionSource::Detector));
        }
        found
    };
    let (_, tracks) = world.track_boxes(40, 5, |t| world.boxes(t, DetectionSource::Motion), &honest);
    assert_eq!((tracks.len(), tracks[0].class.as_str(), tracks[0].found.motion), (1, "vehicle", 40));
    let (_, tracks) = world.track_boxes(40, 5, both, &honest);
    assert_eq!((tracks.len(), tracks[0].class.as_str()), (1, "car"));
    assert_eq!((tracks[0].found.motion, tracks[0].found.both), (39, 1));
    assert!((tracks[0].class_confidence - 0.9).abs() < 1e-9);
}

#[test]
fn crossing_cars_of_one_color_keep_their_ids() {
    for every in [1, 3, 5] {
        let world = World::still(vec![
            Thing::car(RED, |t| (5 + 4 * t as i64, 30)),
            Thing::car(RED, |t| (170 - 4 * t as i64, 34)),
        ]);
        let (frames, tracks) = world.track_boxes(40, every, |t| world.boxes(t, DetectionSource::Detector), &honest);
        let of = |t: usize, thing: usize| {
            let truth = world.mask(t, thing);
            frames[t].iter().find(|m| m.mask.iou(&truth) > 0.5).map(|m| m.object)
        };
        for thing in 0..2 {
            assert!(of(2, thing).is_some());
            assert_eq!(of(2, thing), of(39, thing), "thing {thing}, every {every}: {tracks:#?}");
        }
    }
}

#[test]
fn a_part_of_a_vehicle_grows_to_the_whole_that_moves_like_it() {
    let size = (60, 40);
    let lorry = || Thing { size, class: Some("truck"), ..Thing::car(BLUE, |t| (10 + 3 * t as i64, 20)) };
    // Until frame 8 motion detection finds a corner of the lorry alone.
    let part =
        |t: usize, rect: Rect| if t < 8 { Rect { x1: rect.x0 + 24.0, y1: rect.y0 + 14.0, ..rect } } else { rect };
    let lorry_alone = World::still(vec![lorry()]);
    let boxes = |t: usize| {
        let found = lorry_alone.boxes(t, DetectionSource::Motion).into_iter();
        found.map(|found| BoxDetection { rect: part(t, found.rect), confidence: 1.0, ..found }).collect()
    };
    for every in [1, 4] {
        let (frames, tracks) = lorry_alone.track_boxes(30, every, boxes, &honest);
        let [track] = &tracks[..] else { panic!("one track, every {every}: {tracks:#?}") };
        assert!(followed(&lorry_alone, &frames, track, 0) >= 20, "every {every}: {tracks:#?}");
    }

    // A car over which the lorry drives is no part of it.
    let car = Thing::car(RED, |t| (70 + t as i64, 40));
    let world = World::still(vec![car, lorry()]);
    let boxes = |t: usize| {
        let both = world.boxes(t, DetectionSource::Motion).into_iter();
        let both = both.map(|found| BoxDetection { confidence: 1.0, ..found });
        both.filter(|found| found.rect.width() < 30.0 || t > 4).collect::<Vec<_>>()
    };
    let (frames, tracks) = world.track_boxes(30, 1, boxes, &honest);
    let of_lorry = tracks.iter().map(|track| followed(&world, &frames, track, 1)).collect::<Vec<_>>();
    let car = tracks.iter().position(|track| track.first == FrameId(0)).unwrap();
    assert!(of_lorry[car] == 0 && of_lorry.iter().any(|frames| *frames > 20), "{of_lorry:?} {tracks:#?}");
}

#[test]
fn one_car_overtakes_the_other() {
    for every in [1, 5] {
        let world =
            World::still(vec![Thing::car(RED, |t| (60 + t as i64, 28)), Thing::car(BLUE, |t| (5 + 4 * t as i64, 36))]);
        let (frames, tracks) = world.track_boxes(40, every, |t| world.boxes(t, DetectionSource::Detector), &honest);
        assert_eq!(tracks.len(), 2, "every {every}: {tracks:#?}");
        for track in &tracks {
            let per_thing: Vec<usize> = (0..2).map(|thing| followed(&world, &frames, track, thing)).collect();
            assert!(per_thing.contains(&0) && per_thing.iter().any(|n| *n > 25), "every {every}: {per_thing:?}");
        }
    }
}

#[test]
fn a_car_that_passes_a_parked_one_takes_none_of_its_pixels() {
    let world = World::still(vec![Thing::car(RED, |_| (80, 40)), Thing::car(RED, |t| (5 + 4 * t as i64, 54))]);
    // Where the cars are side by side, the network includes a part of the other one.
    let and_more = |t: usize, answer: BoxMask| {
        let is_next_to_it = (60..=100).contains(&(5 + 4 * t));
        let is_of_either = |x: u32, y: u32| (0..2).any(|thing| world.mask(t, thing).get(x.into(), y.into()));
        let mask = Mask::from_fn(WIDTH, HEIGHT, |x, y| {
            answer.mask.get(x.into(), y.into()) || is_next_to_it && (49..59).contains(&y) && is_of_either(x, y)
        });
        Some(BoxMask { mask, ..answer })
    };
    let (frames, tracks) = world.track_boxes(40, 4, |t| world.boxes(t, DetectionSource::Detector), &and_more);
    assert_eq!(tracks.len(), 2, "{tracks:#?}");
    for (t, masks) in frames.iter().enumerate() {
        for thing in 0..2 {
            let truth = world.mask(t, thing);
            assert!(masks.iter().any(|found| found.mask.iou(&truth) > 0.9), "frame {t}, thing {thing}");
        }
    }
}

#[test]
fn a_car_behind_a_pole_keeps_its_identity() {
    for every in [1, 5] {
        let world = World::still(vec![Thing::car(RED, |t| (4 + 4 * t as i64, 30)), Thing::wall(80, 8)]);
        let (frames, tracks) = world.track_boxes(40, every, |t| world.boxes(t, DetectionSource::Detector), &honest);
        // With segmentation in every fifth frame, the car after the pole may be a second piece.
        let is_linked =
            |track: &TrackSummary| track.after.is_some_and(|after| after.provisional == tracks[0].provisional);
        assert!(tracks.len() <= if every == 1 { 1 } else { 2 }, "every {every}: {tracks:#?}");
        assert!(tracks[1..].iter().all(is_linked), "every {every}: {tracks:#?}");
        let num_followed: usize = tracks.iter().map(|track| followed(&world, &frames, track, 0)).sum();
        assert!(num_followed >= 32, "every {every}: {num_followed}");
    }
}

#[test]
fn a_propagated_mask_excludes_the_occluder() {
    let world = World::still(vec![Thing::car(RED, |t| (4 + 5 * t as i64, 30)), Thing::wall(80, 44)]);
    // Only the first prompt succeeds: from then on the mask is propagated.
    let once = |t: usize, answer: BoxMask| (t == 0).then_some(answer);
    let (frames, _) = world.track_boxes(20, 30, |t| world.boxes(t, DetectionSource::Detector), &once);
    let on_wall = |t: usize| frames[t].iter().map(|m| m.mask.intersection_px2(&world.mask(t, 1))).max().unwrap_or(0);
    // The wall takes 70 more pixels in every frame.
    assert!((0..20).all(|t| on_wall(t) <= 28), "{:?}", (0..20).map(on_wall).collect::<Vec<_>>());
    let occluded: Vec<usize> = (0..20).filter(|&t| world.mask(t, 0).area_px2() == 0).collect();
    assert!(occluded.len() > 2 && occluded.into_iter().all(|t| frames[t].is_empty()));
    let seen = |t: usize| frames[t].first().map_or(0.0, |m| m.mask.iou(&world.mask(t, 0)));
    assert!((0..14).all(|t| seen(t) > 0.75), "{:?}", (0..20).map(seen).collect::<Vec<_>>());
}

#[test]
fn a_car_is_linked_after_a_wall() {
    for every in [1, 5] {
        let world = World::still(vec![Thing::car(RED, |t| (4 + 4 * t as i64, 30)), Thing::wall(70, 50)]);
        let (frames, tracks) = world.track_boxes(45, every, |t| world.boxes(t, DetectionSource::Detector), &honest);
        let [before, after] = &tracks[..] else { panic!("two pieces, every {every}: {tracks:#?}") };
        assert_eq!(after.after.map(|after| after.provisional), Some(before.provisional), "every {every}");
        let occluded = (0..45).filter(|&t| world.mask(t, 0).area_px2() == 0);
        assert!(occluded.clone().count() > 3 && occluded.into_iter().all(|t| frames[t].is_empty()));
    }
}

#[test]
fn one_motion_box_over_two_cars_keeps_two_tracks() {
    let world =
        World::still(vec![Thing::car(RED, |t| (4 + 3 * t as i64, 20)), Thing::car(BLUE, |t| (32 + 3 * t as i64, 20))]);
    let merged = |t: usize| {
        if t < 5 {
            return world.boxes(t, DetectionSource::Detector);
        }
        let boxes = world.boxes(t, DetectionSource::Motion);
        vec![BoxDetection { rect: boxes[0].rect.union(&boxes[1].rect), ..boxes[0].clone() }]
    };
    for every in [1, 5] {
        let (frames, tracks) = world.track_boxes(40, every, merged, &honest);
        assert_eq!(tracks.len(), 2, "every {every}: {tracks:#?}");
        for (thing, track) in tracks.iter().enumerate() {
            assert_eq!(followed(&world, &frames, track, thing), 40, "every {every}");
            assert_eq!((track.found.detector, track.found.motion), (5, 35));
        }
    }
}

#[test]
fn the_propagated_mask_wins_over_road_and_half_a_car() {
    let world = one_car();
    let patch = |t: usize, answer: BoxMask| match t {
        10 => Some(BoxMask { mask: Mask::from_fn(WIDTH, HEIGHT, |_, y| y > 25), quality: 0.99 }),
        15 => None,
        20 => {
            let left = answer.mask.bounding_box()?.x0 + 11;
            let mask = Mask::from_fn(WIDTH, HEIGHT, |x, y| x < left && answer.mask.get(x.into(), y.into()));
            Some(BoxMask { mask, ..answer })
        }
        _ => Some(answer),
    };
    for finder in [DetectionSource::Detector, DetectionSource::Motion] {
        // Boxes in the beginning only: after that, masks are prompted with propagated ones.
        let found = |t: usize| if t < 6 { world.boxes(t, finder) } else { Vec::new() };
        let (frames, tracks) = world.track_boxes(40, 5, found, &patch);
        assert_eq!(tracks.len(), 1);
        assert_eq!(followed(&world, &frames, &tracks[0], 0), 40);
        let at_10 = frames[10].iter().map(|m| m.evidence).collect::<Vec<_>>();
        assert_eq!(at_10, [Evidence::Carried]);
        assert_eq!(frames[25][0].evidence, Evidence::Prompted { quality: 0.9 });
    }
}

#[test]
fn failed_prompts_end_the_track_at_its_last_reliable_mask() {
    let world = one_car();
    let blind = |t: usize, answer: BoxMask| (t < 15).then_some(answer);
    let found = |t: usize| if t < 6 { world.boxes(t, DetectionSource::Detector) } else { Vec::new() };
    let (frames, tracks) = world.track_boxes(40, 5, found, &blind);
    assert_eq!((tracks.len(), tracks[0].last), (1, FrameId(14)));
    assert!(frames[35].is_empty());
}

#[test]
fn a_false_box_gets_no_final_id() {
    let world = one_car();
    let alarm = |t: usize| {
        let mut found = world.boxes(t, DetectionSource::Detector);
        if t == 10 || t == 12 {
            let rect = Rect { x0: 20.0, y0: 55.0, x1: 50.0, y1: 75.0 };
            found.push(BoxDetection { rect, ..found[0].clone() });
        }
        found
    };
    let (_, tracks) = world.track_boxes(40, 5, alarm, &honest);
    assert_eq!(tracks.iter().map(|t| t.id).collect::<Vec<_>>(), [ObjectId(1)]);
}

#[test]
fn the_same_boxes_give_the_same_result() {
    let world = World::still(vec![
        Thing::car(RED, |t| (5 + 4 * t as i64, 30)),
        Thing::car(BLUE, |t| (170 - 4 * t as i64, 33)),
        Thing::wall(90, 12),
    ]);
    let run = || world.track_boxes(40, 5, |t| world.boxes(t, DetectionSource::Detector), &honest);
    assert_eq!(run(), run());
}

#[test]
fn a_segmenter_with_masks_of_wrong_size_is_rejected() {
    let world = one_car();
    let small = |_: usize, answer: BoxMask| Some(BoxMask { mask: Mask::full(5, 5), ..answer });
    let mut tracker = Tracker::new(TrackerOptions::default());
    let mut segmenter = world::WorldSegmenter { world: &world, t: 0, num_prompts: 0, spoil: &small };
    let found = found_boxes(world.boxes(0, DetectionSource::Detector));
    let input = FrameInput { found, by: BoxSource::Detector, segmenter: Some(&mut segmenter) };
    let wrong = tracker.advance(&World::frame(0), &world.image(0), input, None);
    assert!(matches!(wrong, Err(crate::networks::PerceptionError::SizeMismatch { .. })));
}

/// Frames in which an object's mask overlaps a thing by more than 0.7, by final id.
fn shown(world: &World, frames: &[Vec<TrackedMask>], object: u32, thing: usize) -> Vec<usize> {
    let is_tracked = |t: &usize| {
        let truth = world.mask(*t, thing);
        frames[*t].iter().any(|m| m.object == ObjectId(object) && m.mask.iou(&truth) > 0.7)
    };
    (0..frames.len()).filter(is_tracked).collect()
}

#[test]
fn a_car_that_was_detected_late_gets_masks_from_its_first_frame_on() {
    let world = one_car();
    let late = |t: usize| if t < 22 { Vec::new() } else { world.boxes(t, DetectionSource::Detector) };
    for every in [1, 5, 10] {
        let (mut frames, tracks) = world.track_boxes(40, every, late, &honest);
        let first = 22_usize.next_multiple_of(every);
        assert_eq!((tracks.len(), tracks[0].first), (1, FrameId(first as u32)));
        let firsts = world.extend_back(&mut frames, &tracks, every, &honest);
        assert_eq!(firsts, [(ObjectId(1), FrameId(0))].into());
        assert_eq!(shown(&world, &frames, 1, 0), (0..40).collect::<Vec<_>>());
    }
}

#[test]
fn backward_tracking_ends_where_the_car_enters_the_image() {
    let world = World::still(vec![Thing::car(RED, |t| (-60 + 4 * t as i64, 30))]);
    let late = |t: usize| if t < 30 { Vec::new() } else { world.boxes(t, DetectionSource::Detector) };
    let (mut frames, tracks) = world.track_boxes(40, 5, late, &honest);
    let firsts = world.extend_back(&mut frames, &tracks, 5, &honest);
    // The car enters with frame 10 and is half visible in frame 13.
    assert!(firsts.len() == 1 && (10..=13).contains(&firsts[&ObjectId(1)].0), "{firsts:?}");
    assert!(frames[..10].iter().all(Vec::is_empty));
}

#[test]
fn backward_tracking_ends_at_an_occluder() {
    let world = World::still(vec![Thing::car(RED, |t| (4 + 4 * t as i64, 30)), Thing::wall(0, 90)]);
    let late = |t: usize| if t < 33 { Vec::new() } else { world.boxes(t, DetectionSource::Detector) };
    let (mut frames, tracks) = world.track_boxes(40, 5, late, &honest);
    let firsts = world.extend_back(&mut frames, &tracks, 5, &honest);
    let occluded = (0..40).filter(|&t| world.mask(t, 0).area_px2() == 0);
    assert!(occluded.into_iter().all(|t| frames[t].is_empty()), "{firsts:?}");
    assert!(shown(&world, &frames, 1, 0).len() >= 13, "{firsts:?}");
}

#[test]
fn backward_tracking_ends_at_another_object() {
    // One car under two ids: the first was lost for good while the car was not observed.
    let world = one_car();
    let (frames, tracks) = world.track_boxes(40, 1, |t| world.boxes(t, DetectionSource::Detector), &honest);
    let second = TrackSummary { id: ObjectId(2), first: FrameId(25), ..tracks[0].clone() };
    let first = TrackSummary { last: FrameId(12), ..tracks[0].clone() };
    let mut tracker = BackwardTracker::new(TrackerOptions::default(), &[first, second]);
    for t in (0..40).rev() {
        let id = if t > 12 { ObjectId(2) } else { ObjectId(1) };
        let known = if (13..25).contains(&t) { Vec::new() } else { vec![(id, frames[t][0].mask.clone())] };
        let flow = (t < 39).then(|| world.flow_between(t + 1, t));
        tracker.advance(&World::frame(t), &world.image(t), &known, None, flow.as_ref()).unwrap();
    }
    assert_eq!(tracker.finish(), [(ObjectId(1), FrameId(0)), (ObjectId(2), FrameId(13))].into());
}

#[test]
fn backward_tracking_requires_descending_frames() {
    let world = one_car();
    let mut tracker = BackwardTracker::new(TrackerOptions::default(), &[]);
    tracker.advance(&World::frame(5), &world.image(5), &[], None, None).unwrap();
    let again = tracker.advance(&World::frame(6), &world.image(6), &[], None, None);
    assert!(matches!(again, Err(crate::networks::PerceptionError::FrameOrder { .. })));
    let other = tracker.advance(&World::frame(4), &::image::RgbImage::new(9, 9), &[], None, None);
    assert!(matches!(other, Err(crate::networks::PerceptionError::SizeMismatch { .. })));
}

#[test]
fn a_stationary_object_starts_a_track_only_at_high_confidence() {
    let world = one_car();
    let tracked = |confidence: f64, is_stationary: bool| {
        let mut tracker = Tracker::new(TrackerOptions::default());
        for t in 0..12 {
            let flow = (t > 0).then(|| world.flow(t));
            let mut segmenter = world::WorldSegmenter { world: &world, t, num_prompts: 0, spoil: &honest };
            let boxes = world.boxes(t, DetectionSource::Detector).into_iter();
            let found =
                boxes.map(|found| DetectedBox { found: BoxDetection { confidence, ..found }, is_stationary }).collect();
            let input = FrameInput { found, by: BoxSource::Detector, segmenter: Some(&mut segmenter) };
            tracker.advance(&World::frame(t), &world.image(t), input, flow.as_ref()).unwrap();
        }
        let ignored = tracker.ignored_boxes();
        (tracker.finish().len(), ignored)
    };
    assert_eq!(tracked(0.5, false), (1, IgnoredBoxes::default()));
    assert_eq!(tracked(0.6, true), (1, IgnoredBoxes::default()));
    assert_eq!(tracked(0.5, true), (0, IgnoredBoxes { num_boxes: 12, max_confidence: 0.5 }));
}
