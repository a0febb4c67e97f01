//! The networks that come with the program, on the clip that comes with it. Where ONNX Runtime is missing
//! (`scripts/fetch-onnxruntime`) the tests that need it say so and pass.

use std::path::PathBuf;

use image::RgbImage;
use tractrix::ffi::onnx::{self, Provider, Resources};
use tractrix::networks::{
    BoxSegmenter, DetectorOptions, GrabCut, PromptOptions, default_models, load_box_segmenter, load_detector,
    load_small_box_segmenter,
};
use tractrix::scene::{BoxDetection, Mask, Rect};
use tractrix::video::Source;

fn demo() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("dataset/demo")
}

/// One frame of the clip.
fn frame(number: usize) -> RgbImage {
    let source = Source::open(&demo().join("video.mp4"), &tractrix::video::Options::default()).unwrap();
    source.frames().unwrap().nth(number).unwrap().unwrap().1
}

/// The true mask of the vehicle in a frame, and its box.
fn truth(number: usize) -> (Mask, Rect) {
    let labels = image::open(demo().join(format!("masks/{number:05}.png"))).unwrap().to_luma8();
    let mask = Mask::from_fn(labels.width(), labels.height(), |x, y| labels.get_pixel(x, y).0[0] == 1);
    let rect = mask.bounding_box().unwrap().into();
    (mask, rect)
}

/// Whether networks can run here.
fn can_run() -> bool {
    let missing = onnx::probe(Provider::Cpu).err();
    if let Some(reason) = &missing {
        eprintln!("not tested: {reason}");
    }
    missing.is_none()
}

fn prompter(num_threads: usize) -> Box<dyn BoxSegmenter> {
    let models = default_models().unwrap();
    load_box_segmenter(&models.mask_encoder, &models.mask_decoder, &PromptOptions::default(), num_threads).unwrap()
}

fn detect(image: &RgbImage, num_threads: usize) -> Vec<BoxDetection> {
    let models = default_models().unwrap();
    let mut detector = load_detector(&models.detector, &DetectorOptions::default(), num_threads).unwrap();
    detector.detect(image).unwrap()
}

#[test]
fn the_shipped_detector_finds_the_vehicle_of_the_clip() {
    if !can_run() {
        return;
    }
    for number in [10, 40] {
        let found = detect(&frame(number), 1);
        let (_, rect) = truth(number);
        let best = found.iter().max_by(|a, b| a.rect.iou(&rect).total_cmp(&b.rect.iou(&rect))).unwrap();
        assert!(best.rect.iou(&rect) > 0.7, "frame {number}: {best:?} for {rect:?}");
        assert!(["car", "truck", "bus"].contains(&best.class.as_str()), "{best:?}");
        assert!(found.windows(2).all(|pair| pair[0].confidence >= pair[1].confidence));
    }
}

#[test]
fn the_shipped_mask_network_outlines_the_vehicle_from_its_box() {
    if !can_run() {
        return;
    }
    let mut prompter = prompter(1);
    for number in [10, 40] {
        let (mask, rect) = truth(number);
        let found = prompter.masks(&frame(number), &[rect]).unwrap();
        let found = found[0].as_ref().unwrap();
        let iou = found.mask.iou(&mask);
        assert!(iou >= 0.85, "frame {number}: mask IoU {iou:.3}");
        assert!((found.quality - iou).abs() < 0.2, "frame {number}: quality {} for IoU {iou:.3}", found.quality);
    }
    assert!(!prompter.is_coarse());
}

#[test]
fn the_small_mask_network_outlines_the_vehicle_from_its_box_and_from_a_loose_one() {
    if !can_run() {
        return;
    }
    let path = default_models().unwrap().small_masks;
    let mut small = load_small_box_segmenter(&path, &PromptOptions::default(), 1).unwrap();
    for number in [10, 40] {
        let (mask, rect) = truth(number);
        let loose = Rect { x0: rect.x0 - 0.3 * rect.width(), y1: rect.y1 + 0.2 * rect.height(), ..rect };
        let found = small.masks(&frame(number), &[rect, loose]).unwrap();
        let iou = found[0].as_ref().unwrap().mask.iou(&mask);
        assert!(iou >= 0.9, "frame {number}: mask IoU {iou:.3}");
        let loose = found[1].as_ref().map(|found| found.mask.iou(&mask));
        assert!(loose.is_none_or(|iou| iou >= 0.8), "frame {number}, loose box: mask IoU {loose:?}");
    }
    assert!(!small.is_coarse());
    let decoder = default_models().unwrap().mask_decoder;
    let refused = load_small_box_segmenter(&decoder, &PromptOptions::default(), 1).err().unwrap().to_string();
    assert!(refused.contains("crop [n, 4, 128, 128]"), "{refused}");
}

