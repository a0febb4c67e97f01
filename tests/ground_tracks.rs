//! A vehicle of a few pixels: too small for a model, followed on the ground by its masks in every outlet.

mod common;

use std::fs;

use common::{drive, json, outcome, tractrix};
use image::GrayImage;
use serde_json::Value;
use tempfile::TempDir;

const NUM_FRAMES: u32 = 24;
/// The vehicle's size against that of the other tests: 0.9 m long, about 20 pixels.
const SIZE: f64 = 0.2;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// Largest width and height of the masks, pixels.
fn largest(masks: &std::path::Path) -> (u32, u32) {
    let mut size = (0, 0);
    for entry in fs::read_dir(masks).unwrap() {
        let mask: GrayImage = image::open(entry.unwrap().path()).unwrap().to_luma8();
        let inside = || mask.enumerate_pixels().filter(|(.., pixel)| pixel.0[0] > 0);
        let span = |along: fn((u32, u32)) -> u32| {
            let all = || inside().map(|(x, y, _)| along((x, y)));
            all().max().unwrap() - all().min().unwrap() + 1
        };
        size = (size.0.max(span(|at| at.0)), size.1.max(span(|at| at.1)));
    }
    size
}

#[test]
fn a_tiny_vehicle_has_a_ground_track_in_every_outlet() {
    let folder = TempDir::new().unwrap();
    drive::write_sized(folder.path(), NUM_FRAMES, SIZE);
    let path = |name: &str| folder.path().join(name);
    let shown = |name: &str| path(name).display().to_string();
    let (width, height) = largest(&path("masks"));
    assert!((12..30).contains(&width) && height < 20, "{width} × {height} px");
    let run = |more: &[&str]| {
        let mut command = tractrix();
        command.args(["run", &shown("images"), "--output", &shown("out"), "--masks", &shown("masks")]);
        command.args(["--ground-masks", &shown("ground"), "--intrinsics", &drive::intrinsics()]);
        command.args(["--fps", "12", "--threads", "1"]).args(more);
        let (code, stdout, stderr) = outcome(&mut command);
        assert_eq!(code, 0, "{stderr}");
        stdout
    };
    let terminal = run(&[]);
    assert!(
        terminal.contains("ground track in") && terminal.contains("1 ground track without a 3D model"),
        "{terminal}"
    );
    let file = json(&path("out/trajectories.json"));
    // A model of a few frames may come about; it is no trajectory of the vehicle.
    let of_most = |object: &&Value| object["frames"].as_array().unwrap().len() > NUM_FRAMES as usize / 2;
    assert_eq!(file["objects"].as_array().unwrap().iter().filter(of_most).count(), 0, "{}", file["objects"]);
    let [track] = &file["ground_tracks"].as_array().unwrap()[..] else { panic!("{}", file["ground_tracks"]) };
    assert_eq!((&track["id"], &track["method"]), (&1.into(), &"ground-contact".into()));
    assert_eq!(track["verdict"]["state"], "usable", "{}", track["verdict"]);
    let frames = track["frames"].as_array().unwrap();
    assert!(frames.len() >= 20 && !track["reason"].as_str().unwrap().is_empty(), "{}", frames.len());

    // The camera goes 9.43 m, the vehicle 9.34 m; the contact point moves by half a vehicle at most against it.
    let summary: Value = serde_json::from_str(&run(&["--json"])).unwrap();
    assert_eq!(summary["ground_tracks"][0]["frames"], frames.len());
    let (code, _, stderr) = outcome(tractrix().args(["export", &shown("out"), "--format", "csv,tum,gltf"]));
    assert_eq!(code, 0, "{stderr}");
    let camera = fs::read_to_string(path("out/export/tum/camera.txt")).unwrap();
    let centers: Vec<Vec<f64>> = (camera.lines().filter(|line| !line.starts_with('#')))
        .map(|line| line.split(' ').skip(1).take(3).map(|number| number.parse().unwrap()).collect())
        .collect();
    let unit = distance(&centers[0], centers.last().unwrap()) / 9.43;
    let (first, last) = (&frames[0], frames.last().unwrap());
    let steps = last["frame"].as_f64().unwrap() - first["frame"].as_f64().unwrap();
    let way = distance(&numbers(&first["position"]), &numbers(&last["position"])) / unit;
    let expected = 9.34 * steps / f64::from(NUM_FRAMES - 1);
    assert!((way - expected).abs() < 0.9, "{way} m, expected {expected} m");
    let stated = &track["travel"]["displacement_units"];
    let [value, std] = ["value", "std"].map(|key| stated[key].as_f64().unwrap() / unit);
    assert!((value - expected).abs() < 3.0 * std && std < 2.0, "{value} ± {std} m, expected {expected} m");

    let table = fs::read_to_string(path("out/export/ground-tracks.csv")).unwrap();
    assert!(table.lines().count() == 2 && table.contains("ground-contact"), "{table}");
    let positions = fs::read_to_string(path("out/export/ground-positions.csv")).unwrap();
    assert_eq!(positions.lines().count(), frames.len() + 1);
    let scene = fs::read(path("out/export/scene.glb")).unwrap();
    let is_in_scene = scene.windows(14).any(|bytes| bytes == b"ground-contact");
    assert!(is_in_scene, "the scene has the ground track");
    let page = fs::read_to_string(path("out/report.html")).unwrap();
    assert!(page.contains("Ground track, without a 3D model: usable") && page.contains("plan-path on-ground"));
    let (code, summary, _) = outcome(tractrix().args(["summary", &shown("out")]));
    assert!(code == 0 && summary.contains("ground track of"), "{summary}");
}
