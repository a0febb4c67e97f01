//! Binary masks, label maps and detections, all at the frame's own resolution.

use serde::{Deserialize, Serialize};

/// A set of pixels of one frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    pixels: Vec<bool>,
}

/// An axis-aligned box of whole pixels: `x0 ≤ x < x1`, `y0 ≤ y < y1`.
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

    /// Returns true if it reaches the border of an image of a size, pixels.
    pub fn touches_border(&self, width: u32, height: u32) -> bool {
        self.x0 == 0 || self.y0 == 0 || self.x1 >= width || self.y1 >= height
    }
}

impl Mask {
    /// No pixel set.
    pub fn empty(width: u32, height: u32) -> Self {
        Self { width, height, pixels: vec![false; width as usize * height as usize] }
    }

    /// Every pixel set.
    pub fn full(width: u32, height: u32) -> Self {
        Self { width, height, pixels: vec![true; width as usize * height as usize] }
    }

    /// The pixels at which `inside(x, y)` holds.
    pub fn from_fn(width: u32, height: u32, mut inside: impl FnMut(u32, u32) -> bool) -> Self {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| inside(x, y)).collect();
        Self { width, height, pixels }
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Row-major pixels.
    pub fn pixels(&self) -> &[bool] {
        &self.pixels
    }

    /// Row-major pixels, to change.
    pub fn pixels_mut(&mut self) -> &mut [bool] {
        &mut self.pixels
    }

    /// Row-major bytes, 255 where set: what image libraries and the contract's PNG files take.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.pixels.iter().map(|&p| if p { 255 } else { 0 }).collect()
    }

    /// Returns true if a pixel is set; outside the frame none is.
    pub fn get(&self, x: i64, y: i64) -> bool {
        x >= 0
            && y >= 0
            && x < i64::from(self.width)
            && y < i64::from(self.height)
            && self.pixels[y as usize * self.width as usize + x as usize]
    }

    /// Returns true if the pixel at an image position is set (center of the first pixel at 0.5, 0.5).
    pub fn contains(&self, x: f64, y: f64) -> bool {
        self.get(x.floor() as i64, y.floor() as i64)
    }

    /// Sets or clears one pixel, which must lie in the frame.
    pub fn set(&mut self, x: u32, y: u32, value: bool) {
        self.pixels[y as usize * self.width as usize + x as usize] = value;
    }

    /// Number of set pixels.
    pub fn area_px2(&self) -> usize {
        self.pixels.iter().filter(|&&p| p).count()
    }

    /// The smallest box round all set pixels; `None` if there is none.
    pub fn bounding_box(&self) -> Option<BoundingBox> {
        let mut found: Option<BoundingBox> = None;
        for (y, row) in (0..self.height).zip(self.pixels.chunks_exact((self.width as usize).max(1))) {
            // Without an early end it is done in vectors: most rows are empty.
            if !row.iter().fold(false, |any, &p| any | p) {
                continue;
            }
            let Some(first) = row.iter().position(|&p| p) else { continue };
            let last = row.iter().rposition(|&p| p).unwrap_or(first);
            let (x0, x1) = (first as u32, last as u32 + 1);
            found = Some(match found {
                None => BoundingBox { x0, y0: y, x1, y1: y + 1 },
                Some(b) => BoundingBox { x0: b.x0.min(x0), y0: b.y0, x1: b.x1.max(x1), y1: y + 1 },
            });
        }
        found
    }

    /// Pixels set in both; the sizes must agree.
    pub fn intersection_px2(&self, other: &Self) -> usize {
        assert_eq!((self.width, self.height), (other.width, other.height), "masks of one frame have one size");
        self.pixels.iter().zip(&other.pixels).filter(|&(&a, &b)| a && b).count()
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
        for (a, &b) in self.pixels.iter_mut().zip(&other.pixels) {
            *a |= b;
        }
    }

    /// The pixels that are not set.
    pub fn complement(&self) -> Self {
        Self { width: self.width, height: self.height, pixels: self.pixels.iter().map(|&p| !p).collect() }
    }

    /// Grown by `radius_px` in the maximum norm: a pixel is set if any within the square round it is.
    pub fn dilated(&self, radius_px: u32) -> Self {
        let Some(from) = self.bounding_box().filter(|_| radius_px > 0) else { return self.clone() };
        let to = BoundingBox {
            x0: from.x0.saturating_sub(radius_px),
            y0: from.y0.saturating_sub(radius_px),
            x1: from.x1.saturating_add(radius_px).min(self.width),
            y1: from.y1.saturating_add(radius_px).min(self.height),
        };
        let mut out = Self::empty(self.width, self.height);
        // Separable: along rows, then along columns, of which one row is looked at after the other.
        let columns = to.x0 as usize..to.x1 as usize;
        for y in from.y0..from.y1 {
            let row = self.row(y);
            spread(&self.pixels[row.start + columns.start..row.start + columns.end], radius_px as usize, |x| {
                out.pixels[row.start + columns.start + x] = true;
            });
        }
        let part = |y: u32| self.row(y).start + columns.start..self.row(y).start + columns.end;
        let rows: Vec<_> = (to.y0..to.y1).map(part).collect();
        let wide = out.pixels.clone();
        smear(&wide, &mut out.pixels, rows.iter().cloned(), radius_px);
        smear(&wide, &mut out.pixels, rows.into_iter().rev(), radius_px);
        out
    }

    /// Where a row lies among the pixels.
    fn row(&self, y: u32) -> std::ops::Range<usize> {
        let start = y as usize * self.width as usize;
        start..start + self.width as usize
    }

    /// Shrunk by `radius_px` in the maximum norm; pixels beyond the frame's border count as set.
    pub fn eroded(&self, radius_px: u32) -> Self {
        let Some(set) = self.bounding_box().filter(|_| radius_px > 0) else { return self.clone() };
        // Nothing is set beyond the box, which one pixel more on each side says as well as all of them.
        let (x0, y0) = (set.x0.saturating_sub(1), set.y0.saturating_sub(1));
        let (x1, y1) = ((set.x1 + 1).min(self.width), (set.y1 + 1).min(self.height));
        let part = |mask: &Self, y: u32| mask.row(y).start + x0 as usize..mask.row(y).start + x1 as usize;
        let mut unset = Self::empty(x1 - x0, y1 - y0);
        for y in y0..y1 {
            let own = unset.row(y - y0);
            unset.pixels[own].copy_from_slice(&self.pixels[part(self, y)]);
        }
        unset.pixels.iter_mut().for_each(|set| *set = !*set);
        let unset = unset.dilated(radius_px);
        let mut out = Self::empty(self.width, self.height);
        for y in y0..y1 {
            let to = part(&out, y);
            let from = &unset.pixels[unset.row(y - y0)];
            out.pixels[to].iter_mut().zip(from).for_each(|(to, from)| *to = !from);
        }
        out
    }
}

