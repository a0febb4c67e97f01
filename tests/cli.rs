//! The program as a user meets it: what it says and how it ends, above all on input that is wrong.

mod common;

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use common::{drive, json, outcome, tractrix};
use sha2::{Digest, Sha256};
use tempfile::TempDir;
use tractrix::synthetic::write_clip;

/// A clip of `num_frames` plain frames of 64 × 48 pixels.
fn clip(folder: &Path, num_frames: u32) -> PathBuf {
    let path = folder.join("clip.avi");
    let plain = |k| image::RgbImage::from_pixel(64, 48, image::Rgb([k as u8, 90, 40]));
    write_clip(&path, 10, &(0..num_frames).map(plain).collect::<Vec<_>>()).unwrap();
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
    assert!(said.contains("empty.mp4") && said.contains("empty file"), "{said}");
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
    fs::write(&model, b"cannot load this network").unwrap();
    let mut command = tractrix();
    command.arg("run").arg(clip(folder.path(), 2)).arg("--output").arg(folder.path().join("out"));
    let (code, _, stderr) = outcome(command.arg("--segmentation-model").arg(&model));
    assert_eq!(code, 1, "{stderr}");
    // With ONNX Runtime installed the file is at fault, else the runtime; either way there is a cure.
    assert!(stderr.contains("noise.onnx") || stderr.contains("fetch-onnxruntime"), "{stderr}");
}

#[test]
fn options_are_printed_and_read_back() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("options.json");
    let (code, printed, _) = outcome(tractrix().args(["options", "--json", "--seed", "3", "--set", "video.start=2.5"]));
    assert_eq!(code, 0);
    fs::write(&file, &printed).unwrap();
    let (_, again, _) = outcome(tractrix().args(["options", "--json", "--options"]).arg(&file));
    assert_eq!(printed, again);
    fs::write(&file, format!("{{\"version\": \"1\", \"stages\": {{}}, \"options\": {printed}}}")).unwrap();
    let (_, again, stderr) = outcome(tractrix().args(["options", "--json", "--options"]).arg(&file));
    assert_eq!(printed, again, "{stderr}");
    // Flags go before --set, and --set before the file.
    let set = ["--set", "seed=4", "--set", "ground.min_points=12", "--set", "scale.method=joint"];
    let flags = ["--scale-method", "intersection"];
    let (_, text, _) = outcome(tractrix().args(["options", "--options"]).arg(&file).args(set).args(flags));
    for line in ["seed = 4 ", "ground.min_points = 12 ", "scale.method = \"intersection\" ", "video.start = \"2.5\" "] {
        assert!(text.contains(line), "{line}: {text}");
    }
}

#[test]
fn options_that_do_not_exist_are_refused() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("options.json");
    fs::write(&file, r#"{"scale": {"joint": {"independent_point": 5}}}"#).unwrap();
    let run = || {
        let mut command = tractrix();
        command.arg("run").arg(clip(folder.path(), 2)).arg("--output").arg(folder.path().join("out"));
        command
    };
    let (code, _, stderr) = outcome(run().arg("--options").arg(&file));
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("options.json") && stderr.contains("scale.joint.independent_points"), "{stderr}");
    for set in ["objects.mapper.max_star=5", "objects.mapper.max_starts=0", "objects.mapper.max_starts=many", "seed"] {
        let (code, _, stderr) = outcome(run().args(["--masks", "masks", "--set", set]));
        assert_eq!(code, 2, "{set}: {stderr}");
        assert!(stderr.contains(set.split('=').next().unwrap()), "{set}: {stderr}");
    }
}

#[test]
fn without_masks_or_model_vehicles_are_looked_for() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    let mut command = tractrix();
    let (code, _, stderr) = outcome(command.arg("run").arg(clip(folder.path(), 4)).arg("--output").arg(&out));
    // Nothing is in the pictures; what is told is that, and not that something has to be given.
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("background") && !stderr.contains("--masks"), "{stderr}");
    let run: serde_json::Value = serde_json::from_slice(&fs::read(out.join("run.json")).unwrap()).unwrap();
    assert_eq!(run["options"]["instances"], "vehicles");
    let tracks: serde_json::Value = serde_json::from_slice(&fs::read(out.join("tracks.json")).unwrap()).unwrap();
    assert!(tracks["objects"].as_array().unwrap().is_empty(), "{tracks}");
}

