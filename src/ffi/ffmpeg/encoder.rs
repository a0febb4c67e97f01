//! Writer of a video file, image by image.

use std::ffi::{CStr, c_int};
use std::path::Path;
use std::ptr;

use ::image::RgbImage;
use ffmpeg_sys_the_third as sys;

use super::{FfmpegError, checked, url_of, words};

/// Encoders, in order of preference: H.264 if the distribution has it, else MPEG-4 part 2, which every FFmpeg has.
const ENCODERS: [&CStr; 3] = [c"libx264", c"libopenh264", c"mpeg4"];
/// Ticks per second.
///
/// A whole number of ticks per frame at 24, 25, 30, 50, 60 and 29.97 frames per second, within the range of MPEG-4.
const TICKS_PER_S: c_int = 60_000;
/// Number of encoder threads. The result depends on it, and must not depend on the number of cores.
const NUM_THREADS: c_int = 4;
/// Keyframe interval of a preview, frames: seeking to any frame decodes at most that many.
const PREVIEW_INTERVAL: c_int = 10;
/// Bits per pixel of an image, for encoders without a constant-quality mode.
const BITS_PER_PIXEL: f64 = 0.2;

/// Purpose of a file.
#[derive(Clone, Copy, PartialEq)]
enum Use {
    Film,
    Preview,
}

impl Use {
    /// Browsers play only H.264.
    fn encoders(self) -> &'static [&'static CStr] {
        if self == Self::Film { &ENCODERS } else { &ENCODERS[..2] }
    }

    /// Options of x264: good quality, fast encoding; a preview takes 6 to 8 kB per image of 640×360 pixels.
    fn x264_options(self) -> [(&'static CStr, &'static CStr); 2] {
        let quality = if self == Self::Film { c"21" } else { c"27" };
        [(c"preset", c"veryfast"), (c"crf", quality)]
    }
}

/// Writes an MP4 file: 4:2:0 images of one size, at times that need not be evenly spaced.
pub struct Encoder {
    format: *mut sys::AVFormatContext,
    codec: *mut sys::AVCodecContext,
    scaler: *mut sys::SwsContext,
    frame: *mut sys::AVFrame,
    packet: *mut sys::AVPacket,
    is_begun: bool,
    last_tick: Option<i64>,
    ticks_per_frame: i64,
}

// SAFETY: everything is owned and not bound to the thread that created it.
#[allow(unsafe_code)]
unsafe impl Send for Encoder {}

#[allow(unsafe_code)]
impl Encoder {
    /// Starts a file.
    ///
    /// * `size` – width and height of the images, pixels; a last odd column or row is dropped, as 4:2:0 needs even
    ///   sizes.
    /// * `rate` – approximate frames per second; it determines the duration of the last image.
    ///
    /// # Errors
    /// [`FfmpegError::NoEncoder`], [`FfmpegError::Encoder`], [`FfmpegError::Write`], [`FfmpegError::Memory`].
    pub fn create(path: &Path, size: (u32, u32), rate: f64) -> Result<Self, FfmpegError> {
        Self::with_encoders(path, size, rate, Use::Film)
    }

    /// Starts a small file for a browser, which seeks in it: H.264 with a keyframe at least every tenth image.
    ///
    /// # Errors
    /// As [`Encoder::create`]; [`FfmpegError::NoEncoder`] without an encoder of H.264.
    pub fn preview(path: &Path, size: (u32, u32), rate: f64) -> Result<Self, FfmpegError> {
        Self::with_encoders(path, size, rate, Use::Preview)
    }

    fn with_encoders(path: &Path, size: (u32, u32), rate: f64, purpose: Use) -> Result<Self, FfmpegError> {
        let rate = if rate.is_finite() { rate.clamp(0.1, 1000.0) } else { 25.0 };
        let mut encoder = Self {
            format: ptr::null_mut(),
            codec: ptr::null_mut(),
            scaler: ptr::null_mut(),
            // SAFETY: both allocate, or return null.
            frame: unsafe { sys::av_frame_alloc() },
            packet: unsafe { sys::av_packet_alloc() },
            is_begun: false,
            last_tick: None,
            ticks_per_frame: (f64::from(TICKS_PER_S) / rate).round().max(1.0) as i64,
        };
        if encoder.frame.is_null() || encoder.packet.is_null() {
            return Err(FfmpegError::Memory);
        }
        let even = |side: u32| c_int::try_from(side & !1).unwrap_or(0);
        let (width, height) = (even(size.0), even(size.1));
        if width == 0 || height == 0 {
            return Err(FfmpegError::Encoder(format!("images of {}x{} pixels are too small", size.0, size.1)));
        }
        let url = url_of(path).ok_or_else(|| FfmpegError::Write("path contains a zero byte".to_owned()))?;
        encoder.open_container(&url)?;
        encoder.open_codec((width, height), rate, purpose)?;
        encoder.open_scaler(width, height)?;
        encoder.begin(&url)?;
        Ok(encoder)
    }

