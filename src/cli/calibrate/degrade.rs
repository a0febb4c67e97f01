//! A sequence with worse pictures or masks, as a folder of its own that any command reads.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use rand::Rng as _;
use rand_distr::StandardNormal;
use serde_json::{Value, json};

use super::variant::{Kind, Variant};
use crate::image::{blurred, noisy, resize_rgb};
use crate::io::{Sequence, SequenceFrame, TARGET_LABEL, atomic, json as io_json, masks};
use crate::math::{Rng, seeded_rng};
use crate::scene::{FrameId, LabelMap, Mask};
use crate::video::{Options, Source};

/// Stream of random numbers for the noise of images ("nois"); [`stream`] makes one of each frame from it.
const NOISE: u64 = 0x6e6f_6973;
/// Stream of random numbers for the jitter of masks ("jitt"), likewise.
const JITTER: u64 = 0x6a69_7474;
/// Stream of random numbers for the patch over the target ("cove"), the same in all frames.
const COVER: u64 = 0x636f_7665;
/// Margin of the patch that covers the target, as a share of its box.
const MARGIN: f64 = 0.15;

/// Writes the variant of a sequence into a new folder.
///
/// # Errors
/// What cannot be read of the sequence, or written.
pub(super) fn write(sequence: &Sequence, variant: Variant, folder: &Path, seed: u64) -> anyhow::Result<()> {
    for part in ["images", "masks", "semantic"] {
        fs::create_dir_all(folder.join(part)).with_context(|| format!("{}: cannot be created", folder.display()))?;
    }
    let maker = Maker { sequence, variant, folder, seed, size: size(sequence.frame_size(), variant) };
    let source = Source::open(&sequence.input()?, &Options::default())?;
    for item in source.frames()? {
        let (frame, picture) = item?;
        if let Some(truth) = sequence.frame(frame.id) {
            maker.frame(truth, picture)?;
        }
    }
    maker.describe()?;
    let mesh = "object_mesh.ply";
    fs::copy(sequence.folder.join(mesh), folder.join(mesh)).with_context(|| format!("{mesh}: cannot be copied"))?;
    Ok(())
}

/// Writes the pictures of a clip's variant into a new folder, one for every frame.
///
/// # Errors
/// What cannot be read of the clip, or written.
pub(super) fn write_clip(clip: &Path, variant: Variant, folder: &Path, seed: u64) -> anyhow::Result<()> {
    let images = folder.join("images");
    fs::create_dir_all(&images).with_context(|| format!("{}: cannot be created", images.display()))?;
    let source = Source::open(clip, &Options::default())?;
    let size = size((source.info().width, source.info().height), variant);
    for item in source.frames()? {
        let (frame, picture) = item?;
        let picture = degraded(&picture, variant, size, &mut seeded_rng(seed, stream(NOISE, frame.id)))?;
        write_picture(&images.join(picture_name(variant, frame.id)), &picture, variant)?;
    }
    Ok(())
}

/// Width and height of the variant's frames.
fn size((width, height): (u32, u32), variant: Variant) -> (u32, u32) {
    let factor = if variant.kind == Kind::Scale { variant.level } else { 1.0 };
    let side = |side: u32| ((f64::from(side) * factor).round() as u32).max(1);
    (side(width), side(height))
}

struct Maker<'a> {
    sequence: &'a Sequence,
    variant: Variant,
    folder: &'a Path,
    seed: u64,
    size: (u32, u32),
}

