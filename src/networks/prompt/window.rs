//! Windows of the frame for boxes, and their mapping to a network's input.

use ::image::RgbImage;

use super::options::{CELL, MASK_MARGIN, PromptOptions};
use crate::image::{ImageError, resize_rgb};
use crate::scene::Rect;

/// Window of the frame, in whole pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) x0: u32,
    pub(super) y0: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

impl Window {
    /// Window around a box with a margin on every side, at least `min_side_px` wide and high.
    ///
    /// It is shifted into the frame, and clipped if the frame is smaller.
    pub(super) fn around(rect: &Rect, margin_px: f64, min_side_px: u32, frame: (u32, u32)) -> Self {
        let along = |first: f64, last: f64, length: u32| {
            let side = (last - first + 2.0 * margin_px).ceil() as u32;
            let side = side.max(min_side_px).max(1).min(length);
            let start = ((first + last - f64::from(side)) / 2.0).round().max(0.0) as u32;
            (start.min(length - side), side)
        };
        let (x0, width) = along(rect.x0, rect.x1, frame.0);
        let (y0, height) = along(rect.y0, rect.y1, frame.1);
        Self { x0, y0, width, height }
    }

    /// Window of the pixels whose centers are in a box; `None` if there are none.
    pub(super) fn of_pixels(rect: &Rect, frame: (u32, u32)) -> Option<Self> {
        let along = |first: f64, last: f64, length: u32| {
            let bound = |edge: f64| (edge - 0.5).ceil().clamp(0.0, f64::from(length)) as u32;
            (bound(first) < bound(last)).then(|| (bound(first), bound(last) - bound(first)))
        };
        let (x0, width) = along(rect.x0, rect.x1, frame.0)?;
        let (y0, height) = along(rect.y0, rect.y1, frame.1)?;
        Some(Self { x0, y0, width, height })
    }

    /// Longer side, pixels.
    fn side(&self) -> f64 {
        f64::from(self.width.max(self.height))
    }

    pub(super) fn rect(&self) -> Rect {
        let [x0, y0] = [self.x0, self.y0].map(f64::from);
        Rect { x0, y0, x1: x0 + f64::from(self.width), y1: y0 + f64::from(self.height) }
    }

    /// Returns true if the window contains a box with a margin, clipped to the frame.
    fn contains(&self, rect: &Rect, margin: f64, frame: (u32, u32)) -> bool {
        let grown = rect.grown(margin).clipped(frame.0, frame.1);
        self.rect().intersection(&grown) == grown
    }

    pub(super) fn crop(&self, image: &RgbImage) -> RgbImage {
        ::image::imageops::crop_imm(image, self.x0, self.y0, self.width, self.height).to_image()
    }
}

/// Window with the indices of the boxes that are segmented in it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SharedWindow {
    pub(super) window: Window,
    pub(super) boxes: Vec<usize>,
}

/// Longer side of a box.
fn longer_side(rect: &Rect) -> f64 {
    rect.width().max(rect.height())
}

/// Assigns boxes to windows, greedily with few windows.
///
/// The largest box without a window gets a new one. Every other box that is inside it, and not too small for it, shares
/// this window.
///
/// * `boxes` – boxes in the frame; boxes without area get no window.
pub(super) fn shared_windows(boxes: &[Rect], frame: (u32, u32), options: &PromptOptions) -> Vec<SharedWindow> {
    let mut pending: Vec<usize> = (0..boxes.len()).filter(|&b| boxes[b].area_px2() > 0.0).collect();
    pending.sort_by(|&a, &b| longer_side(&boxes[b]).total_cmp(&longer_side(&boxes[a])));
    let mut all = Vec::new();
    while let Some(&first) = pending.first() {
        let margin_px = (options.window - 1.0) / 2.0 * longer_side(&boxes[first]);
        let window = Window::around(&boxes[first], margin_px, options.min_window, frame);
        let fits = |b: usize| {
            let large_enough = longer_side(&boxes[b]) >= options.min_shared * window.side();
            b == first || (large_enough && window.contains(&boxes[b], MASK_MARGIN, frame))
        };
        let (inside, outside) = pending.iter().partition(|&&b| fits(b));
        pending = outside;
        all.push(SharedWindow { window, boxes: inside });
    }
    all
}

/// Mapping of a window to the upper left corner of a network's input: `input = (frame - origin) · scale`, per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placement {
    origin: [f64; 2],
    scale: [f64; 2],
    /// Width and height of the window's pixels in the input.
    filled: (u32, u32),
    /// Width and height of the input.
    pub(super) input: (u32, u32),
}

impl Placement {
    /// Fits a window into an input whose longer side is `input_size`, a multiple of [`CELL`].
    ///
    /// The shorter side is rounded up to a multiple.
    pub(super) fn new(window: Window, input_size: u32) -> Self {
        let ratio = f64::from(input_size) / window.side();
        let fit = |side: u32| ((f64::from(side) * ratio).round() as u32).clamp(1, input_size);
        let filled = (fit(window.width), fit(window.height));
        let scale = [f64::from(filled.0) / f64::from(window.width), f64::from(filled.1) / f64::from(window.height)];
        let input = (filled.0.div_ceil(CELL) * CELL, filled.1.div_ceil(CELL) * CELL);
        Self { origin: [f64::from(window.x0), f64::from(window.y0)], scale, filled, input }
    }

