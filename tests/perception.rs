//! Segmentation, flow and tracking on real clips. Reads the folder named by TRACTRIX_DATA (`models/`, `videos/`) and needs
//! ONNX Runtime; without either the tests say so and pass. With TRACTRIX_DUMP naming a folder, overlays are written there.

use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use image::{Rgb, RgbImage};
use tractrix::perception::{
    Evidence, FlowOptions, GroundOptions, SegmentationOptions, Tiling, TrackSummary, TrackedMask, Tracker,
    TrackerOptions, load_flow, load_ground_segmenter, load_segmenter,
};
use tractrix::scene::{BoundingBox, Frame, Mask, ObjectId};
use tractrix::video::Source;

const MODEL: &str = "models/yolov8n-seg_640_fromint8.onnx";

/// The data folder, if it is there and networks can be run.
fn data() -> Option<PathBuf> {
    let Some(folder) = env::var_os("TRACTRIX_DATA").map(PathBuf::from) else {
        println!("skipped: TRACTRIX_DATA is not set");
        return None;
    };
    if let Err(error) = tractrix::ffi::onnx::probe() {
        println!("skipped: {error}");
        return None;
    }
    Some(folder)
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
    segment: Duration,
    flow: Duration,
    track: Duration,
}

/// Segments and tracks the first frames of a clip.
fn follow(clip: &Path, model: &Path, options: &SegmentationOptions, limit: usize, dump: &str) -> Outcome {
    let mut segmenter = load_segmenter(model, options).unwrap();
    let mut estimator = load_flow(None, &FlowOptions::default()).unwrap();
    let mut tracker = Tracker::new(TrackerOptions::default());
    let mut outcome = Outcome::default();
    let mut previous: Option<RgbImage> = None;
    for (frame, image) in frames(clip).take(limit) {
        let start = Instant::now();
        let detections = segmenter.segment(&image).unwrap();
        outcome.segment += start.elapsed();
        let start = Instant::now();
        let flow = previous.as_ref().map(|p| estimator.flow(p, &image).unwrap());
        outcome.flow += start.elapsed();
        let start = Instant::now();
        let masks = tracker.advance(&frame, &image, detections, flow.as_ref()).unwrap();
        outcome.track += start.elapsed();
        assert_disjoint(&masks);
        write_overlay(dump, &frame, &image, &masks);
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

/// Writes a frame with its masks painted over, if a folder for it is named. Carried masks are only outlined.
fn write_overlay(name: &str, frame: &Frame, image: &RgbImage, masks: &[TrackedMask]) {
    let Some(folder) = env::var_os("TRACTRIX_DUMP").map(|root| Path::new(&root).join(name)) else { return };
    std::fs::create_dir_all(&folder).unwrap();
    let mut picture = image.clone();
    for tracked in masks {
        let colour = colour_of(tracked.object);
        let rim = rim(&tracked.mask);
        for (x, y, pixel) in picture.enumerate_pixels_mut() {
            if rim.get(x.into(), y.into()) {
                *pixel = Rgb(colour);
            } else if tracked.evidence != Evidence::Carried && tracked.mask.get(x.into(), y.into()) {
                pixel.0 = std::array::from_fn(|c| ((u16::from(pixel.0[c]) + u16::from(colour[c])) / 2) as u8);
            }
        }
        if let Some(b) = tracked.mask.bounding_box() {
            write_number(&mut picture, b.x0, b.y0.saturating_sub(12), tracked.object.0, colour);
        }
    }
    picture.save(folder.join(format!("{}.png", frame.stem()))).unwrap();
}

fn rim(mask: &Mask) -> Mask {
    let mut rim = mask.dilated(1);
    for (pixel, &inside) in rim.pixels_mut().iter_mut().zip(mask.pixels()) {
        *pixel &= !inside;
    }
    rim
}

fn colour_of(object: ObjectId) -> [u8; 3] {
    const COLOURS: [[u8; 3]; 8] = [
        [230, 60, 60],
        [60, 200, 80],
        [70, 110, 255],
        [240, 200, 40],
        [220, 80, 220],
        [60, 210, 220],
        [250, 140, 40],
        [170, 255, 120],
    ];
    COLOURS[object.0 as usize % COLOURS.len()]
}

/// Digits as 3×5 dots, doubled.
fn write_number(picture: &mut RgbImage, x: u32, y: u32, number: u32, colour: [u8; 3]) {
    const DIGITS: [u16; 10] =
        [0o75557, 0o22222, 0o71747, 0o71717, 0o55711, 0o74717, 0o74757, 0o71111, 0o75757, 0o75717];
    for (i, digit) in number.to_string().bytes().enumerate() {
        let dots = DIGITS[usize::from(digit - b'0')];
        for k in 0..60u32 {
            let (u, v) = (k % 6, k / 6);
            let is_set = dots >> (14 - (v / 2 * 3 + u / 2)) & 1 == 1;
            if is_set && let Some(pixel) = picture.get_pixel_mut_checked(x + i as u32 * 8 + u, y + v) {
                *pixel = Rgb(colour);
            }
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

/// How well the annotated object was followed: frames in which it is there, frames in which a tracked box overlaps it by
/// more than 0.3, and how often the id that overlaps it changes.
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

fn print_outcome(name: &str, outcome: &Outcome) {
    let n = outcome.boxes.len().max(1) as f64;
    let per_frame = |d: Duration| d.as_secs_f64() * 1000.0 / n;
    println!(
        "{name}: {} frames, {} tracks; ms per frame: segmentation {:.0}, flow {:.0}, tracking {:.1}",
        outcome.boxes.len(),
        outcome.tracks.len(),
        per_frame(outcome.segment),
        per_frame(outcome.flow),
        per_frame(outcome.track)
    );
    for t in &outcome.tracks {
        println!(
            "  {:>3} (provisional {:>3}) {:<6} {:.2} frames {}-{}: {} detected, {} carried, {:.0} px",
            t.id,
            t.provisional,
            t.class,
            t.confidence,
            t.first.0,
            t.last.0,
            t.num_detected,
            t.num_carried,
            t.mean_area_px2
        );
    }
}

fn limit() -> usize {
    env::var("TRACTRIX_FRAMES").ok().and_then(|n| n.parse().ok()).unwrap_or(usize::MAX)
}

/// The part of a mask's rows between two fractions of the height that is set.
fn share(mask: &Mask, from: f64, to: f64) -> f64 {
    let rows = (f64::from(mask.height()) * from) as usize..(f64::from(mask.height()) * to) as usize;
    let pixels = &mask.pixels()[rows.start * mask.width() as usize..rows.end * mask.width() as usize];
    pixels.iter().filter(|&&p| p).count() as f64 / pixels.len().max(1) as f64
}

#[test]
fn a_dashcam_shows_vehicles_and_road() {
    let Some(data) = data() else { return };
    let clip = data.join("videos/dashcam_udacity_test_video.mp4");
    let outcome = follow(&clip, &data.join(MODEL), &SegmentationOptions::default(), 4, "short");
    assert!(outcome.tracks.len() >= 2, "{:?}", outcome.tracks);
    assert!(outcome.tracks.iter().all(|t| t.num_detected >= 3));
    let (_, image) = frames(&clip).next().unwrap();
    for model in ["espnet_cityscapes_1024x512.onnx", "twinlitenet_bdd100k_640x360.onnx"] {
        let path = data.join("models").join(model);
        let mask = load_ground_segmenter(&path, &GroundOptions::default()).unwrap().ground_mask(&image).unwrap();
        assert_eq!((mask.width(), mask.height()), image.dimensions());
        let (sky, road) = (share(&mask, 0.0, 0.4), share(&mask, 0.7, 0.9));
        assert!(sky < 0.02 && road > 0.5, "{model}: sky {sky}, road {road}");
    }
}

#[test]
fn a_network_of_another_kind_is_refused_with_what_it_has() {
    let Some(data) = data() else { return };
    let semantic = data.join("models/espnet_cityscapes_1024x512.onnx");
    let error = load_segmenter(&semantic, &SegmentationOptions::default()).err().unwrap().to_string();
    assert!(error.contains("logits") && error.contains("YOLO-seg"), "{error}");
    let error = load_ground_segmenter(&data.join(MODEL), &GroundOptions::default()).err().unwrap().to_string();
    assert!(error.contains("output0") && error.contains("semantic"), "{error}");
    let error = load_flow(Some(&semantic), &FlowOptions::default()).err().unwrap().to_string();
    assert!(error.contains("logits") && error.contains("RAFT"), "{error}");
    let not_a_network = data.join("videos/truth/uav123_car10_a.target_2d.txt");
    let error = load_segmenter(&not_a_network, &SegmentationOptions::default()).err().unwrap().to_string();
    assert!(error.contains("uav123_car10_a"), "{error}");
}

#[test]
#[ignore = "minutes; measures all clips: cargo test --release --test perception -- --ignored --nocapture"]
fn every_clip() {
    let Some(data) = data() else { return };
    let wanted = env::var("TRACTRIX_CLIP").unwrap_or_default();
    for clip in ["uav123_car10_a", "uav123_car14_a", "dashcam_solidWhiteRight", "dashcam_udacity_test_video"] {
        if !clip.contains(&wanted) {
            continue;
        }
        let tilings = if env::var_os("TRACTRIX_TILES").is_some() { vec![Tiling::On] } else { vec![Tiling::Off] };
        for tiling in tilings {
            let options = SegmentationOptions { tiling, ..SegmentationOptions::default() };
            let name = format!("{clip}_{tiling:?}");
            let path = data.join(format!("videos/{clip}.mp4"));
            let outcome = follow(&path, &data.join(MODEL), &options, limit(), &name);
            print_outcome(&name, &outcome);
            let truth = data.join(format!("videos/truth/{clip}.target_2d.txt"));
            if truth.exists() {
                let (there, found, switches) = against_truth(&outcome, &read_truth(&truth));
                println!("  annotated object: in {there} frames, followed in {found}, id changes {switches}");
            }
        }
    }
}
