//! A mask that stores only its bounding box: a frame has many small objects, and they are compared in pairs.

use crate::scene::{BoundingBox, Mask, Rect};

/// The set pixels of one object; never empty.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Region {
    bounds: BoundingBox,
    /// Row-major over the bounding box.
    pixels: Vec<bool>,
    area: usize,
}

impl Region {
    /// The set pixels of a mask; `None` if there is none.
    pub(super) fn from_mask(mask: &Mask) -> Option<Self> {
        let bounds = mask.bounding_box()?;
        let pixels = mask.pixels_in(bounds);
        let area = pixels.iter().filter(|&&p| p).count();
        Some(Self { bounds, pixels, area })
    }

    /// The pixels of `bounds` that are set, row-major; shrinks the box to them. `None` if none is set.
    pub(super) fn from_pixels(bounds: BoundingBox, pixels: Vec<bool>) -> Option<Self> {
        Self::from_mask(&Mask::from_window((bounds.x1, bounds.y1), bounds, pixels))
    }

    /// The region in a frame of the given size.
    pub(super) fn to_mask(&self, width: u32, height: u32) -> Mask {
        Mask::from_window((width, height), self.bounds, self.pixels.clone())
    }

    pub(super) fn bounds(&self) -> BoundingBox {
        self.bounds
    }

    /// The bounding box as a box of real numbers.
    pub(super) fn rect(&self) -> Rect {
        self.bounds.into()
    }

    /// Number of pixels.
    pub(super) fn area(&self) -> usize {
        self.area
    }

    /// Centre of the bounding box, pixels.
    pub(super) fn centre(&self) -> [f64; 2] {
        let b = self.bounds;
        [f64::from(b.x0 + b.x1) / 2.0, f64::from(b.y0 + b.y1) / 2.0]
    }

    /// Side of a square as large as the bounding box, pixels.
    pub(super) fn size(&self) -> f64 {
        (f64::from(self.bounds.width()) * f64::from(self.bounds.height())).sqrt()
    }

    pub(super) fn contains(&self, x: u32, y: u32) -> bool {
        let b = self.bounds;
        let inside = x >= b.x0 && x < b.x1 && y >= b.y0 && y < b.y1;
        inside && self.pixels[(y - b.y0) as usize * b.width() as usize + (x - b.x0) as usize]
    }

    /// The set pixels, row by row.
    pub(super) fn iter(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let (b, width) = (self.bounds, self.bounds.width());
        let at = move |(i, _): (usize, &bool)| (b.x0 + i as u32 % width, b.y0 + i as u32 / width);
        self.pixels.iter().enumerate().filter(|(_, set)| **set).map(at)
    }

    /// Pixels set in both.
    pub(super) fn intersection(&self, other: &Self) -> usize {
        let (a, b) = (self.bounds, other.bounds);
        let (x0, x1) = (a.x0.max(b.x0), a.x1.min(b.x1));
        let (y0, y1) = (a.y0.max(b.y0), a.y1.min(b.y1));
        if x0 >= x1 {
            return 0;
        }
        let row = |r: &Self, y: u32| {
            let start = (y - r.bounds.y0) as usize * r.bounds.width() as usize;
            start + (x0 - r.bounds.x0) as usize..start + (x1 - r.bounds.x0) as usize
        };
        (y0..y1)
            .map(|y| {
                let (one, two) = (&self.pixels[row(self, y)], &other.pixels[row(other, y)]);
                one.iter().zip(two).filter(|&(&p, &q)| p && q).count()
            })
            .sum()
    }

    /// Intersection over union.
    pub(super) fn iou(&self, other: &Self) -> f64 {
        let both = self.intersection(other);
        both as f64 / (self.area + other.area - both) as f64
    }

    /// Share of this region that lies in another.
    pub(super) fn covered_by(&self, other: &Self) -> f64 {
        self.intersection(other) as f64 / self.area as f64
    }

    /// The region moved by whole pixels, clipped to the frame; `None` if it is outside.
    pub(super) fn moved(&self, by: [f64; 2], width: u32, height: u32) -> Option<Self> {
        let (dx, dy) = (by[0].round() as i64, by[1].round() as i64);
        let clip = |v: u32, d: i64, limit: u32| (i64::from(v) + d).clamp(0, i64::from(limit)) as u32;
        let b = self.bounds;
        let bounds = BoundingBox {
            x0: clip(b.x0, dx, width),
            y0: clip(b.y0, dy, height),
            x1: clip(b.x1, dx, width),
            y1: clip(b.y1, dy, height),
        };
        let source = |x: u32, y: u32| self.contains((i64::from(x) - dx) as u32, (i64::from(y) - dy) as u32);
        let pixels: Vec<bool> = (bounds.y0..bounds.y1)
            .flat_map(|y| (bounds.x0..bounds.x1).map(move |x| (x, y)))
            .map(|(x, y)| source(x, y))
            .collect();
        Self::from_pixels(bounds, pixels)
    }

    /// The pixels for which `keep(x, y)` holds; `None` if there is none.
    pub(super) fn filtered(&self, mut keep: impl FnMut(u32, u32) -> bool) -> Option<Self> {
        let (b, width) = (self.bounds, self.bounds.width());
        let kept = |(i, &set): (usize, &bool)| set && keep(b.x0 + i as u32 % width, b.y0 + i as u32 / width);
        let pixels: Vec<bool> = self.pixels.iter().enumerate().map(kept).collect();
        Self::from_pixels(b, pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(x: u32, y: u32, w: u32, h: u32) -> Region {
        Region::from_mask(&Mask::from_fn(40, 30, |u, v| (x..x + w).contains(&u) && (y..y + h).contains(&v))).unwrap()
    }

    #[test]
    fn a_region_is_its_mask() {
        let mask = Mask::from_fn(9, 7, |x, y| (x + y) % 3 == 0 && x > 2);
        let region = Region::from_mask(&mask).unwrap();
        assert_eq!(region.to_mask(9, 7), mask);
        assert_eq!(region.area(), mask.area_px2());
        assert_eq!(Region::from_mask(&Mask::empty(4, 4)), None);
    }

    #[test]
    fn overlaps_agree_with_those_of_masks() {
        let (a, b) = (block(2, 3, 10, 8), block(7, 5, 10, 8));
        assert_eq!(a.intersection(&b), 5 * 6);
        assert_eq!(a.iou(&b), a.to_mask(40, 30).iou(&b.to_mask(40, 30)));
        assert_eq!(a.intersection(&block(20, 20, 3, 3)), 0);
    }

    #[test]
    fn moving_clips_at_the_border() {
        let moved = block(30, 20, 8, 8).moved([5.0, -2.0], 40, 30).unwrap();
        assert_eq!(moved.bounds(), BoundingBox { x0: 35, y0: 18, x1: 40, y1: 26 });
        assert_eq!(moved.area(), 40);
        assert_eq!(block(1, 1, 3, 3).moved([-90.0, 0.0], 40, 30), None);
    }

    #[test]
    fn filtering_shrinks_the_box() {
        let left = block(4, 4, 6, 2).filtered(|x, _| x < 6).unwrap();
        assert_eq!((left.bounds().x1, left.area()), (6, 4));
        assert_eq!(left.filtered(|_, _| false), None);
    }
}
