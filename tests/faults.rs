//! Faults from outside: kills and signals, files that are none, links, and numbers and sizes beyond any sense. The long
//! forms of these tests are in `scripts/faults`; docs/reliability.md has what they found.

mod common;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::{Place, drive, json, outcome, tractrix};
use image::RgbImage;
use rand::Rng as _;
use rustix::process::{Pid, Signal, kill_process};
use tractrix::io::interchange::{colmap, ply};
use tractrix::io::{Sequence, trajectories};

const NUM_FRAMES: u32 = 12;
/// More than any refusal takes on a slow machine, and less than any hang.
const AT_ONCE: Duration = Duration::from_secs(60);

fn arguments(place: &Place, output: &str) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = vec!["run".into(), place.path("images").into()];
    for (flag, value) in [("--output", place.path(output)), ("--masks", place.path("masks"))] {
        arguments.extend([flag.into(), value.into()]);
    }
    let known = drive::intrinsics();
    arguments.extend(["--intrinsics", &known, "--fps", "12", "--threads", "1"].map(OsString::from));
    arguments
}

fn started(place: &Place, output: &str) -> Child {
    // Who starts the tests may have signals ignored, and a program that is started so goes on ignoring them.
    let mut command = Command::new("env");
    command.arg("--default-signal=INT,TERM,HUP").arg(env!("CARGO_BIN_EXE_tractrix"));
    command.args(arguments(place, output)).args(["--progress", "plain"]);
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

#[track_caller]
fn finished(place: &Place, output: &str) {
    let (code, _, stderr) = outcome(tractrix().args(arguments(place, output)));
    assert_eq!(code, 0, "{stderr}");
}

/// Every file below a folder by name, but for those that tell times.
fn result(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let tells_times = |path: &Path| ["run.json", "report.html"].iter().any(|name| path == Path::new(name));
    let own_state = |path: &Path| path.starts_with(".tractrix") && path.extension().is_some_and(|e| e == "json");
    let mut found = everything(root);
    found.retain(|path, _| !tells_times(path) && !own_state(path));
    found
}

fn everything(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![root.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match fs::symlink_metadata(&path).unwrap().is_dir() {
                true => open.push(path),
                false => drop(found.insert(path.strip_prefix(root).unwrap().to_owned(), fs::read(&path).unwrap())),
            }
        }
    }
    found
}

fn named(found: &BTreeMap<PathBuf, Vec<u8>>) -> Vec<&PathBuf> {
    found.keys().collect()
}

#[test]
fn kills_at_random_moments_change_no_byte() {
    const SEED: u64 = 7;
    const ENOUGH: Duration = Duration::from_secs(40);
    let place = Place::new(NUM_FRAMES);
    let start = Instant::now();
    finished(&place, "whole");
    let whole_run = start.elapsed();
    let whole = result(&place.path("whole"));
    let mut rng = tractrix::math::seeded_rng(SEED, 0);
    let (start, mut num_kills) = (Instant::now(), 0);
    for trial in 0..10 {
        for _ in 0..rng.random_range(1..4) {
            let mut child = started(&place, "out");
            std::thread::sleep(whole_run.mul_f64(rng.random_range(0.0..1.0)));
            num_kills += u32::from(child.try_wait().unwrap().is_none());
            child.kill().unwrap();
            child.wait().unwrap();
        }
        finished(&place, "out");
        let found = result(&place.path("out"));
        assert_eq!(named(&whole), named(&found), "trial {trial} of seed {SEED}");
        assert!(whole == found, "trial {trial} of seed {SEED}: some files differ");
        fs::remove_dir_all(place.path("out")).unwrap();
        if start.elapsed() > ENOUGH {
            break;
        }
    }
    assert!(num_kills > 0, "no kill came in time");
}

