//! Segmentation, flow and tracking on real clips: `models/` and `videos/` of the folder that TRACTRIX_DATA names. Needs
//! ONNX Runtime (`scripts/fetch-onnxruntime`). `examples/track_vehicles.rs` measures and draws what these tests only
//! judge.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use image::RgbImage;
use tractrix::networks::{
    GroundOptions, KnownMasks, SegmentationOptions, load_flow, load_ground_segmenter, load_segmenter,
};
use tractrix::scene::{BoundingBox, Frame, Mask, ObjectId};
use tractrix::tracking::{BoxSource, DetectedBox, FrameInput, TrackSummary, TrackedMask, Tracker, TrackerOptions};
use tractrix::video::Source;

const MODEL: &str = "models/yolov8n-seg_640_fromint8.onnx";

/// A file of the data that is not in the repository.
fn in_data(path: &str) -> PathBuf {
    let data = std::env::var_os("TRACTRIX_DATA").expect("TRACTRIX_DATA names the folder of the data");
    PathBuf::from(data).join(path)
}

/// Frames of a video, one after the other.
fn frames(path: &Path) -> impl Iterator<Item = (Frame, RgbImage)> {
    let source = Source::open(path, &tractrix::video::Options::default()).unwrap();
    source.frames().unwrap().map(Result::unwrap)
}

/// What one clip gave.
#[derive(Default)]
struct Outcome {
    /// Per frame the tracked boxes by provisional id.
    boxes: Vec<BTreeMap<ObjectId, BoundingBox>>,
    tracks: Vec<TrackSummary>,
}

/// Segments and tracks the first frames of a clip.
fn follow(clip: &Path, limit: usize) -> Outcome {
    let mut segmenter = load_segmenter(&in_data(MODEL), &SegmentationOptions::default(), 0).unwrap();
    let mut estimator = load_flow(None, 0).unwrap();
    let mut tracker = Tracker::new(TrackerOptions::default());
    let mut outcome = Outcome::default();
    let mut previous: Option<RgbImage> = None;
    for (frame, image) in frames(clip).take(limit) {
        let detections = segmenter.segment(&image).unwrap();
        let flow = previous.map(|p| estimator.flow(&p, &image, &tracker.flow_regions()).unwrap());
        let (found, mut known) = (DetectedBox::of_masks(&detections), KnownMasks::new(detections));
        let look = FrameInput { found, by: BoxSource::Detector, segmenter: Some(&mut known) };
        let masks = tracker.advance(&frame, &image, look, flow.as_ref()).unwrap();
        assert_disjoint(&masks);
        outcome.boxes.push(masks.iter().filter_map(|m| Some((m.object, m.mask.bounding_box()?))).collect());
        previous = Some(image);
    }
    outcome.tracks = tracker.finish();
    outcome
}

fn assert_disjoint(masks: &[TrackedMask]) {
    for (i, a) in masks.iter().enumerate() {
        for b in &masks[i + 1..] {
            assert_eq!(a.mask.intersection_px2(&b.mask), 0, "masks of {} and {} overlap", a.object, b.object);
        }
    }
}

/// One box per frame, `None` where the object is absent.
fn read_truth(path: &Path) -> Vec<Option<[f64; 4]>> {
    let text = std::fs::read_to_string(path).unwrap();
    let line = |line: &str| {
        let numbers: Vec<f64> = line.split(',').filter_map(|n| n.trim().parse().ok()).collect();
        (numbers.len() == 4 && numbers.iter().all(|n| n.is_finite()))
            .then(|| [numbers[0], numbers[1], numbers[2], numbers[3]])
    };
    text.lines().map(line).collect()
}

fn iou([x, y, w, h]: [f64; 4], b: BoundingBox) -> f64 {
    let overlap = |a0: f64, a1: f64, b0: u32, b1: u32| (a1.min(b1.into()) - a0.max(b0.into())).max(0.0);
    let both = overlap(x, x + w, b.x0, b.x1) * overlap(y, y + h, b.y0, b.y1);
    both / (w * h + f64::from(b.width() * b.height()) - both)
}

