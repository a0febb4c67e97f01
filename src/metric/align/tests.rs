//! Simulated flights, with drift, jumps and rounding of the receiver.

use nalgebra::{Vector2, point, vector};
use rand_distr::{Distribution, StandardNormal};

use super::covariance::WANDER_TIME_S;
use super::*;
use crate::math::{Rng, seeded_rng};

/// Flight path in metres, with times from 0.
type Flight = fn(f64) -> Point3<f64>;

/// Two hundred metres in a minute, with turns.
fn winding(t: f64) -> Point3<f64> {
    point![4.0 * t + 20.0 * (t / 9.0).sin(), 30.0 * (t / 14.0).cos(), 30.0 + 3.0 * (t / 11.0).sin()]
}

/// Straight flight at a varying speed.
fn straight(t: f64) -> Point3<f64> {
    let distance = 5.0 * t + 12.0 * (t / 8.0).sin();
    point![0.8 * distance, 0.6 * distance, 40.0]
}

/// Sharp turns and stops of a car.
fn hasty(t: f64) -> Point3<f64> {
    point![9.0 * t + 25.0 * (t / 2.5).sin(), 20.0 * (t / 3.3).cos(), 1.5]
}

fn hovering(t: f64) -> Point3<f64> {
    point![0.3 * (t / 7.0).sin(), 0.2 * (t / 5.0).cos(), 25.0]
}

/// True similarity from the frame of the background in the simulations.
fn metric_from_world() -> Sim3 {
    Sim3::new(12.5, UnitQuaternion::from_euler_angles(0.9, -0.4, 2.2), vector![300.0, -120.0, 40.0])
}

fn path(flight: Flight, duration_s: f64) -> CameraPath {
    let world_from_metric = metric_from_world().inverse();
    let num = (duration_s * 10.0) as usize;
    CameraPath::new((0..num).map(|i| i as f64 * 0.1).map(|t| (t, world_from_metric * flight(t))), 1e-4).unwrap()
}

struct Receiver {
    rate_hz: f64,
    noise_m: f64,
    wander_m: f64,
    offset_s: f64,
}

const RECEIVER: Receiver = Receiver { rate_hz: 1.0, noise_m: 1.5, wander_m: 3.0, offset_s: 0.7 };

fn normal(rng: &mut Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Fixes of a flight: log time = video time + offset.
fn log(flight: impl Fn(f64) -> Point3<f64>, duration_s: f64, receiver: &Receiver, rng: &mut Rng) -> Vec<PositionFix> {
    let step_s = 1.0 / receiver.rate_hz;
    let keep = (-step_s / WANDER_TIME_S).exp();
    let mut drift = vector![normal(rng), normal(rng), normal(rng)] * receiver.wander_m;
    let std_m = receiver.noise_m.hypot(receiver.wander_m);
    (0..(duration_s * receiver.rate_hz) as usize)
        .map(|i| {
            let time_s = i as f64 * step_s;
            let fresh = vector![normal(rng), normal(rng), normal(rng)];
            drift = drift * keep + fresh * receiver.wander_m * (1.0 - keep * keep).sqrt();
            let noise = vector![normal(rng), normal(rng), normal(rng)] * receiver.noise_m;
            let position = flight(time_s - receiver.offset_s) + drift + noise;
            PositionFix {
                time_s,
                east_north_m: Vector2::new(position.x, position.y),
                up_m: Some(position.z),
                horizontal_std_m: std_m,
                vertical_std_m: std_m,
                rounding_m: 0.0,
            }
        })
        .collect()
}

fn support(offset: Offset) -> Support {
    let up_in_world = metric_from_world().rotation.inverse() * Vector3::z();
    Support { offset, gravity: Some(Gravity { up_in_world, std: 0.03 }), orientation: None }
}

fn scale_error(found: &Alignment) -> f64 {
    (found.metric_from_world.scale / metric_from_world().scale).ln()
}

#[test]
fn perfect_fixes_give_the_similarity_and_the_offset() {
    let receiver = Receiver { rate_hz: 5.0, noise_m: 1e-3, wander_m: 1e-3, offset_s: 0.7 };
    let fixes = log(winding, 60.0, &receiver, &mut seeded_rng(1, 0));
    let found = align_to_fixes(&path(winding, 50.0), &fixes, &support(Offset::Unknown)).unwrap();
    assert!(scale_error(&found).abs() < 1e-3, "{found:?}");
    assert!(found.metric_from_world.rotation.angle_to(&metric_from_world().rotation) < 1e-3);
    assert!((found.offset_s - 0.7).abs() < 0.01 && found.rejected_share == 0.0, "{found:?}");
    let place = found.metric_from_world * point![0.3, -0.2, 0.9];
    assert!((place - metric_from_world() * point![0.3, -0.2, 0.9]).norm() < 0.1);
}

/// Errors of scale and offset over noise realizations, and the coverage of the scale within 1 σ and 2 σ.
struct Trials {
    refused: usize,
    /// Mean reported standard deviation of the scale.
    stated: f64,
    scale_rms: f64,
    scale_mean: f64,
    offset_rms_s: f64,
    within: [f64; 2],
    offset_within: f64,
}

impl std::fmt::Display for Trials {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} refused; scale: mean {:+.1} %, rms {:.1} %, stated {:.1} %, within 1 and 2: {:.0} %, {:.0} %; offset: \
             rms {:.2} s, within 1: {:.0} %",
            self.refused,
            100.0 * self.scale_mean,
            100.0 * self.scale_rms,
            100.0 * self.stated,
            100.0 * self.within[0],
            100.0 * self.within[1],
            self.offset_rms_s,
            100.0 * self.offset_within,
        )
    }
}

