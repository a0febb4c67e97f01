//! A video file, decoded by FFmpeg.

use std::path::{Path, PathBuf};

use ::image::{RgbImage, imageops};

use super::clock::Clock;
use super::decode::Decoder;
use super::error::regular;
use super::{VideoError, diagnosis};
use crate::ffi::ffmpeg::{self, FfmpegError, MediaFile, Packet, Purpose, RgbConverter, Stream, StreamKind};
use crate::image::resize_rgb;
use crate::scene::{Frame, FrameId};

/// What the container states about itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Container {
    /// Frames per second, if it is a rate that can be believed.
    pub(super) fps: Option<f64>,
    /// Number of frames: as the container counts them, else its length times its rate.
    pub(super) num_frames: Option<u32>,
    /// Rotation that is asked for, degrees clockwise, from 0 to 359.
    pub(super) rotation_deg: i32,
}

/// Rates beyond this are a time base mistaken for a rate.
const MAX_FPS: f64 = 1000.0;

/// A video that is being decoded.
pub(super) struct Video {
    file: MediaFile,
    stream: Stream,
    decoder: ffmpeg::Decoder,
    packet: Packet,
    converter: RgbConverter,
    /// Time stamp that counts as zero, in ticks; that of the first picture where the container states no start.
    origin: Option<i64>,
}

impl Video {
    /// Opens the first stream of moving pictures.
    ///
    /// # Errors
    /// What [`diagnosis`] finds, where FFmpeg does not take the file or there is no such stream;
    /// [`VideoError::NoDecoder`]; [`VideoError::Ffmpeg`].
    pub(super) fn open(path: &Path, purpose: Purpose) -> Result<Self, VideoError> {
        let refused = |error| match error {
            FfmpegError::Open(_) => diagnosis::why_not(path),
            FfmpegError::NoDecoder(coding) => VideoError::NoDecoder { path: path.to_owned(), coding },
            other => VideoError::Ffmpeg(other),
        };
        regular(path)?;
        let mut file = MediaFile::open(path).map_err(refused)?;
        let stream = diagnosis::moving_pictures(&file, path)?;
        file.keep_only(stream.index);
        let decoder = ffmpeg::Decoder::new(&file, stream.index, purpose).map_err(refused)?;
        let (packet, converter) = (Packet::new()?, RgbConverter::new()?);
        Ok(Self { file, stream, decoder, packet, converter, origin: stream.start })
    }

    /// What the container states.
    pub(super) fn container(&self) -> Container {
        let fps = self.stream.rate.filter(|fps| *fps <= MAX_FPS);
        let estimated = || Some((self.stream.duration_s? * fps?).round()).filter(|count| *count >= 1.0);
        let num_frames = self.stream.num_packets.map(|count| count as f64).or_else(estimated);
        let num_frames = num_frames.filter(|count| *count < f64::from(u32::MAX)).map(|count| count as u32);
        Container { fps, num_frames, rotation_deg: self.stream.rotation_deg }
    }

    /// Goes to the next picture and gives the time that is stated for it, seconds; `None` at the end.
    fn advance(&mut self) -> Result<Option<Option<f64>>, FfmpegError> {
        if !self.decoder.advance(&mut self.file, &mut self.packet)? {
            return Ok(None);
        }
        Ok(Some(self.decoder.time().map(|ticks| {
            let origin = *self.origin.get_or_insert(ticks);
            self.stream.time_base.seconds(ticks.saturating_sub(origin))
        })))
    }

    /// The picture, upright.
    fn picture(&mut self) -> Result<RgbImage, FfmpegError> {
        let picture = self.converter.convert(&self.decoder)?;
        Ok(match self.stream.rotation_deg {
            90 => imageops::rotate90(&picture),
            180 => imageops::rotate180(&picture),
            270 => imageops::rotate270(&picture),
            _ => picture,
        })
    }

    /// Size of the first picture, upright; `None` if there is none.
    pub(super) fn first_size(mut self) -> Result<Option<(u32, u32)>, VideoError> {
        match self.advance()? {
            Some(_) => Ok(Some(self.picture()?.dimensions())),
            None => Ok(None),
        }
    }
}

/// Where the pictures of a file begin on the container's clock, seconds: its zero as far as frames are concerned.
pub(super) fn origin_s(streams: &[Stream]) -> f64 {
    let stream = streams.iter().find(|stream| stream.kind == StreamKind::Video);
    stream.and_then(|stream| Some(stream.time_base.seconds(stream.start?))).unwrap_or(0.0)
}

/// Steps through a video file.
pub(super) struct FileDecoder {
    path: PathBuf,
    video: Video,
    clock: Clock,
    next: u32,
    /// Size that every decoded picture must have, pixels.
    size: (u32, u32),
    /// Size that it is brought to.
    target: (u32, u32),
}

impl FileDecoder {
    pub(super) fn open(
        path: &Path,
        purpose: Purpose,
        size: (u32, u32),
        target: (u32, u32),
    ) -> Result<Self, VideoError> {
        let video = Video::open(path, purpose)?;
        let clock = Clock::new(video.container().fps);
        Ok(Self { path: path.to_owned(), video, clock, next: 0, size, target })
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

    fn picture(&mut self) -> Result<RgbImage, VideoError> {
        let (path, frame) = (|| self.path.clone(), self.next.saturating_sub(1));
        let failed = |error: FfmpegError| match error {
            FfmpegError::Memory => VideoError::Ffmpeg(error),
            _ => VideoError::Frame { path: path(), frame, reason: error.to_string() },
        };
        let picture = self.video.picture().map_err(failed)?;
        let found = picture.dimensions();
        if found != self.size {
            let ((width, height), (found_width, found_height)) = (self.size, found);
            return Err(VideoError::SizeChanges { path: path(), frame, width, height, found_width, found_height });
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
