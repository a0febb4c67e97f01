//! Accuracy of metric scale from a log: simulated one-minute drone flights and reconstructions with drift.
//!
//! A flight has legs of three to nine seconds at 2 to 8 m/s, turns of up to 120° between them with a second's lag,
//! climbs, descents, and a sway of a few decimetres in the wind. The errors of its reconstruction are random walks:
//! 0.5 % of scale and 0.3° of heading in a minute (standard deviations). The truth is the similarity that fits all
//! centres best.

use nalgebra::{Vector2, vector};
use rand::Rng as _;
use rand_distr::{Distribution, StandardNormal};

use super::covariance::WANDER_TIME_S;
use super::*;
use crate::math::{Rng, seeded_rng, umeyama};

const DURATION_S: f64 = 60.0;
const STEP_S: f64 = 0.1;
/// Lag of the drone behind the pilot's command, seconds.
const LAG_S: f64 = 1.0;
/// Drift of a reconstruction per minute: logarithm of the scale, and heading in radians.
const DRIFT: [f64; 2] = [5e-3, 5e-3];
/// Standard deviation of camera centres as a share of the path length, as in the pipeline.
const STATED_DRIFT: f64 = 0.002;
const OFFSET_S: f64 = 0.7;
const NOISE_M: f64 = 1.5;
const WANDER_M: f64 = 3.0;

fn normal(rng: &mut Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Positions every tenth of a second, metres.
fn flight(rng: &mut Rng) -> Vec<Point3<f64>> {
    let (mut position, mut velocity, mut wanted) = (Point3::new(0.0, 0.0, 40.0), Vector3::zeros(), Vector3::zeros());
    let (mut heading, mut leg_until): (f64, f64) = (0.0, 0.0);
    let mut path = Vec::new();
    let phases: [f64; 2] = [rng.random_range(0.0..6.0), rng.random_range(0.0..6.0)];
    for k in 0..(DURATION_S / STEP_S) as usize {
        let t = k as f64 * STEP_S;
        if t >= leg_until {
            heading += rng.random_range(-2.1..2.1);
            let speed = rng.random_range(2.0..8.0);
            wanted = vector![speed * heading.cos(), speed * heading.sin(), rng.random_range(-1.0..1.0)];
            leg_until = t + rng.random_range(3.0..9.0);
        }
        velocity += (wanted - velocity) * (STEP_S / LAG_S);
        position += velocity * STEP_S;
        let sway = vector![(1.9 * t + phases[0]).sin(), (2.3 * t + phases[1]).sin(), 0.5 * (1.1 * t).sin()] * 0.2;
        path.push(position + sway);
    }
    path
}

/// Reconstructed path, units of 12.5 m, with accumulated errors of rotation and scale.
fn reconstructed(path: &[Point3<f64>], rng: &mut Rng) -> Vec<Point3<f64>> {
    let step = (STEP_S / DURATION_S).sqrt();
    let (mut log_scale, mut turn, mut center) = (0.0, 0.0, Point3::origin());
    let mut found = vec![center];
    for pair in path.windows(2) {
        log_scale += DRIFT[0] * step * normal(rng);
        turn += DRIFT[1] * step * normal(rng);
        let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, turn);
        center += rotation * (pair[1] - pair[0]) * f64::exp(log_scale) / 12.5;
        found.push(center);
    }
    found
}

fn at(path: &[Point3<f64>], time_s: f64) -> Point3<f64> {
    let place = (time_s / STEP_S).clamp(0.0, (path.len() - 2) as f64);
    let k = place as usize;
    path[k] + (path[k + 1] - path[k]) * (place - k as f64)
}