#[test]
fn the_system_stops_a_run_with_a_code_that_asks_for_another_start() {
    let place = Place::new(48);
    for signal in [Signal::TERM, Signal::HUP] {
        let mut child = started(&place, "out");
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        assert!(lines.any(|line| line.starts_with("features   stage")), "the stage begins");
        let asked = Instant::now();
        kill_process(Pid::from_child(&child), signal).unwrap();
        let rest: Vec<String> = lines.collect();
        assert_eq!(child.wait().unwrap().code(), Some(75), "{signal:?}: {rest:?}");
        assert!(asked.elapsed() < Duration::from_secs(10), "{:?}", asked.elapsed());
        assert!(rest.iter().any(|line| line.contains("the same command resumes")), "{rest:?}");
        assert!(place.path("out/.tractrix/frames.json").is_file());
        fs::remove_dir_all(place.path("out")).unwrap();
    }
}

#[test]
fn what_a_killed_process_left_half_written_goes_with_the_next_run() {
    let place = Place::new(NUM_FRAMES);
    finished(&place, "out");
    let state = place.path("out/.tractrix");
    let folders = fs::read_dir(&state).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_dir());
    let left: Vec<PathBuf> = folders.chain([state.clone()]).map(|folder| folder.join(".tractrix-x1y2z3")).collect();
    assert!(left.len() > 3, "{left:?}");
    left.iter().for_each(|path| fs::write(path, "half").unwrap());
    finished(&place, "out");
    assert!(!left.iter().any(|path| path.exists()), "{left:?}");
}

/// Makes a pipe that nobody writes into.
fn pipe(path: &Path) {
    rustix::fs::mknodat(rustix::fs::CWD, path, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
}

#[test]
fn what_is_no_file_is_never_waited_for() {
    let place = Place::new(3);
    pipe(&place.path("pipe.mp4"));
    symlink("/dev/zero", place.path("zero.txt")).unwrap();
    fs::create_dir(place.path("piped")).unwrap();
    pipe(&place.path("piped/0001.png"));
    fs::copy(place.path("masks/0000.png"), place.path("piped/0000.png")).unwrap();
    let (pipe, zero) = (place.path("pipe.mp4"), place.path("zero.txt"));
    let flags = ["--options", "--segmentation-model", "--ground-model", "--flow-model", "--background-model"];
    let mut cases: Vec<Vec<OsString>> = Vec::new();
    for special in [&pipe, &zero] {
        cases.push(vec!["run".into(), special.into()]);
        cases.extend(flags.map(|flag| vec!["run".into(), place.path("images").into(), flag.into(), special.into()]));
        for command in ["telemetry", "bal"] {
            cases.push(vec![command.into(), special.into()]);
        }
        cases.push(vec!["convert".into(), special.into(), place.path("copy").into()]);
    }
    let intrinsics = ["--intrinsics".into(), zero.clone().into()];
    cases.push([vec!["run".into(), place.path("images").into()], intrinsics.to_vec()].concat());
    cases.push(vec!["run".into(), place.path("images").into(), "--masks".into(), place.path("piped").into()]);
    for case in cases {
        let mut command = tractrix();
        command.args(&case).timeout(AT_ONCE);
        if case[0] == "run" {
            command.arg("--output").arg(place.path("out"));
        }
        let (code, _, stderr) = outcome(&mut command);
        assert!(code == 1 || code == 2, "{case:?}: {code}: {stderr}");
        let is_named = ["pipe.mp4", "zero.txt", "0001.png"].iter().any(|name| stderr.contains(name));
        assert!(is_named, "{case:?}: {stderr}");
    }
}

fn textured(k: u32) -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| image::Rgb([((x * 37) ^ (y * 91)) as u8, (x * y + k) as u8, 90]))
}