/// Calls `set` for every place in a row within `radius` of a set one.
fn spread(row: &[bool], radius: usize, mut set: impl FnMut(usize)) {
    let mut next = 0;
    for x in (0..row.len()).filter(|&x| row[x]) {
        let end = x.saturating_add(radius).saturating_add(1).min(row.len());
        (next.max(x.saturating_sub(radius))..end).for_each(&mut set);
        next = end;
    }
}

/// Sets in each row what is set in one of the `radius` rows before it.
///
/// * `rows` – where they lie among the pixels, one after the other; all of one length.
fn smear(pixels: &[bool], out: &mut [bool], rows: impl Iterator<Item = std::ops::Range<usize>>, radius: u32) {
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

/// One number per pixel: 0 is background, k is object k (or class k).
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
    /// The pixels that carry one label.
    pub fn mask(&self, label: u8) -> Mask {
        Mask { width: self.width, height: self.height, pixels: self.labels.iter().map(|&l| l == label).collect() }
    }

    /// The pixels that carry any label but 0.
    pub fn any(&self) -> Mask {
        Mask { width: self.width, height: self.height, pixels: self.labels.iter().map(|&l| l != 0).collect() }
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

/// One object found in one frame by a segmentation model.
#[derive(Clone, Debug, PartialEq)]
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
    fn dilation_sets_what_is_near_and_nothing_else() {
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
    fn erosion_keeps_what_lies_deep_and_nothing_else() {
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