#[test]
fn a_run_names_its_video_and_its_networks_by_their_hashes() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (folder, video) = (TempDir::new().unwrap(), root.join("dataset/demo/video.mp4"));
    let out = folder.path().join("out");
    // Three frames give no background; that is recorded, too.
    outcome(tractrix().arg("run").arg(&video).args(["--end", "3f"]).arg("--output").arg(&out));
    let run = json(&out.join("run.json"));
    let sha256 = |path: &Path| format!("{:x}", Sha256::digest(fs::read(path).unwrap()));
    assert_eq!(run["input"]["sha256"], sha256(&video));
    let networks = |stage: &str| run["stages"][stage]["figures"]["networks"].as_object().cloned().unwrap_or_default();
    for (stage, name) in [("segment", "yolox_nano.onnx"), ("track", "box_masks.onnx")] {
        match networks(stage).get(name) {
            Some(hash) => assert_eq!(*hash, sha256(&root.join("models").join(name))),
            None => assert!(std::env::var_os("TRACTRIX_REQUIRE_ONNXRUNTIME").is_none(), "{stage}: {run}"),
        }
    }
}

#[test]
fn flags_of_the_programs_own_eyes_do_not_go_with_masks() {
    for flag in [["--detector", "none"], ["--motion", "off"], ["--mask-network", "none"], ["--segment-every", "3"]] {
        let mut command = tractrix();
        command.args(["run", "in.mp4", "--output", "out", "--masks", "masks"]).args(flag);
        let (code, _, stderr) = outcome(&mut command);
        assert_eq!(code, 2, "{stderr}");
        assert!(stderr.contains(flag[0]) && stderr.contains("--masks"), "{stderr}");
    }
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
    assert!(stderr.contains("background not reconstructed"), "{stderr}");
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
    assert!(warnings.iter().any(|w| w.as_str().unwrap().contains("truncated")), "{warnings:?}");
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
    let (stderr, run) = without_ground(&images, &masks, &folder.path().join("out"));
    assert!(stderr.contains("camera does not translate") && stderr.contains("--camera-pitch"), "{stderr}");
    assert_eq!(run["stages"]["background"]["figures"]["num_registered"], 6);
    // Masks of other programs, in which 0 marks what is to be ignored, leave the vehicles alone.
    for k in 0..6 {
        let mask = image::GrayImage::from_fn(drive::WIDTH, drive::HEIGHT, |_, y| image::Luma([u8::from(y < 126)]));
        mask.save(masks.join(format!("{k:04}.png"))).unwrap();
    }
    let (stderr, _) = without_ground(&images, &masks, &folder.path().join("inverted"));
    assert!(stderr.contains("cover 71 % of the images") && stderr.contains("invert them"), "{stderr}");
}

/// Runs on images of a camera that stands still, none of whose vehicles moves: rotations and no ground.
fn without_ground(images: &Path, masks: &Path, output: &Path) -> (String, serde_json::Value) {
    let mut command = tractrix();
    let (code, _, stderr) =
        outcome(command.arg("run").arg(images).arg("--masks").arg(masks).arg("--output").arg(output));
    assert_eq!(code, 0, "{stderr}");
    (stderr, json(&output.join("run.json")))
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
    assert!(text.contains("--masks") && text.contains("--segmentation-model"), "how vehicles are found: {text}");
    assert!(!text.contains("Build Info"), "{text}");
    let (_, text, _) = outcome(tractrix().args(["doctor", "--json"]));
    let found: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(found["findings"].as_array().unwrap().iter().any(|f| f["name"] == "OpenCV" && f["ok"] == true), "{text}");
    let (code, text, _) = outcome(tractrix().args(["doctor", "--segmentation-model", "none.onnx"]));
    assert_eq!(code, 1);
    assert!(text.contains("none.onnx") || text.contains("not found"), "{text}");
}

