//! A video file, decoded by FFmpeg.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::image::{RgbImage, imageops};

use super::clock::Clock;
use super::decode::{Decoder, Inspection};
use super::error::regular;
use super::tracks::{self, Chosen};
use super::{VideoError, diagnosis, fields, repeats, shape};
use crate::ffi::ffmpeg::{self, FfmpegError, Luma, MediaFile, Packet, Purpose, RgbConverter};
use crate::files::Growth;
use crate::image::resize_rgb;
use crate::scene::{Frame, FrameId, Warning};

/// Metadata of the container.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Container {
    /// Frames per second, if plausible.
    pub(super) fps: Option<f64>,
    /// Number of frames: the container's count, else its duration times its rate.
    pub(super) num_frames: Option<u32>,
    /// Rotation to be applied, degrees clockwise, from 0 to 359.
    pub(super) rotation_deg: i32,
    /// Number of the video track, from 0.
    pub(super) track: u32,
    /// Remarks on how the file is read, for the user.
    pub(super) remarks: Vec<Warning>,
}

/// Sizes of a frame, upright, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sizes {
    /// Stored size.
    pub(super) stored: (u32, u32),
    /// Size with square pixels.
    pub(super) shown: (u32, u32),
}

/// Maximum plausible frame rate; a higher one is a time base mistaken for a rate.
const MAX_FPS: f64 = 1000.0;

/// A video that is being decoded.
pub(super) struct Video {
    file: MediaFile,
    chosen: Chosen,
    decoder: ffmpeg::Decoder,
    packet: Packet,
    converter: RgbConverter,
    /// Time stamp of time zero, in ticks; that of the first frame if the container has no start time.
    origin: Option<i64>,
}

impl Video {
    /// Opens a video track.
    ///
    /// * `track` – as [`super::Options::track`].
    /// * `growth` – growth of a file that is still being written.
    ///
    /// # Errors
    /// The error found by [`diagnosis`] if FFmpeg rejects the file or there is no such track;
    /// [`VideoError::NoDecoder`]; [`VideoError::Ffmpeg`].
    pub(super) fn open(
        path: &Path,
        purpose: Purpose,
        track: Option<u32>,
        growth: Option<&Arc<Growth>>,
    ) -> Result<Self, VideoError> {
        let refused = |error| diagnosis::refused(path, error);
        regular(path)?;
        let mut file = match growth {
            Some(growth) => MediaFile::open_growing(path, growth.clone()),
            None => MediaFile::open(path),
        }
        .map_err(refused)?;
        let chosen = tracks::choose(&file, path, track)?;
        file.keep_only(chosen.stream.index);
        let decoder = ffmpeg::Decoder::new(&file, chosen.stream.index, purpose).map_err(refused)?;
        let (packet, converter) = (Packet::new()?, RgbConverter::new()?);
        Ok(Self { file, chosen, decoder, packet, converter, origin: chosen.stream.start })
    }

    /// Metadata of the container.
    pub(super) fn container(&self) -> Container {
        let stream = &self.chosen.stream;
        let fps = stream.rate.filter(|fps| *fps <= MAX_FPS);
        let estimated = || Some((stream.duration_s? * fps?).round()).filter(|count| *count >= 1.0);
        let num_frames = stream.num_packets.map(|count| count as f64).or_else(estimated);
        let num_frames = num_frames.filter(|count| *count < f64::from(u32::MAX)).map(|count| count as u32);
        let remarks = self.chosen.remark().into_iter().collect();
        Container { fps, num_frames, rotation_deg: stream.rotation_deg, track: self.chosen.track, remarks }
    }

    /// Advances to the next image and returns its time stamp, seconds, if it has one; `None` at the end.
    fn advance(&mut self) -> Result<Option<Option<f64>>, FfmpegError> {
        if !self.decoder.advance(&mut self.file, &mut self.packet)? {
            return Ok(None);
        }
        Ok(Some(self.decoder.time().map(|ticks| {
            let origin = *self.origin.get_or_insert(ticks);
            self.chosen.stream.time_base.seconds(ticks.saturating_sub(origin))
        })))
    }

    /// Size of the image with square pixels, before rotation.
    fn squared(&self) -> (u32, u32) {
        let aspect = self.file.pixel_aspect(self.chosen.stream.index, &self.decoder);
        shape::squared(self.decoder.size(), aspect)
    }

