//! What a map of a long video costs, and how exact it is: tracks made up for a camera that flies past a landscape that
//! never repeats, or tracks that a run has found.
//!
//! ```text
//! cargo run --release --example long_map -- FRAMES OBSERVATIONS_PER_FRAME [unknown] [back]
//! cargo run --release --example long_map -- OUT/.tractrix/features-HASH/background.bin WIDTH HEIGHT
//! ```
//!
//! `unknown`: the focal length is to be found. `back`: the camera turns back and forth over 200 places, and a quarter
//! of the points are found again.

use std::error::Error;
use std::time::Instant;

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use rand::Rng as _;
use rand_distr::{Distribution, StandardNormal};
use tractrix::camera::Camera;
use tractrix::features::TrackTable;
use tractrix::features::tracks::Track;
use tractrix::mapper::{self, Intrinsics};
use tractrix::math::{Rigid3, Rng, seeded_rng, umeyama};
use tractrix::scene::Reconstruction;
use tractrix::synthetic::{empty_table, observe};

const STEP: f64 = 1.0 / 12.0;
const PLACES: usize = 200;

/// What is known of the made-up flight.
struct Truth {
    camera: Camera,
    poses: Vec<Rigid3>,
}

fn main() -> Result<(), Box<dyn Error>> {
    if std::env::var_os("TRACTRIX_LOG").is_some() {
        tracing_subscriber::fmt().with_max_level(tracing::Level::TRACE).with_writer(std::io::stderr).init();
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [first, second, words @ ..] = arguments.as_slice() else {
        return Err("usage: long_map FRAMES OBSERVATIONS_PER_FRAME [unknown] [back]".into());
    };
    let has = |word: &str| words.iter().any(|given| given == word);
    match first.parse::<usize>() {
        Ok(frames) => {
            let truth = flight(frames, has("back"));
            let table = tracks(&truth, second.parse()?, has("back"));
            let (guess, known) = match has("unknown") {
                true => (Camera::prior(960, 540), Intrinsics::GUESSED),
                false => (truth.camera, Intrinsics::FIXED),
            };
            let model = map(table, guess, known)?;
            println!("RMS of the camera centres {:.5} of the path's unit", center_error(&model, &truth));
        }
        Err(_) => {
            let table: TrackTable = postcard::from_bytes(&std::fs::read(first)?)?;
            let camera = Camera::prior(second.parse()?, words.first().ok_or("no height")?.parse()?);
            map(table, camera, Intrinsics::GUESSED)?;
        }
    }
    Ok(())
}

/// Maps as the stage `background` does, and says what it took.
fn map(mut table: TrackTable, camera: Camera, known: Intrinsics) -> Result<Reconstruction, Box<dyn Error>> {
    let options = mapper::Options::background();
    let before = status_mib("VmHWM:");
    let (frames, observations) = (table.views.len() as f64, table.num_observations() as f64);
    let (start, cpu) = (Instant::now(), tractrix::pipeline::process_cpu_s());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let (model, report) = pool.install(|| {
        mapper::cut_long_tracks(&mut table, &[camera], known, &options, 0);
        mapper::reconstruct_watched(table, &[camera], known, &options, 0, None, &mut |_| {})
    })?;
    let cpu = tractrix::pipeline::process_cpu_s() - cpu;
    println!(
        "{} frames, {:.0} observations a frame: {} registered, {:.1} s, {:.4} CPU s a frame",
        frames,
        observations / frames,
        report.num_registered(),
        start.elapsed().as_secs_f64(),
        cpu / frames
    );
    let found = model.cameras.values().next().ok_or("no camera")?;
    println!("f {:.3}, radial {:?}, deviation {:?}", found.mean_focal(), found.radial, report.focal_deviation());
    println!("mean error {:.5} px, {} points", report.mean_error_px.unwrap_or(f64::NAN), report.num_points);
    println!("largest memory {:.0} MiB, before the map {before:.0} MiB", status_mib("VmHWM:"));
    Ok(model)
}

fn flight(frames: usize, back: bool) -> Truth {
    let at = |frame: usize| {
        let place = match (back, frame / PLACES % 2) {
            (true, 0) => frame % PLACES,
            (true, _) => PLACES - frame % PLACES,
            (false, _) => frame,
        };
        let x = STEP * place as f64;
        let center = Point3::new(x, 0.3 * (0.7 * x).sin(), 0.2 * (0.4 * x).cos());
        let turn = Vector3::new(0.03 * (0.5 * x).sin(), 0.05 * (0.3 * x).cos(), 0.02 * (0.9 * x).sin());
        Rigid3::from_rotation_and_center(UnitQuaternion::from_scaled_axis(turn), center)
    };
    Truth { camera: Camera::with_focal(960, 540, 880.0), poses: (0..frames).map(at).collect() }
}

/// Tracks of 10 to 120 views, with 0.1 px of noise, one position in a hundred eight times as far off.
fn tracks(truth: &Truth, per_frame: usize, back: bool) -> TrackTable {
    let mut rng = seeded_rng(7, 0);
    let frames = truth.poses.len();
    let mut table = empty_table(frames);
    // Tracks end where points leave the picture: half of their views are left, about.
    let per_view = (per_frame as f64 / 45.0).max(1.0) as usize;
    for first in 0..frames {
        for _ in 0..per_view {
            let length = rng.random_range(10..=120usize);
            let point = point_in(truth, first, &mut rng);
            let mut track = Track::new();
            seen(truth, &mut table, &mut track, point, first..frames.min(first + length), &mut rng);
            if back && rng.random::<f64>() < 0.25 {
                let again =
                    2 * PLACES * (1 + first / (2 * PLACES)) + (2 * PLACES - first % (2 * PLACES)) % (2 * PLACES);
                let later = again.saturating_sub(length / 2).max(first + length + 100);
                seen(truth, &mut table, &mut track, point, later..(later + length).min(frames), &mut rng);
            }
            if track.len() >= 3 {
                table.tracks.push(track);
            }
        }
    }
    table
}

/// A point somewhere in the picture, 8 to 20 units away.
fn point_in(truth: &Truth, frame: usize, rng: &mut Rng) -> Point3<f64> {
    let depth = rng.random_range(8.0..20.0);
    let [u, v] = [rng.random_range(0.0..960.0), rng.random_range(0.0..540.0)];
    let in_cam = Point3::new((u - 480.0) / 880.0 * depth, (v - 270.0) / 880.0 * depth, depth);
    truth.poses[frame].inverse() * in_cam
}

fn seen(
    truth: &Truth,
    table: &mut TrackTable,
    track: &mut Track,
    point: Point3<f64>,
    views: std::ops::Range<usize>,
    rng: &mut Rng,
) {
    for view in views {
        let exact = truth.camera.pixel_from_cam(truth.poses[view] * point);
        let Some(exact) = exact.filter(|pixel| truth.camera.contains(*pixel)) else { continue };
        let noise_px = if rng.random::<f64>() < 0.01 { 0.8 } else { 0.1 };
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let pixel = exact + noise_px * Vector2::new(normal(), normal());
        observe(table, track, view, pixel);
    }
}

/// Root mean square distance of the centres after alignment.
fn center_error(model: &Reconstruction, truth: &Truth) -> f64 {
    let pairs = model.images.iter();
    let (found, exact): (Vec<_>, Vec<_>) =
        pairs.map(|(id, image)| (image.cam_from_world.center(), truth.poses[id.0 as usize - 1].center())).unzip();
    let Some(similarity) = umeyama(&found, &exact) else { return f64::NAN };
    let sum: f64 = found.iter().zip(&exact).map(|(a, b)| (similarity * *a - b).norm_squared()).sum();
    (sum / found.len() as f64).sqrt()
}

/// A line of `/proc/self/status` that is given in kB.
fn status_mib(key: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default();
    line.split_whitespace().next().and_then(|kib| kib.parse::<f64>().ok()).unwrap_or(f64::NAN) / 1024.0
}
