//! The program as a user meets it: what it says and how it ends, above all on input that is wrong.

mod common;

use std::fs;
use std::path::{Path, PathBuf};

use common::{drive, json, outcome, tractrix};
use opencv::core::{CV_8UC3, Mat, Scalar, Size};
use opencv::videoio::{VideoWriter, VideoWriterTrait};
use tempfile::TempDir;

/// A clip of `num_frames` plain frames of 64 × 48 pixels.
fn clip(folder: &Path, num_frames: u32) -> PathBuf {
    let path = folder.join("clip.avi");
    let fourcc = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
    let mut writer = VideoWriter::new(&path, fourcc, 10.0, Size::new(64, 48), true).unwrap();
    for k in 0..num_frames {
        let colour = Scalar::new(40.0, 90.0, f64::from(k), 0.0);
        writer.write(&Mat::new_rows_cols_with_default(48, 64, CV_8UC3, colour).unwrap()).unwrap();
    }
    writer.release().unwrap();
    path
}

/// Masks for the frames of [`clip`].
fn masks(folder: &Path, num_frames: u32, width: u32, height: u32) -> PathBuf {
    let masks = folder.join("masks");
    fs::create_dir_all(&masks).unwrap();
    for k in 0..num_frames {
        let mask = image::GrayImage::from_fn(width, height, |x, _| image::Luma([u8::from(x < width / 2)]));
        mask.save(masks.join(format!("{k:06}.png"))).unwrap();
    }
    masks
}

/// Runs `tractrix run` on an input with masks and expects a failure on the input; gives what it says.
fn refused(input: &Path, masks: &Path, output: &Path) -> String {
    let arguments = [input.as_os_str(), "--masks".as_ref(), masks.as_os_str(), "--output".as_ref(), output.as_os_str()];
    let (code, stdout, stderr) = outcome(tractrix().arg("run").args(arguments).arg("--quiet"));
    assert_eq!((code, stdout.as_str()), (1, ""), "{stderr}");
    let lines: Vec<&str> = stderr.lines().collect();
    assert_eq!(lines.len(), 1, "an error is said once, and decoders are silent: {stderr}");
    assert!(lines[0].starts_with("tractrix: error: "), "{stderr}");
    stderr
}

#[test]
fn an_empty_file_is_refused() {
    let folder = TempDir::new().unwrap();
    let input = folder.path().join("empty.mp4");
    fs::write(&input, b"").unwrap();
    let said = refused(&input, &masks(folder.path(), 1, 8, 8), &folder.path().join("out"));
    assert!(said.contains("empty.mp4") && said.contains("is empty"), "{said}");
    assert!(!folder.path().join("out").exists(), "nothing is left behind where nothing could be done");
}

#[test]
fn a_text_file_with_the_name_of_a_video_is_refused() {
    let folder = TempDir::new().unwrap();
    let input = folder.path().join("text.mp4");
    fs::write(&input, b"Dear reader,\nthis is no video.\n").unwrap();
    let said = refused(&input, &masks(folder.path(), 1, 8, 8), &folder.path().join("out"));
    assert!(said.contains("text.mp4") && said.contains("not a video") && said.contains("folder of"), "{said}");
}

#[test]
fn what_is_not_there_is_refused_by_name() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    let masks = masks(folder.path(), 1, 64, 48);
    let said = refused(&folder.path().join("none.mp4"), &masks, &out);
    assert!(said.contains("none.mp4") && said.contains("check the path"), "{said}");
    let said = refused(&clip(folder.path(), 2), &folder.path().join("no-masks"), &out);
    assert!(said.contains("no-masks") && said.contains("--masks"), "{said}");
}

