//! Views of a frame that a network processes one after the other: the whole frame and its tiles.

use super::{SegmentationOptions, Tiling};
use crate::scene::Mask;

/// A rectangle of the frame, whole pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tile {
    pub(super) x0: u32,
    pub(super) y0: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

impl Tile {
    /// The whole frame.
    pub(super) fn whole(width: u32, height: u32) -> Self {
        Self { x0: 0, y0: 0, width, height }
    }

    /// Returns true if a box (x0, y0, x1, y1) in frame pixels ends at a border of the view that is not one of the
    /// frame: such an object is truncated, and another view may contain more of it.
    pub(super) fn cuts(&self, corners: [f32; 4], frame: (u32, u32)) -> bool {
        /// A box within this many pixels of the border ends there.
        const NEAR_PX: f32 = 3.0;
        let (right, bottom) = (self.x0 + self.width, self.y0 + self.height);
        (self.x0 > 0 && corners[0] < self.x0 as f32 + NEAR_PX)
            || (self.y0 > 0 && corners[1] < self.y0 as f32 + NEAR_PX)
            || (right < frame.0 && corners[2] > right as f32 - NEAR_PX)
            || (bottom < frame.1 && corners[3] > bottom as f32 - NEAR_PX)
    }
}

/// The whole frame, and the tiles if the options enable tiling.
pub(super) fn views(frame: (u32, u32), tile: (u32, u32), options: &SegmentationOptions) -> Vec<Tile> {
    let mut views = vec![Tile::whole(frame.0, frame.1)];
    if options.tiling == Tiling::On {
        views.extend(tiles(frame, tile, options.tile_overlap));
    }
    views
}

/// Tiles of at most `tile` pixels that cover the frame with at least the given overlap, evenly spread; empty if one
/// tile contains the frame, since the whole frame is processed in any case.
fn tiles(frame: (u32, u32), tile: (u32, u32), overlap: f64) -> Vec<Tile> {
    let columns = starts(frame.0, tile.0, overlap);
    let rows = starts(frame.1, tile.1, overlap);
    if columns.len() * rows.len() <= 1 {
        return Vec::new();
    }
    let (width, height) = (tile.0.min(frame.0), tile.1.min(frame.1));
    rows.iter().flat_map(|&y0| columns.iter().map(move |&x0| Tile { x0, y0, width, height })).collect()
}

/// First pixels of the minimum number of tiles along one side.
fn starts(side: u32, tile: u32, overlap: f64) -> Vec<u32> {
    if side <= tile || tile == 0 {
        return vec![0];
    }
    let step = (f64::from(tile) * (1.0 - overlap)).max(1.0);
    let gaps = (f64::from(side - tile) / step).ceil().max(1.0);
    (0..=gaps as u32).map(|k| (f64::from(side - tile) * f64::from(k) / gaps).round() as u32).collect()
}

/// Mask of the pixels in a box (x0, y0, x1, y1) of a frame whose centres belong to the object.
pub(super) fn mask_in(corners: [f32; 4], frame: (u32, u32), is_object: impl Fn(f32, f32) -> bool) -> Mask {
    let [x0, y0, x1, y1] = corners;
    let inside = |first: f32, last: f32, side: u32| {
        let first = (first - 0.5).ceil().max(0.0) as u32;
        first..((last - 0.5).ceil().max(0.0) as u32).min(side)
    };
    let mut mask = Mask::empty(frame.0, frame.1);
    for y in inside(y0, y1, frame.1) {
        for x in inside(x0, x1, frame.0) {
            if is_object(x as f32 + 0.5, y as f32 + 0.5) {
                mask.set(x, y);
            }
        }
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_the_frame_with_the_requested_overlap() {
        let all = tiles((1280, 720), (640, 640), 0.2);
        assert_eq!(all.iter().map(|v| v.x0).collect::<Vec<_>>(), [0, 320, 640, 0, 320, 640]);
        assert_eq!(all.iter().map(|v| v.y0).collect::<Vec<_>>(), [0, 0, 0, 80, 80, 80]);
        assert!(tiles((640, 360), (640, 640), 0.2).is_empty());
        for side in [641, 1000, 1153, 3840] {
            let starts = starts(side, 640, 0.2);
            assert_eq!(starts.last(), Some(&(side - 640)));
            assert!(starts.windows(2).all(|w| w[1] - w[0] <= 512), "{starts:?}");
        }
    }

    #[test]
    fn only_inner_borders_cut() {
        let left = Tile { x0: 0, y0: 0, width: 640, height: 640 };
        assert!(!left.cuts([0.0, 0.0, 100.0, 100.0], (1280, 640)));
        assert!(left.cuts([600.0, 10.0, 639.0, 30.0], (1280, 640)));
        assert!(!Tile::whole(1280, 640).cuts([0.0, 0.0, 1280.0, 640.0], (1280, 640)));
    }
}