impl Maker<'_> {
    fn frame(&self, truth: &SequenceFrame, picture: RgbImage) -> anyhow::Result<()> {
        let labels = self.sequence.labels(truth)?;
        let is_hidden = self.is_hidden(truth);
        let picture = if is_hidden { self.covered(picture, &labels) } else { picture };
        let picture = degraded(&picture, self.variant, self.size, &mut self.random(NOISE, truth))?;
        let name = picture_name(self.variant, truth.id);
        write_picture(&self.folder.join("images").join(name), &picture, self.variant)?;
        masks::write_label_map(&self.place("masks", truth), &self.labels(truth, labels, is_hidden))?;
        if let Some(semantic) = &truth.semantic {
            let map = masks::read_label_map(&self.sequence.folder.join(semantic), self.sequence.frame_size())?;
            masks::write_label_map(&self.place("semantic", truth), &map.resized(self.size))?;
        }
        Ok(())
    }

    fn place(&self, part: &str, truth: &SequenceFrame) -> PathBuf {
        self.folder.join(part).join(format!("{:06}.png", truth.id.0))
    }

    fn random(&self, kind: u64, truth: &SequenceFrame) -> Rng {
        seeded_rng(self.seed, stream(kind, truth.id))
    }

    /// Returns true if the target is occluded in a frame: those in the middle are.
    fn is_hidden(&self, truth: &SequenceFrame) -> bool {
        if self.variant.kind != Kind::Hidden {
            return false;
        }
        let frames = &self.sequence.frames;
        let index = frames.iter().position(|frame| frame.id == truth.id).unwrap_or(0);
        let from_middle = ((index as f64 + 0.5) / frames.len() as f64 - 0.5).abs();
        from_middle < 0.5 * self.variant.level
    }

    /// The picture with a patch of coarse noise over the target, the same in every frame.
    fn covered(&self, mut picture: RgbImage, labels: &LabelMap) -> RgbImage {
        let Some(bounds) = labels.mask(TARGET_LABEL).bounding_box() else { return picture };
        let margin = |side: u32| (MARGIN * f64::from(side)).ceil() as u32;
        let (dx, dy) = (margin(bounds.width()), margin(bounds.height()));
        let columns = bounds.x0.saturating_sub(dx)..(bounds.x1 + dx).min(picture.width());
        let rows = bounds.y0.saturating_sub(dy)..(bounds.y1 + dy).min(picture.height());
        let mut random = seeded_rng(self.seed, COVER);
        let shades: Vec<u8> = (0..256).map(|_| random.random_range(60..180)).collect();
        for y in rows {
            for x in columns.clone() {
                let shade = shades[(((x - columns.start) / 8 * 31 + (y / 8) * 17) % 256) as usize];
                picture.put_pixel(x, y, image::Rgb([shade; 3]));
            }
        }
        picture
    }

    /// The label map with the target's mask changed.
    fn labels(&self, truth: &SequenceFrame, mut map: LabelMap, is_hidden: bool) -> LabelMap {
        let before = map.mask(TARGET_LABEL);
        let after = match self.variant.kind {
            Kind::Erosion => before.eroded(self.variant.level as u32),
            Kind::Dilation => before.dilated(self.variant.level as u32),
            Kind::Jitter => {
                let mut random = self.random(JITTER, truth);
                let mut by = || (self.variant.level * random.sample::<f64, _>(StandardNormal)).round() as i64;
                let (dx, dy) = (by(), by());
                let from = |at: u32, by: i64| i64::from(at) - by;
                Mask::from_fn(map.width, map.height, |x, y| before.get(from(x, dx), from(y, dy)))
            }
            _ if is_hidden => Mask::empty(map.width, map.height),
            _ => return map.resized(self.size),
        };
        let pixels = (0..map.height).flat_map(|y| (0..map.width).map(move |x| (i64::from(x), i64::from(y))));
        for (label, (x, y)) in map.labels.iter_mut().zip(pixels) {
            match (before.get(x, y), after.get(x, y)) {
                (true, false) => *label = 0,
                (false, true) if *label == 0 => *label = TARGET_LABEL,
                _ => {}
            }
        }
        map
    }

    /// The scene.json of the variant.
    fn describe(&self) -> anyhow::Result<()> {
        let mut scene: Value = io_json::read(&self.sequence.folder.join("scene.json"))?;
        let (width, height) = self.sequence.frame_size();
        let factors = [f64::from(self.size.0) / f64::from(width), f64::from(self.size.1) / f64::from(height)];
        let camera = &self.sequence.camera;
        let [fx, fy] = [0, 1].map(|k| camera.focal[k] * factors[k]);
        let [cx, cy] = [0, 1].map(|k| camera.principal[k] * factors[k]);
        scene["width"] = json!(self.size.0);
        scene["height"] = json!(self.size.1);
        scene["K"] = json!([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]);
        for (frame, truth) in scene["frames"].as_array_mut().into_iter().flatten().zip(&self.sequence.frames) {
            frame["image"] = json!(format!("images/{}", picture_name(self.variant, truth.id)));
            frame["mask"] = json!(format!("masks/{:06}.png", truth.id.0));
            if truth.semantic.is_some() {
                frame["semantic"] = json!(format!("semantic/{:06}.png", truth.id.0));
            }
        }
        Ok(atomic::write_json(&self.folder.join("scene.json"), &scene)?)
    }
}

/// The stream of random numbers of one frame.
fn stream(kind: u64, frame: FrameId) -> u64 {
    kind ^ (u64::from(frame.0) << 32)
}

fn degraded(picture: &RgbImage, variant: Variant, size: (u32, u32), random: &mut Rng) -> anyhow::Result<RgbImage> {
    Ok(match variant.kind {
        Kind::Blur => blurred(picture, variant.level)?,
        Kind::Noise => noisy(picture, variant.level, random),
        Kind::Scale => resize_rgb(picture, size.0, size.1)?,
        _ => picture.clone(),
    })
}

fn write_picture(path: &Path, picture: &RgbImage, variant: Variant) -> anyhow::Result<()> {
    let mut bytes = Vec::new();
    match variant.kind {
        Kind::Compression => {
            JpegEncoder::new_with_quality(&mut bytes, variant.level as u8).encode_image(picture)?;
        }
        _ => picture.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png)?,
    }
    Ok(atomic::write(path, &bytes)?)
}

fn picture_name(variant: Variant, frame: FrameId) -> String {
    let ending = if variant.kind == Kind::Compression { "jpg" } else { "png" };
    format!("{:06}.{ending}", frame.0)
}
