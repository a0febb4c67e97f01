//! Binary masks, label maps and detections, all at the frame's own resolution.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::Rect;

/// Binary mask of one frame. Only a window around the set pixels is stored: a frame has many small objects.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(into = "Runs", try_from = "Runs")]
pub struct Mask {
    width: u32,
    height: u32,
    /// Pixels outside of it are clear. It may be larger than the bounding box of the set pixels.
    window: BoundingBox,
    /// Row-major over the window.
    pixels: Vec<bool>,
}

/// Serialized mask: run lengths of clear and set pixels in turn, row by row over the bounding box.
#[derive(Serialize, Deserialize)]
struct Runs {
    size: (u32, u32),
    window: BoundingBox,
    runs: Vec<u32>,
}

/// Maximum number of pixels of a mask, far beyond any video frame.
///
/// It bounds the memory that a damaged or hostile file takes.
pub const MAX_MASK_PIXELS: u64 = 1 << 28;

/// Distance from the border of an image at which it may truncate a mask, pixels: networks omit the outermost pixels.
pub const TRUNCATION_PX: u32 = 3;

impl From<Mask> for Runs {
    fn from(mask: Mask) -> Self {
        let window = mask.bounding_box().unwrap_or(BoundingBox { x0: 0, y0: 0, x1: 0, y1: 0 });
        // The first run, of clear pixels, may be empty.
        let pixels = mask.pixels_in(window);
        let lengths = pixels.chunk_by(|a, b| a == b).map(|run| run.len() as u32);
        let runs = pixels.first().filter(|first| **first).map(|_| 0).into_iter().chain(lengths).collect();
        Self { size: mask.size(), window, runs }
    }
}

impl TryFrom<Runs> for Mask {
    type Error = &'static str;

    fn try_from(Runs { size: (width, height), window, runs }: Runs) -> Result<Self, Self::Error> {
        let is_inside = window.x0 <= window.x1 && window.x1 <= width && window.y0 <= window.y1 && window.y1 <= height;
        if !is_inside {
            return Err("the window of a mask is outside its frame");
        }
        let total: u64 = runs.iter().map(|&run| u64::from(run)).sum();
        let area = u64::from(window.width()) * u64::from(window.height());
        if total != area || area > MAX_MASK_PIXELS {
            return Err("runs do not fill the window of a mask");
        }
        let pixels = runs.iter().enumerate().flat_map(|(k, &run)| std::iter::repeat_n(k % 2 == 1, run as usize));
        Ok(Self { width, height, window, pixels: pixels.collect() })
    }
}

/// Axis-aligned box of whole pixels: `x0 ≤ x < x1`, `y0 ≤ y < y1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BoundingBox {
    /// First column.
    pub x0: u32,
    /// First row.
    pub y0: u32,
    /// One past the last column.
    pub x1: u32,
    /// One past the last row.
    pub y1: u32,
}

impl BoundingBox {
    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.x1 - self.x0
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.y1 - self.y0
    }

    /// Returns true if the border of an image of this size, pixels, may truncate the object.
    ///
    /// Masks of truncated objects end up to [`TRUNCATION_PX`] before it, or as far as their box prompts do: boxes whose
    /// sides err by up to a tenth end up to a twentieth of their side before it in four of five cases, and the mask of
    /// a rendered lorry ended 4 % before it.
    pub fn is_truncated(&self, width: u32, height: u32) -> bool {
        let margin = |side: u32| TRUNCATION_PX.max(side / 20);
        let (x, y) = (margin(self.width()), margin(self.height()));
        self.x0 < x || self.y0 < y || self.x1 + x > width || self.y1 + y > height
    }

    /// Number of pixels.
    fn area(&self) -> usize {
        self.width() as usize * self.height() as usize
    }

    /// Intersection; empty if the boxes do not overlap.
    fn intersection(&self, other: &Self) -> Self {
        let (x0, y0) = (self.x0.max(other.x0), self.y0.max(other.y0));
        Self { x0, y0, x1: self.x1.min(other.x1).max(x0), y1: self.y1.min(other.y1).max(y0) }
    }

    /// The box enlarged by a distance on all sides, clipped to a frame.
    pub fn grown(&self, by_px: u32, (width, height): (u32, u32)) -> Self {
        Self {
            x0: self.x0.saturating_sub(by_px),
            y0: self.y0.saturating_sub(by_px),
            x1: self.x1.saturating_add(by_px).min(width),
            y1: self.y1.saturating_add(by_px).min(height),
        }
    }
}

