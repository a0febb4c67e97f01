//! `tractrix benchmark` on the bundled clip and on a sequence that is broken.

mod common;

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use common::{json, outcome, tractrix};
use serde_json::Value;
use tempfile::TempDir;

const CLIP: &str = "right_curves_hatchback";
const BROKEN: &str = "bridge_van";

/// A data set of the bundled clip, and of a sequence whose video is cut short and whose masks are missing.
fn data_set(folder: &Path) -> PathBuf {
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("dataset/demo");
    let set = folder.join("set");
    for name in [CLIP, BROKEN] {
        let place = set.join(name);
        fs::create_dir_all(&place).unwrap();
        for file in ["scene.json", "object_mesh.ply", "masks", "semantic", "video.mp4"] {
            symlink(clip.join(file), place.join(file)).unwrap();
        }
    }
    for file in ["video.mp4", "masks", "scene.json"] {
        fs::remove_file(set.join(BROKEN).join(file)).unwrap();
    }
    let scene = fs::read_to_string(clip.join("scene.json")).unwrap();
    let scene = scene.replace("\"vehicle\":\"hatchback\"", "\"vehicle\":\"van\"").replace("right_curves", "bridge");
    fs::write(set.join(BROKEN).join("scene.json"), scene).unwrap();
    let video = fs::read(clip.join("video.mp4")).unwrap();
    fs::write(set.join(BROKEN).join("video.mp4"), &video[..1000]).unwrap();
    fs::create_dir(set.join("notes")).unwrap();
    set
}

/// Runs a benchmark on the first half of every sequence; gives exit code, stdout and stderr.
fn benchmark(set: &Path, output: &Path, more: &[&str]) -> (i32, String, String) {
    let mut command = tractrix();
    command.arg("benchmark").arg(set).arg("--output").arg(output).args(["--end", "30f", "--seed", "3"]);
    outcome(command.args(more))
}

fn sequence<'a>(results: &'a Value, name: &str) -> &'a Value {
    results["sequences"].as_array().unwrap().iter().find(|entry| entry["folder"] == name).unwrap()
}

#[test]
fn a_broken_sequence_counts_as_failed_and_the_rest_is_done_once() {
    let folder = TempDir::new().unwrap();
    let (set, out) = (data_set(folder.path()), folder.path().join("out"));
    let (code, text, stderr) = benchmark(&set, &out, &[]);
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("1 of 2 sequences failed: bridge_van") && stderr.contains("notes"), "{stderr}");
    assert!(text.starts_with("2 sequences, 1 failed.") && text.contains("paper: constant-distance"), "{text}");

    let results = json(&out.join("benchmark.json"));
    assert_eq!((&results["num_sequences"], &results["left_out"][0]), (&2.into(), &"notes".into()));
    let failed = sequence(&results, BROKEN);
    assert_eq!((&failed["vehicle"], &failed["trajectory"]), (&"van".into(), &"bridge".into()));
    assert!(failed["failure"].as_str().unwrap().contains("video.mp4"), "{failed}");
    let done = sequence(&results, CLIP);
    assert_eq!((&done["vehicle"], &done["trajectory"]), (&"hatchback".into(), &"right_curves".into()));
    assert_eq!(done["registered"]["num_frames"], 60);
    let registered = done["registered"]["num_background"].as_u64().unwrap();
    assert!((25..=30).contains(&registered), "{registered}");
    let number = |key: &str| done[key].as_f64().unwrap();
    assert!(number("floor_m") > 0.0 && number("floor_m") < 1.0 && number("camera_rmse_m") < 0.1, "{done}");
    for estimator in ["constant-distance", "intersection", "least-squares", "joint"] {
        assert!(done["estimators"][estimator]["trajectory_error_m"].is_number(), "{done}");
    }
    let paper: Vec<&Value> = results["paper"].as_array().unwrap().iter().collect();
    assert_eq!(paper.len(), 2, "the published method is the reference column");
    assert!(paper.iter().any(|entry| entry["folder"] == CLIP && entry["trajectory_error_m"].is_number()), "{paper:?}");
    let by_paper = json(&out.join(".tractrix/paper").join(CLIP).join("run.json"));
    assert_eq!(by_paper["method"], "paper");
    let cost = |key: &str| done["cost"][key].as_f64().unwrap();
    assert!(cost("sfm_cpu_s") > 0.0 && cost("sfm_cpu_s") < cost("cpu_s") && cost("peak_rss_mib") > 1.0);
    let all = &results["summary"]["rows"][0]["trajectory_error_m"]["all"];
    assert_eq!((&all["num"], &all["num_failed"]), (&1.into(), &1.into()));
    let page = fs::read_to_string(out.join("benchmark.md")).unwrap();
    assert!(page.contains("| method paper: intersection"), "{page}");
    assert!(page.contains("FAILED") && page.contains("- **bridge_van**: failed: "), "{page}");
    for chart in ["trajectory-error.svg", "scale-deviation.svg", "estimators.svg"] {
        let chart = fs::read_to_string(out.join(chart)).unwrap();
        assert!(chart.starts_with("<svg") && chart.contains("\nfailed\n"), "{chart}");
    }

    // Again: nothing is done twice, and the figures are those of the first time, costs included.
    let (code, _, stderr) = benchmark(&set, &out, &["--only", CLIP, "--json"]);
    assert_eq!(code, 0, "{stderr}");
    let run = json(&out.join(CLIP).join("run.json"));
    let stages = run["stages"].as_object().unwrap();
    assert!(stages.iter().all(|(name, stage)| stage["reused"] == true || name == "report"), "{stages:?}");
    let again = json(&out.join("benchmark.json"));
    assert_eq!(again["num_sequences"], 1);
    for key in ["trajectory_error_m", "floor_m", "estimators", "registered"] {
        assert_eq!(sequence(&again, CLIP)[key], done[key], "{key}");
    }

    // Without a mechanism: another result, in which all but the stages that it concerns is reused.
    let ablate = ["--only", CLIP, "--no-paper", "--json", "--ablate", "joint,smooth-surface"];
    let (code, text, stderr) = benchmark(&set, &out, &ablate);
    assert_eq!(code, 0, "{stderr}");
    let printed: Value = serde_json::from_str(&text).unwrap();
    let effects = printed["ablation"].as_array().unwrap();
    assert_eq!((effects.len(), &effects[0]["name"]), (2, &"joint".into()), "{effects:?}");
    let error = |side: &str| effects[0][side]["trajectory_error_m"].as_f64().unwrap();
    let of_joint = done["trajectory_error_m"].as_f64().unwrap();
    let of_other = done["estimators"]["least-squares"]["trajectory_error_m"].as_f64().unwrap();
    assert!((error("with") - of_joint).abs() < 1e-9 && (error("without") - of_other).abs() < 1e-9, "{effects:?}");
    assert!(effects.iter().all(|effect| effect["without"]["cpu_s"].as_f64().unwrap() > 0.0), "{effects:?}");
    let page = fs::read_to_string(out.join("ablation.md")).unwrap();
    assert!(page.contains("| smooth-surface |"), "{page}");
    let before = fs::read(out.join("ablation.json")).unwrap();
    let (code, ..) = benchmark(&set, &out, &ablate);
    assert!(code == 0 && fs::read(out.join("ablation.json")).unwrap() == before, "what is done is kept");
    let (code, _, stderr) = benchmark(&set, &out, &["--ablate", "joints"]);
    assert!(code == 2 && stderr.contains("vehicle-path"), "{stderr}");

    // With another scale method only that stage is done again, reconstructions stay as they are, and the result is the
    // one that stood beside the first.
    let (code, _, stderr) = benchmark(&set, &out, &["--only", CLIP, "--no-paper", "--scale-method", "least-squares"]);
    assert_eq!(code, 0, "{stderr}");
    let other = json(&out.join("benchmark.json"));
    let other = sequence(&other, CLIP);
    let same = |a: &Value, b: &Value| {
        let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
        assert!((a - b).abs() < 1e-9 * b, "{a}, {b}");
    };
    assert!(other["floor_as_reconstructed_m"].is_null() && other["estimators"]["joint"].is_null(), "{other}");
    same(&other["floor_m"], &done["floor_as_reconstructed_m"]);
    same(&other["trajectory_error_m"], &done["estimators"]["least-squares"]["trajectory_error_m"]);
    same(
        &other["estimators"]["intersection"]["trajectory_error_m"],
        &done["estimators"]["intersection"]["trajectory_error_m"],
    );
    models_of_others_are_taken_as_they_are(folder.path(), &set, &out);
}

