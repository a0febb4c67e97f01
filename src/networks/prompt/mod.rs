//! Masks of boxes: which pixels of a box are the object.

mod box_net;
mod by_size;
mod grabcut;
mod known;
mod local;
mod mobile_sam;
mod options;
mod outline;
mod window;

use ::image::RgbImage;
use serde::{Deserialize, Serialize};

pub use self::box_net::load_small_box_segmenter;
pub use self::by_size::BySize;
pub use self::grabcut::GrabCut;
pub use self::known::KnownMasks;
pub use self::mobile_sam::load_box_segmenter;
use self::options::FILL;
pub use self::options::PromptOptions;
use super::PerceptionError;
use crate::scene::{Mask, Rect};

/// The pixels of one box's object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoxMask {
    /// Its pixels, at the frame's resolution.
    pub mask: Mask,
    /// Mask quality by the segmenter's own estimate: the expected intersection over union, 0 to 1.
    pub quality: f64,
}

/// Finds the pixels of objects whose boxes are known.
pub trait BoxSegmenter {
    /// One answer per box, in their order; `None` where there is no mask that could be the object's: the box is empty,
    /// or what was found in it is not trustworthy.
    ///
    /// # Errors
    /// When the network cannot be run or answers in a shape that its family does not allow.
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError>;

    /// Returns true if the masks are coarse: good for finding the object, not for its outline.
    fn is_coarse(&self) -> bool;
}

/// Boxes that overlap so much agree: those of detectors are off by a tenth of their sides.
const AGREEMENT: f64 = 0.75;

/// Agreement of the box round a mask with the box prompt, 0 to 1.
fn agreement(found: &Rect, asked: &Rect) -> f64 {
    (found.iou(asked) / AGREEMENT).min(1.0)
}

/// Returns true if a mask fills neither too little nor too much of its box.
fn fills(mask: &Mask, rect: &Rect) -> bool {
    FILL.contains(&(mask.area_px2() as f64 / rect.area_px2()))
}

/// The part of a box that lies in a frame; of no area for one that is not finite.
fn visible(rect: &Rect, frame: (u32, u32)) -> Rect {
    let finite = [rect.x0, rect.y0, rect.x1, rect.y1].iter().all(|side| side.is_finite());
    if finite { rect.clipped(frame.0, frame.1) } else { Rect { x0: 0.0, y0: 0.0, x1: 0.0, y1: 0.0 } }
}
