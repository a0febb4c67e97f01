//! Letterboxing: fits a view of the frame into a network's input at constant aspect ratio.

use std::borrow::Cow;

use ::image::RgbImage;

use super::tiles::Tile;
use crate::image::{ImageError, resize_rgb_quickly};
use crate::networks::tensor::PAD;

/// Alignment of the view in an input that it does not fill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    /// Equal grey margins on opposite sides.
    Centre,
    /// All grey to the right and below.
    TopLeft,
}

/// Transform from a view to the network's input: `input = (frame - origin) * scale + pad`, per axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Letterbox {
    origin: [f32; 2],
    scale: [f32; 2],
    pad: [f32; 2],
}

impl Letterbox {
    /// Crops `view` from the frame and fits it into the middle of `input` (width, height); returns the input's pixels,
    /// too.
    pub(super) fn place(frame: &RgbImage, view: Tile, input: (u32, u32)) -> Result<(Self, RgbImage), ImageError> {
        Self::place_at(frame, view, input, Anchor::Centre)
    }

    /// As [`Self::place`], at a given alignment in the input.
    pub(super) fn place_at(
        frame: &RgbImage,
        view: Tile,
        input: (u32, u32),
        anchor: Anchor,
    ) -> Result<(Self, RgbImage), ImageError> {
        let crop = match view == Tile::whole(frame.width(), frame.height()) {
            true => Cow::Borrowed(frame),
            false => {
                Cow::Owned(::image::imageops::crop_imm(frame, view.x0, view.y0, view.width, view.height).to_image())
            }
        };
        let (width, height) = fitted((view.width, view.height), input);
        let resized = resize_rgb_quickly(&crop, width, height)?;
        let (left, top) = match anchor {
            Anchor::Centre => ((input.0 - width) / 2, (input.1 - height) / 2),
            Anchor::TopLeft => (0, 0),
        };
        let mut image = RgbImage::from_pixel(input.0, input.1, ::image::Rgb([PAD; 3]));
        ::image::imageops::replace(&mut image, &resized, i64::from(left), i64::from(top));
        let boxed = Self {
            origin: [view.x0 as f32, view.y0 as f32],
            scale: [width as f32 / view.width as f32, height as f32 / view.height as f32],
            pad: [left as f32, top as f32],
        };
        Ok((boxed, image))
    }

    /// Transforms a position in the frame to the input.
    pub(super) fn input_from_frame(&self, x: f32, y: f32) -> [f32; 2] {
        [(x - self.origin[0]) * self.scale[0] + self.pad[0], (y - self.origin[1]) * self.scale[1] + self.pad[1]]
    }

    /// Transforms a position in the input to the frame.
    pub(super) fn frame_from_input(&self, x: f32, y: f32) -> [f32; 2] {
        [(x - self.pad[0]) / self.scale[0] + self.origin[0], (y - self.pad[1]) / self.scale[1] + self.origin[1]]
    }
}

/// Largest size at which an image fits into an input, both (width, height).
pub(super) fn fitted((width, height): (u32, u32), input: (u32, u32)) -> (u32, u32) {
    let ratio = f64::min(f64::from(input.0) / f64::from(width.max(1)), f64::from(input.1) / f64::from(height.max(1)));
    let fit = |side: u32, limit: u32| ((f64::from(side) * ratio).round() as u32).clamp(1, limit.max(1));
    (fit(width, input.0), fit(height, input.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wide_frame_gets_grey_above_and_below() {
        let frame = RgbImage::from_pixel(1280, 720, ::image::Rgb([200, 0, 0]));
        let (boxed, input) = Letterbox::place(&frame, Tile::whole(1280, 720), (640, 640)).unwrap();
        assert_eq!(input.get_pixel(320, 139).0, [114; 3]);
        assert_eq!(input.get_pixel(320, 140).0, [200, 0, 0]);
        assert_eq!(boxed.input_from_frame(0.0, 0.0), [0.0, 140.0]);
        assert_eq!(boxed.frame_from_input(640.0, 500.0), [1280.0, 720.0]);
    }

    #[test]
    fn positions_are_exact_to_a_part_of_a_pixel_at_either_place() {
        let frame = RgbImage::from_pixel(1279, 717, ::image::Rgb([9, 9, 9]));
        let (boxed, input) = Letterbox::place_at(&frame, Tile::whole(1279, 717), (960, 544), Anchor::TopLeft).unwrap();
        assert_eq!((input.get_pixel(0, 537).0, input.get_pixel(0, 538).0), ([9; 3], [114; 3]));
        assert_eq!(boxed.input_from_frame(1279.0, 717.0), [960.0, 538.0]);
        for (x, y) in [(0.5, 0.5), (640.25, 300.75), (1278.5, 716.5)] {
            let [u, v] = boxed.input_from_frame(x, y);
            let [back_x, back_y] = boxed.frame_from_input(u, v);
            assert!((back_x - x).abs() < 1e-3 && (back_y - y).abs() < 1e-3, "{x}, {y}: {back_x}, {back_y}");
        }
    }

    #[test]
    fn a_tile_is_not_scaled() {
        let frame = RgbImage::from_fn(100, 80, |x, y| ::image::Rgb([x as u8, y as u8, 0]));
        let view = Tile { x0: 30, y0: 10, width: 64, height: 64 };
        let (boxed, input) = Letterbox::place(&frame, view, (64, 64)).unwrap();
        assert_eq!(input.get_pixel(5, 6).0, [35, 16, 0]);
        assert_eq!(boxed.frame_from_input(5.5, 6.5), [35.5, 16.5]);
    }
}
