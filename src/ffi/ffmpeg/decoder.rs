//! Decoder of one video stream.

use std::ffi::CStr;
use std::ptr;

use ffmpeg_sys_the_third as sys;

use super::{FfmpegError, MediaFile, Packet, checked, is_short_of_memory, lacks_memory, stated, words};

/// Number of consecutive failures after which a decoder that is being drained counts as empty.
const MAX_FAILURES: u32 = 1000;
/// Maximum pixels of an image, four times those of the largest video cameras.
///
/// The size in a damaged header may exceed the memory.
const MAX_PIXELS: i64 = 1 << 27;

/// Purpose of decoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Images are converted and used.
    Pictures,
    /// Only the frames and their times are listed.
    ///
    /// Deblocking is skipped, which takes a quarter of the time and loses no frame.
    Times,
}

/// Decodes the packets of one video stream, image by image, in presentation order.
///
/// It works on the caller's thread alone. With several threads, FFmpeg decodes intact videos to the same pixels. The
/// pixels of damaged ones, whose gaps it fills from their surroundings, vary from run to run.
pub struct Decoder {
    context: *mut sys::AVCodecContext,
    pub(super) frame: *mut sys::AVFrame,
    is_drained: bool,
    /// Numbers of packets sent to the decoder, and of images received.
    num_packets: u64,
    num_images: u64,
}

// SAFETY: context and frame are owned; the decoder's own threads are managed by FFmpeg.
#[allow(unsafe_code)]
unsafe impl Send for Decoder {}

#[allow(unsafe_code)]
impl Decoder {
    /// Creates a decoder for a stream of a file.
    ///
    /// # Errors
    /// [`FfmpegError::NoDecoder`], [`FfmpegError::Decoder`], [`FfmpegError::Memory`].
    pub fn new(file: &MediaFile, stream: usize, purpose: Purpose) -> Result<Self, FfmpegError> {
        let parameters = file.parameters(stream);
        // SAFETY: the parameters are those of an open file.
        let (codec, name) = unsafe {
            let id = (*parameters).codec_id;
            (sys::avcodec_find_decoder(id), CStr::from_ptr(sys::avcodec_get_name(id)))
        };
        if codec.is_null() {
            return Err(FfmpegError::NoDecoder(name.to_string_lossy().into_owned()));
        }
        // SAFETY: both calls allocate, or return null; `drop` frees the allocations.
        let decoder = unsafe {
            let (context, frame) = (sys::avcodec_alloc_context3(codec), sys::av_frame_alloc());
            Self { context, frame, is_drained: false, num_packets: 0, num_images: 0 }
        };
        if decoder.context.is_null() || decoder.frame.is_null() {
            return Err(FfmpegError::Memory);
        }
        // SAFETY: the context is new and not open yet, which setting its limits requires.
        let opened = unsafe {
            checked(sys::avcodec_parameters_to_context(decoder.context, parameters)).and_then(|_| {
                (*decoder.context).thread_count = 1;
                (*decoder.context).max_pixels = MAX_PIXELS;
                if purpose == Purpose::Times {
                    (*decoder.context).skip_loop_filter = sys::AVDiscard::ALL;
                }
                checked(sys::avcodec_open2(decoder.context, codec, ptr::null_mut()))
            })
        };
        opened.map_err(|code| FfmpegError::Decoder(words(code)))?;
        Ok(decoder)
    }

    /// Advances to the next image, reading from `file`, whose other streams are skipped.
    ///
    /// Returns `false` after the last one, or if nothing more can be decoded; damaged packets are skipped.
    ///
    /// # Errors
    /// [`FfmpegError::Memory`]: an image that is lost for lack of memory may be decodable in another run.
    pub fn advance(&mut self, file: &mut MediaFile, packet: &mut Packet) -> Result<bool, FfmpegError> {
        let mut num_failures = 0;
        loop {
            // SAFETY: context and frame are allocated, and the context is open.
            match checked(unsafe { sys::avcodec_receive_frame(self.context, self.frame) }) {
                Ok(_) => {
                    self.num_images += 1;
                    return Ok(true);
                }
                Err(sys::AVERROR_EOF) if self.num_images < self.num_packets && lacks_memory() => {
                    return Err(FfmpegError::Memory);
                }
                Err(sys::AVERROR_EOF) => return Ok(false),
                Err(code) if is_short_of_memory(code) => return Err(FfmpegError::Memory),
                Err(_) if self.is_drained => num_failures += 1,
                Err(_) => self.feed(file, packet)?,
            }
            if num_failures > MAX_FAILURES {
                return Ok(false);
            }
        }
    }

    /// Sends the next packet to the decoder, or the end of the stream. A packet that it rejects is lost.
    fn feed(&mut self, file: &mut MediaFile, packet: &mut Packet) -> Result<(), FfmpegError> {
        self.is_drained = !file.read(packet)?;
        self.num_packets += u64::from(!self.is_drained);
        let next = if self.is_drained { ptr::null() } else { packet.packet.cast_const() };
        // SAFETY: the context is open; the packet is allocated, or null for the end.
        match checked(unsafe { sys::avcodec_send_packet(self.context, next) }) {
            Err(code) if is_short_of_memory(code) => Err(FfmpegError::Memory),
            _ => Ok(()),
        }
    }

    /// Coded width and height of the image, pixels.
    pub fn size(&self) -> (u32, u32) {
        // SAFETY: the frame is allocated as long as `self` lives.
        let (width, height) = unsafe { ((*self.frame).width, (*self.frame).height) };
        (u32::try_from(width).unwrap_or(0), u32::try_from(height).unwrap_or(0))
    }

    /// Returns true if the image is declared to consist of two fields.
    pub fn is_interlaced(&self) -> bool {
        // SAFETY: as above.
        is_interlaced(unsafe { &*self.frame })
    }

    /// Time stamp of the image, in ticks of its stream.
    ///
    /// The declared one, else FFmpeg's estimate from neighboring frames.
    pub fn time(&self) -> Option<i64> {
        // SAFETY: the frame is allocated as long as `self` lives.
        stated(unsafe { (*self.frame).best_effort_timestamp })
    }
}

#[allow(unsafe_code)]
impl Drop for Decoder {
    fn drop(&mut self) {
        // SAFETY: both were allocated by `new`, or are null, and are freed once.
        unsafe {
            sys::av_frame_free(&mut self.frame);
            sys::avcodec_free_context(&mut self.context);
        }
    }
}

#[cfg(ffmpeg_6_1)]
fn is_interlaced(frame: &sys::AVFrame) -> bool {
    /// `AV_FRAME_FLAG_INTERLACED`.
    const INTERLACED: std::ffi::c_int = 1 << 3;
    frame.flags & INTERLACED != 0
}

#[cfg(not(ffmpeg_6_1))]
fn is_interlaced(frame: &sys::AVFrame) -> bool {
    frame.interlaced_frame != 0
}