/// How well the annotated object was followed: frames in which it is there, frames in which a tracked box overlaps it
/// by more than 0.3, and how often the id that overlaps it changes.
fn against_truth(outcome: &Outcome, truth: &[Option<[f64; 4]>]) -> (usize, usize, usize) {
    let lasting: BTreeSet<ObjectId> = outcome.tracks.iter().map(|t| t.provisional).collect();
    let (mut there, mut found, mut switches, mut last) = (0, 0, 0, None);
    for (boxes, truth) in outcome.boxes.iter().zip(truth) {
        let Some(truth) = truth else { continue };
        there += 1;
        let best = boxes.iter().filter(|(id, _)| lasting.contains(id)).map(|(id, b)| (iou(*truth, *b), *id));
        let Some((overlap, id)) = best.max_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        if overlap > 0.3 {
            found += 1;
            switches += usize::from(last.is_some_and(|l| l != id));
            last = Some(id);
        }
    }
    (there, found, switches)
}

/// The part of a mask's rows between two fractions of the height that is set.
fn share(mask: &Mask, from: f64, to: f64) -> f64 {
    let [y0, y1] = [from, to].map(|share| (f64::from(mask.height()) * share) as u32);
    let pixels = mask.pixels_in(BoundingBox { x0: 0, y0, x1: mask.width(), y1 });
    pixels.iter().filter(|&&p| p).count() as f64 / pixels.len().max(1) as f64
}

#[test]
#[ignore = "needs TRACTRIX_DATA"]
fn a_dashcam_shows_vehicles_and_road() {
    let clip = in_data("videos/dashcam_udacity_test_video.mp4");
    let outcome = follow(&clip, 4);
    assert!(outcome.tracks.len() >= 2, "{:?}", outcome.tracks);
    assert!(outcome.tracks.iter().all(|t| t.found.detected() >= 3));
    let (_, image) = frames(&clip).next().unwrap();
    for model in ["espnet_cityscapes_1024x512.onnx", "twinlitenet_bdd100k_640x360.onnx"] {
        let path = in_data("models").join(model);
        let mask = load_ground_segmenter(&path, &GroundOptions::default(), 0).unwrap().ground_mask(&image).unwrap();
        assert_eq!((mask.width(), mask.height()), image.dimensions());
        let (sky, road) = (share(&mask, 0.0, 0.4), share(&mask, 0.7, 0.9));
        assert!(sky < 0.02 && road > 0.5, "{model}: sky {sky}, road {road}");
    }
}

#[test]
#[ignore = "needs TRACTRIX_DATA"]
fn a_network_of_another_kind_is_refused_with_what_it_has() {
    let semantic = in_data("models/espnet_cityscapes_1024x512.onnx");
    let error = load_segmenter(&semantic, &SegmentationOptions::default(), 0).err().unwrap().to_string();
    assert!(error.contains("logits") && error.contains("YOLO-seg"), "{error}");
    let error = load_ground_segmenter(&in_data(MODEL), &GroundOptions::default(), 0).err().unwrap().to_string();
    assert!(error.contains("output0") && error.contains("semantic"), "{error}");
    let error = load_flow(Some(&semantic), 0).err().unwrap().to_string();
    assert!(error.contains("logits") && error.contains("RAFT"), "{error}");
    let not_a_network = in_data("videos/truth/uav123_car10_a.target_2d.txt");
    let error = load_segmenter(&not_a_network, &SegmentationOptions::default(), 0).err().unwrap().to_string();
    assert!(error.contains("uav123_car10_a"), "{error}");
}

#[test]
#[ignore = "needs TRACTRIX_DATA"]
fn the_annotated_car_is_followed_under_one_id() {
    let outcome = follow(&in_data("videos/uav123_car10_a.mp4"), 40);
    let truth = read_truth(&in_data("videos/truth/uav123_car10_a.target_2d.txt"));
    let (there, found, switches) = against_truth(&outcome, &truth);
    assert_eq!(there, 40);
    assert!(found >= 36 && switches == 0, "followed in {found} of {there} frames, id changes {switches}");
}
