//! Networks of other people, as their packages export them: small ones with random weights, which
//! `tests/golden/networks/make` writes together with what they find in PyTorch.
//!
//! Where ONNX Runtime is missing (`scripts/fetch-onnxruntime` gets it) the tests say so and pass, unless
//! `TRACTRIX_REQUIRE_ONNXRUNTIME=1`: then they fail.

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use serde_json::Value;
use tractrix::networks::{GroundOptions, SegmentationOptions, load_ground_segmenter, load_segmenter};
use tractrix::scene::{BoundingBox, Mask};

/// Whether networks can be run here.
fn has_runtime() -> bool {
    let Err(error) = tractrix::ffi::onnx::probe(tractrix::ffi::onnx::Provider::Cpu) else { return true };
    assert!(std::env::var_os("TRACTRIX_REQUIRE_ONNXRUNTIME").is_none_or(|v| v != "1"), "{error}");
    eprintln!("skipped: {error}");
    false
}

fn network(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/networks").join(name)
}

fn expected() -> Value {
    serde_json::from_str(&std::fs::read_to_string(network("expected.json")).unwrap()).unwrap()
}

/// The picture of `make`.
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let channel = |(a, b): (i64, i64)| {
            let wave = (a * i64::from(x) + b * i64::from(y)).rem_euclid(512) - 256;
            wave.abs().min(255) as u8
        };
        Rgb([(7, 2), (3, 9), (11, -5)].map(channel))
    })
}

fn sides(case: &Value) -> (u32, u32) {
    let side = |k: usize| u32::try_from(case["size"][k].as_u64().unwrap()).unwrap();
    (side(0), side(1))
}

/// Pixels and their mean position.
fn area_and_center(mask: &Mask) -> (f64, [f64; 2]) {
    let mut sum = [0.0; 2];
    for (x, y) in mask.iter() {
        sum[0] += f64::from(x) + 0.5;
        sum[1] += f64::from(y) + 0.5;
    }
    let area = mask.area_px2() as f64;
    (area, sum.map(|s| s / area))
}

/// Holds what a Mask R-CNN finds in both pictures against what PyTorch finds. Torchvision pastes masks into boxes of
/// whole pixels, which moves each border by up to a pixel.
fn compare_mask_rcnn(name: &str) {
    let options = SegmentationOptions { confidence: 0.2, nms_iou: 1.0, ..SegmentationOptions::default() };
    let mut segmenter = load_segmenter(&network(name), &options, 1).unwrap();
    for case in expected()["mask_rcnn"].as_array().unwrap() {
        let (width, height) = sides(case);
        let found = segmenter.segment(&picture(width, height)).unwrap();
        let objects = case["objects"].as_array().unwrap();
        assert_eq!(found.len(), objects.len(), "{name}");
        for (object, truth) in found.iter().zip(objects) {
            let class = if truth["label"] == 3 { "car" } else { "cow" };
            assert_eq!(object.class, class, "{name}: {truth}");
            let (area, center) = area_and_center(&object.mask);
            let (true_area, score) = (truth["area"].as_f64().unwrap(), truth["score"].as_f64().unwrap());
            assert!((object.confidence - score).abs() < 1e-3, "{name}: score {} for {score}", object.confidence);
            assert!((area / true_area - 1.0).abs() < 0.12, "{name}: area {area} for {true_area}");
            for (found, truth) in center.iter().zip(truth["center"].as_array().unwrap()) {
                assert!((found - truth.as_f64().unwrap()).abs() < 1.0, "{name}: centre {center:?} for {truth}");
            }
        }
    }
}

#[test]
fn mask_rcnn_finds_what_it_finds_in_pytorch() {
    if !has_runtime() {
        return;
    }
    compare_mask_rcnn("mask_rcnn.onnx");
}

#[test]
fn mask_rcnn_with_pasted_masks_finds_the_same() {
    if !has_runtime() {
        return;
    }
    compare_mask_rcnn("mask_rcnn_pasted.onnx");
}

#[test]
fn classes_of_mask_rcnn_come_from_the_file_beside_it_and_begin_with_the_background() {
    if !has_runtime() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("own.onnx");
    std::fs::copy(network("mask_rcnn.onnx"), &path).unwrap();
    let load = |classes: &str| {
        std::fs::write(path.with_extension("toml"), format!("classes = {classes}")).unwrap();
        load_segmenter(&path, &SegmentationOptions::default(), 1)
    };
    let error = load("['car', 'van']").err().unwrap().to_string();
    assert!(error.contains("own.toml") && error.contains("background"), "{error}");
    let mut short = load("['background', 'pot', 'cup', 'van']").unwrap();
    let error = short.segment(&picture(480, 288)).unwrap_err().to_string();
    assert!(error.contains("own.onnx") && error.contains("below 4"), "{error}");
    let names: Vec<String> = (0..91).map(|k| if k == 21 { "van".to_owned() } else { k.to_string() }).collect();
    let found = load(&format!("{names:?}")).unwrap().segment(&picture(480, 288)).unwrap();
    assert!(!found.is_empty() && found.iter().all(|object| object.class == "van"));
}

#[test]
fn segformer_finds_the_ground_that_it_finds_in_pytorch() {
    if !has_runtime() {
        return;
    }
    let case = &expected()["segformer"];
    let (width, height) = sides(case);
    let mut segmenter = load_ground_segmenter(&network("segformer.onnx"), &GroundOptions::default(), 1).unwrap();
    let mask = segmenter.ground_mask(&picture(width, height)).unwrap();
    let row = |y| mask.pixels_in(BoundingBox { x0: 0, y0: y, x1: width, y1: y + 1 });
    let rows = (0..height).map(|y| row(y).iter().filter(|set| **set).count() as f64);
    let mut differing = 0.0;
    for (found, truth) in rows.zip(case["rows"].as_array().unwrap()) {
        differing += (found - truth.as_f64().unwrap()).abs();
    }
    assert!(differing / f64::from(width * height) < 1e-3, "{differing} pixels differ");
}

#[test]
fn segformer_without_its_description_is_refused_with_what_it_has() {
    if !has_runtime() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.onnx");
    std::fs::copy(network("segformer.onnx"), &path).unwrap();
    let error = load_ground_segmenter(&path, &GroundOptions::default(), 1).err().unwrap().to_string();
    assert!(error.contains("pixel_values") && error.contains(".toml"), "{error}");
}