    fn sizes(&self) -> Sizes {
        let is_turned = matches!(self.chosen.stream.rotation_deg, 90 | 270);
        let upright = |(width, height)| if is_turned { (height, width) } else { (width, height) };
        Sizes { stored: upright(self.decoder.size()), shown: upright(self.squared()) }
    }

    /// Returns true if the image is declared interlaced and its fields differ.
    fn is_combed(&self) -> bool {
        let is_declared = self.chosen.stream.is_interlaced || self.decoder.is_interlaced();
        is_declared && self.decoder.luma(1).is_some_and(|luma| fields::is_combed(&luma))
    }

    /// Converts the image: of one instant, with square pixels, upright.
    fn image(&mut self) -> Result<RgbImage, VideoError> {
        let mut image = match self.is_combed() {
            true => fields::filled(&self.converter.convert_upper_field(&self.decoder)?, self.decoder.size().1),
            false => self.converter.convert(&self.decoder)?,
        };
        let (width, height) = self.squared();
        if (width, height) != image.dimensions() {
            image = resize_rgb(&image, width, height)?;
        }
        Ok(match self.chosen.stream.rotation_deg {
            90 => imageops::rotate90(&image),
            180 => imageops::rotate180(&image),
            270 => imageops::rotate270(&image),
            _ => image,
        })
    }

    /// Sizes of the first image; `None` if there is none.
    pub(super) fn first_sizes(mut self) -> Result<Option<Sizes>, VideoError> {
        if self.advance()?.is_none() {
            return Ok(None);
        }
        // Unknown pixel formats are detected here.
        self.converter.convert(&self.decoder)?;
        Ok(Some(self.sizes()))
    }
}

/// Steps through a video file.
pub(super) struct FileDecoder {
    path: PathBuf,
    video: Video,
    clock: Clock,
    next: u32,
    /// Required size of every decoded image, upright and with square pixels.
    size: (u32, u32),
    /// Size after resizing.
    target: (u32, u32),
    /// Luma of the last inspected frame.
    luma: Option<Luma>,
}

impl FileDecoder {
    pub(super) fn open(
        path: &Path,
        purpose: Purpose,
        track: Option<u32>,
        size: (u32, u32),
        target: (u32, u32),
        growth: Option<&Arc<Growth>>,
    ) -> Result<Self, VideoError> {
        let video = Video::open(path, purpose, track, growth)?;
        let clock = Clock::new(video.container().fps);
        Ok(Self { path: path.to_owned(), video, clock, next: 0, size, target, luma: None })
    }
}

impl Decoder for FileDecoder {
    fn step(&mut self) -> Result<Option<Frame>, VideoError> {
        let Some(stated_s) = self.video.advance()? else { return Ok(None) };
        let id = self.next;
        let Some(next) = id.checked_add(1) else { return Ok(None) };
        self.next = next;
        Ok(Some(Frame { id: FrameId(id), name: format!("{id:06}.jpg"), time_s: self.clock.advance(stated_s) }))
    }

    fn image(&mut self) -> Result<RgbImage, VideoError> {
        let (path, frame) = (|| self.path.clone(), self.next.saturating_sub(1));
        // Checked before the conversion: the size in a damaged header may exceed the memory.
        let found = self.video.sizes().shown;
        if found != self.size {
            let ((width, height), (found_width, found_height)) = (self.size, found);
            return Err(VideoError::SizeChanges { path: path(), frame, width, height, found_width, found_height });
        }
        let failed = |error: VideoError| match error {
            VideoError::Ffmpeg(FfmpegError::Memory) => error,
            error => VideoError::Frame { path: path(), frame, reason: error.to_string() },
        };
        let image = self.video.image().map_err(failed)?;
        if found == self.target {
            return Ok(image);
        }
        Ok(resize_rgb(&image, self.target.0, self.target.1)?)
    }

    fn inspect(&mut self) -> Inspection {
        let size = self.video.sizes().shown;
        let luma = self.video.decoder.luma(repeats::ROW_STEP);
        let change = self.luma.as_ref().zip(luma.as_ref()).and_then(|(last, luma)| repeats::change(last, luma));
        self.luma = luma;
        let other_size = (size != self.size).then_some(size);
        Inspection { other_size, change, is_combed: self.video.is_combed() }
    }

    fn num_guessed(&self) -> u32 {
        self.clock.num_guessed()
    }

    fn num_stepped(&self) -> u32 {
        self.next
    }
}