fn trials(flight: Flight, duration_s: f64, receiver: &Receiver, offset: Offset, num: u64) -> Trials {
    trials_on(&path(flight, duration_s), flight, duration_s, receiver, offset, num)
}

fn trials_on(
    path: &CameraPath,
    flight: impl Fn(f64) -> Point3<f64>,
    duration_s: f64,
    receiver: &Receiver,
    offset: Offset,
    num_flights: u64,
) -> Trials {
    let (mut squares, mut sum, mut offsets, mut within, mut offset_within) = (0.0, 0.0, 0.0, [0.0; 2], 0.0);
    let (mut num, mut stated) = (0, 0.0);
    for seed in 0..num_flights {
        let fixes = log(&flight, duration_s + 2.0, receiver, &mut seeded_rng(7, seed));
        let Ok(found) = align_to_fixes(path, &fixes, &support(offset)) else { continue };
        num += 1;
        stated += found.log_scale_std();
        let error = scale_error(&found);
        squares += error * error;
        sum += error;
        offsets += (found.offset_s - receiver.offset_s).powi(2);
        offset_within += f64::from((found.offset_s - receiver.offset_s).abs() < found.offset_std_s);
        for (limit, count) in within.iter_mut().enumerate() {
            *count += f64::from(error.abs() < (limit + 1) as f64 * found.log_scale_std());
        }
    }
    let n = f64::from(num);
    Trials {
        refused: num_flights as usize - num as usize,
        stated: stated / n,
        scale_rms: (squares / n).sqrt(),
        scale_mean: sum / n,
        offset_rms_s: (offsets / n).sqrt(),
        within: within.map(|count| count / n),
        offset_within: offset_within / n,
    }
}

#[test]
fn a_minute_of_flight_gives_metres_to_two_per_cent_with_calibrated_deviations() {
    let found = trials(winding, 60.0, &RECEIVER, Offset::Unknown, 100);
    assert!(found.scale_rms < 0.02 && found.scale_mean.abs() < 0.006, "{found}");
    assert!(found.offset_rms_s < 0.5, "{found}");
    // Of 100 flights 68 ± 4.7 are within one standard deviation.
    assert!((0.56..=0.80).contains(&found.within[0]) && found.within[1] > 0.88, "{found}");
    assert!((0.54..=0.82).contains(&found.offset_within), "{found}");
}

#[test]
fn a_quick_receiver_on_a_quick_flight_gives_the_offset_to_a_tenth_of_a_second() {
    let found = trials(hasty, 30.0, &Receiver { rate_hz: 10.0, ..RECEIVER }, Offset::Unknown, 25);
    assert!(found.offset_rms_s < 0.1 && found.scale_rms < 0.02, "{found}");
}

/// Times in seconds and camera centres in metres.
type TimedPath = Vec<(f64, Point3<f64>)>;

/// Camera paths of rendered sequences, metres: those of the data, and the one in this repository.
fn rendered_paths() -> Vec<(String, TimedPath)> {
    let repository = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("dataset");
    let data = std::env::var_os("TRACTRIX_DATA").map(std::path::PathBuf::from).expect("TRACTRIX_DATA names the data");
    let folders = [repository, data.join("sequences"), data.join("sequences/generated")];
    let mut files: Vec<_> = folders
        .iter()
        .filter_map(|folder| std::fs::read_dir(folder).ok())
        .flat_map(|entries| entries.flatten().map(|entry| entry.path().join("scene.json")))
        .filter(|file| file.is_file())
        .collect();
    files.sort();
    files.iter().map(|file| rendered_path(file)).collect()
}

fn rendered_path(file: &std::path::Path) -> (String, Vec<(f64, Point3<f64>)>) {
    let scene: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let frames = scene["frames"].as_array().unwrap().iter().map(|frame| {
        let center = [0, 1, 2].map(|axis| frame["T_world_camera"][axis][3].as_f64().unwrap());
        (frame["time_s"].as_f64().unwrap(), Point3::from(center))
    });
    (scene["name"].as_str().unwrap_or_default().to_owned(), frames.collect())
}

