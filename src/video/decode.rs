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
    /// Its size, pixels, if it differs from the first frame's.
    pub(super) other_size: Option<(u32, u32)>,
    /// Difference from the frame inspected before, if there is one of the same size.
    pub(super) change: Option<Change>,
    /// It is interlaced, and its fields differ.
    pub(super) is_combed: bool,
}

/// Something that gives frames in order of their index. Stepping is cheap next to making the picture.
pub(super) trait Decoder: Send {
    /// Steps to the next frame; `None` at the end, or where nothing further can be decoded.
    ///
    /// # Errors
    /// Where the machine is at fault ([`VideoError::is_of_machine`]): the frame may be there another time.
    fn step(&mut self) -> Result<Option<Frame>, VideoError>;

    /// The picture of the frame last stepped to: upright, at the size asked for.
    fn picture(&mut self) -> Result<RgbImage, VideoError>;

    /// Examines the frame last stepped to without making a picture of it.
    fn inspect(&mut self) -> Inspection {
        Inspection::default()
    }

    /// Frames stepped to so far.
    fn num_stepped(&self) -> u32;

    /// Time stamps among them that had to be guessed.
    fn num_guessed(&self) -> u32 {
        0
    }
}

/// Steps to the next frame that is chosen.
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