    fn open_container(&mut self, url: &CStr) -> Result<(), FfmpegError> {
        // SAFETY: allocates the context, or leaves it null; the strings end in zero bytes, and the URL is copied.
        unsafe {
            let name = c"mp4".as_ptr();
            let made = sys::avformat_alloc_output_context2(&mut self.format, ptr::null_mut(), name, url.as_ptr());
            checked(made).map_err(|code| FfmpegError::Encoder(words(code)))?;
            // No date and no version: equal images give equal bytes.
            (*self.format).flags |= sys::AVFMT_FLAG_BITEXACT;
        }
        Ok(())
    }

    /// Opens the first available encoder.
    fn open_codec(&mut self, size: (c_int, c_int), rate: f64, purpose: Use) -> Result<(), FfmpegError> {
        let mut refusal = FfmpegError::NoEncoder;
        for name in purpose.encoders() {
            // SAFETY: the name ends in a zero byte.
            let codec = unsafe { sys::avcodec_find_encoder_by_name(name.as_ptr()) };
            if codec.is_null() {
                continue;
            }
            match self.try_codec(codec, size, rate, purpose) {
                Ok(()) => return Ok(()),
                Err(error) => refusal = error,
            }
        }
        Err(refusal)
    }

    fn try_codec(
        &mut self,
        codec: *const sys::AVCodec,
        (width, height): (c_int, c_int),
        rate: f64,
        purpose: Use,
    ) -> Result<(), FfmpegError> {
        // SAFETY: the context is allocated here, not open yet while it is set up, and freed by `drop` or here; the
        // strings end in zero bytes, and options that an encoder does not know are rejected without side effects.
        unsafe {
            sys::avcodec_free_context(&mut self.codec);
            self.codec = sys::avcodec_alloc_context3(codec);
            if self.codec.is_null() {
                return Err(FfmpegError::Memory);
            }
            let context = &mut *self.codec;
            (context.width, context.height) = (width, height);
            context.time_base = sys::AVRational { num: 1, den: TICKS_PER_S };
            context.framerate = sys::AVRational { num: (rate * 1000.0).round() as c_int, den: 1000 };
            context.pix_fmt = sys::AVPixelFormat::YUV420P;
            context.color_range = sys::AVColorRange::MPEG;
            context.colorspace = sys::AVColorSpace::BT709;
            context.color_primaries = sys::AVColorPrimaries::BT709;
            context.color_trc = sys::AVColorTransferCharacteristic::BT709;
            context.thread_count = NUM_THREADS;
            if purpose == Use::Preview {
                context.gop_size = PREVIEW_INTERVAL;
            }
            context.bit_rate = (f64::from(width) * f64::from(height) * rate * BITS_PER_PIXEL) as i64;
            if (*codec).id == sys::AVCodecID::H264 {
                // x264 has a constant-quality mode.
                context.bit_rate = if is_named(codec, ENCODERS[0]) { 0 } else { context.bit_rate };
                for (key, value) in purpose.x264_options() {
                    sys::av_opt_set(context.priv_data, key.as_ptr(), value.as_ptr(), 0);
                }
            }
            if (*(*self.format).oformat).flags & sys::AVFMT_GLOBALHEADER != 0 {
                context.flags |= sys::AV_CODEC_FLAG_GLOBAL_HEADER as c_int;
            }
            context.flags |= sys::AV_CODEC_FLAG_BITEXACT as c_int;
            let opened = sys::avcodec_open2(self.codec, codec, ptr::null_mut());
            checked(opened).map(drop).map_err(|code| FfmpegError::Encoder(words(code)))
        }
    }

    fn open_scaler(&mut self, width: c_int, height: c_int) -> Result<(), FfmpegError> {
        // SAFETY: the context is created for these sizes and formats; the coefficients are constants of the library;
        // the frame is new, and gets planes of the encoder's size and format.
        unsafe {
            let (from, to) = (sys::AVPixelFormat::RGB24, sys::AVPixelFormat::YUV420P);
            let flags = super::colour::BICUBIC | sys::SWS_ACCURATE_RND;
            let none = ptr::null_mut();
            self.scaler = sys::sws_getContext(width, height, from, width, height, to, flags, none, none, ptr::null());
            if self.scaler.is_null() {
                return Err(FfmpegError::Encoder("images of this size cannot be converted".to_owned()));
            }
            let bt709 = sys::sws_getCoefficients(sys::SWS_CS_ITU709);
            sys::sws_setColorspaceDetails(self.scaler, bt709, 1, bt709, 0, 0, 1 << 16, 1 << 16);
            let frame = &mut *self.frame;
            (frame.width, frame.height, frame.format) = (width, height, to.0);
            checked(sys::av_frame_get_buffer(self.frame, 0)).map(drop).map_err(|_| FfmpegError::Memory)
        }
    }

