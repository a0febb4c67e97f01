//! The verdict on what a detector takes for a car. Needs `videos/` and `models/` of the folder that TRACTRIX_DATA
//! names, ONNX Runtime, and some minutes.

mod common;

use std::path::PathBuf;

use common::{json, outcome, tractrix};
use serde_json::Value;

/// A part of the horizon that YOLOv8n-seg takes for a car in six of the clip's frames: left and right edge, top and
/// bottom of where it lies in frame 110, pixels.
const PATCH: [f64; 4] = [1140.0, 1195.0, 180.0, 215.0];

fn in_data(path: &str) -> PathBuf {
    let data = std::env::var_os("TRACTRIX_DATA").expect("TRACTRIX_DATA names the folder of the data");
    PathBuf::from(data).join(path)
}

/// The middle of an object's mask in a frame; `None` where it has none.
fn middle(output: &std::path::Path, id: u64, frame: u32) -> Option<[f64; 2]> {
    let mask = image::open(output.join(format!("tracks/{id}/{frame:06}.jpg.png"))).ok()?.to_luma8();
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for (x, y, _) in mask.enumerate_pixels().filter(|(.., pixel)| pixel.0[0] > 0) {
        (sum[0], sum[1], count) = (sum[0] + f64::from(x), sum[1] + f64::from(y), count + 1.0);
    }
    (count > 0.0).then(|| sum.map(|s| s / count))
}

fn state(object: &Value) -> &str {
    object["verdict"]["state"].as_str().unwrap()
}

#[test]
#[ignore = "reads a real clip and a model, takes minutes"]
fn a_patch_of_the_horizon_is_not_trusted_and_a_car_beside_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    let mut command = tractrix();
    command.arg("run").arg(in_data("videos/uav123_car10_a.mp4")).arg("--output").arg(&output);
    command.arg("--segmentation-model").arg(in_data("models/yolov8n-seg_640_fromint8.onnx")).arg("--quiet");
    let (code, stdout, stderr) = outcome(&mut command);
    assert_eq!(code, 0, "{stdout}{stderr}");
    let found = json(&output.join("trajectories.json"));
    let objects = found["objects"].as_array().unwrap();
    let lies_in_patch = |object: &&Value| {
        let Some([x, y]) = middle(&output, object["id"].as_u64().unwrap(), 110) else { return false };
        let [left, right, top, bottom] = PATCH;
        (left..right).contains(&x) && (top..bottom).contains(&y)
    };
    // A run that gives it no trajectory at all is as good.
    for patch in objects.iter().filter(lies_in_patch) {
        assert_eq!(state(patch), "rejected", "{}", patch["verdict"]);
    }
    assert!(objects.iter().any(|object| matches!(state(object), "good" | "fair")), "{found}");
}
