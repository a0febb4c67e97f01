//! All scale estimators on motions of cameras and vehicles, with simulated observations.
//!
//! ```text
//! cargo run --release --example scale_estimators -- SEQUENCE/scene.json...
//! cargo run --release --example scale_estimators -- LABELS POSES
//! ```
//!
//! LABELS is a folder of label files of the KITTI tracking benchmark, POSES has `<sequence>/CameraTrajectory.txt` for
//! each. Vehicles count that both move, by 5 m, and are labeled in 30 to 60 frames in a row. The noise is that of a
//! reconstruction: the vehicle's size drifts by 1 %, directions are off by half a pixel, attitudes by 0.3°, normals by
//! 0.5°, planes by 3 cm. The true ratio is 1.

use std::error::Error;
use std::fs;
use std::path::Path;

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rand::Rng as _;
use rand_distr::StandardNormal;
use tractrix::math::seeded_rng;
use tractrix::scene::{FrameId, ScaleMethod};
use tractrix::trajectory::{Options, View, Views, estimate};

/// Draws of the noise for each motion.
const NUM_DRAWS: u64 = 5;
/// Height of the vehicle's middle above ground, meters.
const HALF_HEIGHT: f64 = 0.7;

/// Camera center, center of the vehicle, and its axes as columns: forward, left, up.
type TrueFrame = (Vector3<f64>, Vector3<f64>, Matrix3<f64>);

/// Camera and vehicle, by frame.
struct Motion {
    frames: Vec<TrueFrame>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let motions = match arguments.as_slice() {
        [labels, poses] if Path::new(labels).is_dir() => kitti(Path::new(labels), Path::new(poses))?,
        [] => return Err("usage: scale_estimators SCENE... | LABELS POSES".into()),
        scenes => scenes.iter().map(|path| scene(Path::new(path))).collect::<Result<_, _>>()?,
    };
    let num = motions.len() as u64 * NUM_DRAWS;
    println!("{} motions, {NUM_DRAWS} draws; errors are of log r, %, of determined ratios\n", motions.len());
    let methods: Vec<ScaleMethod> =
        ScaleMethod::ALL.into_iter().filter(|method| *method != ScaleMethod::Joint).collect();
    let answers: Vec<Vec<Answer>> = methods.iter().map(|method| answers(*method, &motions)).collect();
    println!("| estimator | undetermined of {num} | median | mean | within 1σ | within 2σ |");
    println!("|---|---|---|---|---|---|");
    for (method, all) in methods.iter().zip(&answers) {
        println!("| {} | {} |", method.name(), row(all).join(" | "));
    }
    Ok(())
}

/// |log r| and relative standard deviation of a determined ratio.
type Answer = Option<(f64, Option<f64>)>;

fn answers(method: ScaleMethod, motions: &[Motion]) -> Vec<Answer> {
    let options = Options::default();
    let answer = |motion: &Motion, draw: u64, stream: u64| {
        let views = views(motion, draw, stream);
        let found = estimate(method, &views, &options).ok()?;
        let std = found.std.map(|std| std / found.ratio);
        std.is_none_or(|std| std <= options.max_relative_std).then(|| (found.ratio.ln().abs(), std))
    };
    let of = |(motion, stream): (&Motion, u64)| (0..NUM_DRAWS).map(|draw| answer(motion, draw, stream)).collect();
    motions.iter().zip(0..).flat_map::<Vec<Answer>, _>(of).collect()
}

fn row(answers: &[Answer]) -> Vec<String> {
    let errors = errors(answers);
    let share = |count: usize, of: usize| {
        if of == 0 { "–".into() } else { format!("{:.0} %", 100.0 * count as f64 / of as f64) }
    };
    let text = |value: Option<f64>| value.map_or("–".to_owned(), |value| format!("{value:.1}"));
    let surprises: Vec<f64> = answers.iter().flatten().filter_map(|(error, std)| Some(error / (*std)?)).collect();
    let within = |limit: f64| share(surprises.iter().filter(|surprise| **surprise <= limit).count(), surprises.len());
    let mean = (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64);
    vec![(answers.len() - errors.len()).to_string(), text(median(&errors)), text(mean), within(1.0), within(2.0)]
}

/// Errors in percent, ascending.
fn errors(answers: &[Answer]) -> Vec<f64> {
    let mut errors: Vec<f64> = answers.iter().flatten().map(|(error, _)| 100.0 * error).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

fn median(sorted: &[f64]) -> Option<f64> {
    sorted.get(sorted.len() / 2).copied()
}

/// Views of a box of 4.3 × 1.8 × 1.4 m that moves, with noise.
fn views(motion: &Motion, draw: u64, stream: u64) -> Views {
    let rng = &mut seeded_rng(draw, stream);
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * rng.sample::<f64, _>(StandardNormal));
    let count = motion.frames.len();
    let mut drift: Vec<f64> = Vec::new();
    for _ in 0..count {
        drift.push(drift.last().unwrap_or(&0.0) + vector(0.01 / (count as f64).sqrt()).x);
    }
    let mean = drift.iter().sum::<f64>() / count as f64;
    let view = |(k, &(camera, object, axes)): (usize, &TrueFrame)| {
        let offset = object - camera;
        let offset = offset * (drift[k] - mean).exp() + vector(0.5 / 880.0) * offset.norm();
        let exact = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&axes));
        let attitude = UnitQuaternion::from_scaled_axis(vector(0.3_f64.to_radians())) * exact;
        let up = axes.column(2).into_owned();
        let normal = (up + vector(0.5_f64.to_radians())).normalize();
        let below = object - HALF_HEIGHT * up;
        View {
            frame: FrameId(k as u32),
            camera_height: normal.dot(&(camera - below)) + vector(0.03).x,
            normal_in_object: attitude.inverse() * normal,
            center_in_object: Point3::from(-(attitude.inverse() * offset)),
            center_in_background: camera.into(),
            background_from_object: attitude,
            height_std: 0.03,
        }
    };
    let views: Vec<View> = motion.frames.iter().enumerate().map(view).collect();
    let half = |k: usize, bit: usize| if k >> bit & 1 == 0 { -0.5 } else { 0.5 };
    let corner = |k: usize| Point3::new(4.3 * half(k, 0), 1.8 * half(k, 1), 2.0 * HALF_HEIGHT * half(k, 2));
    let points = (0..8).map(corner).collect();
    Views {
        num_paired: count,
        num_planes: count,
        views,
        points,
        plane_std: 0.0,
        max_drift: 0.008,
        camera_hovers: false,
    }
}

