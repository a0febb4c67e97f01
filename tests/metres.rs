//! Metres of a whole run: from a log, from a known height, from both; and logs that are no use.

mod common;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use common::{Place, drive, json, outcome, tractrix};
use serde_json::Value;

const NUM_FRAMES: u32 = 24;
const FPS: f64 = 12.0;

/// Runs `run` on the drive with more flags; gives exit code and what went to stderr.
fn run(place: &Place, output: &str, more: &[&str]) -> (i32, String) {
    let path = |name: &str| place.path(name).display().to_string();
    let mut command = tractrix();
    command.args(["run", &path("images"), "--output", &path(output), "--masks", &path("masks")]);
    command.args(["--ground-masks", &path("ground"), "--intrinsics", &drive::intrinsics()]);
    command.args(["--fps", &FPS.to_string(), "--threads", "1"]).args(more);
    let (code, _, stderr) = outcome(&mut command);
    (code, stderr)
}

fn trajectories(place: &Place, output: &str) -> Value {
    json(&place.path(output).join("trajectories.json"))
}

/// Where the camera is, metres; the drive's own course.
fn eye(time_s: f64) -> [f64; 3] {
    let t = time_s * FPS / 23.0;
    [-7.0 + 8.0 * t, -10.0 - 3.0 * t, 3.5 + 4.0 * t]
}

/// A table with the camera's places at 10 Hz, as a receiver with corrections writes it; `warp` makes another flight of
/// it.
fn write_log(path: &Path, warp: impl Fn([f64; 3]) -> [f64; 3]) {
    let mut text = "time,longitude,latitude,altitude,fix\n".to_owned();
    for i in 0..19 {
        let time_s = 0.05 + 0.1 * f64::from(i);
        let [x, y, z] = warp(eye(time_s));
        let (longitude, latitude) = (8.5 + x / (111_320.0 * 47.3f64.to_radians().cos()), 47.3 + y / 111_320.0);
        writeln!(text, "{time_s:.2},{longitude:.9},{latitude:.9},{:.3},rtk", 400.0 + z).unwrap();
    }
    fs::write(path, text).unwrap();
}