impl Mask {
    /// Mask without a set pixel.
    pub fn empty(width: u32, height: u32) -> Self {
        Self { width, height, window: BoundingBox { x0: 0, y0: 0, x1: 0, y1: 0 }, pixels: Vec::new() }
    }

    /// Mask with all pixels set.
    pub fn full(width: u32, height: u32) -> Self {
        let window = BoundingBox { x0: 0, y0: 0, x1: width, y1: height };
        Self { width, height, window, pixels: vec![true; window.area()] }
    }

    /// Mask of the pixels for which `inside(x, y)` is true.
    pub fn from_fn(width: u32, height: u32, inside: impl FnMut(u32, u32) -> bool) -> Self {
        Self::in_window((width, height), BoundingBox { x0: 0, y0: 0, x1: width, y1: height }, inside)
    }

    /// Mask of the pixels of a window for which `inside(x, y)` is true. The window must be in the frame.
    pub fn in_window(frame: (u32, u32), window: BoundingBox, mut inside: impl FnMut(u32, u32) -> bool) -> Self {
        let BoundingBox { x0, y0, x1, y1 } = window;
        let pixels = (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y))).map(|(x, y)| inside(x, y)).collect();
        Self::from_window(frame, window, pixels)
    }

    /// Mask from the pixels of a window.
    ///
    /// * `pixels` – row-major over the window, which must be in the frame.
    pub fn from_window((width, height): (u32, u32), window: BoundingBox, pixels: Vec<bool>) -> Self {
        assert!(window.x1 <= width && window.y1 <= height && pixels.len() == window.area(), "a window of the frame");
        Self { width, height, window, pixels }
    }

    /// Mask of the pixels whose value satisfies `inside`.
    ///
    /// * `values` – row-major over the frame.
    pub fn from_values<T: Copy>(width: u32, height: u32, values: &[T], inside: impl Fn(T) -> bool) -> Self {
        let rows = || (0..height).zip(values.chunks_exact((width as usize).max(1)));
        let Some(window) = bounds_of(rows().map(|(y, row)| (y, 0, row)), &inside) else {
            return Self::empty(width, height);
        };
        let rows = rows().skip(window.y0 as usize).take(window.height() as usize);
        let inside = |row: &[T]| row.iter().map(|value| inside(*value)).collect::<Vec<_>>();
        let pixels = rows.flat_map(|(_, row)| inside(&row[window.x0 as usize..window.x1 as usize])).collect();
        Self { width, height, window, pixels }
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// The pixels of a window, row-major; those outside of the frame are clear.
    pub fn pixels_in(&self, window: BoundingBox) -> Vec<bool> {
        let common = window.intersection(&self.window);
        let mut pixels = vec![false; window.area()];
        for (y, row) in self.parts(&common) {
            let to = pixel_index(&window, common.x0, y);
            pixels[to..to + row.len()].copy_from_slice(row);
        }
        pixels
    }

    /// The set pixels, row by row.
    pub fn iter(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.rows().flat_map(|(y, x0, row)| (x0..).zip(row).filter(|(_, set)| **set).map(move |(x, _)| (x, y)))
    }

    /// Rows of the window: row and first column in the frame, and pixels.
    pub fn rows(&self) -> impl Iterator<Item = (u32, u32, &[bool])> {
        let rows = self.pixels.chunks_exact((self.window.width() as usize).max(1));
        (self.window.y0..).zip(rows).map(|(y, row)| (y, self.window.x0, row))
    }

    /// Row-major bytes of the frame, 255 where set, as in image libraries and the contract's PNG files.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = vec![0; self.width as usize * self.height as usize];
        for (y, x0, row) in self.rows() {
            let start = y as usize * self.width as usize + x0 as usize;
            bytes[start..start + row.len()].iter_mut().zip(row).for_each(|(byte, set)| *byte = 255 * u8::from(*set));
        }
        bytes
    }

    /// Returns true if a pixel is set; false outside the frame.
    pub fn get(&self, x: i64, y: i64) -> bool {
        let BoundingBox { x0, y0, x1, y1 } = self.window;
        let is_stored = (i64::from(x0)..i64::from(x1)).contains(&x) && (i64::from(y0)..i64::from(y1)).contains(&y);
        is_stored && self.pixels[pixel_index(&self.window, x as u32, y as u32)]
    }

    /// Returns true if the pixel at an image position is set (center of the first pixel at 0.5, 0.5).
    pub fn contains(&self, x: f64, y: f64) -> bool {
        self.get(x.floor() as i64, y.floor() as i64)
    }

    /// Sets one pixel, which must be in the frame.
    pub fn set(&mut self, x: u32, y: u32) {
        self.fill(x..x + 1, y, true);
    }

    /// Sets or clears a range of columns of a row; all must be in the frame.
    pub fn fill(&mut self, columns: Range<u32>, y: u32, value: bool) {
        assert!(columns.end <= self.width && y < self.height, "pixels of the frame");
        let wanted = BoundingBox { x0: columns.start, y0: y, x1: columns.end.max(columns.start), y1: y + 1 };
        if value && wanted.area() > 0 {
            self.reserve(&wanted);
        }
        let common = wanted.intersection(&self.window);
        if common.area() > 0 {
            let start = pixel_index(&self.window, common.x0, y);
            self.pixels[start..start + common.width() as usize].fill(value);
        }
    }

    /// Sets or clears the pixels that a rectangle overlaps, wholly or in part.
    pub fn fill_rect(&mut self, rect: &Rect, value: bool) {
        let rect = rect.clipped(self.width, self.height);
        for y in rect.y0.floor() as u32..rect.y1.ceil() as u32 {
            self.fill(rect.x0.floor() as u32..rect.x1.ceil() as u32, y, value);
        }
    }

    /// Enlarges the window to contain some pixels. It grows by its own size at least, so that setting pixels one by one
    /// copies each of them a few times only.
    fn reserve(&mut self, wanted: &BoundingBox) {
        let old = self.window;
        if wanted.intersection(&old) == *wanted {
            return;
        }
        let mut window = *wanted;
        if old.area() > 0 {
            let before =
                |old: u32, new: u32, size: u32| if new < old { new.min(old.saturating_sub(size)) } else { old };
            let after = |old: u32, new: u32, size: u32, limit: u32| {
                if new > old { new.max(old.saturating_add(size).min(limit)) } else { old }
            };
            window = BoundingBox {
                x0: before(old.x0, wanted.x0, old.width()),
                y0: before(old.y0, wanted.y0, old.height()),
                x1: after(old.x1, wanted.x1, old.width(), self.width),
                y1: after(old.y1, wanted.y1, old.height(), self.height),
            };
        }
        (self.pixels, self.window) = (self.pixels_in(window), window);
    }

    /// Number of set pixels.
    pub fn area_px2(&self) -> usize {
        self.pixels.iter().filter(|&&p| p).count()
    }

    /// Bounding box of the set pixels; `None` if there is none.
    pub fn bounding_box(&self) -> Option<BoundingBox> {
        bounds_of(self.rows(), |set| set)
    }

    /// Number of pixels set in both; the sizes must agree.
    pub fn intersection_px2(&self, other: &Self) -> usize {
        assert_eq!((self.width, self.height), (other.width, other.height), "masks of one frame have one size");
        let common = self.window.intersection(&other.window);
        let in_both = |(one, two): (&[bool], &[bool])| one.iter().zip(two).filter(|&(&a, &b)| a && b).count();
        let rows = self.parts(&common).zip(other.parts(&common));
        rows.map(|((_, one), (_, two))| in_both((one, two))).sum()
    }

    /// Intersection over union; 0 when both are empty.
    pub fn iou(&self, other: &Self) -> f64 {
        let both = self.intersection_px2(other);
        let either = self.area_px2() + other.area_px2() - both;
        if either == 0 { 0.0 } else { both as f64 / either as f64 }
    }

    /// Adds the pixels of another mask of the same size.
    pub fn union_with(&mut self, other: &Self) {
        assert_eq!((self.width, self.height), (other.width, other.height), "masks of one frame have one size");
        let Some(added) = other.bounding_box() else { return };
        self.reserve(&added);
        for (y, row) in other.parts(&added) {
            let start = pixel_index(&self.window, added.x0, y);
            self.pixels[start..start + row.len()].iter_mut().zip(row).for_each(|(a, &b)| *a |= b);
        }
    }

    /// Mask of the pixels that are not set.
    pub fn complement(&self) -> Self {
        let mut out = Self::full(self.width, self.height);
        for (y, x0, row) in self.rows() {
            let start = pixel_index(&out.window, x0, y);
            out.pixels[start..start + row.len()].iter_mut().zip(row).for_each(|(out, set)| *out = !set);
        }
        out
    }

    /// Dilation by `radius_px` in the maximum norm: a pixel is set if any pixel of the square around it is.
    pub fn dilated(&self, radius_px: u32) -> Self {
        let Some(from) = self.bounding_box().filter(|_| radius_px > 0) else { return self.clone() };
        let window = from.grown(radius_px, (self.width, self.height));
        let (before, size) = (self.pixels_in(window), window.width() as usize);
        let mut pixels = vec![false; before.len()];
        // Separable: along rows, then along columns, row by row.
        for (row, out) in before.chunks_exact(size).zip(pixels.chunks_exact_mut(size)) {
            dilate_row(row, radius_px as usize, |x| out[x] = true);
        }
        let wide = pixels.clone();
        let rows: Vec<Range<usize>> = (0..window.height() as usize).map(|y| y * size..(y + 1) * size).collect();
        dilate_columns(&wide, &mut pixels, rows.iter().cloned(), radius_px);
        dilate_columns(&wide, &mut pixels, rows.into_iter().rev(), radius_px);
        Self { window, pixels, ..*self }
    }

    /// Erosion by `radius_px` in the maximum norm; pixels outside the frame count as set.
    pub fn eroded(&self, radius_px: u32) -> Self {
        let Some(set) = self.bounding_box().filter(|_| radius_px > 0) else { return self.clone() };
        // No pixel outside the box is set; a margin of one clear pixel on each side represents all of them.
        let window = set.grown(1, (self.width, self.height));
        let inverted = |pixels: Vec<bool>| pixels.into_iter().map(|set| !set).collect();
        let own = BoundingBox { x0: 0, y0: 0, x1: window.width(), y1: window.height() };
        let unset = Self::from_window((own.x1, own.y1), own, inverted(self.pixels_in(window))).dilated(radius_px);
        Self { window, pixels: inverted(unset.pixels_in(own)), ..*self }
    }

    /// Rows of a part of the window, with their index in the frame.
    fn parts(&self, part: &BoundingBox) -> impl Iterator<Item = (u32, &[bool])> {
        let (rows, width) = (if part.area() > 0 { part.y0..part.y1 } else { 0..0 }, part.width() as usize);
        let x0 = part.x0;
        rows.map(move |y| {
            let start = pixel_index(&self.window, x0, y);
            (y, &self.pixels[start..start + width])
        })
    }
}