#[test]
fn what_the_networks_find_does_not_depend_on_the_number_of_threads() {
    if !can_run() {
        return;
    }
    let (image, (_, rect)) = (frame(20), truth(20));
    assert_eq!(detect(&image, 1), detect(&image, 2));
    assert_eq!(prompter(1).masks(&image, &[rect]).unwrap(), prompter(2).masks(&image, &[rect]).unwrap());
}

#[test]
fn masks_do_not_depend_on_what_was_asked_before() {
    if !can_run() {
        return;
    }
    let (image, (_, rect)) = (frame(20), truth(20));
    let other = Rect { x0: 0.0, y0: 0.0, x1: 900.0, y1: 500.0 };
    let mut used = prompter(1);
    used.masks(&image, &[other, rect.grown(1.0)]).unwrap();
    assert_eq!(used.masks(&image, &[rect]).unwrap(), prompter(1).masks(&image, &[rect]).unwrap());
}

#[test]
fn boxes_that_are_none_have_no_mask() {
    if !can_run() {
        return;
    }
    let outside = Rect { x0: 2000.0, y0: 10.0, x1: 2050.0, y1: 40.0 };
    let nan = Rect { x0: f64::NAN, y0: 10.0, x1: 50.0, y1: 40.0 };
    let turned = Rect { x0: 90.0, y0: 90.0, x1: 50.0, y1: 40.0 };
    let found = prompter(1).masks(&frame(0), &[outside, nan, turned]).unwrap();
    assert_eq!(found, [None, None, None]);
}

#[test]
fn the_stand_in_finds_most_of_the_vehicle() {
    let (mask, rect) = truth(10);
    let found = GrabCut::new(&PromptOptions::default()).masks(&frame(10), &[rect]).unwrap();
    let iou = found[0].as_ref().map(|found| found.mask.iou(&mask)).unwrap();
    assert!(iou >= 0.7, "mask IoU {iou:.3}");
}

#[test]
fn without_onnx_runtime_the_networks_find_the_same() {
    if !can_run() {
        return;
    }
    let (image, models, (_, rect)) = (frame(20), default_models().unwrap(), truth(20));
    let found = [Provider::Cpu, Provider::Rust].map(|provider| {
        let resources = Resources { provider, ..Resources::from(1) };
        let mut detector = load_detector(&models.detector, &DetectorOptions::default(), resources).unwrap();
        let mut masks =
            load_box_segmenter(&models.mask_encoder, &models.mask_decoder, &PromptOptions::default(), resources)
                .unwrap();
        let boxes = detector.detect(&image).unwrap();
        (boxes, masks.masks(&image, &[rect]).unwrap().remove(0).unwrap().mask)
    });
    let [(boxes, mask), (others, other)] = &found;
    assert_eq!(boxes.len(), others.len());
    for (a, b) in boxes.iter().zip(others) {
        assert!(a.rect.iou(&b.rect) > 0.99 && a.class == b.class, "{a:?} {b:?}");
    }
    assert!(mask.iou(other) > 0.98, "{}", mask.iou(other));
}

#[test]
fn a_provider_that_the_library_lacks_is_an_error() {
    if !can_run() {
        return;
    }
    let out = tempfile::tempdir().unwrap();
    let clip = demo().join("video.mp4");
    let program = env!("CARGO_BIN_EXE_tractrix");
    let mut run = std::process::Command::new(program);
    run.args(["run", clip.to_str().unwrap(), "--provider", "migraphx", "--output"]).arg(out.path().join("out"));
    let ended = run.output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success() && said.contains("provider migraphx") && said.contains("--provider cpu"), "{said}");
    let doctor = std::process::Command::new(program).args(["doctor", "--provider", "rust"]).output().unwrap();
    assert!(doctor.status.success() && String::from_utf8_lossy(&doctor.stdout).contains("provider rust"));
}