/// From the first to the last place of the vehicle, in metres.
fn way_m(trajectories: &Value) -> f64 {
    let frames = trajectories["objects"][0]["frames"].as_array().unwrap();
    let place = |frame: &Value| -> Vec<f64> { serde_json::from_value(frame["position_m"].clone()).unwrap() };
    let (first, last) = (place(&frames[0]), place(&frames[frames.len() - 1]));
    first.iter().zip(&last).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// What metres must not change: all that was there before them.
fn without_metres(mut trajectories: Value) -> Value {
    trajectories.as_object_mut().unwrap().remove("metric");
    for object in trajectories["objects"].as_array_mut().unwrap() {
        for frame in object["frames"].as_array_mut().unwrap() {
            let kept = ["frame", "name", "time_s", "position", "world_from_object"];
            frame.as_object_mut().unwrap().retain(|key, _| kept.contains(&key.as_str()));
        }
        for key in ["dimensions", "travel"] {
            object.as_object_mut().unwrap().remove(key);
        }
    }
    trajectories
}

fn stages_done(place: &Place, output: &str) -> Vec<String> {
    let run = json(&place.path(output).join("run.json"));
    let stages = run["stages"].as_object().unwrap();
    stages.iter().filter(|(_, stage)| stage["reused"] == false).map(|(name, _)| name.clone()).collect()
}

#[test]
fn a_log_and_a_height_give_metres_and_do_nothing_else_anew() {
    let place = Place::new(NUM_FRAMES);
    assert_eq!(run(&place, "out", &[]).0, 0);
    let unknown = trajectories(&place, "out");
    assert_eq!(unknown["metric"]["verdict"], "unknown");
    assert!(unknown["metric"]["reason"].as_str().unwrap().contains("--camera-height"), "{}", unknown["metric"]);
    assert!(unknown["objects"][0]["frames"][0]["position_m"].is_null());

    let log = place.path("log.csv");
    write_log(&log, |position| position);
    let log = log.display().to_string();
    assert_eq!(run(&place, "out", &["--telemetry", &log]).0, 0);
    assert_eq!(stages_done(&place, "out"), ["metric", "report"]);
    let found = trajectories(&place, "out");
    assert_eq!((&found["metric"]["verdict"], &found["metric"]["axes"]), (&"telemetry".into(), &"east-north-up".into()));
    // Nine metres along the street and two and a half to the side.
    let expected = 9.0f64.hypot(2.5);
    // In pictures of 320 pixels the vehicle itself is placed to some percent.
    assert!((way_m(&found) / expected - 1.0).abs() < 0.1, "{}", way_m(&found));
    let by_log = found["metric"]["scale"].as_f64().unwrap();
    let frame = &found["objects"][0]["frames"][0];
    // The vehicle begins at (-4, 0), of which the first fix is three metres west and ten south.
    let longitude = frame["longitude"].as_f64().unwrap();
    assert!(((longitude - 8.5) * 111_320.0 * 47.3f64.to_radians().cos() + 4.0).abs() < 1.0, "{frame}");
    assert!(frame["distance_to_camera_m"].as_f64().unwrap() > 8.0 && !frame["place_std_m"].is_null(), "{frame}");
    assert_eq!(without_metres(found), without_metres(unknown));

    // The camera rises from 3.5 to 7.5 metres.
    assert_eq!(run(&place, "out", &["--no-telemetry", "--camera-height", "5.5±0.05"]).0, 0);
    assert_eq!(stages_done(&place, "out"), ["metric", "report"]);
    let found = trajectories(&place, "out");
    assert_eq!((&found["metric"]["verdict"], &found["metric"]["axes"]), (&"surveyed".into(), &"up".into()));
    let by_height = found["metric"]["scale"].as_f64().unwrap();
    assert!((by_height / by_log - 1.0).abs() < 0.05, "{by_height} {by_log}");

    let (code, stderr) = run(&place, "out", &["--telemetry", &log, "--camera-height", "11±0.05"]);
    assert_eq!(code, 0);
    let found = trajectories(&place, "out");
    let named: Vec<&str> =
        found["metric"]["contradictions"].as_array().unwrap().iter().map(|c| c["source"].as_str().unwrap()).collect();
    assert!(named.contains(&"camera height") && stderr.contains("contradicts"), "{named:?} {stderr}");
    let share = found["metric"]["std"]["scale"].as_f64().unwrap() / found["metric"]["scale"].as_f64().unwrap();
    assert!(share > 0.04, "sources that contradict one another make nobody sure: {share}");
}

#[test]
fn models_alone_go_to_the_map_and_to_no_unknown_format() {
    let place = Place::new(NUM_FRAMES);
    let path = |name: &str| place.path(name).display().to_string();
    write_log(&place.path("log.csv"), |position| position);
    let sfm = |more: &[&str]| {
        let mut command = tractrix();
        command.args(["sfm", &path("images"), "--output", &path("out"), "--masks", &path("masks")]);
        command.args(["--intrinsics", &drive::intrinsics(), "--fps", &FPS.to_string(), "--threads", "1"]).args(more);
        let (code, _, stderr) = outcome(&mut command);
        assert_eq!(code, 0, "{stderr}");
    };
    let convert = |more: &[&str]| {
        let (code, _, stderr) = outcome(tractrix().args(["convert", &path("out")]).args(more));
        (code, stderr)
    };
    sfm(&[]);
    let (code, stderr) = convert(&[&path("utm"), "--frame", "utm"]);
    assert!(code == 1 && stderr.contains("--telemetry FILE"), "{stderr}");
    sfm(&["--telemetry", &path("log.csv")]);
    assert_eq!(stages_done(&place, "out"), [""; 0]);
    assert_eq!(convert(&[&path("utm"), "--frame", "utm"]).0, 0);
    let frame = json(&place.path("utm/frame.json"));
    assert_eq!((&frame["epsg"], &frame["axes"]), (&32_632.into(), &"easting, northing, height".into()));
    assert_eq!(convert(&[&path("points.ply"), "--frame", "enu"]).0, 0);
    assert!(place.path("points.ply.frame.json").is_file());
    sfm(&["--no-telemetry"]);
    assert_eq!(convert(&[&path("other"), "--frame", "metric"]).0, 1);
    for name in ["points.obj", "scene.e57"] {
        let (code, stderr) = convert(&[&path(name)]);
        assert!(code == 1 && stderr.contains("NAME.ply") && !place.path(name).exists(), "{stderr}");
    }
    assert_eq!(convert(&[&path("model.v2"), "--to", "colmap-text"]).0, 0);
    assert_eq!(convert(&[&path("model.2026")]).0, 0);
}

#[test]
fn logs_that_are_no_use_cost_nothing_but_their_metres() {
    let place = Place::new(NUM_FRAMES);
    let log = place.path("log.csv");
    let flag = log.display().to_string();
    // Refused before work.
    for content in ["", "hello\n", "time,longitude,latitude\n"] {
        fs::write(&log, content).unwrap();
        let (code, stderr) = run(&place, "out", &["--telemetry", &flag]);
        assert!(code == 2 && stderr.contains("log.csv") && !place.path("out").exists(), "{content:?}: {stderr}");
    }
    let none = place.path("none.gpx").display().to_string();
    assert_eq!(run(&place, "out", &["--telemetry", &none]).0, 2);

    assert_eq!(run(&place, "out", &["--no-telemetry"]).0, 0);
    let expected = fs::read_to_string(place.path("out/trajectories.json")).unwrap();
    // Another flight, half a file, and one that stands still.
    write_log(&log, |[x, y, z]| [300.0 * (x * y).sin(), 200.0 * (x * 3.0).cos(), z]);
    let another = fs::read_to_string(&log).unwrap();
    write_log(&log, |position| position);
    let half: String = fs::read_to_string(&log).unwrap().lines().take(3).collect::<Vec<_>>().join("\n") + "\n0.45,8.4";
    write_log(&log, |_| [0.0, 0.0, 5.0]);
    let still = fs::read_to_string(&log).unwrap();
    for content in [another, half, still] {
        fs::write(&log, &content).unwrap();
        let (code, stderr) = run(&place, "out", &["--telemetry", &flag]);
        assert!(code == 0 && stderr.contains("log.csv") && stderr.contains("no scale"), "{content}: {stderr}");
        let found = fs::read_to_string(place.path("out/trajectories.json")).unwrap();
        assert_eq!(found, expected, "{content}");
    }
}

#[test]
fn a_log_of_another_clock_says_so() {
    let place = Place::new(NUM_FRAMES);
    let log = place.path("log.csv");
    write_log(&log, |position| position);
    let later = |row: &str| match row.split_once(',') {
        Some((time, rest)) if time != "time" => format!("{},{rest}", time.parse::<f64>().unwrap() + 5000.0),
        _ => row.to_owned(),
    };
    let rows: Vec<String> = fs::read_to_string(&log).unwrap().lines().map(later).collect();
    fs::write(&log, rows.join("\n") + "\n").unwrap();
    let (code, stderr) = run(&place, "out", &["--telemetry", &log.display().to_string()]);
    // Whether so short a way tells its time or not: nothing is taken in silence.
    assert!(code == 0 && stderr.contains("log.csv: "), "{stderr}");
    assert!(stderr.contains("stated time does not fit") || stderr.contains("no scale"), "{stderr}");
}
