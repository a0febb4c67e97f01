//! Nothing of the user's is lost: every command that writes is held against a snapshot of every byte, before and after.

mod common;

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use common::{Place, drive, outcome, tractrix};

const NUM_FRAMES: u32 = 12;
/// The commands that do a run or a part of it.
const RUNS: [&str; 6] = ["run", "segment", "track", "sfm", "ground", "scale"];
/// What a user may have lying about, in the very folders in which results stand.
const THEIRS: [&str; 5] =
    ["objects/my_models/car.obj", "tracks/gps/t.gpx", "ply/scan.ply", "background/notes.txt", "notes/thesis.tex"];

impl Place {
    fn run(&self, command: &str, images: &str, output: &str, more: &[&OsStr]) -> (i32, String) {
        let mut started = tractrix();
        started.arg(command).arg(self.path(images)).arg("--output").arg(self.path(output));
        if !more.contains(&OsStr::new("--masks")) {
            started.arg("--masks").arg(self.path("masks"));
        }
        let known = drive::intrinsics();
        let (code, _, stderr) = outcome(started.args(["--intrinsics", &known, "--fps", "12"]).args(more));
        (code, stderr)
    }

    #[track_caller]
    fn succeeds(&self, images: &str, output: &str, more: &[&str]) -> String {
        let more: Vec<&OsStr> = more.iter().map(OsStr::new).collect();
        let (code, stderr) = self.run("run", images, output, &more);
        assert_eq!(code, 0, "{stderr}");
        stderr
    }

    /// Runs a command that must be refused, with every byte of the place as it was.
    #[track_caller]
    fn refused(&self, command: &str, images: &str, output: &str, more: &[&OsStr]) -> String {
        let before = snapshot(self.folder.path());
        let (code, stderr) = self.run(command, images, output, more);
        assert_eq!(code, 2, "{command} {more:?}: {stderr}");
        assert_same(&before, &snapshot(self.folder.path()), &format!("{command} {more:?}"));
        stderr
    }
}

fn plant(root: &Path, names: &[&str]) {
    for name in names {
        fs::create_dir_all(root.join(name).parent().unwrap()).unwrap();
        fs::write(root.join(name), format!("precious: {name}")).unwrap();
    }
}