#[test]
fn what_is_no_picture_is_told_and_moves_no_other_frame() {
    let place = Place::new(1);
    let frames = place.path("frames");
    fs::create_dir(&frames).unwrap();
    for k in [0, 1, 3] {
        textured(k).save(frames.join(format!("{k}.png"))).unwrap();
    }
    symlink("nowhere.png", frames.join("2.png")).unwrap();
    pipe(&frames.join("4.png"));
    fs::create_dir(frames.join("5.png")).unwrap();
    fs::write(frames.join(OsString::from_vec(b"6\xff.png".to_vec())), "x").unwrap();
    for name in [" 7.png", "8\n.png"] {
        textured(7).save_with_format(frames.join(name), image::ImageFormat::Png).unwrap();
    }
    RgbImage::new(16, 16).save(frames.join("00.png")).unwrap();
    let mut command = tractrix();
    command.arg("sfm").arg(&frames).arg("--output").arg(place.path("out")).args(["--fps", "10"]).timeout(AT_ONCE);
    let (_, _, stderr) = outcome(&mut command);
    for (name, reason) in [
        ("2.png", "cannot be read"),
        ("4.png", "a pipe"),
        ("5.png", "a folder"),
        ("6\u{fffd}.png", "UTF-8"),
        (" 7.png", "space"),
        ("00.png", "16x16"),
    ] {
        let said = stderr.lines().any(|line| line.contains(name) && line.contains(reason));
        assert!(said, "{name}, {reason}: {stderr}");
    }
    assert!(stderr.contains("line break"), "{stderr}");
    let listed = json(&place.path("out/.tractrix/frames-list.json"));
    let frames: Vec<(u64, &str)> = listed
        .as_array()
        .unwrap()
        .iter()
        .map(|frame| (frame["id"].as_u64().unwrap(), frame["name"].as_str().unwrap()))
        .collect();
    // " 7.png" and "00.png" stand before them.
    assert_eq!(frames, [(1, "0.png"), (3, "1.png"), (5, "3.png")], "{listed}");
}

#[test]
fn pictures_that_memory_does_not_hold_are_refused_before_they_are_decoded() {
    let place = Place::new(1);
    let frames = place.path("frames");
    fs::create_dir(&frames).unwrap();
    for k in 0..2 {
        image::GrayImage::new(6000, 4000).save(frames.join(format!("{k}.png"))).unwrap();
    }
    let run = |more: &[&str]| {
        let mut command = tractrix();
        command.arg("sfm").arg(&frames).arg("--output").arg(place.path("out")).args(["--fps", "9"]).args(more);
        outcome(command.timeout(AT_ONCE))
    };
    let (code, _, stderr) = run(&["--memory-limit", "500MiB"]);
    assert_eq!(code, 1, "{stderr}");
    for expected in ["6000x4000", "--max-dimension", "500 MiB", "--memory-limit"] {
        assert!(stderr.contains(expected), "{expected}: {stderr}");
    }
    assert!(!place.path("out").exists(), "nothing was begun");
    assert_eq!(run(&["--memory-limit", "lots"]).0, 2);
    let (_, _, stderr) = run(&["--memory-limit", "500MiB", "--max-dimension", "320"]);
    assert!(!stderr.contains("memory-limit"), "{stderr}");
}

#[test]
fn a_byte_order_mark_is_no_content() {
    let place = Place::new(1);
    let marked = |name: &str, text: &[u8]| fs::write(place.path(name), [b"\xef\xbb\xbf", text].concat()).unwrap();
    marked("options.json", b"{\"seed\": 3}");
    let (code, text, stderr) =
        outcome(tractrix().args(["options", "--json", "--options"]).arg(place.path("options.json")));
    assert!(code == 0 && text.contains("\"seed\": 3"), "{stderr}");
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/models/colmap_text");
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        marked(name, &fs::read(golden.join(name)).unwrap());
    }
    let (read, expected) = (colmap::read(place.folder.path()).unwrap(), colmap::read(&golden).unwrap());
    assert!(read.cameras == expected.cameras && read.images == expected.images);
}