impl PartialEq for Mask {
    fn eq(&self, other: &Self) -> bool {
        let content = |mask: &Self| mask.bounding_box().map(|bounds| (bounds, mask.pixels_in(bounds)));
        (self.width, self.height) == (other.width, other.height) && content(self) == content(other)
    }
}

impl Eq for Mask {}

/// Index of a pixel in a window's row-major pixels.
fn pixel_index(window: &BoundingBox, x: u32, y: u32) -> usize {
    (y - window.y0) as usize * window.width() as usize + (x - window.x0) as usize
}

/// Bounding box of the values that satisfy `inside`; `None` if there is none.
///
/// * `rows` – row index, first column and values of each row.
fn bounds_of<'a, T: Copy + 'a>(
    rows: impl Iterator<Item = (u32, u32, &'a [T])>,
    inside: impl Fn(T) -> bool,
) -> Option<BoundingBox> {
    let mut found: Option<BoundingBox> = None;
    for (y, start, row) in rows {
        // Without early exit this is vectorized: most rows are empty.
        if !row.iter().fold(false, |any, &value| any | inside(value)) {
            continue;
        }
        let Some(first) = row.iter().position(|&value| inside(value)) else { continue };
        let last = row.iter().rposition(|&value| inside(value)).unwrap_or(first);
        let (x0, x1) = (start + first as u32, start + last as u32 + 1);
        found = Some(match found {
            None => BoundingBox { x0, y0: y, x1, y1: y + 1 },
            Some(b) => BoundingBox { x0: b.x0.min(x0), y0: b.y0, x1: b.x1.max(x1), y1: y + 1 },
        });
    }
    found
}

/// Calls `set` for every column of a row within `radius` of a set pixel.
fn dilate_row(row: &[bool], radius: usize, mut set: impl FnMut(usize)) {
    let mut next = 0;
    for x in (0..row.len()).filter(|&x| row[x]) {
        let end = x.saturating_add(radius).saturating_add(1).min(row.len());
        (next.max(x.saturating_sub(radius))..end).for_each(&mut set);
        next = end;
    }
}

/// Sets in each row the columns that are set in one of the `radius` rows before it, or in the row itself.
///
/// * `rows` – index ranges of consecutive rows in `pixels`; all of one length.
fn dilate_columns(pixels: &[bool], out: &mut [bool], rows: impl Iterator<Item = Range<usize>>, radius: u32) {
    let mut left: Vec<u32> = Vec::new();
    for row in rows {
        left.resize(row.len(), 0);
        for ((left, &is_set), out) in left.iter_mut().zip(&pixels[row.clone()]).zip(&mut out[row]) {
            *left = if is_set { radius.saturating_add(1) } else { *left };
            *out |= *left > 0;
            *left = left.saturating_sub(1);
        }
    }
}

/// Label of every pixel: 0 is background, k is object k (or class k).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelMap {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Row-major labels.
    pub labels: Vec<u8>,
}

