//! Tests in synthetic worlds with known motion.

mod world;

use super::{
    Judgement, MovementReason, Mover, PointOnObject, PointTrack, Surroundings, TrackLabel, Verdict, classify, judge,
    judge_pieces, movers, with_travel,
};
use crate::scene::{Movement, Rect};
use world::{Flight, Plan, World, world};

fn detect(world: &World) -> (Vec<TrackLabel>, Vec<Mover>) {
    detect_with(world, &world.surroundings())
}

fn detect_with(world: &World, surroundings: &Surroundings) -> (Vec<TrackLabel>, Vec<Mover>) {
    let labels = classify(&world.tracks, surroundings);
    let found = movers(&world.tracks, &labels, surroundings);
    (labels, found)
}

/// Shares of the vehicle's tracks, and of all others, that are classified as moving.
fn rates(world: &World, labels: &[TrackLabel]) -> (f64, f64) {
    let share = |vehicle: bool| {
        let of = || world.is_vehicle.iter().zip(labels).filter(move |(is, _)| **is == vehicle);
        of().filter(|(_, label)| label.is_moving()).count() as f64 / of().count().max(1) as f64
    };
    (share(true), share(false))
}

/// Motion state of the vehicle.
fn judged(world: &World) -> Judgement {
    let labels = classify(&world.tracks, &world.surroundings());
    let own = (0..labels.len()).filter(|&k| world.is_vehicle[k]);
    let point = |k: usize| {
        let (track, label) = (&world.tracks[k], &labels[k]);
        PointOnObject { track, label, inside: 1.0, contact: world.contact_depth(track, label) }
    };
    judge(&own.map(point).collect::<Vec<_>>(), 10.0)
}

/// Box of the vehicle's points in a frame.
fn truth(world: &World, frame: u32) -> Option<Rect> {
    let own = world.tracks.iter().zip(&world.is_vehicle).filter(|(_, is)| **is);
    let points = own.filter_map(|(track, _)| track.at(frame));
    points.map(|[x, y]| Rect { x0: x, y0: y, x1: x, y1: y }).reduce(|a, b| a.union(&b))
}

/// Share of the frames with the vehicle in which a box fits it.
fn found_share(world: &World, found: &[Mover]) -> f64 {
    let frames: Vec<(u32, Rect)> = (0..30).filter_map(|frame| Some((frame, truth(world, frame)?))).collect();
    let fits = |(frame, rect): &&(u32, Rect)| {
        found.iter().filter_map(|mover| mover.boxes.get(frame)).any(|found| found.iou(rect) >= 0.5)
    };
    frames.iter().filter(fits).count() as f64 / frames.len().max(1) as f64
}

fn plan(flight: Flight, start: [f64; 2], velocity: [f64; 2]) -> Plan {
    Plan { flight, vehicle: Some((start, velocity)), ..Plan::default() }
}

const LOW: Flight = Flight::Forward { height_m: 1.5 };
const HIGH: Flight = Flight::Forward { height_m: 12.0 };

#[test]
fn a_crossing_vehicle_is_found_under_any_camera_motion() {
    for flight in [Flight::Hovering, Flight::Turning, HIGH, Flight::Sideways] {
        for noise_px in [0.0, 0.3] {
            let world = world(&Plan { noise_px, ..plan(flight, [40.0, -8.0], [2.0, 5.0]) });
            let (labels, found) = detect(&world);
            let (moving, others) = rates(&world, &labels);
            assert!(moving > 0.95 && others < 0.03, "{flight:?} {noise_px}: {moving} {others}");
            assert_eq!(found.len(), 1, "{flight:?} {noise_px}");
            assert!(found_share(&world, &found) > 0.95, "{flight:?} {noise_px}: {}", found_share(&world, &found));
        }
    }
}

