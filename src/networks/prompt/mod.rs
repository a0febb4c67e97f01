//! Masks of objects from box prompts.

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

/// Mask of the object in one box, with its quality.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoxMask {
    /// Mask at the resolution of the frame.
    pub mask: Mask,
    /// Quality by the segmenter's own estimate: the expected intersection over union with the truth, 0 to 1.
    pub quality: f64,
}

/// Promptable segmentation: masks of objects from their boxes.
pub trait BoxSegmenter {
    /// Segments the object in each box; one result per box, in their order.
    ///
    /// `None` where there is no acceptable mask: the box is empty, or the mask fails a quality test.
    ///
    /// # Errors
    /// If the network cannot be run, or the shape of its output is not that of its family.
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError>;

    /// Returns true if the masks are coarse: sufficient for localization, not for the outline.
    fn is_coarse(&self) -> bool;
}

/// IoU from which two boxes agree fully: detected boxes are off by a tenth of their sides.
const AGREEMENT: f64 = 0.75;

/// Agreement of the bounding box of a mask with the box prompt, 0 to 1.
fn agreement(found: &Rect, prompt: &Rect) -> f64 {
    (found.iou(prompt) / AGREEMENT).min(1.0)
}

/// Returns true if the area of a mask relative to its box is within [`FILL`].
fn fills(mask: &Mask, rect: &Rect) -> bool {
    FILL.contains(&(mask.area_px2() as f64 / rect.area_px2()))
}

/// Part of a box within a frame; an empty box if its coordinates are not finite.
fn visible(rect: &Rect, frame: (u32, u32)) -> Rect {
    let finite = [rect.x0, rect.y0, rect.x1, rect.y1].iter().all(|side| side.is_finite());
    if finite { rect.clipped(frame.0, frame.1) } else { Rect { x0: 0.0, y0: 0.0, x1: 0.0, y1: 0.0 } }
}
