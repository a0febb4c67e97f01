//! Conversion of decoded images to RGB.

use std::ffi::c_int;
use std::ptr;

use ::image::RgbImage;
use ffmpeg_sys_the_third as sys;

use super::{Decoder, FfmpegError, checked};

/// `SWS_BICUBIC`: newer versions of the library give it another Rust type, with the same value.
pub(super) const BICUBIC: c_int = 4;

/// Converts decoded images of any pixel format to 8-bit RGB.
///
/// Luma and chroma are interpreted by ITU-R BT.601, whatever the file declares. Chroma comes from the nearest sample if
/// the library has a fast path for the format. The pixels equal those of OpenCV's reader. For the same reason the
/// internal order is BGR: when the library dithers, it rounds the RGB order differently.
pub struct RgbConverter {
    context: *mut sys::SwsContext,
    target: *mut sys::AVFrame,
}

// SAFETY: context and frame are owned and not bound to the thread that created them.
#[allow(unsafe_code)]
unsafe impl Send for RgbConverter {}

#[allow(unsafe_code)]
impl RgbConverter {
    /// Creates a converter, which adapts to the size and format of each image.
    ///
    /// # Errors
    /// [`FfmpegError::Memory`].
    pub fn new() -> Result<Self, FfmpegError> {
        // SAFETY: allocates, or returns null.
        let target = unsafe { sys::av_frame_alloc() };
        if target.is_null() { Err(FfmpegError::Memory) } else { Ok(Self { context: ptr::null_mut(), target }) }
    }

    /// Converts the decoder's current image.
    ///
    /// # Errors
    /// [`FfmpegError::Convert`] for pixel formats that the library does not know, [`FfmpegError::Memory`].
    pub fn convert(&mut self, decoder: &Decoder) -> Result<RgbImage, FfmpegError> {
        self.convert_rows(decoder, 1)
    }

    /// Converts the upper field of an interlaced image: its even rows, with their chroma.
    ///
    /// # Errors
    /// As [`Self::convert`].
    pub fn convert_upper_field(&mut self, decoder: &Decoder) -> Result<RgbImage, FfmpegError> {
        self.convert_rows(decoder, 2)
    }

    /// Converts every `step`-th row of each plane to an image.
    fn convert_rows(&mut self, decoder: &Decoder, step: c_int) -> Result<RgbImage, FfmpegError> {
        // SAFETY: the decoder's frame is allocated.
        let (width, height, format) =
            unsafe { ((*decoder.frame).width, (*decoder.frame).height, (*decoder.frame).format) };
        let failed = |reason| FfmpegError::Convert { width, height, reason };
        if width <= 0 || height <= 0 {
            return Err(failed("frame is empty"));
        }
        // The first row of each plane is used: no plane has fewer rows than requested, rounded up.
        let height = (height - 1) / step + 1;
        self.allocate(width, height)?;
        // SAFETY: reuses the context or creates a new one for the given sizes and formats; source and target frames
        // have planes of those sizes and formats, aligned by FFmpeg itself.
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

    /// Allocates a target frame of the requested size.
    fn allocate(&mut self, width: c_int, height: c_int) -> Result<(), FfmpegError> {
        // SAFETY: the frame is allocated; its buffer is released before another one is requested.
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

    /// Copies the rows of the target without the padding between them, in RGB order.
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