#[test]
fn a_runtime_or_networks_that_a_variable_names_and_that_cannot_be_used_are_an_error() {
    const VARIABLES: [&str; 3] = ["TRACTRIX_ONNXRUNTIME", "ORT_DYLIB_PATH", "TRACTRIX_MODELS"];
    let folder = TempDir::new().unwrap();
    let clip = clip(folder.path(), 3);
    let no_library = folder.path().join("no-library");
    std::fs::write(&no_library, "text").unwrap();
    for (variable, value) in
        VARIABLES.into_iter().flat_map(|v| [(v, no_library.clone()), (v, folder.path().join("none"))])
    {
        let arguments = |command: &str| {
            let mut started = tractrix();
            for other in VARIABLES {
                started.env_remove(other);
            }
            started.env(variable, &value).arg(command);
            started
        };
        let (code, text, _) = outcome(&mut arguments("doctor"));
        assert!(code == 1 && text.contains(variable), "doctor: {code}: {text}");
        let out = folder.path().join("out");
        let (code, _, stderr) = outcome(arguments("run").arg(&clip).arg("--output").arg(&out));
        assert!(code == 1 && stderr.contains(variable) && stderr.contains("unset it"), "run: {code}: {stderr}");
        // Where no network is needed the variable does not matter.
        let (code, _, stderr) = outcome(arguments("sfm").arg(&clip).arg("--output").arg(folder.path().join("sfm")));
        assert!(!stderr.contains(variable), "sfm: {code}: {stderr}");
    }
}

/// What stands under "error" in the one JSON object on stdout.
fn error_of(arguments: &[&str], expected_code: i32) -> serde_json::Value {
    let (code, stdout, stderr) = outcome(tractrix().args(arguments).arg("--json"));
    assert_eq!(code, expected_code, "{arguments:?}: {stderr}");
    let value: serde_json::Value =
        serde_json::from_str(&stdout).unwrap_or_else(|e| panic!("{arguments:?}: {e}: {stdout}"));
    value["error"].clone()
}

#[test]
fn errors_are_json_where_json_is_asked_for() {
    let cases: [(&[&str], i32, &str); 12] = [
        (&["run", "none.mp4", "--masks", "none", "--output", "out"], 1, "input"),
        (&["run", "none.mp4", "--masks", "a", "--detector", "none", "--output", "out"], 2, "usage"),
        (&["run", "none.mp4", "--output", "out", "--fly"], 2, "usage"),
        (&["evaluate", "none", "--truth", "none"], 1, "input"),
        (&["benchmark", "none"], 1, "input"),
        (&["compare", "none", "none"], 1, "input"),
        (&["convert", "none", "out"], 1, "input"),
        (&["bal", "none"], 1, "input"),
        (&["export", "none", "--format", "csv"], 1, "input"),
        (&["export", "none", "--format", "xlsx"], 2, "usage"),
        (&["summary", "none"], 1, "input"),
        (&["doctor", "--segmentation-model", "none.onnx"], 1, "input"),
    ];
    for (arguments, code, kind) in cases {
        let error = error_of(arguments, code);
        assert_eq!(error["kind"], kind, "{arguments:?}: {error}");
        assert!(!error["message"].as_str().unwrap().is_empty(), "{arguments:?}");
    }
}

#[test]
fn a_run_without_a_background_is_one_json_object_with_its_error() {
    let folder = TempDir::new().unwrap();
    let (input, masks, out) = (clip(folder.path(), 1), masks(folder.path(), 1, 64, 48), folder.path().join("out"));
    let mut command = tractrix();
    command.arg("run").arg(&input).arg("--masks").arg(masks).arg("--output").arg(&out).args(["--json", "--quiet"]);
    let (code, stdout, stderr) = outcome(&mut command);
    assert_eq!(code, 1, "{stderr}");
    let value: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert!(value["error"]["message"].as_str().unwrap().contains("background"), "{value}");
    assert!(value["stages"]["frames"].is_object() && value["missing"][0]["id"] == 1, "{value}");
}

#[test]
fn a_failed_background_is_said_once_and_nothing_is_said_after_it() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    let (stderr, _) = partial(&clip(folder.path(), 1), &masks(folder.path(), 1, 64, 48), &out);
    assert_eq!(stderr.matches("not reconstructed").count(), 1, "{stderr}");
    assert!(stderr.contains("background stage 4 of 12") && !stderr.contains("stage 7 of 12"), "{stderr}");
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    partial(&clip(folder.path(), 1), &masks(folder.path(), 1, 64, 48), &out);
    let model = out.join("background");
    let (model, points) = (model.to_str().unwrap(), folder.path().join("points.ply"));
    let golden = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/models/colmap_text");
    let cases = [vec!["doctor"], vec!["compare", golden, golden], vec!["convert", model, points.to_str().unwrap()]];
    for arguments in cases {
        let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin("tractrix"));
        let mut child = command.args(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        drop(child.stderr.take());
        assert_eq!(child.wait().unwrap().code(), Some(0), "{arguments:?}");
    }
}