/// Prints the table of docs/maths/metric.md.
#[test]
#[ignore = "needs sequences that are not part of this repository: TRACTRIX_DATA"]
fn rendered_camera_paths_under_a_receiver() {
    for (name, frames) in rendered_paths() {
        let path_length_m: f64 = frames.windows(2).map(|pair| (pair[1].1 - pair[0].1).norm()).sum();
        let duration_s = frames[frames.len() - 1].0;
        let in_metres = CameraPath::new(frames.iter().copied(), 0.0).unwrap();
        let world_from_metric = metric_from_world().inverse();
        let path = CameraPath::new(frames.iter().map(|(t, c)| (*t, world_from_metric * *c)), 1e-4).unwrap();
        for (rate_hz, offset) in [(1.0, Offset::SAME_FILE), (10.0, Offset::SAME_FILE), (10.0, Offset::Unknown)] {
            let offset_s = if offset == Offset::Unknown { 0.7 } else { 0.0 };
            let receiver = Receiver { rate_hz, offset_s, ..RECEIVER };
            let found = trials_on(&path, |t| in_metres.at(t).0, duration_s, &receiver, offset, 100);
            println!("| {name} | {path_length_m:.0} m, {duration_s:.1} s | {rate_hz} Hz, {offset:?} | {found} |");
        }
    }
}

#[test]
fn a_straight_flight_leaves_the_roll_to_the_vertical() {
    let path = path(straight, 40.0);
    let fixes = log(straight, 45.0, &Receiver { rate_hz: 5.0, ..RECEIVER }, &mut seeded_rng(3, 0));
    let with = align_to_fixes(&path, &fixes, &support(Offset::Unknown)).unwrap();
    assert!(scale_error(&with).abs() < 3.0 * with.log_scale_std() && with.log_scale_std() < 0.03, "{with:?}");
    assert!(with.tilt_std() < 0.03);
    let without = align_to_fixes(&path, &fixes, &Support { gravity: None, ..support(Offset::Unknown) }).unwrap();
    assert!(without.tilt_std() > 0.5, "{}", without.tilt_std());
    assert!(scale_error(&without).abs() < 3.0 * without.log_scale_std() && without.log_scale_std() < 0.03);
}

#[test]
fn the_attitude_of_the_camera_does_what_the_vertical_does() {
    let orientation = Orientation { metric_from_world: metric_from_world().rotation, tilt_std: 0.02, heading_std: 0.1 };
    let fixes = log(straight, 45.0, &Receiver { rate_hz: 5.0, ..RECEIVER }, &mut seeded_rng(3, 0));
    let support = Support { gravity: None, orientation: Some(orientation), ..support(Offset::SAME_FILE) };
    let found = align_to_fixes(&path(straight, 40.0), &fixes, &support).unwrap();
    assert!(found.tilt_std() < 0.03 && found.heading_std() < 0.05, "{found:?}");
}

#[test]
fn hovering_gives_no_scale() {
    let fixes = log(hovering, 45.0, &Receiver { rate_hz: 5.0, ..RECEIVER }, &mut seeded_rng(4, 0));
    let refusal = align_to_fixes(&path(hovering, 40.0), &fixes, &support(Offset::SAME_FILE)).unwrap_err();
    assert!(matches!(refusal, Refusal::Motionless { .. }), "{refusal}");
    assert!(refusal.to_string().contains("moved too little"));
}

#[test]
fn few_fixes_give_the_determined_parameters() {
    let fixes = log(winding, 62.0, &Receiver { rate_hz: 0.1, ..RECEIVER }, &mut seeded_rng(5, 0));
    let found = align_to_fixes(&path(winding, 60.0), &fixes, &support(Offset::SAME_FILE)).unwrap();
    assert!(found.num_fixes <= 7 && scale_error(&found).abs() < 3.0 * found.log_scale_std(), "{found:?}");
    let few = align_to_fixes(&path(winding, 60.0), &fixes[..3], &support(Offset::SAME_FILE)).unwrap_err();
    assert_eq!(few, Refusal::NoOverlap { num: 3, of: 3 });
}

#[test]
fn jumps_lose_their_weight() {
    let path = path(winding, 60.0);
    for seed in 0..10 {
        let mut fixes = log(winding, 62.0, &RECEIVER, &mut seeded_rng(6, seed));
        let clean = align_to_fixes(&path, &fixes, &support(Offset::Unknown)).unwrap();
        for (i, fix) in fixes.iter_mut().enumerate() {
            match i {
                7 | 31 => fix.east_north_m.x += 5e5,
                20 => fix.east_north_m.y -= 60.0,
                44..=50 => fix.east_north_m += vector![40.0, -30.0],
                _ => {}
            }
        }
        let found = align_to_fixes(&path, &fixes, &support(Offset::Unknown)).unwrap();
        assert!(found.rejected_share > 0.1, "{found:?}");
        let moved = scale_error(&found) - scale_error(&clean);
        assert!(moved.abs() < 2.0 * found.log_scale_std(), "{seed}: {moved} {}", found.log_scale_std());
    }
}