#[test]
fn coordinates_beyond_any_sense_are_refused_where_they_are_read() {
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("dataset/demo");
    let place = Place::new(1);
    let path = place.path("object_mesh.ply");
    let corner = |x: &str| {
        let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n";
        let faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
        fs::write(&path, format!("{head}{faces}0 0 0\n{x} 0 0\n0 1 0\n3 0 1 2\n")).unwrap();
        ply::read_mesh(&path)
    };
    assert!(corner("1e6").is_ok());
    assert!(corner("1e154").unwrap_err().to_string().contains("object_mesh.ply"));
    let mut scene = json(&demo.join("scene.json"));
    scene["frames"][2]["T_world_camera"][1][3] = 1e200.into();
    fs::write(place.path("scene.json"), scene.to_string()).unwrap();
    assert!(Sequence::open(place.folder.path()).unwrap_err().to_string().contains("frame 2"));
    let pose = serde_json::json!({"scale": 1.0, "rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 1e160]});
    let frame = serde_json::json!({"frame": 0, "name": "a", "time_s": 0.0, "position": [0, 0, 0],
                                   "world_from_object": pose, "speed": null});
    let scale = serde_json::json!({"ratio": 1.0, "std": null, "method": "joint", "degenerate": false, "reason": null,
                                   "alternatives": {}});
    let object = serde_json::json!({"id": 1, "class": "car", "confidence": 1.0, "scale": scale, "frames": [frame]});
    let mut document = serde_json::json!({"version": 1, "unit": "background", "objects": [object]});
    let read = |document: &serde_json::Value| {
        fs::write(place.path("trajectories.json"), document.to_string()).unwrap();
        trajectories::read(&place.path("trajectories.json")).map(drop).map_err(|error| error.to_string())
    };
    assert!(read(&document).unwrap_err().contains("out of range"), "{:?}", read(&document));
    document["objects"][0]["frames"][0]["world_from_object"]["translation"][2] = 1e5.into();
    assert_eq!(read(&document), Ok(()));
    document["objects"][0]["scale"]["ratio"] = 1e308.into();
    assert!(read(&document).unwrap_err().contains("scale ratio"));
}

/// A link in the place of everything that a run leaves, as somebody else's hand, or an archive, may put there.
#[test]
fn no_link_in_the_folder_leads_the_program_out_of_it() {
    let place = Place::new(NUM_FRAMES);
    finished(&place, "out");
    let (out, elsewhere) = (place.path("out"), place.path("elsewhere"));
    let files = everything(&out);
    let folders = files.keys().filter_map(|file| file.parent()).filter(|folder| *folder != Path::new(""));
    let mut all: Vec<PathBuf> = files.keys().cloned().chain(folders.map(Path::to_owned)).collect();
    all.sort();
    all.dedup();
    assert!(all.len() > 40, "{}", all.len());
    // One mask is like the other.
    for target in all.iter().filter(|path| !path.starts_with("tracks/1/") || path.ends_with("0003.png.png")) {
        let (path, kept) = (out.join(target), place.path("kept"));
        fs::rename(&path, &kept).unwrap();
        fs::create_dir(&elsewhere).unwrap();
        match kept.is_dir() {
            true => fs::write(elsewhere.join("precious.txt"), "precious").unwrap(),
            false => fs::copy(&kept, elsewhere.join("precious")).map(drop).unwrap(),
        }
        let aim = if kept.is_dir() { elsewhere.clone() } else { elsewhere.join("precious") };
        symlink(aim, &path).unwrap();
        let before = everything(&elsewhere);
        let (code, _, stderr) = outcome(tractrix().args(arguments(&place, "out")).args(["--every", "2"]));
        assert!(before == everything(&elsewhere), "{}: what it leads to was changed", target.display());
        assert!(code == 2 && stderr.contains("link"), "{}: {code}: {stderr}", target.display());
        fs::remove_file(&path).unwrap();
        fs::rename(&kept, &path).unwrap();
        fs::remove_dir_all(&elsewhere).unwrap();
    }
}

/// Paths of all numbers of a tree of options, as JSON pointers.
fn numbers(tree: &serde_json::Value, path: &str) -> Vec<String> {
    match tree {
        serde_json::Value::Number(_) => vec![path.to_owned()],
        serde_json::Value::Object(map) => {
            map.iter().flat_map(|(key, value)| numbers(value, &format!("{path}/{key}"))).collect()
        }
        serde_json::Value::Array(list) => {
            list.iter().enumerate().flat_map(|(k, value)| numbers(value, &format!("{path}/{k}"))).collect()
        }
        _ => Vec::new(),
    }
}

#[test]
fn no_number_of_the_options_is_without_a_range() {
    let place = Place::new(1);
    let file = place.path("options.json");
    let (code, text, stderr) = outcome(tractrix().args(["options", "--json"]));
    assert_eq!(code, 0, "{stderr}");
    let tree: serde_json::Value = serde_json::from_str(&text).unwrap();
    let all = numbers(&tree, "");
    assert!(all.len() > 100, "{all:?}");
    // Any number will do to draw others from.
    for path in all.iter().filter(|path| path.as_str() != "/seed") {
        let is_whole = tree.pointer(path).unwrap().is_u64();
        let extremes = if is_whole { [u64::MAX.into(), (-1).into()] } else { [1e308.into(), (-1e308).into()] };
        for value in extremes {
            let value: serde_json::Value = value;
            let mut changed = tree.clone();
            *changed.pointer_mut(path).unwrap() = value.clone();
            fs::write(&file, changed.to_string()).unwrap();
            let (code, _, stderr) = outcome(tractrix().args(["options", "--json", "--options"]).arg(&file));
            let key = path.split('/').rfind(|key| key.parse::<usize>().is_err()).unwrap();
            assert!(matches!(code, 1 | 2) && stderr.contains(key), "{path} = {value}: {code}: {stderr}");
        }
    }
}

/// As an archive of somebody else's folder may hold them.
#[test]
fn own_files_that_are_damaged_are_named_with_a_cure_and_lead_nowhere() {
    let place = Place::new(NUM_FRAMES);
    finished(&place, "out");
    let (state, whole) = (place.path("out/.tractrix"), result(&place.path("out")));
    let refused = |more: &[&str], word: &str| {
        let (code, _, stderr) = outcome(tractrix().args(arguments(&place, "out")).args(more));
        assert!(code == 1 && stderr.contains(word) && !stderr.contains("panicked"), "{code}: {stderr}");
        let named = stderr.split("; delete ").nth(1).and_then(|rest| rest.split(", and the stage").next());
        PathBuf::from(named.expect("it says what to delete"))
    };

    let list = state.join("frames-list.json");
    let mut frames = json(&list);
    frames[3]["name"] = "../../../../escaped.png".into();
    fs::write(&list, frames.to_string()).unwrap();
    fs::remove_file(state.join("track.json")).unwrap();
    let named = refused(&[], "not a frame name");
    assert!(!everything(place.folder.path()).keys().any(|path| path.ends_with("escaped.png.png")));
    assert_eq!(named, list);
    fs::remove_file(named).unwrap();
    finished(&place, "out");

    let is_features = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with("features-");
    let mut features = fs::read_dir(&state).unwrap().map(|entry| entry.unwrap().path()).filter(is_features);
    let folder = features.find(|path| path.is_dir()).unwrap();
    let file = folder.join("background.bin");
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&file, bytes).unwrap();
    let other = ["--set", "background.mapper.max_error_px=2.5"];
    assert_eq!(refused(&other, "checksum mismatch"), folder);
    fs::remove_file(&file).unwrap();
    assert_eq!(refused(&other, "missing"), folder);
    fs::remove_dir_all(&folder).unwrap();
    finished(&place, "out");
    assert!(result(&place.path("out")) == whole, "some files differ");
}
