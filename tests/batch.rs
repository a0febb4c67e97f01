//! Many videos: one job of a list after the other, side by side, and what has become of them.

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{self, Child, Stdio};
use std::thread;
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

/// Starts `tractrix batch` and goes on.
fn start(place: &Place, more: &[&str]) -> Child {
    let command = batch(place, more);
    let mut started = process::Command::new(command.get_program());
    started.args(command.get_args()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Waits until something is so, half a minute at most.
#[track_caller]
fn wait_for(what: &str, is_so: impl Fn() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(started.elapsed() < Duration::from_secs(30), "{what}");
        thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_list_that_changes_while_its_jobs_are_done_changes_no_job() {
    let (place, list) = place();
    fs::write(&list, "images\t--name one\nimages\t--name two\n").unwrap();
    let mut running = start(&place, &["--jobs", "1"]);
    wait_for("the first job begins", || place.path("out/one/.tractrix").is_dir());
    fs::write(&list, "images\t--name zero\nimages\t--name one\nimages\t--name two\n").unwrap();
    assert_eq!(running.wait().unwrap().code(), Some(0));
    assert!(place.path("out/two/report.html").is_file() && !place.path("out/zero").exists());
    let (_, stdout, stderr) = outcome(&mut batch(&place, &["--index", "2"]));
    assert!(stderr.contains("two: index 2 in the list, 1 in its last run"), "{stdout} {stderr}");
    assert_eq!(states(&status(&place).1), ["missing", "done", "done"]);
}

#[test]
fn a_job_without_a_vehicle_is_done_and_stays_done() {
    let (place, list) = place();
    fs::write(&list, "images").unwrap();
    for entry in fs::read_dir(place.path("masks")).unwrap().flatten() {
        image::GrayImage::new(drive::WIDTH, drive::HEIGHT).save(entry.path()).unwrap();
    }
    let (code, _, stderr) = outcome(&mut batch(&place, &["--jobs", "1"]));
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(status(&place).0, 0);
    let (code, _, stderr) = outcome(&mut batch(&place, &["--jobs", "1"]));
    assert!(code == 0 && stderr.contains("done before"), "{stderr}");
}

#[test]
fn without_options_the_status_compares_none_and_with_them_it_names_the_other_one() {
    let (place, list) = place();
    fs::write(&list, "images").unwrap();
    assert_eq!(outcome(&mut batch(&place, &["--jobs", "1", "--seed", "3"])).0, 0);
    let status = |more: &[&str]| {
        let mut command = tractrix();
        command.arg("batch").arg(&list).arg("--output").arg(place.path("out")).args(["--status"]).args(more);
        let (code, stdout, _) = outcome(&mut command);
        (code, stdout)
    };
    assert_eq!(status(&[]).0, 0, "{}", status(&[]).1);
    assert_eq!(status(&["--seed", "3", "--threads", "1"]).0, 0);
    let (code, stdout) = status(&["--seed", "4", "--end", "6f"]);
    assert!(code == 1 && stdout.contains("seed is 3 in the results, now 4"), "{stdout}");
    assert!(stdout.contains("video.end is null in the results, now \"6f\""), "{stdout}");
    fs::write(&list, "images\t--seed 5").unwrap();
    assert!(status(&[]).1.contains("seed is 3 in the results, now 5"));
}

#[test]
fn of_two_batches_of_one_list_one_finds_all_done() {
    let (place, list) = place();
    fs::write(&list, "images\t--name one\nimages\t--name two\nimages\t--name three").unwrap();
    let mut both = [start(&place, &["--jobs", "1"]), start(&place, &["--jobs", "1"])];
    let codes = both.each_mut().map(|batch| batch.wait().unwrap().code());
    assert!(codes.contains(&Some(0)), "{codes:?}");
    assert_eq!(status(&place).0, 0);
}

#[test]
fn jobs_end_when_their_batch_is_killed() {
    let (place, list) = place();
    fs::write(&list, "images\t--name one").unwrap();
    let mut running = start(&place, &["--jobs", "1"]);
    wait_for("the job begins", || place.path("out/one/.tractrix").is_dir());
    running.kill().unwrap();
    running.wait().unwrap();
    wait_for("the job ends", || !is_run_anywhere(&place.path("out")));
    assert!(!place.path("out/one/report.html").exists(), "the job went on alone");
    assert_eq!(outcome(&mut batch(&place, &["--jobs", "1"])).0, 0);
}

/// Whether a process has a path among its arguments.
fn is_run_anywhere(path: &Path) -> bool {
    let name = path.to_str().unwrap();
    let arguments = |process: fs::DirEntry| fs::read(process.path().join("cmdline")).unwrap_or_default();
    fs::read_dir("/proc").unwrap().flatten().any(|process| String::from_utf8_lossy(&arguments(process)).contains(name))
}

#[test]
fn the_status_of_a_long_list_takes_a_moment() {
    let (place, list) = place();
    let lines: String = (0..100_000).map(|k| format!("videos/{k}.mp4\n")).collect();
    fs::write(&list, lines).unwrap();
    let started = Instant::now();
    let mut command = tractrix();
    let (code, stdout, _) =
        outcome(command.arg("batch").arg(&list).arg("--status").arg("--output").arg(place.path("out")));
    assert!(code == 1 && stdout.ends_with("100000 missing\n"), "{code}");
    // A second on a machine that does nothing else; 8 where every line is parsed as a command line.
    assert!(started.elapsed() < Duration::from_secs(4), "{:?}", started.elapsed());
}