#[test]
fn static_points_of_a_vehicle_ahead_at_the_same_speed_are_behind_the_ground() {
    for flight in [LOW, HIGH] {
        let start = if flight == LOW { [14.0, 0.5] } else { [40.0, 0.5] };
        let world = world(&Plan { has_trees: false, ..plan(flight, start, [8.8, 0.2]) });
        let (labels, found) = detect(&world);
        let (moving, others) = rates(&world, &labels);
        // The upper half of a car is at a dash camera's horizon, and is not distinguished from distant points.
        assert!(moving > if flight == LOW { 0.3 } else { 0.9 }, "{flight:?}: {moving}");
        assert!(others < 0.01, "{flight:?}: {others}");
        assert_eq!(found.len(), 1, "{flight:?}");
        let blind = Surroundings { ground: None, ..world.surroundings() };
        assert!(detect_with(&world, &blind).1.is_empty(), "without the ground it is at infinity");
    }
}

#[test]
fn static_points_of_an_oncoming_vehicle_float() {
    let world = world(&Plan { has_trees: false, ..plan(HIGH, [75.0, 3.0], [-8.0, 0.0]) });
    let (labels, _) = detect(&world);
    let own: Vec<_> = (0..labels.len()).filter(|&k| world.is_vehicle[k]).collect();
    let floating = own.iter().filter(|&&k| labels[k].verdict == Verdict::Floating).count();
    assert!(2 * floating > own.len(), "{floating} of {}", own.len());
    let judged = judged(&world);
    assert_eq!((judged.movement, judged.reason), (Movement::Moving, MovementReason::FootFloats), "{judged:?}");
}

#[test]
fn a_parked_vehicle_is_stationary() {
    for flight in [HIGH, Flight::Sideways] {
        let world = world(&plan(flight, [40.0, 2.0], [0.0, 0.0]));
        let (_, found) = detect(&world);
        assert!(found.is_empty(), "{flight:?}: {}", found.len());
        let judged = judged(&world);
        assert_eq!(judged.movement, Movement::Stationary, "{flight:?}: {judged}");
    }
}

#[test]
fn a_track_with_gaps_is_stationary_only_if_every_piece_is() {
    let world = world(&plan(HIGH, [40.0, 2.0], [0.0, 0.0]));
    let labels = classify(&world.tracks, &world.surroundings());
    let point = |k: usize| {
        let (track, label) = (&world.tracks[k], &labels[k]);
        PointOnObject { track, label, inside: 1.0, contact: world.contact_depth(track, label) }
    };
    let parked: Vec<PointOnObject> = (0..labels.len()).filter(|&k| world.is_vehicle[k]).map(point).collect();
    // Points without motion and without a contact depth, like those of an oncoming car.
    let quiet = parked.iter().filter(|point| point.label.verdict == Verdict::Stationary).take(6);
    let open: Vec<PointOnObject> = quiet.map(|point| PointOnObject { contact: None, ..*point }).collect();
    let state = |pieces: &[Vec<PointOnObject>]| judge_pieces(pieces, 10.0).movement;
    assert_eq!(state(&[parked.clone(), parked.clone()]), Movement::Stationary);
    assert_eq!(state(&[parked.clone(), Vec::new()]), Movement::Stationary);
    assert_eq!(state(&[parked, open]), Movement::Undetermined);
}

#[test]
fn a_vehicle_that_stops_keeps_its_label_and_its_boxes() {
    let world = world(&Plan { moves_in: [0, 12], ..plan(Flight::Sideways, [35.0, -6.0], [0.0, 5.0]) });
    let (labels, found) = detect(&world);
    assert!(rates(&world, &labels).0 > 0.9);
    assert!(
        found.len() == 1 && found[0].boxes.contains_key(&29),
        "{:?}",
        found.iter().map(Mover::life).collect::<Vec<_>>()
    );
}

/// Heights of dash cameras, meters.
const DASH_HEIGHTS_M: [f64; 3] = [1.2, 1.45, 1.65];

/// Motion states of a vehicle in view of a dash camera that drives at 8 m/s for three seconds, by height and seed.
fn before_dash_cameras(start: [f64; 2], velocity: [f64; 2], hidden_m: f64) -> Vec<Judgement> {
    let worlds = DASH_HEIGHTS_M.into_iter().flat_map(|height_m| (1..=5).map(move |seed| (height_m, seed)));
    let judged = |(height_m, seed)| {
        let flight = Flight::Forward { height_m };
        judged(&world(&Plan { seed, hidden_m, has_trees: false, ..plan(flight, start, velocity) }))
    };
    worlds.map(judged).collect()
}