    /// Creates the stream and writes the file header.
    fn begin(&mut self, url: &CStr) -> Result<(), FfmpegError> {
        let failed = |code| FfmpegError::Write(words(code));
        // SAFETY: the container has no stream yet and gets one with the parameters of the open encoder; the strings end
        // in zero bytes; the dictionary is freed by the library's own call.
        unsafe {
            let stream = sys::avformat_new_stream(self.format, ptr::null());
            if stream.is_null() {
                return Err(FfmpegError::Memory);
            }
            (*stream).time_base = (*self.codec).time_base;
            (*stream).avg_frame_rate = (*self.codec).framerate;
            checked(sys::avcodec_parameters_from_context((*stream).codecpar, self.codec)).map_err(failed)?;
            checked(sys::avio_open(&mut (*self.format).pb, url.as_ptr(), sys::AVIO_FLAG_WRITE)).map_err(failed)?;
            // Browsers start to play before the whole file has arrived if its index comes first.
            let mut options = ptr::null_mut();
            sys::av_dict_set(&mut options, c"movflags".as_ptr(), c"faststart".as_ptr(), 0);
            let written = sys::avformat_write_header(self.format, &mut options);
            sys::av_dict_free(&mut options);
            checked(written).map_err(failed)?;
        }
        self.is_begun = true;
        Ok(())
    }

    /// Adds an image, which must have the size of the file.
    ///
    /// * `time_s` – presentation time, seconds; one that is not later than the last is shown as early as possible after
    ///   it.
    ///
    /// # Errors
    /// [`FfmpegError::Encoder`], [`FfmpegError::Write`].
    pub fn add(&mut self, image: &RgbImage, time_s: f64) -> Result<(), FfmpegError> {
        let tick = (time_s * f64::from(TICKS_PER_S)).round() as i64;
        let tick = self.last_tick.map_or(tick, |last| tick.max(last.saturating_add(1)));
        self.last_tick = Some(tick);
        self.take(image)?;
        // SAFETY: codec and frame are allocated and belong together.
        let sent = unsafe {
            (*self.frame).pts = tick;
            sys::avcodec_send_frame(self.codec, self.frame)
        };
        checked(sent).map_err(|code| FfmpegError::Encoder(words(code)))?;
        self.write_packets()
    }

    /// Converts an image into the frame.
    fn take(&mut self, image: &RgbImage) -> Result<(), FfmpegError> {
        // SAFETY: the frame is allocated.
        let (width, height) = unsafe { ((*self.frame).width, (*self.frame).height) };
        let even = |side: u32| c_int::try_from(side & !1).unwrap_or(0);
        if (even(image.width()), even(image.height())) != (width, height) {
            let (found_width, found_height) = image.dimensions();
            let found = format!("an image of {found_width}x{found_height} pixels among images of {width}x{height}");
            return Err(FfmpegError::Encoder(found));
        }
        // The library reads four plane pointers, whatever the format.
        let none = ptr::null();
        let from = [image.as_raw().as_ptr(), none, none, none];
        let stride = [3 * c_int::try_from(image.width()).unwrap_or(0), 0, 0, 0];
        // SAFETY: the image has `height` rows or one more, `stride` bytes apart; the frame's planes are writable after
        // the call that makes them so, and have the size that the scaler was created for.
        unsafe {
            checked(sys::av_frame_make_writable(self.frame)).map_err(|_| FfmpegError::Memory)?;
            let to = &*self.frame;
            let (planes, strides) = (to.data.as_ptr(), to.linesize.as_ptr());
            sys::sws_scale(self.scaler, from.as_ptr(), stride.as_ptr(), 0, height, planes, strides);
        }
        Ok(())
    }