    /// Pixels of the window, resized for the input.
    pub(super) fn pixels(&self, image: &RgbImage, window: Window) -> Result<RgbImage, ImageError> {
        resize_rgb(&window.crop(image), self.filled.0, self.filled.1)
    }

    /// Converts a position in the frame to the input.
    pub(super) fn input_from_frame(&self, x: f64, y: f64) -> [f64; 2] {
        [(x - self.origin[0]) * self.scale[0], (y - self.origin[1]) * self.scale[1]]
    }

    /// Area of a pixel of the frame in the input, square pixels.
    pub(super) fn area_scale(&self) -> f64 {
        self.scale[0] * self.scale[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: (u32, u32) = (1280, 720);

    fn rect(x0: f64, y0: f64, width: f64, height: f64) -> Rect {
        Rect { x0, y0, x1: x0 + width, y1: y0 + height }
    }

    #[test]
    fn windows_are_in_the_frame_around_their_box() {
        let window = Window::around(&rect(600.0, 300.0, 40.0, 20.0), 60.0, 64, FRAME);
        assert_eq!(window, Window { x0: 540, y0: 240, width: 160, height: 140 });
        let corner = Window::around(&rect(1250.0, 0.0, 30.0, 20.0), 20.0, 120, FRAME);
        assert_eq!(corner, Window { x0: 1160, y0: 0, width: 120, height: 120 });
        let large = Window::around(&rect(100.0, 100.0, 700.0, 300.0), 1000.0, 64, FRAME);
        assert_eq!(large, Window { x0: 0, y0: 0, width: 1280, height: 720 });
    }

    #[test]
    fn pixels_belong_to_a_box_by_their_centers() {
        let window = Window::of_pixels(&rect(2.4, 2.6, 3.2, 2.0), (10, 4)).unwrap();
        assert_eq!(window, Window { x0: 2, y0: 3, width: 4, height: 1 });
        assert_eq!(Window::of_pixels(&rect(2.6, 0.0, 0.8, 4.0), (10, 4)), None);
        assert_eq!(Window::of_pixels(&rect(20.0, 0.0, 5.0, 4.0), (10, 4)), None);
        assert_eq!(Window::of_pixels(&rect(f64::NAN, 0.0, 5.0, 4.0), (10, 4)), None);
    }

    #[test]
    fn placing_is_exact_at_all_corners_and_between() {
        let window = Window { x0: 101, y0: 57, width: 333, height: 190 };
        let placement = Placement::new(window, 448);
        assert_eq!((placement.filled, placement.input), ((448, 256), (448, 256)));
        assert_eq!(placement.input_from_frame(101.0, 57.0), [0.0, 0.0]);
        let [x, y] = placement.input_from_frame(434.0, 247.0);
        assert!((x - 448.0).abs() < 1e-9 && (y - 256.0).abs() < 1e-9, "{x}, {y}");
        let [x, y] = placement.input_from_frame(101.0 + 333.0 / 4.0, 57.0 + 95.0);
        assert!((x - 112.0).abs() < 1e-9 && (y - 128.0).abs() < 1e-9, "{x}, {y}");
        // A ramp is preserved: the gray value at the center of a pixel is that of the frame there.
        let image = RgbImage::from_fn(500, 300, |x, _| ::image::Rgb([(x / 2) as u8; 3]));
        let pixels = placement.pixels(&image, window).unwrap();
        for x in [150.5, 300.5, 400.5] {
            let [u, _] = placement.input_from_frame(x, 100.0);
            let value = f64::from(pixels.get_pixel(u as u32, 128).0[0]);
            assert!((value - x / 2.0).abs() <= 1.5, "at {x}: {value}");
        }
    }

    #[test]
    fn near_boxes_of_like_size_share_a_window_and_others_do_not() {
        let options = PromptOptions { window: 4.0, min_window: 64, min_shared: 0.15, ..PromptOptions::default() };
        let boxes = [
            rect(600.0, 300.0, 40.0, 20.0),
            rect(640.0, 330.0, 50.0, 25.0),
            rect(1000.0, 300.0, 40.0, 20.0),
            rect(650.0, 300.0, 12.0, 8.0),
            rect(10.0, 10.0, 0.0, 9.0),
        ];
        let found: Vec<Vec<usize>> = shared_windows(&boxes, FRAME, &options).into_iter().map(|s| s.boxes).collect();
        assert_eq!(found, [vec![1, 0], vec![2], vec![3]]);
        assert!(shared_windows(&[], FRAME, &options).is_empty());
    }

    #[test]
    fn every_box_with_an_area_is_in_one_window() {
        let options = PromptOptions { window: 2.5, ..PromptOptions::default() };
        let boxes: Vec<Rect> = (0..40)
            .map(|k| rect(f64::from(k * 131 % 400), f64::from(k * 67 % 250), f64::from(4 + k * 7 % 60), 15.0))
            .collect();
        let all = shared_windows(&boxes, FRAME, &options);
        let mut seen: Vec<usize> = all.iter().flat_map(|shared| shared.boxes.clone()).collect();
        seen.sort_unstable();
        assert_eq!(seen, (0..40).collect::<Vec<_>>());
        assert!(all.len() < 40);
        for shared in all {
            for b in shared.boxes {
                let clipped = boxes[b].clipped(FRAME.0, FRAME.1);
                assert_eq!(shared.window.rect().intersection(&clipped), clipped);
            }
        }
    }
}
