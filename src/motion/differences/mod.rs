//! Moving objects in the view of a camera that does not translate, by differences from a median background.
//!
//! Rotations align such frames, so pixels suffice to detect a vehicle of any size, without corners to track (median
//! background: B. P. L. Lo and S. A. Velastin, *Automatic congestion detection system for underground platforms*, ISIMP
//! 2001). The sway of a drone moves houses against the ground by a pixel or two, and wind moves leaves. Such
//! differences keep their positions; only a region with a displacement is an object.

mod linking;
mod regions;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};

use nalgebra::Matrix3;

use super::follower::MAX_SIDE_PX;
use super::{Mover, Surroundings, View};
use crate::image::{ImageError, RgbImage, blurred, resize_rgb_quickly, scale_to_fit};
use crate::scene::Rect;
use linking::Linker;
use regions::SceneMedian;

/// Time before and after a frame from which its background is computed, seconds: a vehicle of 5 m at walking speed
/// covers a position for less than half of it.
const WINDOW_S: f64 = 4.0;
/// Number of frames of the median: fewer than half of them may show a moving object at a pixel.
const NUM_SAMPLES: usize = 9;
/// Time before and after a median for which it is used, seconds: it takes nine warps, a comparison one.
const MEDIAN_REUSE_S: f64 = 0.5;

/// Standard deviation of the blur against noise and jagged edges, pixels.
const BLUR_PX: f64 = 0.8;

/// Boxes of a moving object, independent of the detector.
#[derive(Clone, Debug, PartialEq)]
pub struct MovingObject {
    /// Its box in each frame, pixels.
    pub boxes: BTreeMap<u32, Rect>,
    /// Confidence, 0 to 1.
    pub confidence: f64,
}

impl From<Mover> for MovingObject {
    fn from(Mover { boxes, confidence, .. }: Mover) -> Self {
        Self { boxes, confidence }
    }
}

/// Detector of moving objects that compares sampled frames with the frames before and after.
pub struct DifferenceDetector<'a> {
    surroundings: Surroundings<'a>,
    /// Width and height at which frames are compared.
    working_size: (u32, u32),
    /// Processed frames still needed for a background, then frames that wait for later ones.
    frames: VecDeque<ComparedFrame>,
    num_done: usize,
    median: Option<SceneMedian>,
    linker: Linker,
}

/// Compared frame at the working size; black outside the image.
struct ComparedFrame {
    index: u32,
    time_s: f64,
    view: View,
    image: RgbImage,
}

impl<'a> DifferenceDetector<'a> {
    /// Detector without frames; larger frames are downscaled as for the follower.
    pub fn new(surroundings: Surroundings<'a>) -> Self {
        let (width, height) = surroundings.size;
        let working_size = scale_to_fit(width, height, MAX_SIDE_PX);
        Self {
            surroundings,
            working_size,
            frames: VecDeque::new(),
            num_done: 0,
            median: None,
            linker: Linker::default(),
        }
    }

    /// Adds a frame, later than those before; a frame without a camera is skipped.
    ///
    /// # Errors
    /// [`ImageError`] if OpenCV fails.
    pub fn push(&mut self, index: u32, image: &RgbImage) -> Result<(), ImageError> {
        let known = self.surroundings.view(index).zip(self.surroundings.times_s.get(index as usize));
        let Some((&view, &time_s)) = known else { return Ok(()) };
        let mut image = blurred(&resize_rgb_quickly(image, self.working_size.0, self.working_size.1)?, BLUR_PX)?;
        image.iter_mut().for_each(|value| *value = (*value).max(1));
        let view = View { camera: view.camera.resized(self.working_size.0, self.working_size.1), ..view };
        self.frames.push_back(ComparedFrame { index, time_s, view, image });
        self.advance(time_s - WINDOW_S - MEDIAN_REUSE_S)
    }

    /// Returns all objects, in the order of their first frames.
    ///
    /// # Errors
    /// [`ImageError`] if OpenCV fails.
    pub fn finish(mut self) -> Result<Vec<MovingObject>, ImageError> {
        self.advance(f64::INFINITY)?;
        Ok(self.linker.finish(&self.surroundings))
    }

    /// Compares all frames up to a time, and drops those that no later frame needs.
    fn advance(&mut self, until_s: f64) -> Result<(), ImageError> {
        while let Some(frame) = self.frames.get(self.num_done).filter(|frame| frame.time_s <= until_s) {
            if self.median.as_ref().is_none_or(|median| frame.time_s > median.time_s + MEDIAN_REUSE_S) {
                self.median = Some(self.median_for(frame)?);
            }
            if let Some(median) = &self.median {
                let found = median.differences(frame)?;
                self.linker.push(frame, &found);
            }
            self.num_done += 1;
            let needed_s = frame.time_s - WINDOW_S;
            let num_past = self.frames.iter().take_while(|past| past.time_s < needed_s).count();
            self.frames.drain(..num_past);
            self.num_done -= num_past;
        }
        Ok(())
    }

    /// Median background of a frame and those after it.
    fn median_for(&self, frame: &ComparedFrame) -> Result<SceneMedian, ImageError> {
        let time_s = frame.time_s + MEDIAN_REUSE_S;
        let near: Vec<&ComparedFrame> =
            self.frames.iter().filter(|near| (near.time_s - time_s).abs() <= WINDOW_S).collect();
        let count = NUM_SAMPLES.min(near.len());
        let samples: Vec<&ComparedFrame> = (0..count).map(|k| near[(2 * k + 1) * near.len() / (2 * count)]).collect();
        SceneMedian::new(frame.view, time_s, &samples)
    }
}

/// Homography from source to target pixels of two views with one center.
///
/// Lens distortion is ignored: within a few seconds its change is small.
fn homography(target: &View, source: &View) -> Matrix3<f64> {
    let turn = target.cam_from_world.rotation * source.cam_from_world.rotation.inverse();
    let rays = source.camera.matrix().try_inverse().unwrap_or_else(Matrix3::identity);
    target.camera.matrix() * turn.to_rotation_matrix().matrix() * rays
}
