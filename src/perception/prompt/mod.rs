//! Masks of boxes: which pixels of a box are the object.

use ::image::RgbImage;

use super::PerceptionError;
use crate::scene::{Mask, Rect};

/// The pixels of one box's object.
#[derive(Clone, Debug, PartialEq)]
pub struct Prompted {
    /// Its pixels, at the frame's resolution.
    pub mask: Mask,
    /// How good the mask is, in the words of what made it: the expected intersection over union, 0 to 1.
    pub quality: f64,
}

/// Finds the pixels of objects whose boxes are known.
pub trait Prompter {
    /// One answer per box, in their order; `None` where there is no mask that could be the object's: the box is empty,
    /// or what was found in it is not trustworthy.
    ///
    /// # Errors
    /// When the network cannot be run or answers in a shape that its family does not allow.
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<Prompted>>, PerceptionError>;

    /// Whether the masks are coarse: good for finding the object, not for its outline.
    fn is_coarse(&self) -> bool;
}
