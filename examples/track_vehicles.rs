//! Vehicles of a video, with the time that each part takes, and a picture of every frame if a folder for them is named:
//!
//! ```text
//! cargo run --release --example track_vehicles -- VIDEO MODEL.onnx [NUM_FRAMES] [FOLDER FOR PICTURES]
//! ```
//!
//! MODEL is a YOLO-seg network (`docs/perception.md`); ONNX Runtime must be there (`scripts/fetch-onnxruntime`).

use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use image::{Rgb, RgbImage};
use tractrix::networks::{KnownMasks, SegmentationOptions, load_flow, load_segmenter};
use tractrix::scene::{Frame, Mask, ObjectId};
use tractrix::tracking::{
    BoxSource, DetectedBox, Evidence, FrameInput, TrackSummary, TrackedMask, Tracker, TrackerOptions,
};
use tractrix::video::Source;

/// How long each part took, all frames together.
#[derive(Default)]
struct Times {
    num_frames: u32,
    segmentation: Duration,
    flow: Duration,
    tracking: Duration,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [video, model, rest @ ..] = arguments.as_slice() else {
        return Err("usage: track_vehicles VIDEO MODEL.onnx [NUM_FRAMES] [FOLDER FOR PICTURES]".into());
    };
    let limit = rest.first().map_or(Ok(usize::MAX), |n| n.parse())?;
    let pictures = rest.get(1).map(PathBuf::from);
    let (tracks, times) = follow(video.as_ref(), model.as_ref(), limit, pictures.as_deref())?;
    print_times(&times);
    tracks.iter().for_each(print_track);
    Ok(())
}

/// Segments and tracks the first frames of a video.
fn follow(
    video: &Path,
    model: &Path,
    limit: usize,
    pictures: Option<&Path>,
) -> Result<(Vec<TrackSummary>, Times), Box<dyn Error>> {
    let mut segmenter = load_segmenter(model, &SegmentationOptions::default(), 0)?;
    let mut estimator = load_flow(None, 0)?;
    let mut tracker = Tracker::new(TrackerOptions::default());
    let (mut times, mut previous) = (Times::default(), None::<RgbImage>);
    let source = Source::open(video, &tractrix::video::Options::default())?;
    for item in source.frames()?.take(limit) {
        let (frame, image) = item?;
        let detections = timed(&mut times.segmentation, || segmenter.segment(&image))?;
        let flow = previous
            .map(|previous| timed(&mut times.flow, || estimator.flow(&previous, &image, &tracker.flow_regions())))
            .transpose()?;
        let (found, mut known) = (DetectedBox::of_masks(&detections), KnownMasks::new(detections));
        let look = FrameInput { found, by: BoxSource::Detector, segmenter: Some(&mut known) };
        let masks = timed(&mut times.tracking, || tracker.advance(&frame, &image, look, flow.as_ref()))?;
        if let Some(folder) = pictures {
            write_picture(folder, &frame, &image, &masks)?;
        }
        times.num_frames += 1;
        previous = Some(image);
    }
    Ok((tracker.finish(), times))
}

fn timed<T>(sum: &mut Duration, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *sum += start.elapsed();
    result
}

fn print_times(times: &Times) {
    let per_frame = |d: Duration| d.as_secs_f64() * 1000.0 / f64::from(times.num_frames.max(1));
    println!(
        "{} frames; ms per frame: segmentation {:.0}, flow {:.0}, tracking {:.1}",
        times.num_frames,
        per_frame(times.segmentation),
        per_frame(times.flow),
        per_frame(times.tracking)
    );
}

fn print_track(t: &TrackSummary) {
    println!(
        "{:>3} {:<6} {:.2} frames {}-{}: {} detected, {} carried",
        t.id,
        t.class,
        t.confidence,
        t.first.0,
        t.last.0,
        t.found.detected(),
        t.num_carried
    );
}

/// Writes a frame with its masks painted over. Carried masks are only outlined.
fn write_picture(folder: &Path, frame: &Frame, image: &RgbImage, masks: &[TrackedMask]) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    let mut picture = image.clone();
    for tracked in masks {
        paint(&mut picture, tracked);
        if let Some(b) = tracked.mask.bounding_box() {
            write_number(&mut picture, b.x0, b.y0.saturating_sub(12), tracked.object.0, colour_of(tracked.object));
        }
    }
    Ok(picture.save(folder.join(format!("{}.png", frame.stem())))?)
}

fn paint(picture: &mut RgbImage, tracked: &TrackedMask) {
    let (colour, rim) = (colour_of(tracked.object), rim(&tracked.mask));
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        if rim.get(x.into(), y.into()) {
            *pixel = Rgb(colour);
        } else if tracked.evidence != Evidence::Carried && tracked.mask.get(x.into(), y.into()) {
            pixel.0 = std::array::from_fn(|c| ((u16::from(pixel.0[c]) + u16::from(colour[c])) / 2) as u8);
        }
    }
}

fn rim(mask: &Mask) -> Mask {
    let mut rim = mask.dilated(1);
    mask.iter().for_each(|(x, y)| rim.fill(x..x + 1, y, false));
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