#[test]
fn convert_says_what_it_wrote() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    partial(&clip(folder.path(), 1), &masks(folder.path(), 1, 64, 48), &out);
    let binary = folder.path().join("binary");
    let (code, text, stderr) = outcome(tractrix().arg("convert").arg(&out).arg(&binary));
    assert_eq!(code, 0, "{stderr}");
    assert!(text.contains("COLMAP (text) to COLMAP (binary)") && text.contains("binary\n"), "{text}");
    let ply = folder.path().join("points.ply");
    let (_, text, _) = outcome(tractrix().arg("convert").arg(&binary).arg(&ply).arg("--json"));
    let said: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(said["to"] == "PLY" && said["num_points"] == 0 && said["output"] == ply.to_str().unwrap(), "{said}");
}

#[test]
fn what_a_late_stage_cannot_use_is_said_before_the_first_long_one() {
    let folder = TempDir::new().unwrap();
    let (input, masks) = (clip(folder.path(), 3), masks(folder.path(), 3, 64, 48));
    let noise = folder.path().join("noise.onnx");
    fs::write(&noise, b"cannot load this network").unwrap();
    let ground = folder.path().join("ground");
    fs::create_dir(&ground).unwrap();
    image::GrayImage::new(64, 48).save(ground.join("000000.png")).unwrap();
    image::GrayImage::new(64, 47).save(ground.join("000001.png")).unwrap();
    let cases = [
        ("--ground-model", &noise, "noise.onnx"),
        ("--ground-masks", &ground, "000001.png"),
        ("--background-model", &ground, "ground"),
    ];
    for (k, (flag, path, expected)) in cases.into_iter().enumerate() {
        let out = folder.path().join(k.to_string());
        let mut command = tractrix();
        command.arg("run").arg(&input).arg("--masks").arg(&masks).arg("--output").arg(&out).arg(flag).arg(path);
        let (code, _, stderr) = outcome(&mut command);
        assert_eq!(code, 1, "{stderr}");
        assert!(stderr.contains(expected) || stderr.contains("fetch-onnxruntime"), "{stderr}");
        let stages = json(&out.join("run.json"))["stages"].clone();
        assert_eq!(stages.as_object().unwrap().keys().collect::<Vec<_>>(), ["frames"], "{flag}");
    }
}

#[test]
fn intrinsics_that_no_lens_has_are_refused_by_name() {
    let folder = TempDir::new().unwrap();
    let (input, masks) = (clip(folder.path(), 1), masks(folder.path(), 1, 64, 48));
    for (numbers, expected) in [("1,1,32,24", "field of view"), ("60,60,320,24", "outside the image of 64x48")] {
        let mut command = tractrix();
        command.arg("run").arg(&input).arg("--masks").arg(&masks).arg("--intrinsics").arg(numbers);
        let (code, _, stderr) = outcome(command.arg("--output").arg(folder.path().join("out")));
        assert_eq!(code, 1, "{stderr}");
        assert!(stderr.contains("--intrinsics") && stderr.contains(expected), "{stderr}");
    }
}

#[test]
fn what_was_given_and_is_of_no_use_is_warned_of() {
    let folder = TempDir::new().unwrap();
    let (input, masks) = (clip(folder.path(), 1), masks(folder.path(), 1, 64, 48));
    let mut command = tractrix();
    command.arg("run").arg(&input).arg("--masks").arg(&masks).args(["--fps", "3", "--only-object", "99"]);
    let (_, _, stderr) = outcome(command.arg("--output").arg(folder.path().join("out")));
    assert!(stderr.contains("--fps ignored"), "{stderr}");
    assert!(stderr.contains("--only-object 99") && stderr.contains("does not exist; tracked: 1"), "{stderr}");
}

#[test]
fn a_folder_without_a_rate_has_frame_numbers_for_times() {
    let folder = TempDir::new().unwrap();
    drive::write(folder.path(), 1);
    for k in 1..4 {
        for name in ["images", "masks"] {
            let of = |k: u32| folder.path().join(name).join(format!("{k:04}.png"));
            fs::copy(of(0), of(k)).unwrap();
        }
    }
    let (images, masks) = (folder.path().join("images"), folder.path().join("masks"));
    let (stderr, run) = without_ground(&images, &masks, &folder.path().join("out"));
    assert!(stderr.contains("--fps") && run["input"]["times"] == "frames", "{stderr}");
    let mut command = tractrix();
    command.arg("run").arg(&images).arg("--masks").arg(&masks).args(["--start", "100f"]);
    let (_, _, stderr) = outcome(command.arg("--output").arg(folder.path().join("late")));
    assert!(stderr.contains("from frame 0 to frame 3"), "{stderr}");
}

