//! Conversion of pixels to a network's input tensor.

use ::image::RgbImage;

use super::description::{ChannelOrder, Preprocessing};
use crate::ffi::onnx::{Model, Tensor};
use crate::image::scale_to_fit;

/// Gray value of padding, as in the training of YOLO networks.
pub(super) const PAD: u8 = 114;

/// Width and height of a network's input image, the last two sides of its first input; free ones are `open`.
pub(super) fn input_size(model: &Model, open: (u32, u32)) -> (u32, u32) {
    let sides = &model.inputs()[0].shape;
    let side = |from_last: usize, open: u32| {
        sides[sides.len() - from_last].and_then(|side| u32::try_from(side).ok()).unwrap_or(open)
    };
    (side(1, open.0), side(2, open.1))
}

/// Smallest size with sides of whole steps that contains a frame scaled to a maximum longer side.
pub(super) fn size_in_steps(frame: (u32, u32), max_side: u32, step: u32) -> (u32, u32) {
    let (width, height) = scale_to_fit(frame.0, frame.1, max_side);
    (width.next_multiple_of(step), height.next_multiple_of(step))
}

/// Fills a tensor [1, 3, height, width] with the pixels of an image: `(v - mean) / std * scale` per channel.
pub(super) fn tensor_from_image(image: &RgbImage, preprocessing: &Preprocessing) -> Tensor {
    let plane = image.width() as usize * image.height() as usize;
    let mut tensor = Tensor::zeros(&[1, 3, image.height() as usize, image.width() as usize]);
    for (c, values) in tensor.values.chunks_exact_mut(plane.max(1)).enumerate() {
        let source = match preprocessing.order {
            ChannelOrder::Rgb => c,
            ChannelOrder::Bgr => 2 - c,
        };
        let factor = preprocessing.scale / preprocessing.std[c];
        let offset = -preprocessing.mean[c] * factor;
        for (value, pixel) in values.iter_mut().zip(image.as_raw().chunks_exact(3)) {
            *value = f32::from(pixel[source]) * factor + offset;
        }
    }
    tensor
}

/// Plane of samples for interpolation; sample (0, 0) is at the centre of the first cell, (0.5, 0.5).
pub(super) struct Plane<'a> {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) values: &'a [f32],
}

impl Plane<'_> {
    /// Linear interpolation at a position in cells; beyond the outermost centres the border value is used.
    pub(super) fn sample(&self, x: f32, y: f32) -> f32 {
        Between::new(x, y, self.width, self.height).value(self.values)
    }
}

/// Interpolation weights of a position in planes of one size.
pub(super) struct Between {
    /// Indices of the surrounding samples: above left and right, below left and right.
    near: [usize; 4],
    /// Offset from the first of them, cells across and down.
    part: [f32; 2],
}

impl Between {
    /// Weights at a position in cells; beyond the outermost centres those at the border.
    #[inline(always)]
    pub(super) fn new(x: f32, y: f32, width: usize, height: usize) -> Self {
        let x = (x - 0.5).clamp(0.0, (width - 1) as f32);
        let y = (y - 0.5).clamp(0.0, (height - 1) as f32);
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
        let near = [y0 * width + x0, y0 * width + x1, y1 * width + x0, y1 * width + x1];
        Self { near, part: [x - x0 as f32, y - y0 as f32] }
    }

    /// Value of a plane at the position, by linear interpolation.
    #[inline(always)]
    pub(super) fn value(&self, values: &[f32]) -> f32 {
        let [a, b, c, d] = self.near.map(|k| values[k]);
        let (top, bottom) = (a + self.part[0] * (b - a), c + self.part[0] * (d - c));
        top + self.part[1] * (bottom - top)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_ordered_and_normalised() {
        let image = RgbImage::from_raw(2, 1, vec![10, 20, 30, 40, 50, 60]).unwrap();
        let plain = Preprocessing { scale: 0.5, ..Preprocessing::default() };
        assert_eq!(tensor_from_image(&image, &plain).values, [5.0, 20.0, 10.0, 25.0, 15.0, 30.0]);
        let bgr = Preprocessing {
            order: ChannelOrder::Bgr,
            mean: [30.0, 0.0, 0.0],
            std: [1.0, 2.0, 1.0],
            ..Preprocessing::default()
        };
        let tensor = tensor_from_image(&image, &Preprocessing { scale: 1.0, ..bgr });
        assert_eq!(tensor.shape, [1, 3, 1, 2]);
        assert_eq!(tensor.values, [0.0, 30.0, 10.0, 25.0, 10.0, 40.0]);
    }

    #[test]
    fn sampling_is_linear_between_centres_and_constant_beyond() {
        let plane = Plane { width: 2, height: 2, values: &[0.0, 1.0, 2.0, 3.0] };
        assert_eq!(plane.sample(0.5, 0.5), 0.0);
        assert_eq!(plane.sample(1.0, 1.0), 1.5);
        assert_eq!(plane.sample(9.0, 9.0), 3.0);
        assert_eq!(plane.sample(-1.0, 0.5), 0.0);
    }
}