/// A benchmark's own models, given as another program's, lead to the same errors.
fn models_of_others_are_taken_as_they_are(folder: &Path, set: &Path, first: &Path) {
    let results = json(&first.join("benchmark.json"));
    let done = sequence(&results, CLIP);
    let (models, out) = (folder.join("models"), folder.join("out-models"));
    let place = models.join(CLIP);
    fs::create_dir_all(&place).unwrap();
    symlink(first.join(CLIP).join("background"), place.join("background")).unwrap();
    symlink(first.join(CLIP).join("objects/1"), place.join("object")).unwrap();
    let (models, results) = (models.display().to_string(), first.join("benchmark.json").display().to_string());
    let more = ["--models", &models, "--label", "others", "--compare", &results, "--no-paper", "--json"];
    let (code, text, stderr) = benchmark(set, &out, &more);
    assert_eq!(code, 1, "{stderr}");
    let results: Value = serde_json::from_str(&text).unwrap();
    let failed = sequence(&results, BROKEN)["failure"].as_str().unwrap();
    assert!(failed.contains("model not found"), "{failed}");
    let given = sequence(&results, CLIP);
    for key in ["floor_m", "trajectory_error_m"] {
        let (given, expected) = (given[key].as_f64().unwrap(), done[key].as_f64().unwrap());
        assert!((given - expected).abs() < 1e-9 * expected, "{key}: {given}, {expected}");
    }
    let page = fs::read_to_string(out.join("benchmark.md")).unwrap();
    assert!(page.contains("others: constant-distance") && page.contains("tractrix: constant-distance"), "{page}");
}

#[test]
fn what_is_no_data_set_is_refused() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    let (code, _, stderr) = benchmark(folder.path(), &out, &[]);
    assert_eq!(code, 1);
    assert!(stderr.contains("no folder in it has a scene.json"), "{stderr}");
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("dataset/demo");
    let (code, _, stderr) = benchmark(&clip, &out, &[]);
    assert!(code == 1 && stderr.contains("give the folder that contains it"), "{stderr}");
    let none = folder.path().join("none.json").display().to_string();
    let (code, _, stderr) = benchmark(clip.parent().unwrap(), &out, &["--only", "demo", "--compare", &none]);
    assert!(code == 1 && stderr.contains("none.json") && stderr.contains("--compare"), "{stderr}");
    let (code, ..) = benchmark(folder.path(), &out, &["--models", "a", "--object-models", "b"]);
    assert_eq!(code, 2);
    assert!(!out.exists(), "nothing is left behind where nothing could be done");
}
