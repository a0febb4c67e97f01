//! Images of the page: the film, the strip, and a portrait of each vehicle, made in one pass over the frames.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use image::{RgbImage, imageops};
use serde::{Deserialize, Serialize};

use super::ReportError;
use super::overlay::{Label, Silhouette, Thumbnail, drawn, jpeg, shrunk, spread, strip_frames};
use crate::ffi::ffmpeg::{Encoder, FfmpegError};
use crate::files;
use crate::scene::{BoundingBox, FrameId, Mask, ObjectId};

/// Maximum number of frames of the film: at 6 to 8 kB each the page can still be mailed. Of a longer clip evenly spaced
/// frames are shown.
const MAX_FILM_FRAMES: usize = 600;
/// Frame rate of the film; the page seeks in it by frame number.
pub(super) const FILM_RATE: f64 = 25.0;

/// Images of the page.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pictures {
    /// The frames with masks drawn in, as a video; `None` if FFmpeg has no encoder of H.264.
    pub film: Option<Film>,
    /// Images of the strip, ascending in time.
    pub strip: Vec<Thumbnail>,
    /// JPEG file of each vehicle, from the frame in which its mask is largest.
    pub portraits: BTreeMap<ObjectId, Vec<u8>>,
}

/// A video of 25 frames per second.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Film {
    /// The MP4 file.
    pub mp4: Vec<u8>,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Frame of each image.
    pub frames: Vec<FrameId>,
    /// Numbers of the vehicles in each image.
    pub labels: Vec<Vec<Label>>,
}

/// Builder of the page's images from frames that are pushed one by one.
pub struct PictureMaker {
    path: PathBuf,
    of_film: BTreeSet<FrameId>,
    of_strip: BTreeSet<FrameId>,
    encoder: Option<Encoder>,
    film: Option<Film>,
    strip: Vec<Thumbnail>,
    portraits: BTreeMap<ObjectId, (u64, RgbImage)>,
}

impl PictureMaker {
    /// * `frames` – all frames of the run, ascending.
    /// * `path` – file for the film while it is made.
    pub fn new(frames: &[FrameId], path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            of_film: spread(frames.len(), MAX_FILM_FRAMES).into_iter().map(|k| frames[k]).collect(),
            of_strip: strip_frames(frames).into_iter().collect(),
            encoder: None,
            film: Some(Film::default()),
            strip: Vec::new(),
            portraits: BTreeMap::new(),
        }
    }

    /// Frames to be pushed.
    pub fn wanted(&self) -> BTreeSet<FrameId> {
        self.of_film.union(&self.of_strip).copied().collect()
    }

    /// Adds the next frame.
    ///
    /// # Errors
    /// [`ReportError::Picture`] if the image is empty, [`ReportError::Film`] if the film cannot be written.
    pub fn push(&mut self, frame: FrameId, picture: &RgbImage, masks: &[(ObjectId, &Mask)]) -> Result<(), ReportError> {
        let silhouettes = Silhouette::of_all(masks);
        if self.of_strip.contains(&frame) {
            self.strip.push(Thumbnail::new(frame, picture, &silhouettes)?);
        }
        for silhouette in &silhouettes {
            self.keep_portrait(picture, silhouette)?;
        }
        if self.of_film.contains(&frame) && self.film.is_some() {
            // Longer side of the film, pixels.
            match self.add_to_film(frame, shrunk(picture, 640)?, &silhouettes) {
                // Without such an encoder the page has only the strip.
                Err(FfmpegError::NoEncoder | FfmpegError::Encoder(_)) => self.film = None,
                Err(source) => return Err(ReportError::Film(source)),
                Ok(()) => {}
            }
        }
        Ok(())
    }

    fn add_to_film(&mut self, frame: FrameId, small: RgbImage, silhouettes: &[Silhouette]) -> Result<(), FfmpegError> {
        let mut small = drawn(small, silhouettes);
        let film = self.film.get_or_insert_default();
        let encoder = match &mut self.encoder {
            Some(encoder) => encoder,
            none => {
                (film.width, film.height) = small.dimensions();
                none.insert(Encoder::preview(&self.path, small.dimensions(), FILM_RATE)?)
            }
        };
        if small.dimensions() != (film.width, film.height) {
            // A photograph of another size.
            small = fitted(&small, (film.width, film.height));
        }
        encoder.add(&small, film.frames.len() as f64 / FILM_RATE)?;
        film.frames.push(frame);
        film.labels.push(silhouettes.iter().map(Silhouette::label).collect());
        Ok(())
    }

    /// Keeps the masked part of an image, if its bounding box is larger than the vehicle's previous ones.
    fn keep_portrait(&mut self, picture: &RgbImage, silhouette: &Silhouette) -> Result<(), ReportError> {
        let Silhouette { id, bounds: found, .. } = *silhouette;
        let area = u64::from(found.x1 - found.x0) * u64::from(found.y1 - found.y0);
        if self.portraits.get(&id).is_some_and(|(largest, _)| area <= *largest) {
            return Ok(());
        }
        let BoundingBox { x0, y0, x1, y1 } = with_border(found, picture.dimensions());
        let cut = imageops::crop_imm(picture, x0, y0, x1 - x0, y1 - y0).to_image();
        // Twice its size on the page.
        self.portraits.insert(id, (area, shrunk(&cut, 144)?));
        Ok(())
    }

    /// The images.
    ///
    /// # Errors
    /// [`ReportError::Film`] if the film cannot be written or read again.
    pub fn finish(mut self) -> Result<Pictures, ReportError> {
        if let Some(encoder) = self.encoder.take() {
            encoder.finish().map_err(ReportError::Film)?;
        }
        let film = match self.film.filter(|film| !film.frames.is_empty()) {
            Some(film) => {
                let failed = |source| ReportError::Write { path: self.path.clone(), source };
                let mp4 = files::read(&self.path).map_err(failed)?;
                Some(Film { mp4, ..film })
            }
            None => None,
        };
        let portrait = |(id, (_, picture)): (ObjectId, (u64, RgbImage))| Some((id, jpeg(&picture, 80).ok()?));
        let portraits = self.portraits.into_iter().filter_map(portrait).collect();
        Ok(Pictures { film, strip: self.strip, portraits })
    }
}