#[test]
fn a_missing_model_is_refused_by_name() {
    let folder = TempDir::new().unwrap();
    let input = clip(folder.path(), 2);
    let out = folder.path().join("out");
    for flag in ["--segmentation-model", "--ground-model", "--flow-model", "--background-model"] {
        let mut command = tractrix();
        command.arg("run").arg(&input).arg("--output").arg(&out).arg(flag).arg("missing.onnx");
        if flag != "--segmentation-model" {
            command.arg("--masks").arg(masks(folder.path(), 2, 64, 48));
        }
        let (code, _, stderr) = outcome(&mut command);
        assert_eq!(code, 1, "{stderr}");
        assert!(stderr.contains("missing.onnx") && stderr.contains(flag), "{stderr}");
    }
}

#[test]
fn a_model_that_is_none_is_refused() {
    let folder = TempDir::new().unwrap();
    let model = folder.path().join("noise.onnx");
    fs::write(&model, b"not a network").unwrap();
    let mut command = tractrix();
    command.arg("run").arg(clip(folder.path(), 2)).arg("--output").arg(folder.path().join("out"));
    let (code, _, stderr) = outcome(command.arg("--segmentation-model").arg(&model));
    assert_eq!(code, 1, "{stderr}");
    // With ONNX Runtime installed the file is at fault, else the runtime; either way there is a cure.
    assert!(stderr.contains("noise.onnx") || stderr.contains("fetch-onnxruntime"), "{stderr}");
}

#[test]
fn without_masks_or_model_the_use_is_wrong() {
    let folder = TempDir::new().unwrap();
    let mut command = tractrix();
    let (code, _, stderr) = outcome(command.arg("run").arg(clip(folder.path(), 2)).arg("--output").arg("out"));
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("--segmentation-model") && stderr.contains("--masks"), "{stderr}");
}

#[test]
fn an_output_folder_that_cannot_be_written_is_refused() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, b"in the way").unwrap();
    let said = refused(&clip(folder.path(), 2), &masks(folder.path(), 2, 64, 48), &file.join("out"));
    assert!(said.contains("file/out") && said.contains("--output"), "{said}");
    // The kernel's own files refuse even the superuser.
    let said = refused(&clip(folder.path(), 2), &masks(folder.path(), 2, 64, 48), Path::new("/proc/tractrix-out"));
    assert!(said.contains("/proc/tractrix-out") && said.contains("--output"), "{said}");
}

#[test]
fn a_mask_of_the_wrong_size_is_refused_with_both_sizes() {
    let folder = TempDir::new().unwrap();
    let said = refused(&clip(folder.path(), 2), &masks(folder.path(), 2, 32, 48), &folder.path().join("out"));
    assert!(said.contains("000000.png") && said.contains("32x48") && said.contains("64x48"), "{said}");
    let run = json(&folder.path().join("out/run.json"));
    assert!(run["error"].as_str().unwrap().contains("32x48"));
}

#[test]
fn masks_that_belong_to_no_frame_are_refused() {
    let folder = TempDir::new().unwrap();
    let masks = masks(folder.path(), 1, 64, 48);
    fs::rename(masks.join("000000.png"), masks.join("front-left.png")).unwrap();
    let said = refused(&clip(folder.path(), 2), &masks, &folder.path().join("out"));
    assert!(said.contains("masks") && said.contains("000000.png"), "{said}");
}

/// Runs on an input that gives no background and expects everything that can be said about it nevertheless.
fn partial(input: &Path, masks: &Path, output: &Path) -> (String, serde_json::Value) {
    let mut command = tractrix();
    command.arg("run").arg(input).arg("--masks").arg(masks).arg("--output").arg(output);
    let (code, _, stderr) = outcome(&mut command);
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("the background cannot be reconstructed"), "{stderr}");
    for file in ["run.json", "trajectories.json", "ground.json", "report.html", "background/cameras.txt"] {
        assert!(output.join(file).is_file(), "{file}");
    }
    assert_eq!(json(&output.join("trajectories.json"))["objects"].as_array().unwrap().len(), 0);
    (stderr, json(&output.join("run.json")))
}