fn count(all: &[Judgement], movement: Movement) -> usize {
    all.iter().filter(|judged| judged.movement == movement).count()
}

#[test]
fn a_passed_parked_car_with_an_occluded_lower_body_does_not_move() {
    for hidden_m in [0.0, 0.25, 0.4, 0.6] {
        let all = before_dash_cameras([22.0, 3.2], [0.0; 2], hidden_m);
        assert_eq!(count(&all, Movement::Moving), 0, "{hidden_m}: {all:?}");
        if hidden_m <= 0.25 {
            assert!(count(&all, Movement::Stationary) >= 5, "{hidden_m}: {all:?}");
        }
    }
}

#[test]
fn a_distant_parked_car_does_not_move() {
    let all = before_dash_cameras([75.0, 4.0], [0.0; 2], 0.0);
    assert_eq!(count(&all, Movement::Moving), 0, "{all:?}");
}

#[test]
fn a_lead_car_at_the_speed_of_the_camera_moves() {
    // At exactly the speed of the camera it would be fixed in the image.
    let all = before_dash_cameras([14.0, 0.5], [8.8, 0.2], 0.0);
    assert_eq!(count(&all, Movement::Moving), all.len(), "{all:?}");
}

#[test]
fn a_lead_car_that_the_camera_approaches_slowly_is_not_stationary() {
    // Gaps that close by a half of the camera's displacement, by a third and by a fifth.
    for (start, speed) in [([16.0, 0.3], 4.0), ([13.0, 0.3], 5.3), ([12.0, 0.3], 6.4)] {
        let all = before_dash_cameras(start, [speed, 0.0], 0.0);
        assert_eq!(count(&all, Movement::Stationary), 0, "{speed}: {all:?}");
        assert!(count(&all, Movement::Moving) >= 10, "{speed}: {all:?}");
    }
}

#[test]
fn an_oncoming_car_before_a_dash_camera_is_not_stationary() {
    for speed in [4.0, 8.0, 14.0] {
        let all = before_dash_cameras([26.0 + 3.0 * speed, 3.5], [-speed, 0.0], 0.0);
        assert_eq!(count(&all, Movement::Stationary), 0, "{speed}: {all:?}");
    }
}

#[test]
fn a_crossing_car_is_not_stationary() {
    let all = before_dash_cameras([40.0, -9.0], [0.0, 6.0], 0.0);
    assert_eq!(count(&all, Movement::Stationary), 0, "{all:?}");
}

#[test]
fn a_vehicle_that_stops_or_starts_moves() {
    for moves_in in [[0, 15], [15, 30]] {
        for (flight, start, velocity) in [
            (Flight::Sideways, [35.0, -6.0], [0.0, 6.0]),
            (Flight::Hovering, [30.0, -4.0], [2.0, 4.0]),
            (HIGH, [50.0, -6.0], [1.0, 5.0]),
        ] {
            let judged = judged(&world(&Plan { moves_in, ..plan(flight, start, velocity) }));
            assert_eq!(judged.movement, Movement::Moving, "{flight:?} {moves_in:?}: {judged:?}");
        }
    }
}

#[test]
fn a_vehicle_that_waits_for_long_before_it_starts_moves() {
    let start = plan(Flight::Hovering, [30.0, -4.0], [2.0, 4.0]);
    let mut world = world(&Plan { moves_in: [75, 90], num_frames: 90, ..start });
    // Points are lost and re-detected: most tracks are from the time before the start.
    let pieces = |(track, is_vehicle): (&PointTrack, &bool)| -> Vec<(PointTrack, bool)> {
        let piece = |k: usize| PointTrack {
            first: track.first + 15 * k as u32,
            pixels: track.pixels[15 * k..].iter().take(15).copied().collect(),
        };
        (0..track.pixels.len() / 15).map(|k| (piece(k), *is_vehicle)).collect()
    };
    (world.tracks, world.is_vehicle) = world.tracks.iter().zip(&world.is_vehicle).flat_map(pieces).unzip();
    let judged = judged(&world);
    assert_eq!(judged.movement, Movement::Moving, "{judged:?}");
}

