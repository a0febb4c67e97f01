//! Stop and go on: a run that was killed ends where an undisturbed one ends, and changed options do again what they
//! touch and nothing else.

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use common::{Place, drive, json, outcome, tractrix};

const NUM_FRAMES: u32 = 24;

impl Place {
    fn arguments(&self, output: &str) -> Vec<String> {
        let path = |name: &str| self.path(name).display().to_string();
        let mut arguments = vec!["run".to_owned(), path("images"), "--output".to_owned(), path(output)];
        for (flag, value) in [
            ("--masks", path("masks")),
            ("--ground-masks", path("ground")),
            ("--intrinsics", drive::intrinsics()),
            ("--fps", "12".to_owned()),
            ("--threads", "1".to_owned()),
        ] {
            arguments.extend([flag.to_owned(), value]);
        }
        arguments
    }

    /// Runs to the end; gives the stages that were done and those that were taken over.
    fn run(&self, output: &str, more: &[&str]) -> (Vec<String>, Vec<String>) {
        let (code, _, stderr) = outcome(tractrix().args(self.arguments(output)).args(more));
        assert_eq!(code, 0, "{stderr}");
        let run = json(&self.path(output).join("run.json"));
        let stages = run["stages"].as_object().unwrap();
        let (reused, done): (Vec<_>, Vec<_>) = stages.iter().partition(|(_, stage)| stage["reused"] == true);
        let names = |stages: Vec<(&String, _)>| stages.into_iter().map(|(name, _)| name.clone()).collect();
        (names(done), names(reused))
    }

    /// Every file of a result by name, but for those that tell times.
    fn result(&self, output: &str) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut files = BTreeMap::new();
        collect(&self.path(output), Path::new(""), &mut files);
        files
    }
}

fn collect(root: &Path, below: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(root.join(below)).unwrap() {
        let name = below.join(entry.unwrap().file_name());
        let tells_times = [".tractrix", "run.json", "report.html"].iter().any(|own| name == Path::new(own));
        if root.join(&name).is_dir() && !tells_times {
            collect(root, &name, files);
        } else if !tells_times {
            files.insert(name.clone(), fs::read(root.join(&name)).unwrap());
        }
    }
}

fn assert_same(a: &BTreeMap<PathBuf, Vec<u8>>, b: &BTreeMap<PathBuf, Vec<u8>>, what: &str) {
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>(), "{what}");
    let different: Vec<_> = a.iter().filter(|(name, bytes)| b[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(different.is_empty(), "{what}: {different:?} differ");
}

const ALL: [&str; 12] = [
    "frames",
    "segment",
    "features",
    "background",
    "motion",
    "track",
    "follow",
    "objects",
    "ground",
    "scale",
    "metric",
    "report",
];

#[test]
fn a_killed_run_ends_where_an_undisturbed_one_ends() {
    let place = Place::new(NUM_FRAMES);
    let (done, reused) = place.run("whole", &[]);
    assert_eq!((done.len(), reused.len()), (ALL.len(), 0));
    let whole = place.result("whole");
    assert!(whole.contains_key(Path::new("objects/1/images.txt")), "{:?}", whole.keys());
    for stage in ["frames", "features", "background", "motion", "track", "follow", "objects", "scale", "metric"] {
        let output = format!("killed-after-{stage}");
        let marker = format!("{stage}.json");
        kill_when(&place, &output, stage, |state| state.join(&marker).is_file());
        let (_, reused) = place.run(&output, &[]);
        assert!(reused.iter().any(|name| name == stage), "{stage} was done twice: {reused:?}");
        assert_same(&whole, &place.result(&output), &output);
    }
    // The vehicle is reconstructed, and not yet compared with the masks of all frames.
    kill_when(&place, "killed-inside", "object 1", has_report_of_object);
    place.run("killed-inside", &[]);
    assert_same(&whole, &place.result("killed-inside"), "killed-inside");
    assert!(folders_of_objects(&place.path("killed-inside/.tractrix")).is_empty());
}

/// The folders in which the stage `objects` keeps what it has done so far.
fn folders_of_objects(state: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(state).into_iter().flatten().flatten().map(|entry| entry.path());
    entries.filter(|path| path.is_dir() && path.to_string_lossy().contains("objects-")).collect()
}

fn has_report_of_object(state: &Path) -> bool {
    folders_of_objects(state).iter().any(|folder| folder.join("1.json").is_file())
}

/// Starts a run and kills it without warning as soon as its state folder shows that something is done.
fn kill_when(place: &Place, output: &str, what: &str, is_done: impl Fn(&Path) -> bool) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_tractrix"))
        .args(place.arguments(output))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let state = place.path(output).join(".tractrix");
    let started = Instant::now();
    let is_reached = loop {
        if is_done(&state) {
            break true;
        }
        if child.try_wait().unwrap().is_some() {
            break false;
        }
        assert!(started.elapsed() < Duration::from_secs(600), "{what} is never done");
        std::thread::sleep(Duration::from_millis(2));
    };
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(is_reached, "the run ended before {what} was done");
}