#[test]
fn a_video_of_one_frame_gives_a_report_that_says_why_there_is_no_more() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    let (_, run) = partial(&clip(folder.path(), 1), &masks(folder.path(), 1, 64, 48), &out);
    assert_eq!(run["stages"]["frames"]["figures"]["num_frames"], 1);
    assert!(out.join("tracks/1/000000.jpg.png").is_file());
}

#[test]
fn a_video_that_is_cut_off_is_used_as_far_as_it_goes() {
    let folder = TempDir::new().unwrap();
    let input = clip(folder.path(), 30);
    let bytes = fs::read(&input).unwrap();
    fs::write(&input, &bytes[..bytes.len() / 2]).unwrap();
    let (stderr, run) = partial(&input, &masks(folder.path(), 30, 64, 48), &folder.path().join("out"));
    assert!(stderr.contains("clip.avi") && stderr.contains("of 30 frames can be decoded"), "{stderr}");
    let found = run["stages"]["frames"]["figures"]["num_frames"].as_u64().unwrap();
    assert!((2..29).contains(&found), "{found}");
    let warnings = run["warnings"].as_array().unwrap();
    assert!(warnings.iter().any(|w| w.as_str().unwrap().contains("cut off")), "{warnings:?}");
}

#[test]
fn a_camera_that_stands_still_is_told_so() {
    let folder = TempDir::new().unwrap();
    drive::write(folder.path(), 1);
    for k in 1..6 {
        for name in ["images", "masks"] {
            fs::copy(folder.path().join(name).join("0000.png"), folder.path().join(name).join(format!("{k:04}.png")))
                .unwrap();
        }
    }
    let (images, masks) = (folder.path().join("images"), folder.path().join("masks"));
    let (stderr, _) = partial(&images, &masks, &folder.path().join("out"));
    assert!(stderr.contains("move"), "{stderr}");
}

#[test]
fn wrong_use_and_help_have_their_codes() {
    let cases: [(&[&str], i32); 6] = [
        (&[], 2),
        (&["fly"], 2),
        (&["run"], 2),
        (&["run", "in.mp4", "--output", "out", "--start", "yesterday"], 2),
        (&["--help"], 0),
        (&["--version"], 0),
    ];
    for (arguments, expected) in cases {
        let (code, _, stderr) = outcome(tractrix().args(arguments));
        assert_eq!(code, expected, "{arguments:?}: {stderr}");
    }
}

#[test]
fn every_command_in_the_help_is_there() {
    let (_, help, _) = outcome(tractrix().arg("--help"));
    let listed =
        help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.trim().is_empty());
    let commands: Vec<&str> = listed.filter_map(|line| line.split_whitespace().next()).collect();
    for wanted in
        ["run", "segment", "track", "sfm", "ground", "scale", "evaluate", "benchmark", "compare", "bal", "doctor"]
    {
        assert!(commands.contains(&wanted), "{wanted} is not in {commands:?}");
    }
    for command in commands.iter().filter(|command| **command != "help") {
        let (code, _, stderr) = outcome(tractrix().args([command, "--help"]));
        assert_eq!(code, 0, "{command}: {stderr}");
    }
}

#[test]
fn doctor_says_what_is_there() {
    let (code, text, stderr) = outcome(tractrix().arg("doctor"));
    assert_eq!(code, 0, "{stderr}");
    assert!(text.contains("OpenCV") && text.contains("ONNX Runtime") && text.contains("FFmpeg"), "{text}");
    let (_, text, _) = outcome(tractrix().args(["doctor", "--json"]));
    let findings: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(findings.as_array().unwrap().iter().any(|f| f["name"] == "OpenCV" && f["ok"] == true), "{text}");
    let (code, text, _) = outcome(tractrix().args(["doctor", "--segmentation-model", "none.onnx"]));
    assert_eq!(code, 1);
    assert!(text.contains("none.onnx") || text.contains("not found"), "{text}");
}
