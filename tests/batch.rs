//! Many videos: one job of a list after the other, side by side, and what has become of them.

mod common;

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use assert_cmd::Command;
use common::{Place, drive, json, outcome, tractrix};
use serde_json::Value;

const NUM_FRAMES: u32 = 12;

/// A drive, and a list of it: three good jobs, and one without a picture.
fn place() -> (Place, PathBuf) {
    let place = Place::new(NUM_FRAMES);
    fs::create_dir(place.path("nothing")).unwrap();
    let list = place.path("list.txt");
    let lines = ["# jobs", "images\t--name one", "nothing", "", "images\t--name 'the other' --seed 5 --masks masks"];
    fs::write(&list, lines.join("\n")).unwrap();
    (place, list)
}

/// `tractrix batch` on the list of a place, into `out` there.
fn batch(place: &Place, more: &[&str]) -> Command {
    let mut command = tractrix();
    command.arg("batch").arg(place.path("list.txt")).arg("--output").arg(place.path("out"));
    command.arg("--masks").arg(place.path("masks")).args(["--intrinsics", &drive::intrinsics()]);
    command.args(["--fps", "12"]).args(more);
    command
}

fn status(place: &Place) -> (i32, Value) {
    let (code, stdout, _) = outcome(&mut batch(place, &["--status", "--json"]));
    (code, serde_json::from_str(&stdout).unwrap())
}

fn states(status: &Value) -> Vec<&str> {
    status["jobs"].as_array().unwrap().iter().map(|job| job["state"].as_str().unwrap()).collect()
}

#[test]
fn jobs_of_a_list_are_done_one_by_one_and_the_rest_is_listed() {
    let (place, _) = place();
    let (code, before) = status(&place);
    assert_eq!((code, states(&before)), (1, vec!["missing"; 3]));

    let (code, _, stderr) = outcome(&mut batch(&place, &["--index", "0"]));
    assert_eq!(code, 0, "{stderr}");
    let result = place.path("out/one/trajectories.json");
    let written = fs::metadata(&result).unwrap().modified().unwrap();
    let (code, _, stderr) = outcome(&mut batch(&place, &["--index", "1"]));
    assert_eq!(code, 1, "{stderr}");

    let started = Instant::now();
    let (code, stdout, stderr) = outcome(&mut batch(&place, &["--index", "0", "--json"]));
    assert_eq!(
        (code, serde_json::from_str::<Value>(&stdout).unwrap()["done_before"].clone()),
        (0, true.into()),
        "{stderr}"
    );
    assert!(started.elapsed() < Duration::from_secs(5), "a job that is done is not looked into");
    assert_eq!(fs::metadata(&result).unwrap().modified().unwrap(), written);

    let (code, after) = status(&place);
    assert_eq!((code, states(&after)), (1, vec!["done", "failed", "missing"]));
    let reason = after["jobs"][1]["reason"].as_str().unwrap();
    assert!(reason.contains("nothing"), "{reason}");
    assert_eq!(after["counts"]["done"], 1);
    let (code, _, stderr) = outcome(&mut batch(&place, &["--index", "3"]));
    assert_eq!(code, 2, "{stderr}");
}

#[test]
fn jobs_side_by_side_do_not_stop_one_another_and_the_same_command_again_does_what_is_left() {
    let (place, _) = place();
    let (code, stdout, stderr) = outcome(&mut batch(&place, &["--jobs", "2", "--threads", "2"]));
    assert_eq!((code, stdout.trim()), (1, "2 done, 1 failed"), "{stderr}");
    assert!(stderr.contains("nothing failed") && stderr.contains("[3/3]"), "{stderr}");
    assert_eq!(json(&place.path("out/the other/run.json"))["options"]["seed"], 5);

    for entry in fs::read_dir(place.path("images")).unwrap().flatten().take(2) {
        fs::copy(entry.path(), place.path("nothing").join(entry.file_name())).unwrap();
    }
    let (_, now) = status(&place);
    assert_eq!(states(&now), ["done", "to-go-on", "done"], "a repaired input counts as another one");
    let (_, _, stderr) = outcome(&mut batch(&place, &["--jobs", "2"]));
    assert_eq!(stderr.matches("done before").count(), 2, "{stderr}");
}

#[test]
fn other_options_and_another_input_are_seen() {
    let (place, list) = place();
    fs::write(&list, "images").unwrap();
    let done = |more: &[&str]| outcome(&mut batch(&place, &[&["--status", "--json"], more].concat()));
    let (code, _, stderr) = outcome(&mut batch(&place, &["--index", "0"]));
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(done(&[]).0, 0);
    assert_eq!(done(&["--threads", "1"]).0, 0, "the number of threads changes no result");
    assert!(done(&["--seed", "7"]).1.contains("\"outdated\""));
    fs::rename(place.path("images"), place.path("away")).unwrap();
    assert_eq!(done(&[]).0, 0, "who has the results may have given the input away");
}

#[test]
fn a_list_that_cannot_be_meant_is_refused_before_any_work() {
    let (place, list) = place();
    for (text, said) in [
        ("images\nimages", "line 2"),
        ("images\t--no-such-flag", "line 1"),
        ("images\t--end x", "line 1"),
        ("# none", "no video"),
    ] {
        fs::write(&list, text).unwrap();
        for which in [["--index", "0"], ["--jobs", "1"]] {
            let (code, _, stderr) = outcome(&mut batch(&place, &which));
            assert!(code == 2 && stderr.contains(said), "{text:?}: {code} {stderr}");
        }
    }
    assert!(!place.path("out").exists());
}