#[test]
fn an_input_of_another_kind_says_what_it_is() {
    let folder = TempDir::new().unwrap();
    let masks = masks(folder.path(), 1, 8, 8);
    let refuse = |name: &str| refused(&folder.path().join(name), &masks, &folder.path().join("out"));
    let unfinished =
        [&20u32.to_be_bytes()[..], b"ftypisom\0\0\0\0isom", &16u32.to_be_bytes(), b"mdat12345678"].concat();
    fs::write(folder.path().join("unfinished.mp4"), unfinished).unwrap();
    let said = refuse("unfinished.mp4");
    assert!(said.contains("index") && !said.contains("ffmpeg"), "{said}");
    // One channel, 8000 samples a second, 16 bits, four samples.
    let format = b"RIFF\x2c\0\0\0WAVEfmt \x10\0\0\0\x01\0\x01\0\x40\x1f\0\0\x80\x3e\0\0\x02\0\x10\0";
    fs::write(folder.path().join("sound.wav"), [&format[..], b"data\x08\0\0\0\0\0\0\0\0\0\0\0"].concat()).unwrap();
    assert!(refuse("sound.wav").contains("no video track"));
    for (name, file, expected) in
        [("films", "a.MP4", "1 .mp4 file"), ("scans", "a.tiff", "convert"), ("bare", ".hidden", "empty")]
    {
        fs::create_dir(folder.path().join(name)).unwrap();
        fs::write(folder.path().join(name).join(file), b"x").unwrap();
        let said = refuse(name);
        assert!(said.contains(expected), "{said}");
    }
}

/// A run on one frame, with the given flags; gives stdout and stderr.
fn with_flags(flags: &[&str]) -> (String, String) {
    let folder = TempDir::new().unwrap();
    let mut command = tractrix();
    command.arg("run").arg(clip(folder.path(), 1)).arg("--masks").arg(masks(folder.path(), 1, 64, 48));
    let (_, stdout, stderr) = outcome(command.arg("--output").arg(folder.path().join("out")).args(flags));
    (stdout, stderr)
}

#[test]
fn progress_is_shown_as_it_is_asked_for() {
    let (_, stderr) = with_flags(&[]);
    assert!(stderr.contains("features   stage 3 of 12\n"), "lines where there is no terminal: {stderr}");
    let (_, stderr) = with_flags(&["--progress", "none"]);
    assert!(!stderr.contains("stage 3 of 12") && stderr.contains("error"), "{stderr}");
    let (stdout, stderr) = with_flags(&["--quiet"]);
    assert_eq!((stdout.as_str(), stderr.lines().count()), ("", 1), "{stderr}");
    let (_, stderr) = with_flags(&["--progress", "json"]);
    let lines: Vec<serde_json::Value> = stderr.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let features: Vec<_> = lines.iter().filter(|line| line["stage"] == "features").collect();
    assert_eq!(
        (&features[0]["index"], &features[0]["of"], &features[0]["event"]),
        (&3.into(), &12.into(), &"begins".into())
    );
    assert!(
        lines.iter().any(|line| line["error"].as_str().is_some_and(|text| text.contains("background"))),
        "{stderr}"
    );
}

#[test]
fn every_stage_is_announced_and_no_count_exceeds_its_total() {
    let folder = TempDir::new().unwrap();
    drive::write(folder.path(), 12);
    let mut command = tractrix();
    command.arg("run").arg(folder.path().join("images")).arg("--masks").arg(folder.path().join("masks"));
    command.arg("--output").arg(folder.path().join("out")).args(["--intrinsics", &drive::intrinsics(), "--fps", "12"]);
    let (code, _, stderr) = outcome(command.args(["--progress", "json"]));
    assert_eq!(code, 0, "{stderr}");
    let lines: Vec<serde_json::Value> = stderr.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let begun = lines.iter().filter(|line| line["event"] == "begins").filter_map(|line| line["index"].as_u64());
    assert_eq!(begun.collect::<Vec<_>>(), (1..=12).collect::<Vec<_>>());
    let is_over = |line: &serde_json::Value| line["done"].as_u64() > line["total"].as_u64().or(Some(u64::MAX));
    assert!(!lines.iter().any(is_over), "{stderr}");
}