fn scene(path: &Path) -> Result<Motion, Box<dyn Error>> {
    let scene: serde_json::Value = serde_json::from_str(&fs::read_to_string(path)?)?;
    let entry = |pose: &serde_json::Value, row: usize, column: usize| pose[row][column].as_f64().unwrap_or(f64::NAN);
    let frames = scene["frames"].as_array().ok_or("no frames")?.iter().map(|frame| {
        let (camera, object) = (&frame["T_world_camera"], &frame["T_world_object"]);
        let axes = Matrix3::from_fn(|row, column| entry(object, row, column));
        let [camera, object] = [camera, object].map(|pose| Vector3::from_fn(|row, _| entry(pose, row, 3)));
        (camera, object + HALF_HEIGHT * axes.column(2), axes)
    });
    Ok(Motion { frames: frames.collect() })
}

/// Vehicles of the KITTI tracking benchmark.
fn kitti(labels: &Path, poses: &Path) -> Result<Vec<Motion>, Box<dyn Error>> {
    let mut files: Vec<_> =
        fs::read_dir(labels)?.map(|entry| Ok(entry?.path())).collect::<Result<_, std::io::Error>>()?;
    files.sort();
    let mut motions = Vec::new();
    for file in files {
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let Ok(text) = fs::read_to_string(poses.join(&name).join("CameraTrajectory.txt")) else { continue };
        let cameras: Vec<Vec<f64>> =
            text.lines().map(|line| line.split_whitespace().filter_map(|word| word.parse().ok()).collect()).collect();
        motions.extend(vehicles(&fs::read_to_string(&file)?, &cameras));
    }
    Ok(motions)
}

fn vehicles(labels: &str, cameras: &[Vec<f64>]) -> Vec<Motion> {
    let mut tracks: std::collections::BTreeMap<u32, Vec<(usize, Vec<f64>)>> = std::collections::BTreeMap::new();
    for words in labels.lines().map(|line| line.split_whitespace().collect::<Vec<_>>()) {
        let is_vehicle = words.get(2).is_some_and(|class| ["Car", "Van", "Truck"].contains(class));
        let numbers: Vec<f64> = words.iter().skip(10).take(7).filter_map(|word| word.parse().ok()).collect();
        let (Some(Ok(frame)), Some(Ok(id))) =
            (words.first().map(|w| w.parse::<usize>()), words.get(1).map(|w| w.parse()))
        else {
            continue;
        };
        if is_vehicle && numbers.len() == 7 && cameras.get(frame).is_some_and(|pose| pose.len() == 12) {
            tracks.entry(id).or_default().push((frame, numbers));
        }
    }
    let tracks = tracks
        .into_values()
        .filter(|track| track.len() >= 30 && track.windows(2).all(|pair| pair[1].0 == pair[0].0 + 1));
    let motions = tracks.map(|track| Motion {
        frames: track.iter().take(60).map(|(frame, numbers)| labeled(numbers, &cameras[*frame])).collect(),
    });
    let length = |ends: [Vector3<f64>; 2]| (ends[1] - ends[0]).norm();
    let moves = |motion: &Motion| match (motion.frames.first(), motion.frames.last()) {
        (Some(first), Some(last)) => length([first.0, last.0]) >= 5.0 && length([first.1, last.1]) >= 5.0,
        _ => false,
    };
    motions.filter(moves).collect()
}

/// A label (height, width, length, place of the bottom, yaw, in the camera's frame: y down) in the world.
fn labeled(numbers: &[f64], camera: &[f64]) -> (Vector3<f64>, Vector3<f64>, Matrix3<f64>) {
    let world_from_camera = Matrix3::from_fn(|row, column| camera[4 * row + column]);
    let center = Vector3::new(camera[3], camera[7], camera[11]);
    let middle = Vector3::new(numbers[3], numbers[4] - numbers[0] / 2.0, numbers[5]);
    let (sin, cos) = numbers[6].sin_cos();
    // Forward, left and up.
    let in_camera = Matrix3::new(cos, 0.0, 0.0, 0.0, 0.0, -1.0, -sin, 0.0, 0.0);
    let mut axes = world_from_camera * in_camera;
    let left = axes.column(2).cross(&axes.column(0));
    axes.set_column(1, &left);
    (center, world_from_camera * middle + center, axes)
}
