//! Mask with its bounding box and area, for comparing objects in pairs.

use super::affine::Affine;
use crate::scene::{BoundingBox, Mask, Rect};

/// The set pixels of one object; never empty.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Region {
    /// In the frame; its window is the bounding box.
    mask: Mask,
    bounds: BoundingBox,
    area: usize,
}

impl Region {
    /// The set pixels of a mask; `None` if there are none.
    pub(super) fn from_mask(mask: &Mask) -> Option<Self> {
        let bounds = mask.bounding_box()?;
        let mask = Mask::from_window((mask.width(), mask.height()), bounds, mask.pixels_in(bounds));
        Some(Self { bounds, area: mask.area_px2(), mask })
    }

    /// Pixels of `window` for which `inside(x, y)` holds; `None` if there are none.
    pub(super) fn in_window(
        frame: (u32, u32),
        window: BoundingBox,
        inside: impl FnMut(u32, u32) -> bool,
    ) -> Option<Self> {
        Self::from_mask(&Mask::in_window(frame, window, inside))
    }

    /// The region in its frame.
    pub(super) fn mask(&self) -> &Mask {
        &self.mask
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

    /// Side of a square as large as the bounding box, pixels.
    pub(super) fn size(&self) -> f64 {
        (f64::from(self.bounds.width()) * f64::from(self.bounds.height())).sqrt()
    }

    pub(super) fn contains(&self, x: u32, y: u32) -> bool {
        self.mask.get(i64::from(x), i64::from(y))
    }

    /// The set pixels, row by row.
    pub(super) fn iter(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.mask.iter()
    }

    /// Intersection over union.
    pub(super) fn iou(&self, other: &Self) -> f64 {
        let both = self.mask.intersection_px2(&other.mask);
        both as f64 / (self.area + other.area - both) as f64
    }

    /// Share of this region that is inside another.
    pub(super) fn covered_by(&self, other: &Self) -> f64 {
        self.mask.intersection_px2(&other.mask) as f64 / self.area as f64
    }

    /// The region moved by whole pixels, clipped to the frame; `None` if it is outside.
    pub(super) fn moved(&self, [dx, dy]: [f64; 2]) -> Option<Self> {
        Affine::shift([dx.round(), dy.round()]).apply(self)
    }

    /// Pixels for which `keep(x, y)` holds; `None` if there are none.
    pub(super) fn filtered(&self, mut keep: impl FnMut(u32, u32) -> bool) -> Option<Self> {
        let frame = (self.mask.width(), self.mask.height());
        Self::in_window(frame, self.bounds, |x, y| self.contains(x, y) && keep(x, y))
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
        assert_eq!(*region.mask(), mask);
        assert_eq!(region.area(), mask.area_px2());
        assert_eq!(Region::from_mask(&Mask::empty(4, 4)), None);
    }

    #[test]
    fn overlaps_agree_with_those_of_masks() {
        let (a, b) = (block(2, 3, 10, 8), block(7, 5, 10, 8));
        assert_eq!(a.covered_by(&b), 30.0 / 80.0);
        assert_eq!(a.iou(&b), a.mask().iou(b.mask()));
        assert_eq!(a.iou(&block(20, 20, 3, 3)), 0.0);
    }

    #[test]
    fn moving_clips_at_the_border() {
        let moved = block(30, 20, 8, 8).moved([5.0, -2.0]).unwrap();
        assert_eq!(moved.bounds(), BoundingBox { x0: 35, y0: 18, x1: 40, y1: 26 });
        assert_eq!(moved.area(), 40);
        assert_eq!(block(1, 1, 3, 3).moved([-90.0, 0.0]), None);
    }

    #[test]
    fn filtering_shrinks_the_box() {
        let left = block(4, 4, 6, 2).filtered(|x, _| x < 6).unwrap();
        assert_eq!((left.bounds().x1, left.area()), (6, 4));
        assert_eq!(left.filtered(|_, _| false), None);
    }
}