#[test]
fn a_run_that_is_stopped_says_how_it_goes_on() {
    let folder = TempDir::new().unwrap();
    drive::write(folder.path(), 24);
    // Who starts the tests may have signals ignored, and a program that is started so goes on ignoring them.
    let mut command = std::process::Command::new("env");
    command.arg("--default-signal=INT").arg(assert_cmd::cargo::cargo_bin("tractrix"));
    command.arg("run").arg(folder.path().join("images")).arg("--masks").arg(folder.path().join("masks"));
    command.arg("--output").arg(folder.path().join("out")).args(["--progress", "plain"]);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.any(|line| line.starts_with("features   stage")), "the stage begins");
    rustix::process::kill_process(rustix::process::Pid::from_child(&child), rustix::process::Signal::INT).unwrap();
    let rest: Vec<String> = lines.collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:?}");
    assert!(rest.iter().any(|line| line.contains("the same command resumes")), "{rest:?}");
}

#[test]
fn the_last_lines_say_of_the_vehicle_what_a_person_wants_to_know() {
    let folder = TempDir::new().unwrap();
    drive::write(folder.path(), 24);
    let of = |name: &str| folder.path().join(name);
    let mut command = tractrix();
    command.arg("run").arg(of("images")).arg("--masks").arg(of("masks")).arg("--ground-masks").arg(of("ground"));
    command.arg("--intrinsics").arg(drive::intrinsics()).args(["--fps", "10"]).arg("--output").arg(of("out"));
    let (code, text, stderr) = outcome(&mut command);
    assert_eq!(code, 0, "{stderr}");
    assert!(text.starts_with("1 vehicle with a trajectory\n  1: vehicle, moving, 3D position in "), "{text}");
    for expected in [" of 24 frames, from 0.", "path length: ", " units, displacement: ", "size and distance"] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    assert!(text.trim_end().ends_with("report.html"), "{text}");
}

#[test]
fn wrong_intrinsics_are_adjusted_and_named() {
    let folder = TempDir::new().unwrap();
    drive::write(folder.path(), 24);
    let of = |name: &str| folder.path().join(name);
    let run = |name: &str, intrinsics: &str, flags: &[&str]| {
        let mut command = tractrix();
        command.arg("sfm").arg(of("images")).arg("--masks").arg(of("masks")).arg("--output").arg(of(name));
        command.args(["--fps", "12", "--threads", "1", "--intrinsics", intrinsics]).args(flags);
        let (code, _, stderr) = outcome(&mut command);
        assert_eq!(code, 0, "{stderr}");
        let figures = json(&of(name).join("run.json"))["stages"]["background"]["figures"].clone();
        (stderr, figures["focal_length_px"].as_f64().unwrap(), figures["calibration_fit"].clone())
    };
    const MISFIT: &str = "the given calibration does not fit: ";
    let (stderr, _, fit) = run("exact", &drive::intrinsics(), &[]);
    assert!(!stderr.contains(MISFIT), "{stderr} {fit}");
    // Longer by 15 %, off center by 5 % of the width, and distorted.
    let wrong = format!("{0},{0},176,82,0.3", 1.15 * drive::FOCAL);
    let (stderr, focal, fit) = run("prior", &wrong, &[]);
    assert!(stderr.contains(MISFIT) && stderr.contains("the adjusted one is used"), "{stderr} {fit}");
    assert!(fit["adjusted_px"].as_f64() < fit["given_px"].as_f64(), "{fit}");
    assert!((focal / drive::FOCAL - 1.0).abs() < 0.1, "{focal}");
    let (stderr, _, fit) = run("fixed", &wrong, &["--fixed"]);
    assert!(stderr.contains(MISFIT) && stderr.contains("remove --fixed"), "{stderr} {fit}");
}

