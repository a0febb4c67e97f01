//! Moving objects before a camera that does not translate: what differs from the median of the frames around.
//!
//! Rotations align such frames, so that a vehicle shows itself by its pixels, however small it is, and needs no corners
//! that can be followed (median background: B. P. L. Lo and S. A. Velastin, *Automatic congestion detection system for
//! underground platforms*, ISIMP 2001). The sway of a drone moves houses against the ground by a pixel or two, and wind
//! moves leaves: such differences stay where they are, and only what leaves its place is an object.

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

/// Time before and after a frame from which its background is taken, seconds: a vehicle of 5 m at walking speed covers
/// a place for less than half of it.
const AROUND_S: f64 = 4.0;
/// Frames of which the median is taken: half of them may show something else.
const NUM_SAMPLES: usize = 9;
/// Time for which one median serves, before and after its own, seconds: it takes nine warps, a comparison one.
const SERVES_S: f64 = 0.5;

/// Standard deviation of the blur against noise and jagged edges, pixels.
const BLUR_PX: f64 = 0.8;

/// Boxes of something that moves, whatever found it.
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

/// Compares frames, some time apart, with those around them.
pub struct DifferenceDetector<'a> {
    surroundings: Surroundings<'a>,
    /// Width and height at which frames are compared.
    work: (u32, u32),
    /// Frames that wait for later ones, after those that are done and still serve as surroundings.
    looks: VecDeque<Look>,
    num_done: usize,
    median: Option<SceneMedian>,
    linker: Linker,
}

/// A frame that is compared, at the working size; black where it shows nothing.
struct Look {
    index: u32,
    time_s: f64,
    view: View,
    picture: RgbImage,
}

impl<'a> DifferenceDetector<'a> {
    /// Nothing seen yet. Larger frames are shrunk as for the follower.
    pub fn new(surroundings: Surroundings<'a>) -> Self {
        let (width, height) = surroundings.size;
        let work = scale_to_fit(width, height, MAX_SIDE_PX);
        Self { surroundings, work, looks: VecDeque::new(), num_done: 0, median: None, linker: Linker::default() }
    }

    /// Takes a frame, later than those before; one without a camera is skipped.
    ///
    /// # Errors
    /// [`ImageError`] if OpenCV fails.
    pub fn push(&mut self, index: u32, picture: &RgbImage) -> Result<(), ImageError> {
        let known = self.surroundings.view(index).zip(self.surroundings.times_s.get(index as usize));
        let Some((&view, &time_s)) = known else { return Ok(()) };
        let mut picture = blurred(&resize_rgb_quickly(picture, self.work.0, self.work.1)?, BLUR_PX)?;
        picture.iter_mut().for_each(|value| *value = (*value).max(1));
        let view = View { camera: view.camera.resized(self.work.0, self.work.1), ..view };
        self.looks.push_back(Look { index, time_s, view, picture });
        self.advance(time_s - AROUND_S - SERVES_S)
    }

    /// All objects, those that were seen first at the front.
    ///
    /// # Errors
    /// [`ImageError`] if OpenCV fails.
    pub fn finish(mut self) -> Result<Vec<MovingObject>, ImageError> {
        self.advance(f64::INFINITY)?;
        Ok(self.linker.finish(&self.surroundings))
    }

    /// Compares all frames up to a time, and forgets those that no later one needs.
    fn advance(&mut self, until_s: f64) -> Result<(), ImageError> {
        while let Some(look) = self.looks.get(self.num_done).filter(|look| look.time_s <= until_s) {
            if self.median.as_ref().is_none_or(|median| look.time_s > median.time_s + SERVES_S) {
                self.median = Some(self.median_for(look)?);
            }
            if let Some(median) = &self.median {
                let found = median.differences(look)?;
                self.linker.push(look, &found);
            }
            self.num_done += 1;
            let needed_s = look.time_s - AROUND_S;
            let num_past = self.looks.iter().take_while(|past| past.time_s < needed_s).count();
            self.looks.drain(..num_past);
            self.num_done -= num_past;
        }
        Ok(())
    }

    /// The median that serves a frame and those after it.
    fn median_for(&self, look: &Look) -> Result<SceneMedian, ImageError> {
        let time_s = look.time_s + SERVES_S;
        let near: Vec<&Look> = self.looks.iter().filter(|near| (near.time_s - time_s).abs() <= AROUND_S).collect();
        let count = NUM_SAMPLES.min(near.len());
        let samples: Vec<&Look> = (0..count).map(|k| near[(2 * k + 1) * near.len() / (2 * count)]).collect();
        SceneMedian::new(look.view, time_s, &samples)
    }
}

/// Target from source, pixels of two views from one place. Distortion of the lens is left out: between frames of a few
/// seconds it differs by little.
fn homography(target: &View, source: &View) -> Matrix3<f64> {
    let turn = target.cam_from_world.rotation * source.cam_from_world.rotation.inverse();
    let rays = source.camera.matrix().try_inverse().unwrap_or_else(Matrix3::identity);
    target.camera.matrix() * turn.to_rotation_matrix().matrix() * rays
}