/// An image scaled to fit and centered in a black one of the given size.
fn fitted(picture: &RgbImage, (width, height): (u32, u32)) -> RgbImage {
    let (own_width, own_height) = picture.dimensions();
    let scale = (f64::from(width) / f64::from(own_width)).min(f64::from(height) / f64::from(own_height));
    let side = |own: u32, most: u32| ((f64::from(own) * scale).round() as u32).clamp(1, most);
    let (fit_width, fit_height) = (side(own_width, width), side(own_height, height));
    let fit = imageops::resize(picture, fit_width, fit_height, imageops::FilterType::Triangle);
    let mut out = RgbImage::new(width, height);
    imageops::replace(&mut out, &fit, i64::from((width - fit_width) / 2), i64::from((height - fit_height) / 2));
    out
}

/// A box with a margin.
fn with_border(found: BoundingBox, (width, height): (u32, u32)) -> BoundingBox {
    let longer = (found.x1 - found.x0).max(found.y1 - found.y0);
    // Border around the mask in a portrait, as a share of the mask's longer side.
    let border = (0.15 * f64::from(longer)).ceil() as u32;
    BoundingBox {
        x0: found.x0.saturating_sub(border),
        y0: found.y0.saturating_sub(border),
        x1: (found.x1 + border).min(width),
        y1: (found.y1 + border).min(height),
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    #[test]
    fn a_film_a_strip_and_portraits_come_from_one_pass() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = (0..30).map(FrameId).collect();
        let mut maker = PictureMaker::new(&frames, &folder.path().join("film.mp4"));
        assert_eq!(maker.wanted().len(), 30);
        let picture = RgbImage::from_pixel(1280, 720, Rgb([90, 120, 60]));
        for (k, &frame) in frames.iter().enumerate() {
            let size = 20 + 2 * k as u32;
            let mask = Mask::from_fn(1280, 720, |x, y| (1200..1200 + size).contains(&x) && y < size);
            maker.push(frame, &picture, &[(ObjectId(3), &mask)]).unwrap();
        }
        let made = maker.finish().unwrap();
        assert_eq!(made.strip.len(), 16);
        let portrait = image::load_from_memory(&made.portraits[&ObjectId(3)]).unwrap();
        assert_eq!((portrait.width(), portrait.height()), (92, 90), "78 px, and a border of 12 px within the picture");
        // FFmpeg without H.264 produces none.
        if let Some(film) = made.film {
            assert_eq!((film.width, film.height, film.frames.len(), film.labels.len()), (640, 360, 30, 30));
            assert!(film.mp4.len() < 100_000, "{}", film.mp4.len());
        }
    }
}