#[test]
fn a_video_from_a_pipe_is_recorded_and_run_like_a_file() {
    let place = TempDir::new().unwrap();
    let video = fs::read(clip(place.path(), 6)).unwrap();
    let out = place.path().join("out");
    let segment = |input: &str| {
        let mut command = tractrix();
        command.args(["segment", input, "--detector", "none", "--output", out.to_str().unwrap()]);
        command
    };
    let (code, _, said) = outcome(segment("-").write_stdin(video.clone()));
    assert_eq!(code, 0, "{said}");
    let recording = out.join("recording.avi");
    assert_eq!(fs::read(&recording).unwrap(), video);
    let (code, _, said) = outcome(&mut segment(recording.to_str().unwrap()));
    assert!(code == 0 && said.contains("segment    up to date"), "{said}");
    let (code, _, said) = outcome(segment("-").write_stdin(video));
    assert!(code == 2 && said.contains("recording.avi") && said.contains("--overwrite"), "{said}");
    let (code, _, said) = outcome(segment("-").arg("--overwrite").write_stdin(""));
    assert!(code == 1 && said.contains("standard input is empty"), "{said}");
}

#[test]
fn a_live_video_is_recorded_and_its_lines_are_whole() {
    let place = TempDir::new().unwrap();
    let file = clip(place.path(), 30);
    let video = fs::read(&file).unwrap();
    let live = |input: &str, out: &Path| {
        let mut command = tractrix();
        command.args(["live", input, "--detector", "none", "--mask-network", "none", "--no-final-run", "--output"]);
        command.arg(out);
        command
    };
    for input in ["-", file.to_str().unwrap()] {
        let out = place.path().join(input.len().to_string());
        let (code, printed, said) = outcome(live(input, &out).write_stdin(video.clone()));
        assert_eq!(code, 0, "{said}");
        assert_eq!(fs::read(out.join("recording.avi")).unwrap(), video);
        let lines = fs::read_to_string(out.join("live.jsonl")).unwrap();
        assert_eq!(lines, printed);
        let last: serde_json::Value = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
        let count = |key: &str| last[key].as_u64().unwrap();
        assert!(last["kind"] == "end" && count("frames") + count("dropped") + count("skipped") == 30, "{last}");
        let (code, _, said) = outcome(live(input, &out).write_stdin(video.clone()));
        assert!(code == 2 && said.contains("recording.avi") && said.contains("--overwrite"), "{said}");
    }
    let (code, _, said) = outcome(&mut live("nowhere.ts", &place.path().join("none")));
    assert!(code == 1 && said.contains("nowhere.ts"), "{said}");
}