impl LabelMap {
    /// Mask of the pixels with one label.
    pub fn mask(&self, label: u8) -> Mask {
        Mask::from_values(self.width, self.height, &self.labels, |l| l == label)
    }

    /// Mask of the pixels with any label but 0.
    pub fn any(&self) -> Mask {
        Mask::from_values(self.width, self.height, &self.labels, |l| l != 0)
    }

    /// The map resized by nearest neighbors: the label at the center of every pixel of the new size.
    pub fn resized(&self, (width, height): (u32, u32)) -> Self {
        let from = |k: u32, to: u32, side: u32| (u64::from(2 * k + 1) * u64::from(side) / u64::from(2 * to)) as usize;
        let row = |y: u32| from(y, height, self.height) * self.width as usize;
        let indices = (0..height).flat_map(|y| (0..width).map(move |x| row(y) + from(x, width, self.width)));
        Self { width, height, labels: indices.map(|idx| self.labels[idx]).collect() }
    }

    /// The labels that occur, ascending, without 0.
    pub fn present(&self) -> Vec<u8> {
        let mut seen = [false; 256];
        for &label in &self.labels {
            seen[label as usize] = true;
        }
        (1..=255).filter(|&label| seen[label as usize]).collect()
    }
}

/// Detection of a segmentation model in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Class name, from the model's metadata.
    pub class: String,
    /// The model's score, 0 to 1.
    pub confidence: f64,
    /// Its pixels, at the frame's resolution.
    pub mask: Mask,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_are_filled_up_to_the_image_border() {
        let mut mask = Mask::empty(6, 4);
        mask.fill_rect(&Rect { x0: 3.5, y0: -2.0, x1: 9.0, y1: 1.2 }, true);
        assert_eq!(mask, Mask::from_fn(6, 4, |x, y| x >= 3 && y < 2));
    }

    #[test]
    fn masks_that_nearly_reach_the_border_may_be_truncated() {
        let is_truncated = |x0: u32, x1: u32| BoundingBox { x0, y0: 40, x1, y1: 60 }.is_truncated(640, 360);
        // Small and large masks, whole ones and some that end a few pixels before the border.
        assert!(!is_truncated(3, 23) && !is_truncated(617, 637) && !is_truncated(7, 147));
        assert!(is_truncated(0, 20) && is_truncated(2, 22) && is_truncated(620, 640) && is_truncated(618, 638));
        assert!(is_truncated(6, 148), "a lorry whose mask ended 6 px before the border that cut off its cab");
    }

    #[test]
    fn dilation_grows_by_the_radius_and_erosion_undoes_it() {
        let dot = Mask::from_fn(11, 9, |x, y| (x, y) == (5, 4));
        let grown = dot.dilated(2);
        assert_eq!(grown.bounding_box(), Some(BoundingBox { x0: 3, y0: 2, x1: 8, y1: 7 }));
        assert_eq!(grown.area_px2(), 25);
        assert_eq!(grown.eroded(2), dot);
        assert_eq!(Mask::empty(4, 4).dilated(3), Mask::empty(4, 4));
        let corner = Mask::from_fn(5, 5, |x, y| (x, y) == (4, 0)).dilated(1);
        assert_eq!(corner.bounding_box(), Some(BoundingBox { x0: 3, y0: 0, x1: 5, y1: 2 }));
        assert_eq!(corner.area_px2(), 4);
    }

    #[test]
    fn dilation_sets_the_pixels_within_the_radius_only() {
        for (width, height, radius) in [(23, 17, 1), (23, 17, 3), (5, 30, 7), (9, 1, 2), (1, 9, 40), (12, 12, u32::MAX)]
        {
            let mask = Mask::from_fn(width, height, |x, y| (x * 7 + y * 13) % 31 == 3);
            let is_near = |x: u32, y: u32| {
                let set = |u: u32, v: u32| mask.get(u.into(), v.into()) && u.abs_diff(x).max(v.abs_diff(y)) <= radius;
                (0..height).any(|v| (0..width).any(|u| set(u, v)))
            };
            assert_eq!(mask.dilated(radius), Mask::from_fn(width, height, is_near), "{width} × {height}, {radius}");
        }
    }

    #[test]
    fn erosion_keeps_the_pixels_beyond_the_radius_only() {
        for (width, height, radius) in
            [(23, 17, 1), (40, 30, 2), (5, 30, 3), (9, 1, 1), (12, 12, u32::MAX), (30, 20, 0)]
        {
            let disc =
                |x: u32, y: u32| (x as i32 - 15).pow(2) + (y as i32 - 9).pow(2) < 90 && (x * 7 + y * 13) % 41 != 3;
            let whole = |_, _| true;
            let corner = |x: u32, y: u32| x < 4 && y < 6;
            let masks = [Mask::from_fn(width, height, disc), Mask::from_fn(width, height, whole)];
            for mask in masks.into_iter().chain([Mask::from_fn(width, height, corner), Mask::empty(width, height)]) {
                let is_near = |x: u32, y: u32, u: u32, v: u32| u.abs_diff(x).max(v.abs_diff(y)) <= radius;
                let is_deep = |x: u32, y: u32| {
                    (0..height).all(|v| (0..width).all(|u| !is_near(x, y, u, v) || mask.get(u.into(), v.into())))
                };
                assert_eq!(mask.eroded(radius), Mask::from_fn(width, height, is_deep), "{width} × {height}, {radius}");
            }
        }
    }

    #[test]
    fn growing_windows_do_not_change_masks() {
        use rand::Rng as _;
        let (width, height) = (37, 23);
        let mut rng = crate::math::seeded_rng(1, 0);
        for _ in 0..20 {
            let mut expected = vec![false; (width * height) as usize];
            let (mut mask, mut other) = (Mask::empty(width, height), Mask::empty(width, height));
            for _ in 0..30 {
                let (x, y, value) = (rng.random_range(0..width), rng.random_range(0..height), rng.random_bool(0.7));
                let end = rng.random_range(x..=width.min(x + 9));
                expected[(y * width + x) as usize..(y * width + end) as usize].fill(value);
                mask.fill(x..end, y, value);
            }
            assert_eq!(mask, Mask::from_values(width, height, &expected, |set| set));
            let bytes: Vec<u8> = expected.iter().map(|set| 255 * u8::from(*set)).collect();
            assert_eq!(mask.to_bytes(), bytes);
            assert_eq!(mask.area_px2(), mask.iter().count());
            mask.iter().for_each(|(x, y)| other.set(x, y));
            assert_eq!(other, mask);
            assert_eq!(mask.complement().complement(), mask);
            let left = Mask::from_fn(width, height, |x, _| x < 9);
            let common = Mask::from_fn(width, height, |x, y| x < 9 && mask.get(x.into(), y.into()));
            assert_eq!(mask.intersection_px2(&left), common.area_px2());
            other.union_with(&left);
            assert_eq!(other.area_px2(), mask.area_px2() + left.area_px2() - common.area_px2());
        }
        assert_eq!(Mask::empty(0, 0).complement(), Mask::full(0, 0));
    }

    #[test]
    fn overlap_is_counted_once() {
        let a = Mask::from_fn(4, 1, |x, _| x < 3);
        let b = Mask::from_fn(4, 1, |x, _| x > 0);
        assert_eq!(a.intersection_px2(&b), 2);
        assert_eq!(a.iou(&b), 0.5);
        assert_eq!(Mask::empty(3, 3).iou(&Mask::empty(3, 3)), 0.0);
        assert!(a.contains(2.9, 0.1) && !a.contains(3.0, 0.1) && !a.contains(-0.1, 0.0));
    }

    #[test]
    fn labels_become_masks() {
        let map = LabelMap { width: 3, height: 1, labels: vec![0, 2, 5] };
        assert_eq!(map.present(), [2, 5]);
        assert_eq!(map.mask(5).area_px2(), 1);
        assert_eq!(map.any().area_px2(), 2);
    }
}
