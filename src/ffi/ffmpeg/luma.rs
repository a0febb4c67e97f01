//! Luma of decoded images, without conversion.

use ffmpeg_sys_the_third as sys;

use super::Decoder;

/// First component of an image, usually luma, in 8 bits.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Luma {
    /// Pixels per row.
    pub width: usize,
    /// Samples, row by row.
    pub samples: Vec<u8>,
}

impl Luma {
    /// Rows, from the top.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[u8]> {
        self.samples.chunks_exact(self.width.max(1))
    }
}

#[allow(unsafe_code)]
impl Decoder {
    /// Every `step`-th row of the image's luma; `None` for pixel formats that do not store it in whole bytes.
    pub fn luma(&self, step: usize) -> Option<Luma> {
        /// Flags of formats whose first component is an index, a bit, or not accessible.
        const ODD: u64 = (sys::AV_PIX_FMT_FLAG_PAL
            | sys::AV_PIX_FMT_FLAG_BITSTREAM
            | sys::AV_PIX_FMT_FLAG_HWACCEL
            | sys::AV_PIX_FMT_FLAG_BE
            | sys::AV_PIX_FMT_FLAG_FLOAT) as u64;
        let (width, height) = self.size();
        // SAFETY: the frame is allocated; descriptors are constants of the library.
        let (frame, descriptor) = unsafe {
            let frame = &*self.frame;
            (frame, sys::av_pix_fmt_desc_get(sys::AVPixelFormat(frame.format)).as_ref()?)
        };
        let component = descriptor.comp[0];
        let (plane, first) = (usize::try_from(component.plane).ok()?, usize::try_from(component.offset).ok()?);
        let (pixel_bytes, depth) = (usize::try_from(component.step).ok()?, u32::try_from(component.depth).ok()?);
        let shift = u32::try_from(component.shift).ok()?;
        let data = *frame.data.get(plane)?;
        // SAFETY: computes from constants of the library.
        let row_bytes =
            unsafe { sys::av_image_get_linesize(sys::AVPixelFormat(frame.format), frame.width, component.plane) };
        let width = width as usize;
        let is_odd = descriptor.flags & ODD != 0 || !(8..=16).contains(&(depth + shift)) || pixel_bytes == 0;
        // Pixels of some formats share bytes.
        let is_shared = usize::try_from(row_bytes).ok()? < width.checked_mul(pixel_bytes)?;
        if is_odd || is_shared || data.is_null() {
            return None;
        }
        let mut samples = Vec::with_capacity(width * height as usize / step.max(1) + width);
        for y in (0..height as usize).step_by(step.max(1)) {
            // SAFETY: the plane has `height` rows, `linesize` bytes apart, of `row_bytes` bytes or more.
            let row = unsafe {
                let row = data.offset(frame.linesize[plane] as isize * y as isize);
                std::slice::from_raw_parts(row, width * pixel_bytes)
            };
            match (pixel_bytes, depth + shift) {
                (1, 8) => samples.extend_from_slice(row),
                (_, 8) => {
                    samples.extend(row.chunks_exact(pixel_bytes).map(|pixel| pixel.get(first).copied().unwrap_or(0)))
                }
                _ => samples.extend(row.chunks_exact(pixel_bytes).map(|pixel| {
                    let [low, high] = [first, first + 1].map(|at| pixel.get(at).copied().unwrap_or(0));
                    (u16::from_le_bytes([low, high]) >> (depth + shift - 8)) as u8
                })),
            }
        }
        Some(Luma { width, samples })
    }
}
