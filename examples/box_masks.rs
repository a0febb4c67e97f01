//! How good the masks of boxes are and what they cost, by setting: rendered sequences with true masks
//! (`docs/formats.md`, a video and `masks/`), every so many frames, the true boxes of all vehicles and the same boxes
//! with sides moved by up to a tenth.
//!
//! ```text
//! cargo run --release --example box_masks -- EVERY SEQUENCE ...
//! ```
//!
//! ONNX Runtime must be there (`scripts/fetch-onnxruntime`).

use std::error::Error;
use std::path::{Path, PathBuf};

use image::RgbImage;
use rustix::time::{ClockId, clock_gettime};
use tractrix::networks::{
    BoxSegmenter, GrabCut, PromptOptions, default_models, load_box_segmenter, load_small_box_segmenter,
};
use tractrix::scene::{Mask, Rect};
use tractrix::video::Source;

/// What is known of a frame.
struct Case {
    image: RgbImage,
    truth: Vec<Mask>,
}

/// Vehicles with a smaller box are left out.
const MIN_SIDE_PX: f64 = 12.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [every, sequences @ ..] = arguments.as_slice() else {
        return Err("usage: box_masks EVERY SEQUENCE ...".into());
    };
    let every: usize = every.parse()?;
    let mut cases = Vec::new();
    for sequence in sequences {
        cases.extend(read(Path::new(sequence), every.max(1))?);
    }
    println!("setting                   mean IoU   below 0.85   none   CPU s a frame | the same, boxes moved");
    let usual = PromptOptions::default();
    let settings = [
        ("as shipped", usual.clone()),
        ("window 2", PromptOptions { window: 2.0, ..usual.clone() }),
        ("window 3", PromptOptions { window: 3.0, ..usual.clone() }),
        ("window 4", PromptOptions { window: 4.0, ..usual.clone() }),
        ("whole frame", PromptOptions { window: 100.0, min_shared: 0.01, ..usual.clone() }),
        ("whole frame, 1024", PromptOptions { window: 100.0, min_shared: 0.01, input_size: 1024, ..usual.clone() }),
        ("input 336", PromptOptions { input_size: 336, ..usual.clone() }),
        ("input 512", PromptOptions { input_size: 512, ..usual.clone() }),
    ];
    let models = default_models()?;
    for (name, options) in settings {
        let mut network = load_box_segmenter(&models.mask_encoder, &models.mask_decoder, &options, 1)?;
        print(name, &cases, network.as_mut())?;
    }
    print("small network", &cases, load_small_box_segmenter(&models.small_masks, &usual, 1)?.as_mut())?;
    print("GrabCut", &cases, &mut GrabCut::new(&usual))
}

/// One line of the table.
fn print(name: &str, cases: &[Case], prompter: &mut dyn BoxSegmenter) -> Result<(), Box<dyn Error>> {
    print!("{name:<24}");
    for share in [0.0, 0.1] {
        let start = cpu_secs();
        let mut overlaps = Vec::new();
        for (c, case) in cases.iter().enumerate() {
            let boxes: Vec<Rect> = case.truth.iter().enumerate().map(|(k, m)| moved(m, share, c * 7 + k)).collect();
            let found = prompter.masks(&case.image, &boxes)?;
            overlaps.extend(found.iter().zip(&case.truth).map(|(f, t)| f.as_ref().map(|f| f.mask.iou(t))));
        }
        let secs = (cpu_secs() - start) / cases.len().max(1) as f64;
        let given: Vec<f64> = overlaps.iter().flatten().copied().collect();
        let mean = given.iter().sum::<f64>() / given.len().max(1) as f64;
        let low = given.iter().filter(|&&iou| iou < 0.85).count();
        print!(" {mean:9.3} {low:5} of {:4} {:6} {secs:9.3}    ", overlaps.len(), overlaps.len() - given.len());
    }
    println!();
    Ok(())
}

/// The box of a mask with its sides moved by up to a share of its size, differently for every number.
fn moved(mask: &Mask, share: f64, number: usize) -> Rect {
    let Some(rect) = mask.bounding_box().map(Rect::from) else { return Rect { x0: 0.0, y0: 0.0, x1: 0.0, y1: 0.0 } };
    let shift = |k: usize| share * (((number * 4 + k) * 7919 % 1000) as f64 / 500.0 - 1.0);
    let (width, height) = (rect.width(), rect.height());
    Rect {
        x0: rect.x0 + shift(0) * width,
        y0: rect.y0 + shift(1) * height,
        x1: rect.x1 + shift(2) * width,
        y1: rect.y1 + shift(3) * height,
    }
}

/// Every so many frames of a sequence in which there are vehicles.
fn read(sequence: &Path, every: usize) -> Result<Vec<Case>, Box<dyn Error>> {
    let source = Source::open(&sequence.join("video.mp4"), &tractrix::video::Options::default())?;
    let mut cases = Vec::new();
    for (number, item) in source.frames()?.enumerate().step_by(every) {
        let (_, image) = item?;
        let truth = vehicles(&sequence.join(format!("masks/{number:05}.png")))?;
        if !truth.is_empty() {
            cases.push(Case { image, truth });
        }
    }
    Ok(cases)
}

/// The vehicles of a frame that are large enough.
fn vehicles(path: &PathBuf) -> Result<Vec<Mask>, Box<dyn Error>> {
    let labels = image::open(path)?.to_luma8();
    let mask = |label: u8| Mask::from_fn(labels.width(), labels.height(), |x, y| labels.get_pixel(x, y).0[0] == label);
    let large = |mask: &Mask| {
        mask.bounding_box().map(Rect::from).is_some_and(|rect| rect.width().max(rect.height()) >= MIN_SIDE_PX)
    };
    Ok((1..=255).map(mask).filter(large).collect())
}

/// Processor time of this program so far.
fn cpu_secs() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
