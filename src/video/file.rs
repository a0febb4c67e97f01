//! A video file, decoded by FFmpeg behind OpenCV.

use std::path::{Path, PathBuf};

use ::image::RgbImage;
use opencv::core::{Mat, MatTraitConst};
use opencv::videoio::{self, CAP_FFMPEG, VideoCapture, VideoCaptureTrait, VideoCaptureTraitConst};

use super::VideoError;
use super::clock::Clock;
use super::decode::Decoder;
use super::{diagnosis, mp4_times};
use crate::image::{resize_rgb, rgb_from_bgr_mat};
use crate::scene::{Frame, FrameId};

/// What the container states about itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Container {
    /// Frames per second, if it is a rate that can be believed.
    pub(super) fps: Option<f64>,
    /// Number of frames; exact for some containers, an estimate for others.
    pub(super) num_frames: Option<u32>,
    /// Rotation metadata, degrees.
    pub(super) rotation_deg: i32,
}

/// Rates beyond this are a time base mistaken for a rate.
const MAX_FPS: f64 = 1000.0;

/// Opens the file for decoding.
pub(super) fn open(path: &Path) -> Result<VideoCapture, VideoError> {
    let mut capture = VideoCapture::from_file(path, CAP_FFMPEG)?;
    if !capture.is_opened()? {
        return Err(diagnosis::why_not(path));
    }
    // Frames come upright. It is OpenCV's default, stated because the result hangs on it; false means "not supported".
    capture.set(videoio::CAP_PROP_ORIENTATION_AUTO, 1.0)?;
    Ok(capture)
}

/// Reads what the container states.
pub(super) fn container(capture: &VideoCapture) -> Result<Container, VideoError> {
    let fps = capture.get(videoio::CAP_PROP_FPS)?;
    let num_frames = capture.get(videoio::CAP_PROP_FRAME_COUNT)?;
    Ok(Container {
        fps: (fps.is_finite() && fps > 0.0 && fps <= MAX_FPS).then_some(fps),
        num_frames: (num_frames.is_finite() && num_frames >= 1.0 && num_frames < f64::from(u32::MAX))
            .then_some(num_frames as u32),
        rotation_deg: capture.get(videoio::CAP_PROP_ORIENTATION_META)? as i32,
    })
}

/// Steps through a video file.
pub(super) struct FileDecoder {
    path: PathBuf,
    capture: VideoCapture,
    clock: Clock,
    next: u32,
    /// Size that every decoded picture must have, pixels.
    size: (u32, u32),
    /// Size that it is brought to.
    target: (u32, u32),
}

impl FileDecoder {
    pub(super) fn open(path: &Path, size: (u32, u32), target: (u32, u32)) -> Result<Self, VideoError> {
        let capture = open(path)?;
        let clock = Clock::new(container(&capture)?.fps, mp4_times::read(path));
        Ok(Self { path: path.to_owned(), capture, clock, next: 0, size, target })
    }

    fn failed(&self, reason: String) -> VideoError {
        VideoError::Frame { path: self.path.clone(), frame: self.next.saturating_sub(1), reason }
    }
}

impl Decoder for FileDecoder {
    fn step(&mut self) -> Option<Frame> {
        if !self.capture.grab().unwrap_or(false) {
            return None;
        }
        let stated_ms = self.capture.get(videoio::CAP_PROP_POS_MSEC).unwrap_or(f64::NAN);
        let id = self.next;
        self.next = id.checked_add(1)?;
        Some(Frame { id: FrameId(id), name: format!("{id:06}.jpg"), time_s: self.clock.advance(stated_ms / 1000.0) })
    }

    fn picture(&mut self) -> Result<RgbImage, VideoError> {
        let picture = match retrieve(&mut self.capture) {
            Ok(Some(picture)) => picture,
            Ok(None) => return Err(self.failed("the decoder gives an empty picture".to_owned())),
            Err(error) => return Err(self.failed(error.to_string())),
        };
        let found = picture.dimensions();
        if found != self.size {
            let ((width, height), (found_width, found_height)) = (self.size, found);
            let (path, frame) = (self.path.clone(), self.next.saturating_sub(1));
            return Err(VideoError::SizeChanges { path, frame, width, height, found_width, found_height });
        }
        if found == self.target {
            return Ok(picture);
        }
        Ok(resize_rgb(&picture, self.target.0, self.target.1)?)
    }

    fn num_guessed(&self) -> u32 {
        self.clock.num_guessed()
    }

    fn num_stepped(&self) -> u32 {
        self.next
    }
}

/// Size of the first picture; `None` if there is none.
pub(super) fn first_size(capture: &mut VideoCapture) -> Result<Option<(u32, u32)>, VideoError> {
    if !capture.grab()? {
        return Ok(None);
    }
    Ok(retrieve(capture)?.map(|picture| picture.dimensions()))
}

/// The picture of the frame that was grabbed last; `None` if the decoder has none.
fn retrieve(capture: &mut VideoCapture) -> Result<Option<RgbImage>, VideoError> {
    let mut mat = Mat::default();
    if !capture.retrieve_def(&mut mat)? || mat.empty() {
        return Ok(None);
    }
    Ok(Some(rgb_from_bgr_mat(&mat)?))
}
