//! Pictures in red, green and blue.

use std::ffi::c_int;
use std::ptr;

use ::image::RgbImage;
use ffmpeg_sys_the_third as sys;

use super::{Decoder, FfmpegError, checked};

/// `SWS_BICUBIC`, which has another Rust type in newer versions of the library, and the same value.
pub(super) const BICUBIC: c_int = 4;

/// Turns decoded pictures of any format into 8-bit red, green and blue.
///
/// Luma and chroma are taken as those of ITU-R BT.601, whatever the file says, chroma by the nearest sample where the
/// library has a short way for the format. These are the pixels that OpenCV's reader gives, and that is why blue comes
/// first inside: where it dithers, the library rounds the other order differently.
pub struct RgbConverter {
    context: *mut sys::SwsContext,
    target: *mut sys::AVFrame,
}

// SAFETY: context and frame are owned and have no ties to the thread that made them.
#[allow(unsafe_code)]
unsafe impl Send for RgbConverter {}

#[allow(unsafe_code)]
impl RgbConverter {
    /// A converter, which adapts itself to what it is given.
    ///
    /// # Errors
    /// [`FfmpegError::Memory`].
    pub fn new() -> Result<Self, FfmpegError> {
        // SAFETY: allocates, or returns null.
        let target = unsafe { sys::av_frame_alloc() };
        if target.is_null() { Err(FfmpegError::Memory) } else { Ok(Self { context: ptr::null_mut(), target }) }
    }

    /// The picture that the decoder is at.
    ///
    /// # Errors
    /// [`FfmpegError::Convert`] for formats of pixels that the library does not know, [`FfmpegError::Memory`].
    pub fn convert(&mut self, decoder: &Decoder) -> Result<RgbImage, FfmpegError> {
        self.convert_rows(decoder, 1)
    }

    /// The upper field of an interlaced picture: its even rows, with the chroma that belongs to them.
    ///
    /// # Errors
    /// As [`Self::convert`].
    pub fn convert_upper_field(&mut self, decoder: &Decoder) -> Result<RgbImage, FfmpegError> {
        self.convert_rows(decoder, 2)
    }

    /// Every `step`-th row of each plane, as a picture of its own.
    fn convert_rows(&mut self, decoder: &Decoder, step: c_int) -> Result<RgbImage, FfmpegError> {
        // SAFETY: the decoder's frame is allocated.
        let (width, height, format) =
            unsafe { ((*decoder.frame).width, (*decoder.frame).height, (*decoder.frame).format) };
        let failed = |reason| FfmpegError::Convert { width, height, reason };
        if width <= 0 || height <= 0 {
            return Err(failed("frame is empty"));
        }
        // Of each plane the first row is taken, so that none has fewer rows than are asked for, rounded up.
        let height = (height - 1) / step + 1;
        self.allocate(width, height)?;
        // SAFETY: reuses the context or makes a new one for the sizes and formats given; source and target frames have
        // planes of those sizes and formats, aligned by FFmpeg itself.
        let num_rows = unsafe {
            let bgr = sys::AVPixelFormat::BGR24;
            self.context = sys::sws_getCachedContext(
                self.context,
                width,
                height,
                sys::AVPixelFormat(format),
                width,
                height,
                bgr,
                BICUBIC,
                ptr::null_mut(),
                ptr::null_mut(),
                ptr::null(),
            );
            if self.context.is_null() {
                return Err(failed("pixel format is unknown"));
            }
            let (source, target) = (&*decoder.frame, &*self.target);
            let from = source.data.as_ptr().cast::<*const u8>();
            let from_stride = source.linesize.map(|stride| stride * step);
            let to_stride = target.linesize.as_ptr();
            sys::sws_scale(self.context, from, from_stride.as_ptr(), 0, height, target.data.as_ptr(), to_stride)
        };
        if num_rows == height { Ok(self.copied(width as u32, height as u32)) } else { Err(failed("frame is damaged")) }
    }

    /// Makes the target one of the size asked for.
    fn allocate(&mut self, width: c_int, height: c_int) -> Result<(), FfmpegError> {
        // SAFETY: the frame is allocated; its buffer is given back before another one is asked for.
        unsafe {
            if ((*self.target).width, (*self.target).height) == (width, height) {
                return Ok(());
            }
            sys::av_frame_unref(self.target);
            let target = &mut *self.target;
            (target.width, target.height, target.format) = (width, height, sys::AVPixelFormat::BGR24.0);
            if checked(sys::av_frame_get_buffer(self.target, 0)).is_err() {
                sys::av_frame_unref(self.target);
                return Err(FfmpegError::Memory);
            }
        }
        Ok(())
    }

    /// The rows of the target without the gaps between them, red first.
    fn copied(&self, width: u32, height: u32) -> RgbImage {
        let mut image = RgbImage::new(width, height);
        let row_bytes = width as usize * 3;
        for (row, to) in image.chunks_exact_mut(row_bytes).enumerate() {
            // SAFETY: the target has `height` rows of at least `row_bytes` bytes, `linesize` apart, and all are
            // written.
            let from = unsafe {
                let first = (*self.target).data[0].offset((*self.target).linesize[0] as isize * row as isize);
                std::slice::from_raw_parts(first, row_bytes)
            };
            for (to, from) in to.as_chunks_mut::<3>().0.iter_mut().zip(from.as_chunks::<3>().0) {
                *to = [from[2], from[1], from[0]];
            }
        }
        image
    }
}

#[allow(unsafe_code)]
impl Drop for RgbConverter {
    fn drop(&mut self) {
        // SAFETY: both were allocated by this type, or are null, and are freed once.
        unsafe {
            sys::sws_freeContext(self.context);
            sys::av_frame_free(&mut self.target);
        }
    }
}