/// Fixes of a receiver whose clock is ahead of the video's.
fn log(path: &[Point3<f64>], rate_hz: f64, rng: &mut Rng) -> Vec<PositionFix> {
    let keep = (-1.0 / rate_hz / WANDER_TIME_S).exp();
    let of_three = |rng: &mut Rng| vector![normal(rng), normal(rng), normal(rng)];
    let mut drift = of_three(rng) * WANDER_M;
    let std_m = NOISE_M.hypot(WANDER_M);
    let fix = |i: usize| {
        let time_s = OFFSET_S + i as f64 / rate_hz;
        drift = drift * keep + of_three(rng) * (WANDER_M * (1.0 - keep * keep).sqrt());
        let position = at(path, time_s - OFFSET_S) + drift + of_three(rng) * NOISE_M;
        PositionFix {
            time_s,
            east_north_m: Vector2::new(position.x, position.y),
            up_m: Some(position.z),
            horizontal_std_m: std_m,
            vertical_std_m: std_m,
            rounding_m: 0.0,
        }
    };
    (0..((DURATION_S - 1.0) * rate_hz) as usize).map(fix).collect()
}

/// One flight: error of the scale, its reported σ, error of the offset and its reported σ.
fn trial(rate_hz: f64, offset: Offset, seed: u64) -> Option<[f64; 4]> {
    let rng = &mut seeded_rng(15, seed);
    let path = flight(rng);
    let centers = reconstructed(&path, rng);
    let truth = umeyama(&centers, &path)?.scale;
    let path_length: f64 = centers.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let times = (0..centers.len()).map(|k| k as f64 * STEP_S);
    let camera = CameraPath::new(times.zip(centers.iter().copied()), STATED_DRIFT * path_length)?;
    let gravity = Some(Gravity { up_in_world: Vector3::z(), std: 0.03 });
    let support = Support { offset, gravity, orientation: None };
    let found = align_to_fixes(&camera, &log(&path, rate_hz, rng), &support).ok()?;
    let error = (found.metric_from_world.scale / truth).ln();
    Some([error, found.log_scale_std(), found.offset_s - OFFSET_S, found.offset_std_s])
}

/// Prints a row of docs/benchmarks/metres.md.
///
/// Returns the root mean square errors of scale and offset, and the number of scales within one standard deviation.
fn row(name: &str, rate_hz: f64, offset: Offset, num: u64) -> [f64; 3] {
    let found: Vec<[f64; 4]> = (0..num).filter_map(|seed| trial(rate_hz, offset, seed)).collect();
    let n = found.len() as f64;
    let mean = |value: &dyn Fn(&[f64; 4]) -> f64| found.iter().map(value).sum::<f64>() / n;
    let rms = |k: usize| mean(&|f| f[k] * f[k]).sqrt();
    let within = |k: usize, limit: f64| mean(&|f| f64::from(f[k].abs() < limit * f[k + 1]));
    println!(
        "| {name} | {:+.1} %, {:.1} % | {:.1} % | {:.0} %, {:.0} % | {:.2} s, {:.2} s, {:.0} % | {} of {num} |",
        100.0 * mean(&|f| f[0]),
        100.0 * rms(0),
        100.0 * mean(&|f| f[1]),
        100.0 * within(0, 1.0),
        100.0 * within(0, 2.0),
        rms(2),
        mean(&|f| f[3]),
        100.0 * within(2, 1.0),
        num as usize - found.len(),
    );
    [rms(0), rms(2), within(0, 1.0)]
}

#[test]
fn a_minute_of_a_drone_gives_metres_to_two_per_cent() {
    let [scale, offset_s, within] = row("10 Hz", 10.0, Offset::TWO_BUTTONS, 40);
    assert!(scale < 0.02 && offset_s < 0.25, "{scale} {offset_s}");
    // Of 40 flights 68 ± 7.4 % are within one standard deviation.
    assert!((0.45..=0.92).contains(&within), "{within}");
}

/// Prints the table of docs/benchmarks/metres.md.
#[test]
#[ignore = "a table of five hundred flights"]
fn table_of_flights_of_a_minute() {
    for (rate_hz, rate) in [(1.0, "1 Hz"), (10.0, "10 Hz")] {
        for (offset, clock) in [(Offset::TWO_BUTTONS, "taken for 0 ± 2 s"), (Offset::Unknown, "clock unknown")] {
            row(&format!("{rate}, 0.7 s late, {clock}"), rate_hz, offset, 200);
        }
    }
}