#[test]
fn a_signal_ends_a_live_recording_and_its_run_follows() {
    use rustix::process::{Pid, Signal, kill_process};
    let place = TempDir::new().unwrap();
    let video = fs::read(clip(place.path(), 30)).unwrap();
    // Without and with a final run; the recording must not grow after the signal.
    for (name, more) in [("recorded", Some("--no-final-run")), ("run", None)] {
        let out = place.path().join(name);
        let mut command = std::process::Command::new("env");
        command.arg("--default-signal=TERM").arg(assert_cmd::cargo::cargo_bin("tractrix")).args(["live", "-"]);
        command.args(["--detector", "none", "--mask-network", "none", "--output"]).arg(&out).args(more);
        command.stdin(Stdio::piped()).stdout(Stdio::null());
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut input = child.stdin.take().unwrap();
        input.write_all(&video).unwrap();
        let lines = out.join("live.jsonl");
        let begun = std::time::Instant::now();
        while fs::metadata(out.join("recording.avi")).map_or(0, |found| found.len()) < video.len() as u64
            || !lines.exists()
        {
            assert!(begun.elapsed().as_secs() < 60, "nothing is recorded");
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        // The signal counts as the end of the recording once frames are processed.
        std::thread::sleep(std::time::Duration::from_millis(500));
        kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
        while !fs::read_to_string(&lines).unwrap().contains("\"kind\":\"end\"") {
            assert!(begun.elapsed().as_secs() < 60, "the recording does not end");
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        // Fails or blocks nobody: the program takes nothing more.
        let _ = input.write_all(&video);
        drop(input);
        let ended = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert!(said.contains("recording ended by a signal"), "{said}");
        assert_eq!(fs::read(out.join("recording.avi")).unwrap(), video, "{name}");
        match more {
            Some(_) => assert_eq!(ended.status.code(), Some(0), "{said}"),
            // A clip of noise has no background: the run tells so, in its report.
            None => assert!(out.join("run.json").exists(), "{said}"),
        }
    }
}

#[test]
fn live_telemetry_is_recorded_and_the_run_would_use_it() {
    let place = TempDir::new().unwrap();
    let (file, log, out) = (clip(place.path(), 30), place.path().join("log"), place.path().join("out"));
    let mut text = "time_s,latitude,longitude,altitude\n".to_owned();
    (0..30).for_each(|k| text += &format!("{:.1},47.{:06},8.5,400\n", 0.1 * f64::from(k), 300_000 + k));
    fs::write(&log, &text).unwrap();
    let live = |log: &Path| {
        let mut command = tractrix();
        command.args(["live", file.to_str().unwrap(), "--detector", "none", "--mask-network", "none", "--output"]);
        command.arg(&out).args(["--no-final-run", "--telemetry"]).arg(log);
        command
    };
    let (code, _, said) = outcome(&mut live(&log));
    assert_eq!(code, 0, "{said}");
    assert_eq!(fs::read_to_string(out.join("recording.csv")).unwrap(), text);
    let (code, _, said) = outcome(&mut live(&place.path().join("none")));
    assert!(code != 0 && said.contains("--telemetry") || said.contains("--overwrite"), "{said}");
}

#[test]
fn live_outputs_are_refused_before_anything_is_recorded() {
    let place = TempDir::new().unwrap();
    let (file, out) = (clip(place.path(), 3), place.path().join("out"));
    for (flags, wanted) in [
        (&["--page", "0.0.0.0:8080"][..], "--page-public"),
        (&["--page", "8080"], "127.0.0.1:8080"),
        (&["--mavlink", "127.0.0.1:14550"], "udp:HOST:PORT"),
        (&["--cot", "udp:127.0.0.1"], "udp:HOST:PORT"),
    ] {
        let mut command = tractrix();
        command.args(["live", file.to_str().unwrap(), "--output"]).arg(&out).args(flags);
        let (code, _, said) = outcome(&mut command);
        assert!(code == 2 && said.contains(wanted), "{flags:?}: {said}");
        assert!(!out.join("recording.avi").exists());
    }
}

/// Sends a clip as datagrams, records them, and looks whether the program that received them has gone.
#[test]
fn a_stream_is_received_by_a_child_that_ends_with_the_program() {
    use std::process::{Command, Stdio};
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        eprintln!("skipped: no ffmpeg");
        return;
    }
    let place = TempDir::new().unwrap();
    let (file, out) = (clip(place.path(), 30), place.path().join("out"));
    let port = std::net::UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let address = format!("udp://127.0.0.1:{port}");
    let mut live = Command::new(env!("CARGO_BIN_EXE_tractrix"))
        .args(["live", &address, "--detector", "none", "--mask-network", "none", "--no-final-run", "--output"])
        .arg(&out)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut sender = Command::new("ffmpeg")
        .args(["-v", "error", "-re", "-stream_loop", "-1", "-i", file.to_str().unwrap()])
        .args(["-c:v", "mpeg2video", "-f", "mpegts", &format!("{address}?pkt_size=1316")])
        .stdin(Stdio::null())
        .spawn()
        .unwrap();
    let recording = out.join("recording.ts");
    let begins = |_| {
        std::thread::sleep(std::time::Duration::from_millis(100));
        fs::metadata(&recording).is_ok_and(|found| found.len() > 20_000)
    };
    let has_begun = (0..300).any(begins);
    let children = || {
        let of = format!("/proc/{0}/task/{0}/children", live.id());
        fs::read_to_string(of).unwrap_or_default().split_whitespace().map(str::to_owned).collect::<Vec<_>>()
    };
    let receivers = children();
    let stop = rustix::process::Pid::from_raw(live.id() as i32).unwrap();
    rustix::process::kill_process(stop, rustix::process::Signal::TERM).unwrap();
    let ended = live.wait().unwrap();
    sender.kill().unwrap();
    sender.wait().unwrap();
    assert!(has_begun, "nothing was recorded");
    assert_eq!(ended.code(), Some(0), "its recording ends");
    assert!(receivers.len() == 1 && !Path::new("/proc").join(&receivers[0]).exists(), "{receivers:?}");
    let lines = fs::read_to_string(out.join("live.jsonl")).unwrap();
    assert!(lines.lines().all(|line| serde_json::from_str::<serde_json::Value>(line).is_ok()));
    assert!(tractrix::files::read(&recording).unwrap().starts_with(b"G"), "a transport stream");
}