#[test]
fn static_and_swaying_points_become_no_movers() {
    let mut num_movers = 0;
    for seed in 0..25 {
        for flight in [Flight::Hovering, Flight::Turning, LOW, HIGH, Flight::Sideways] {
            let world = world(&Plan { flight, seed, noise_px: 0.3, ..Plan::default() });
            let (labels, found) = detect(&world);
            let trees = 12.0 * 25.0 / world.tracks.len() as f64;
            let (_, moving) = rates(&world, &labels);
            assert!(moving < trees + 0.02, "{flight:?} {seed}: {moving}");
            num_movers += found.len();
        }
    }
    assert!(num_movers <= 2, "{num_movers} in 125 worlds");
}

#[test]
fn a_mask_with_a_displacement_before_a_camera_without_translation_moves() {
    // Without points the state is undetermined. Masks of 0.01 rad move by 0.05, sway by 0.005, or jump once.
    let unknown = judge(&[], 10.0);
    assert_eq!(unknown.movement, Movement::Undetermined);
    let directions = |at: &dyn Fn(f64) -> f64| -> Vec<nalgebra::Vector3<f64>> {
        (0..20).map(|k| nalgebra::Vector3::new(at(f64::from(k) / 19.0), 0.0, 1.0)).collect()
    };
    let movement = |at: &dyn Fn(f64) -> f64| with_travel(unknown, &directions(at), 0.01).movement;
    assert_eq!(movement(&|t| 0.05 * t), Movement::Moving);
    assert_eq!(movement(&|t| 0.005 * (40.0 * t).sin()), Movement::Undetermined);
    assert_eq!(movement(&|t| if t < 0.5 { 0.0 } else { 0.015 }), Movement::Undetermined);
    assert_eq!(with_travel(unknown, &[], 0.01).movement, Movement::Undetermined);
    // A stationary state by points has precedence.
    let stationary = Judgement { movement: Movement::Stationary, ..unknown };
    assert_eq!(with_travel(stationary, &directions(&|t| 0.05 * t), 0.01).movement, Movement::Stationary);
}

#[test]
fn without_cameras_all_states_are_undetermined() {
    let world = world(&plan(HIGH, [40.0, 0.0], [8.0, 0.0]));
    let none = vec![None; world.views.len()];
    for views in [&none[..], &[]] {
        let (labels, found) = detect_with(&world, &Surroundings { views, ..world.surroundings() });
        assert!(found.is_empty() && labels.iter().all(|label| label.verdict == Verdict::Undetermined));
    }
    let (labels, found) = detect_with(&world, &Surroundings { times_s: &[], views: &[], ..world.surroundings() });
    assert!(found.is_empty() && labels.len() == world.tracks.len());
    assert_eq!(judge(&[], 10.0).movement, Movement::Undetermined);
}

#[test]
fn points_fixed_to_the_camera_are_no_mover() {
    let mut world = world(&Plan { flight: LOW, num_frames: 45, ..Plan::default() });
    for k in 0..40u8 {
        let position = [400.0 + 8.0 * f32::from(k % 10), 480.0 + 8.0 * f32::from(k / 10)];
        // The points drift by a pixel or two, like those on a reflection.
        let pixels = (0u8..45).map(|frame| [position[0] + 0.04 * f32::from(frame), position[1]]).collect();
        world.tracks.push(PointTrack { first: 0, pixels });
        world.is_vehicle.push(true);
    }
    let (_, found) = detect(&world);
    assert!(found.is_empty(), "{:?}", found.iter().map(Mover::life).collect::<Vec<_>>());
}

#[test]
fn the_same_input_gives_the_same_movers() {
    let world = world(&plan(Flight::Sideways, [40.0, -8.0], [2.0, 5.0]));
    assert_eq!(detect(&world), detect(&world));
}