/// Every file with its bytes and every link with its target, links not followed.
fn snapshot(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![root.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let (path, kind) = entry.map(|entry| (entry.path(), entry.file_type().unwrap())).unwrap();
            if kind.is_dir() {
                open.push(path);
            } else if kind.is_symlink() {
                found.insert(path.clone(), fs::read_link(&path).unwrap().into_os_string().into_encoded_bytes());
            } else {
                found.insert(path.clone(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[track_caller]
fn assert_same(before: &BTreeMap<PathBuf, Vec<u8>>, after: &BTreeMap<PathBuf, Vec<u8>>, what: &str) {
    assert_eq!(before.keys().collect::<Vec<_>>(), after.keys().collect::<Vec<_>>(), "{what}");
    let changed: Vec<_> = before.iter().filter(|(path, bytes)| after[*path] != **bytes).map(|(path, _)| path).collect();
    assert!(changed.is_empty(), "{what}: {changed:?} changed");
}

#[test]
fn a_folder_of_others_is_left_as_it_is_by_every_command() {
    let place = Place::new(NUM_FRAMES);
    plant(&place.path("theirs"), &THEIRS);
    plant(&place.path("theirs"), &["report.html", "evaluation.json", "benchmark.json", "cameras.txt"]);
    for command in RUNS {
        let said = place.refused(command, "images", "theirs", &[]);
        assert!(
            said.contains("not empty") && said.contains("--output") && said.contains("nothing was changed"),
            "{said}"
        );
    }
    plant(&place.path("set/one"), &["scene.json"]);
    let before = snapshot(place.folder.path());
    let theirs = place.path("theirs");
    let (code, _, said) = outcome(tractrix().arg("benchmark").arg(place.path("set")).arg("--output").arg(&theirs));
    assert!(code == 2 && said.contains("not empty"), "{code}: {said}");
    let (code, _, said) = outcome(tractrix().arg("evaluate").arg(&theirs).arg("--truth").arg("dataset/demo"));
    assert!(code == 0 && said.contains("not made by tractrix"), "{code}: {said}");
    assert_same(&before, &snapshot(place.folder.path()), "benchmark, evaluate");
}

#[test]
fn files_of_others_beside_the_results_stay_and_the_run_goes_on() {
    let place = Place::new(NUM_FRAMES);
    place.succeeds("images", "out", &[]);
    plant(&place.path("out"), &THEIRS);
    let theirs = |place: &Place| -> Vec<Vec<u8>> {
        THEIRS.iter().map(|name| fs::read(place.path("out").join(name)).unwrap()).collect()
    };
    let before = theirs(&place);
    let said = place.succeeds("images", "out", &["--scale-method", "intersection"]);
    assert!(said.contains("options changed: re-running scale, metric, report"), "{said}");
    let said = place.succeeds("images", "out", &["--every", "2"]);
    let anew = said.lines().filter(|line| line.contains("re-running frames, segment, features"));
    assert!(anew.count() == 1, "{said}");
    assert_eq!(before, theirs(&place));
    let ours: Vec<PathBuf> = snapshot(&place.path("out/tracks/1")).into_keys().collect();
    assert_eq!(ours.len() as u32, NUM_FRAMES / 2, "masks of frames that are left out go: {ours:?}");
    // Somebody else's file in the very place of a result is not written over.
    plant(&place.path("out"), &["background/cameras.bin"]);
    let said = place.refused("run", "images", "out", &[]);
    assert!(said.contains("background/cameras.bin"), "{said}");
}

#[test]
fn inputs_that_lie_among_the_results_are_refused_by_every_command() {
    let place = Place::new(NUM_FRAMES);
    place.succeeds("images", "out", &[]);
    let out = place.path("out");
    let linked = place.path("linked");
    symlink(&out, &linked).unwrap();
    fs::create_dir(place.path("mixed")).unwrap();
    symlink(out.join("tracks/1/0000.png.png"), place.path("mixed/0000.png")).unwrap();
    let object = |folder: PathBuf| format!("1={}", folder.display());
    let cases: [(&str, PathBuf); 8] = [
        ("--masks", out.join("tracks")),
        ("--masks", place.path("mixed")),
        ("--ground-masks", out.join("tracks/1")),
        ("--background-model", out.join("background")),
        ("--background-model", linked.join("objects/../background")),
        ("--object-model", object(out.join("objects/1")).into()),
        ("--object-model", object(linked.join("as-reconstructed/1")).into()),
        ("--intrinsics", out.join("background/cameras.txt")),
    ];
    for (flag, input) in cases {
        // The last of a repeated flag would be refused by the command line itself.
        let mut started = tractrix();
        started.arg("run").arg(place.path("images")).arg("--output").arg(&out).arg(flag).arg(&input);
        if flag != "--masks" {
            started.arg("--masks").arg(place.path("masks"));
        }
        let before = snapshot(place.folder.path());
        let (code, _, said) = outcome(&mut started);
        assert!(
            code == 2 && said.contains(flag) && said.contains("inside the output folder"),
            "{flag}: {code}: {said}"
        );
        assert_same(&before, &snapshot(place.folder.path()), flag);
    }
    let options = out.join(".tractrix/options.json");
    fs::write(&options, "{}").unwrap();
    for command in RUNS {
        let said = place.refused(command, "images", "out", &["--options".as_ref(), options.as_os_str()]);
        assert!(said.contains("--options") && said.contains("inside the output folder"), "{said}");
        let said = place.refused(command, "out/tracks/1", "out", &[]);
        assert!(said.contains("inside the output folder"), "{said}");
    }
}

#[test]
fn planted_links_are_never_followed() {
    let place = Place::new(NUM_FRAMES);
    place.succeeds("images", "whole", &[]);
    plant(&place.path("elsewhere"), &["profile", "objects/1/cameras.txt"]);
    for (link, to) in [
        ("objects", "elsewhere/objects"),
        ("tracks/1", "elsewhere"),
        ("report.html", "elsewhere/profile"),
        ("run.json", "elsewhere/profile"),
        (".tractrix/lock", "elsewhere/profile"),
        (".tractrix/scale.json", "elsewhere/profile"),
        (".tractrix", "elsewhere"),
    ] {
        place.succeeds("images", "out", &[]);
        let path = place.path("out").join(link);
        if path.is_dir() {
            fs::remove_dir_all(&path).unwrap()
        } else {
            fs::remove_file(&path).unwrap()
        }
        symlink(place.path(to), &path).unwrap();
        for more in [[].as_slice(), &[OsStr::new("--overwrite"), OsStr::new("--every"), OsStr::new("2")]] {
            let said = place.refused("run", "images", "out", more);
            assert!(said.contains(link) && said.contains("link"), "{link}: {said}");
        }
        fs::remove_dir_all(place.path("out")).unwrap();
    }
}

#[test]
fn results_of_another_input_are_given_up_only_when_that_is_asked_for() {
    let place = Place::new(NUM_FRAMES);
    place.succeeds("images", "out", &["--every", "2"]);
    fs::create_dir(place.path("others")).unwrap();
    for entry in fs::read_dir(place.path("images")).unwrap().flatten().take(NUM_FRAMES as usize - 1) {
        fs::copy(entry.path(), place.path("others").join(entry.file_name())).unwrap();
    }
    for command in RUNS {
        let said = place.refused(command, "others", "out", &[]);
        assert!(said.contains("another input") && said.contains("--overwrite"), "{said}");
    }
    // The same pictures elsewhere are the same input.
    fs::rename(place.path("images"), place.path("moved")).unwrap();
    place.succeeds("moved", "out", &["--every", "2"]);
    plant(&place.path("out"), &THEIRS);
    place.succeeds("others", "out", &["--every", "2", "--overwrite"]);
    for name in THEIRS {
        assert!(place.path("out").join(name).is_file(), "{name}");
    }
}

#[test]
fn a_conversion_writes_over_nothing() {
    let place = Place::new(NUM_FRAMES);
    place.succeeds("images", "out", &[]);
    let convert = |input: &Path, output: &Path, more: &[&str]| {
        let (code, _, said) = outcome(tractrix().arg("convert").arg(input).arg(output).args(more));
        (code, said)
    };
    let (model, copy, points) = (place.path("out/background"), place.path("copy"), place.path("points.ply"));
    assert_eq!(convert(&model, &copy, &["--to", "colmap-text"]).0, 0);
    plant(&copy, &["notes.txt"]);
    plant(place.folder.path(), &["points.ply", "linked/notes.txt"]);
    symlink(place.path("points.ply"), place.path("linked/cameras.txt")).unwrap();
    let before = snapshot(place.folder.path());
    for (output, more) in [
        (&copy, ["--to", "colmap-text"].as_slice()),
        (&points, &[]),
        (&place.path("linked"), &["--to", "colmap-text", "--overwrite"]),
        (&model, &["--to", "colmap-text", "--overwrite"]),
    ] {
        let (code, said) = convert(&model, output, more);
        assert_eq!(code, 2, "{}: {said}", output.display());
        assert_same(&before, &snapshot(place.folder.path()), &output.display().to_string());
    }
    assert_eq!(convert(&model, &copy, &["--to", "colmap-text", "--overwrite"]).0, 0);
    assert_same(&before, &snapshot(place.folder.path()), "the same model once more");
}

#[test]
fn a_folder_of_other_hands_opens_no_file_that_it_names() {
    let place = Place::new(NUM_FRAMES);
    place.succeeds("images", "out", &[]);
    let export = |more: &[&OsStr]| {
        let mut command = tractrix();
        command.arg("export").arg(place.path("out")).args(["--format", "colmap"]).args(more);
        outcome(&mut command)
    };
    assert_eq!(export(&[]).0, 0);
    fs::rename(place.path("images"), place.path("moved")).unwrap();
    fs::create_dir(place.path("images")).unwrap();
    let private = image::RgbImage::from_pixel(drive::WIDTH, drive::HEIGHT, image::Rgb([1, 2, 3]));
    for entry in fs::read_dir(place.path("moved")).unwrap().flatten() {
        private.save(place.path("images").join(entry.file_name())).unwrap();
    }
    fs::remove_dir_all(place.path("out/export")).unwrap();
    let (code, _, stderr) = export(&[]);
    assert!(code == 1 && stderr.contains("not the input of the results") && stderr.contains("--input"), "{stderr}");
    assert!(!place.path("out/export/colmap").exists());
    let moved = place.path("moved");
    assert_eq!(export(&[OsStr::new("--input"), moved.as_os_str()]).0, 0);
}

#[test]
fn intermediate_files_of_other_ways_to_find_vehicles_do_not_stay() {
    let place = Place::new(NUM_FRAMES);
    let none = ["--detector", "none", "--motion", "off", "--intrinsics", &drive::intrinsics(), "--fps", "12"];
    let mut command = tractrix();
    command.arg("run").arg(place.path("images")).arg("--output").arg(place.path("out")).args(none);
    let (code, _, stderr) = outcome(&mut command);
    assert_eq!(code, 0, "{stderr}");
    let folders = || -> Vec<String> {
        let entries = fs::read_dir(place.path("out/.tractrix")).unwrap().flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        names.filter(|name| name.starts_with("segment-")).collect()
    };
    let of_boxes = folders();
    assert_eq!(of_boxes.len(), 1, "{of_boxes:?}");
    place.succeeds("images", "out", &[]);
    assert!(!folders().contains(&of_boxes[0]));
}

#[test]
fn a_stderr_that_takes_nothing_stops_no_run() {
    let place = Place::new(NUM_FRAMES);
    // A warning: a frame without its mask.
    fs::remove_file(place.path("masks/0003.png")).unwrap();
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let (reader, broken) = std::io::pipe().unwrap();
    drop(reader);
    for (k, stderr) in [std::process::Stdio::from(full), broken.into()].into_iter().enumerate() {
        let mut command = std::process::Command::new(tractrix().get_program());
        command.arg("run").arg(place.path("images")).arg("--output").arg(place.path(&format!("out{k}")));
        command.arg("--masks").arg(place.path("masks")).args(["--intrinsics", &drive::intrinsics(), "--fps", "12"]);
        assert_eq!(command.stdout(std::process::Stdio::null()).stderr(stderr).status().unwrap().code(), Some(0), "{k}");
    }
}

#[test]
fn no_name_steers_the_terminal() {
    let place = Place::new(1);
    let hostile = "\u{1b}]0;title\u{7}\u{1b}[2J\u{9b}2J.mp4";
    fs::write(place.path(hostile), "no video").unwrap();
    for more in [&["--progress", "json"][..], &["--json"], &["--set", "\u{1b}[2J=1"], &["--\u{1b}[2J"]] {
        let mut command = tractrix();
        command.arg("run").arg(place.path(hostile)).arg("--output").arg(place.path("out")).args(more);
        let (code, stdout, stderr) = outcome(&mut command);
        assert!(code == 1 || code == 2, "{stderr}");
        let steers = |letter: char| letter.is_control() && letter != '\n' && letter != '\t';
        assert!(!stdout.contains(steers) && !stderr.contains(steers), "{more:?}: {stdout:?} {stderr:?}");
        // clap leaves sequences out of what it quotes.
        assert!(stderr.contains("u001b") || stderr.contains("unexpected argument"), "{stderr}");
    }
}