#[test]
fn six_fixes_do_not_determine_the_clock_offset() {
    let receiver = Receiver { noise_m: 0.02, wander_m: 0.02, ..RECEIVER };
    let fixes = log(hasty, 7.0, &receiver, &mut seeded_rng(9, 0));
    let path = path(hasty, 6.0);
    let refusal = align_to_fixes(&path, &fixes, &support(Offset::Unknown)).unwrap_err();
    assert!(matches!(refusal, Refusal::TooFewForOffset { .. }), "{refusal}");
    let stated = Offset::Known { mean_s: 0.7, std_s: 0.2 };
    assert!(align_to_fixes(&path, &fixes, &support(stated)).is_ok());
}

#[test]
fn a_log_of_another_flight_is_rejected() {
    let path = path(winding, 60.0);
    fn circling(t: f64) -> Point3<f64> {
        point![60.0 * (t / 4.0).cos(), 60.0 * (t / 4.0).sin(), 30.0]
    }
    for seed in 0..10 {
        let fixes = log(circling, 62.0, &RECEIVER, &mut seeded_rng(8, seed));
        let refusal = align_to_fixes(&path, &fixes, &support(Offset::Unknown)).unwrap_err();
        assert!(matches!(refusal, Refusal::AnotherMotion { .. } | Refusal::Motionless { .. }), "{seed}: {refusal}");
    }
    let mut tomorrow = log(winding, 62.0, &RECEIVER, &mut seeded_rng(8, 0));
    tomorrow.iter_mut().for_each(|fix| fix.time_s += 86_400.0);
    let clocks = Offset::Known { mean_s: 0.0, std_s: 2.0 };
    let refusal = align_to_fixes(&path, &tomorrow, &support(clocks)).unwrap_err();
    assert!(matches!(refusal, Refusal::NoOverlap { num: 0, .. }), "{refusal}");
}

#[test]
fn a_short_piece_of_a_long_log_is_found() {
    // The video begins 200 s after the log.
    let piece = path(|t| winding(t + 200.0), 40.0);
    let fixes = log(winding, 400.0, &Receiver { offset_s: 0.0, ..RECEIVER }, &mut seeded_rng(9, 0));
    let found = align_to_fixes(&piece, &fixes, &support(Offset::Unknown)).unwrap();
    assert!((found.offset_s - 200.0).abs() < 3.5 * found.offset_std_s, "{found:?}");
    assert!(scale_error(&found).abs() < 3.5 * found.log_scale_std(), "{found:?}");
}

#[test]
fn overstated_noise_is_reduced() {
    let path = path(winding, 60.0);
    let smooth = log(winding, 62.0, &Receiver { rate_hz: 5.0, noise_m: 0.1, ..RECEIVER }, &mut seeded_rng(10, 0));
    let mut stated = smooth.clone();
    stated.iter_mut().for_each(|fix| fix.horizontal_std_m = 3.35);
    let found = align_to_fixes(&path, &stated, &support(Offset::SAME_FILE)).unwrap();
    assert!(found.noise_factor < 0.3, "{}", found.noise_factor);
}

#[test]
fn invalid_input_gives_no_invalid_output() {
    let path = path(winding, 60.0);
    let mut fixes = log(winding, 62.0, &RECEIVER, &mut seeded_rng(11, 0));
    fixes[3].east_north_m.x = f64::NAN;
    fixes[4].horizontal_std_m = 0.0;
    fixes[5].up_m = Some(f64::INFINITY);
    fixes[6].time_s = f64::NAN;
    let found = align_to_fixes(&path, &fixes, &support(Offset::Unknown)).unwrap();
    assert!(found.covariance.iter().all(|value| value.is_finite()) && scale_error(&found).is_finite());
    assert!(align_to_fixes(&path, &[], &support(Offset::Unknown)).is_err());
    let same = vec![fixes[0]; 50];
    assert!(align_to_fixes(&path, &same, &support(Offset::Unknown)).is_err());
    let without_heights: Vec<_> = fixes.iter().map(|fix| PositionFix { up_m: None, ..*fix }).collect();
    let flat = align_to_fixes(&path, &without_heights, &support(Offset::Unknown)).unwrap();
    assert!(scale_error(&flat).abs() < 3.0 * flat.log_scale_std(), "{flat:?}");
}
