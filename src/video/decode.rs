//! Common interface of video files and folders of images: frames in order of their index, and an image for those that
//! are requested.

use ::image::RgbImage;

use super::VideoError;
use super::options::{Choice, Selection};
use super::repeats::Change;
use crate::scene::Frame;

/// Properties of a decoded frame before conversion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Inspection {
    /// Size, pixels, if it differs from the first frame's.
    pub(super) other_size: Option<(u32, u32)>,
    /// Difference from the previously inspected frame, if that has the same size.
    pub(super) change: Option<Change>,
    /// True if the frame is interlaced and its fields differ.
    pub(super) is_combed: bool,
}

/// Source of frames in order of their index. Stepping is cheap compared with converting the image.
pub(super) trait Decoder: Send {
    /// Steps to the next frame; `None` at the end, or if no further frame can be decoded.
    ///
    /// # Errors
    /// Only failures of the machine ([`VideoError::is_of_machine`]): the frame may be decodable in another run.
    fn step(&mut self) -> Result<Option<Frame>, VideoError>;

    /// Image of the current frame: upright, at the requested size.
    fn image(&mut self) -> Result<RgbImage, VideoError>;

    /// Inspects the current frame without converting its image.
    fn inspect(&mut self) -> Inspection {
        Inspection::default()
    }

    /// Number of frames stepped to so far.
    fn num_stepped(&self) -> u32;

    /// Number of guessed time stamps among them.
    fn num_guessed(&self) -> u32 {
        0
    }
}

/// Steps to the next selected frame.
///
/// # Errors
/// Those of [`Decoder::step`].
pub(super) fn next_chosen(decoder: &mut dyn Decoder, selection: &mut Selection) -> Result<Option<Frame>, VideoError> {
    while let Some(frame) = decoder.step()? {
        match selection.choose(&frame) {
            Choice::Take => return Ok(Some(frame)),
            Choice::Skip => {}
            Choice::Stop => break,
        }
    }
    Ok(None)
}