#[test]
fn what_changes_is_done_again_and_nothing_else() {
    let place = Place::new(NUM_FRAMES);
    place.run("out", &[]);
    let before = place.result("out");
    let index = |stage: &str| ALL.iter().position(|name| *name == stage).unwrap();
    let expect = |more: &[&str], first: &str| {
        let (done, reused) = place.run("out", more);
        assert_eq!(reused, ALL[..index(first)], "{more:?}");
        assert_eq!(done, ALL[index(first)..], "{more:?}");
    };

    // The same again does nothing, and neither does another number of threads.
    let (done, _) = place.run("out", &[]);
    assert!(done.iter().all(|stage| stage == "report"), "{done:?}");
    // The vehicle's model is adjusted with the ground, unless another method takes it as it is.
    let model = |folder: &str| fs::read(place.path("out").join(folder).join("1/points3D.txt")).unwrap();
    assert_ne!(model("objects"), model("as-reconstructed"));
    expect(&["--scale-method", "intersection"], "scale");
    assert_eq!(json(&place.path("out/trajectories.json"))["objects"][0]["scale"]["method"], "intersection");
    assert_eq!(model("objects"), model("as-reconstructed"));
    expect(&[], "scale");
    assert_eq!(json(&place.path("out/trajectories.json"))["objects"][0]["scale"]["method"], "joint");
    assert_same(&before, &place.result("out"), "after going back");
    expect(&["--ground-label", "1"], "ground");
    expect(&["--every", "2"], "frames");
    assert_eq!(json(&place.path("out/run.json"))["stages"]["frames"]["figures"]["num_frames"], NUM_FRAMES / 2);
    expect(&[], "frames");
    assert_same(&before, &place.result("out"), "after all frames again");

    // A result that somebody took away is made again.
    fs::remove_file(place.path("out/trajectories.json")).unwrap();
    expect(&[], "scale");
    assert_same(&before, &place.result("out"), "after a loss");
    fs::remove_dir_all(place.path("out/objects/1")).unwrap();
    expect(&[], "scale");
    assert_same(&before, &place.result("out"), "after the loss of a model");
    fs::remove_dir_all(place.path("out/as-reconstructed/1")).unwrap();
    let (done, _) = place.run("out", &[]);
    assert_eq!(done.iter().map(String::as_str).collect::<BTreeSet<_>>(), BTreeSet::from(["objects", "report"]));
    assert_same(&before, &place.result("out"), "after the loss of what it was made from");

    // A changed picture changes everything, a touched one nothing.
    let picture = place.path("images/0003.png");
    let bytes = fs::read(&picture).unwrap();
    fs::write(&picture, &bytes).unwrap();
    let (done, _) = place.run("out", &[]);
    assert!(done.iter().all(|stage| stage == "report"), "{done:?}");
    let mut altered = image::load_from_memory(&bytes).unwrap().to_rgb8();
    altered.put_pixel(0, 0, image::Rgb([1, 2, 3]));
    altered.save(&picture).unwrap();
    let (code, _, stderr) = outcome(tractrix().args(place.arguments("out")));
    assert!(code == 2 && stderr.contains("another input"), "{stderr}");
    expect(&["--overwrite"], "frames");
}

#[test]
fn two_runs_do_not_share_a_folder() {
    let place = Place::new(NUM_FRAMES);
    let mut first = Command::new(env!("CARGO_BIN_EXE_tractrix"))
        .args(place.arguments("out"))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while !place.path("out/.tractrix/frames.json").is_file() {
        assert!(first.try_wait().unwrap().is_none(), "the first run ended too early");
        std::thread::sleep(Duration::from_millis(2));
    }
    let (code, _, stderr) = outcome(tractrix().args(place.arguments("out")));
    assert_eq!(code, 75);
    assert!(stderr.contains("in use by another tractrix process"), "{stderr}");
    first.kill().unwrap();
    first.wait().unwrap();
}