    /// Writes the packets that the encoder has finished.
    fn write_packets(&mut self) -> Result<(), FfmpegError> {
        loop {
            // SAFETY: codec, packet and container are open; the packet's data are handed over to the container.
            unsafe {
                if checked(sys::avcodec_receive_packet(self.codec, self.packet)).is_err() {
                    return Ok(());
                }
                let stream = *(*self.format).streams;
                (*self.packet).duration = self.ticks_per_frame;
                sys::av_packet_rescale_ts(self.packet, (*self.codec).time_base, (*stream).time_base);
                let written = sys::av_interleaved_write_frame(self.format, self.packet);
                checked(written).map_err(|code| FfmpegError::Write(words(code)))?;
            }
        }
    }

    /// Finishes the file. Without this call the file is incomplete.
    ///
    /// # Errors
    /// [`FfmpegError::Write`].
    pub fn finish(mut self) -> Result<(), FfmpegError> {
        // SAFETY: the encoder is open; a null frame marks the end.
        unsafe { sys::avcodec_send_frame(self.codec, ptr::null()) };
        self.write_packets()?;
        let failed = |code| FfmpegError::Write(words(code));
        self.is_begun = false;
        // SAFETY: the header was written, and the trailer is written only here.
        unsafe {
            checked(sys::av_write_trailer(self.format)).map_err(failed)?;
            checked(sys::avio_closep(&mut (*self.format).pb)).map(drop).map_err(failed)
        }
    }
}

/// Returns true if an encoder has the given name.
#[allow(unsafe_code)]
fn is_named(codec: *const sys::AVCodec, name: &CStr) -> bool {
    // SAFETY: every encoder has a name, which is a constant.
    unsafe { CStr::from_ptr((*codec).name) == name }
}

#[allow(unsafe_code)]
impl Drop for Encoder {
    fn drop(&mut self) {
        // SAFETY: all were allocated by this type, or are null, and are freed once; a file that was started is closed.
        unsafe {
            if !self.format.is_null() {
                sys::avio_closep(&mut (*self.format).pb);
            }
            sys::av_packet_free(&mut self.packet);
            sys::av_frame_free(&mut self.frame);
            sys::sws_freeContext(self.scaler);
            sys::avcodec_free_context(&mut self.codec);
            sys::avformat_free_context(self.format);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ffi::ffmpeg::{Decoder, MediaFile, Packet, Purpose, RgbConverter};

    fn image(k: u8) -> RgbImage {
        RgbImage::from_fn(65, 48, |x, _| ::image::Rgb(if x < 32 { [20 * k, 40, 90] } else { [200, 10 * k, 30] }))
    }

    fn write(path: &Path) {
        let mut encoder = Encoder::create(path, (65, 48), 10.0).unwrap();
        for k in 0..8 {
            // A gap after the fifth.
            let time_s = f64::from(k) * 0.1 + if k > 4 { 0.5 } else { 0.0 };
            encoder.add(&image(k), time_s).unwrap();
        }
        assert!(encoder.add(&RgbImage::new(32, 32), 3.0).is_err());
        encoder.finish().unwrap();
    }

    #[test]
    fn written_files_decode_to_their_images_and_times() {
        let folder = tempfile::tempdir().unwrap();
        let [path, again] = ["a.mp4", "b.mp4"].map(|name| folder.path().join(name));
        write(&path);
        write(&again);
        assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&again).unwrap());
        let mut file = MediaFile::open(&path).unwrap();
        let stream = file.streams()[0];
        let mut decoder = Decoder::new(&file, 0, Purpose::Pictures).unwrap();
        let (mut packet, mut converter) = (Packet::new().unwrap(), RgbConverter::new().unwrap());
        let mut times = Vec::new();
        while decoder.advance(&mut file, &mut packet).unwrap() {
            times.push(stream.time_base.seconds(decoder.time().unwrap()));
            let found = converter.convert(&decoder).unwrap();
            assert_eq!(found.dimensions(), (64, 48));
            let expected = image(times.len() as u8 - 1);
            // The reader interprets all videos as BT.601: colors differ slightly.
            let off = found.get_pixel(8, 20).0.iter().zip(expected.get_pixel(8, 20).0).map(|(a, b)| a.abs_diff(b));
            assert!(off.max().unwrap() < 40, "{times:?}");
        }
        let expected = [0.0, 0.1, 0.2, 0.3, 0.4, 1.0, 1.1, 1.2];
        assert_eq!(times.len(), expected.len());
        assert!(times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{times:?}");
    }

    #[test]
    fn a_file_that_cannot_be_written_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path, size| Encoder::create(path, size, 25.0).err().unwrap();
        assert!(matches!(refused(&folder.path().join("no/a.mp4"), (64, 48)), FfmpegError::Write(_)));
        assert!(matches!(refused(&folder.path().join("a.mp4"), (1, 48)), FfmpegError::Encoder(_)));
    }
}
