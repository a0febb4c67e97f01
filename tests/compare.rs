//! `tractrix compare`: what is printed, what is written, and how it ends.

mod common;

use std::fs;
use std::path::{Path, PathBuf};

use common::{outcome, tractrix};
use serde_json::Value;

fn golden(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/models").join(name).display().to_string()
}

fn compare(arguments: &[&str]) -> (i32, String, String) {
    outcome(tractrix().arg("compare").args(arguments))
}

/// A copy of the golden COLMAP text model whose images have other names.
fn renamed(folder: &Path, rename: impl Fn(&str) -> String) -> PathBuf {
    let copy = folder.join("renamed");
    fs::create_dir(&copy).unwrap();
    for name in ["cameras.txt", "points3D.txt"] {
        fs::copy(Path::new(&golden("colmap_text")).join(name), copy.join(name)).unwrap();
    }
    let images = fs::read_to_string(Path::new(&golden("colmap_text")).join("images.txt")).unwrap();
    let is_pose = |line: &str| line.split(' ').count() == 10 && !line.starts_with('#');
    let line = |line: &str| match line.rsplit_once(' ') {
        Some((pose, name)) if is_pose(line) => format!("{pose} {}\n", rename(name)),
        _ => format!("{line}\n"),
    };
    fs::write(copy.join("images.txt"), images.lines().map(line).collect::<String>()).unwrap();
    copy
}

#[test]
fn a_model_does_not_differ_from_itself_in_another_format() {
    let (text, binary) = (golden("colmap_text"), golden("colmap_binary"));
    let (code, stdout, stderr) = compare(&[&text, &binary, "--json"]);
    assert_eq!(code, 0, "{stderr}");
    let found: Value = serde_json::from_str(&stdout).unwrap();
    let other = &found["others"][0];
    assert!(other["cameras"]["center_rmse"].as_f64().unwrap() < 1e-6, "{other}");
    assert_eq!(found["reference"]["figures"], other["subject"]["figures"]);
    let (code, stdout, _) = compare(&[&text, &binary]);
    assert!(code == 0 && stdout.contains("registered in both") && stdout.contains("px per point"), "{stdout}");
}

#[test]
fn several_are_held_against_a_truth_in_one_table() {
    let (text, binary, openmvg) = (golden("colmap_text"), golden("colmap_binary"), golden("openmvg/sfm_data.json"));
    let labels = ["--label", "theirs", "--label", "others"];
    let (code, stdout, stderr) =
        compare(&[&[binary.as_str(), &openmvg, "--truth", &text, "--json"][..], &labels].concat());
    assert_eq!(code, 0, "{stderr}");
    let found: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(found["reference"]["name"], "truth");
    let names: Vec<_> = found["others"].as_array().unwrap().iter().map(|o| o["subject"]["name"].clone()).collect();
    assert_eq!(names, ["theirs", "others"]);
}

#[test]
fn what_has_other_names_fails_and_says_what_helps() {
    let folder = tempfile::tempdir().unwrap();
    let other = renamed(folder.path(), |name| format!("left/{name}")).display().to_string();
    let (code, stdout, stderr) = compare(&[&golden("colmap_text"), &other]);
    assert_eq!(code, 1, "{stdout}");
    assert!(stderr.contains("--match-by stem") && stderr.contains("left/"), "{stderr}");
    let (code, stdout, _) = compare(&[&golden("colmap_text"), &other, "--json"]);
    let said: Value = serde_json::from_str(&stdout).unwrap();
    assert!(code == 1 && said["error"]["message"].as_str().unwrap().contains("--match-by"), "{stdout}");
    for by in ["stem", "order"] {
        let (code, _, stderr) = compare(&[&golden("colmap_text"), &other, "--match-by", by]);
        assert_eq!(code, 0, "{by}: {stderr}");
    }
}

#[test]
fn the_page_is_written_and_not_replaced_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("compare.html");
    let (text, binary, shown) = (golden("colmap_text"), golden("colmap_binary"), page.display().to_string());
    let arguments = [text.as_str(), &binary, "--page", &shown];
    let (code, _, stderr) = compare(&arguments);
    assert_eq!(code, 0, "{stderr}");
    assert!(fs::read_to_string(&page).unwrap().contains("All in one view"));
    let (code, _, stderr) = compare(&arguments);
    assert!(code == 2 && stderr.contains("--overwrite"), "{stderr}");
    let (code, _, stderr) = compare(&[&arguments[..], &["--overwrite"]].concat());
    assert_eq!(code, 0, "{stderr}");
}

#[test]
fn one_model_alone_is_nothing_to_compare() {
    let (code, _, stderr) = compare(&[&golden("colmap_text")]);
    assert!(code == 2 && stderr.contains("--truth"), "{stderr}");
}