#[test]
fn a_drive_becomes_a_trajectory() {
    let place = Place::new(NUM_FRAMES);
    place.run("out", &[]);
    let found = json(&place.path("out/trajectories.json"));
    let object = &found["objects"][0];
    let frames = object["frames"].as_array().unwrap();
    assert!(frames.len() as u32 >= NUM_FRAMES - 2, "{} frames", frames.len());
    assert!((frames[6]["time_s"].as_f64().unwrap() - 0.5).abs() < 1e-9);
    // In the world that was rendered the camera moves 4/9 of the vehicle's way in height and drives beside it; what can
    // be said without its unit is that the way of the vehicle is near its true share of the camera's way.
    let position = |frame: &serde_json::Value| -> nalgebra::Point3<f64> {
        serde_json::from_value::<[f64; 3]>(frame["position"].clone()).unwrap().into()
    };
    let way = (position(&frames[frames.len() - 1]) - position(&frames[0])).norm();
    let background = tractrix::io::interchange::colmap::read(&place.path("out/background")).unwrap();
    let centers: Vec<_> = background.images.values().map(|image| image.cam_from_world.center()).collect();
    let camera_way = (centers[centers.len() - 1] - centers[0]).norm();
    let truth = nalgebra::Vector2::new(9.0f64, 2.5).norm() / nalgebra::Vector3::new(8.0f64, -3.0, 4.0).norm();
    let share = way / camera_way;
    assert!((share / truth - 1.0).abs() < 0.1, "the vehicle's way is {share:.3} of the camera's, in truth {truth:.3}");
}

#[test]
fn images_of_a_given_model_that_are_no_frames_are_named() {
    let place = Place::new(NUM_FRAMES);
    place.run("out", &[]);
    let model = format!("1={}", place.path("out/objects/1").display());
    place.run("given", &["--every", "2", "--object-model", &model]);
    let run = json(&place.path("given/run.json"));
    let warnings: Vec<&str> = run["warnings"].as_array().unwrap().iter().filter_map(|text| text.as_str()).collect();
    let named =
        |text: &&str| text.starts_with("object 1: ") && text.contains("images skipped: not frames of the input");
    assert_eq!(warnings.iter().filter(|text| named(text)).count(), 1, "{warnings:?}");
    let scale = &json(&place.path("given/trajectories.json"))["objects"][0]["scale"];
    assert_eq!(scale["method"], "least-squares", "a model that the user gives is not adjusted");
}

/// The combination of the paper: another program's background, and a third one's object.
#[test]
fn models_of_other_programs_are_taken_as_they_are_and_read_again_when_they_change() {
    let place = Place::new(NUM_FRAMES);
    place.run("out", &[]);
    let convert = |from: &str, to: &str| {
        let (code, _, stderr) = outcome(tractrix().arg("convert").arg(place.path(from)).arg(place.path(to)));
        assert_eq!(code, 0, "{stderr}");
    };
    fs::create_dir_all(place.path("project/sparse")).unwrap();
    convert("out/background", "sfm_data.json");
    convert("out/objects/1", "project/sparse/0");
    let background = place.path("sfm_data.json").display().to_string();
    let object = format!("1={}", place.path("project").display());
    let given = ["--background-model", &background, "--object-model", &object];
    place.run("given", &given);
    for model in ["background", "objects/1"] {
        let read = |out: &str| tractrix::io::interchange::colmap::read(&place.path(out).join(model)).unwrap();
        let (own, other) = (read("out"), read("given"));
        assert!(own.images.keys().eq(other.images.keys()) && !own.images.is_empty());
        let centers = own.images.values().zip(other.images.values());
        let mut centers = centers.map(|(a, b)| (a.cam_from_world.center(), b.cam_from_world.center()));
        assert!(centers.all(|(a, b)| (a - b).norm() < 1e-9), "{model}");
    }
    let found = json(&place.path("given/trajectories.json"));
    assert!(!found["objects"][0]["frames"].as_array().unwrap().is_empty());
    let (done, _) = place.run("given", &given);
    assert!(!done.iter().any(|stage| stage == "objects"), "{done:?}");
    let points = place.path("project/sparse/0/points3D.bin");
    let bytes = fs::read(&points).unwrap();
    convert("out/as-reconstructed/1", "other");
    fs::copy(place.path("other/points3D.bin"), &points).unwrap();
    for name in ["cameras.bin", "images.bin"] {
        fs::copy(place.path("other").join(name), place.path("project/sparse/0").join(name)).unwrap();
    }
    assert_ne!(bytes, fs::read(&points).unwrap());
    let (done, reused) = place.run("given", &given);
    assert!(done.iter().any(|stage| stage == "objects"), "{done:?}");
    assert!(reused.iter().any(|stage| stage == "background"), "{reused:?}");
}
