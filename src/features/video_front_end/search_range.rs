//! Search range and point spacing by the size of the target.
//!
//! A patch shows its point only where it covers the target. At a corner of a vehicle of thirty pixels a patch of
//! fifteen is half road, which moves relative to it: the track ends after a few frames, or drifts with the road. At the
//! coarse levels of a pyramid such a vehicle has four pixels, and Lucas-Kanade estimates the motion of the road. So
//! small targets get smaller patches and windows and denser points, and their points are searched first at the
//! displacement of their mask.

use nalgebra::{Point2, Vector2};

use super::VideoOptions;
use crate::scene::Mask;

/// Side of a target (the root of its area) over half the side of its largest patch: two patches fit across it.
const SIDE_IN_RADII: f64 = 5.0;
/// Half the side of the smallest patch that still determines a position, pixels.
const MIN_RADIUS_PX: i32 = 3;
/// Maximum spacing of points, from one another and from the outline, as a share of the target's side.
const SPACING: f64 = 0.1;
/// Minimum spacing of two points, pixels.
const MIN_SPACING_PX: f64 = 2.0;
/// Minimum distance of points from the outline, pixels: a nearer one is on the road as often as not.
const MIN_BORDER_PX: u32 = 1;

/// Position and size of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Mean of its pixels.
    pub middle: Point2<f32>,
    /// The side of a square of its area, pixels.
    pub side_px: f64,
}

impl Extent {
    /// `None` for an empty mask.
    pub fn of(mask: &Mask) -> Option<Self> {
        let (mut count, mut sum) = (0u64, [0u64; 2]);
        for (x, y) in mask.iter() {
            count += 1;
            sum = [sum[0] + u64::from(x), sum[1] + u64::from(y)];
        }
        if count == 0 {
            return None;
        }
        let middle = sum.map(|sum| (sum as f64 / count as f64 + 0.5) as f32);
        Some(Self { middle: middle.into(), side_px: (count as f64).sqrt() })
    }
}

/// Search range of the options, limited by the size of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchRange {
    pub window_radius_px: i32,
    pub patch_radius_px: i32,
    pub min_distance_px: f64,
    pub border_px: u32,
}

impl SearchRange {
    /// Search range for a target's extent; without an extent that of the options.
    pub fn new(options: &VideoOptions, extent: Option<Extent>) -> Self {
        let side_px = extent.map_or(f64::INFINITY, |extent| extent.side_px);
        let most_radius_px = ((side_px / SIDE_IN_RADII).min(1000.0) as i32).max(MIN_RADIUS_PX);
        let spacing_px = SPACING * side_px;
        Self {
            window_radius_px: options.window_radius_px.min(most_radius_px),
            patch_radius_px: options.patch_radius_px.min(most_radius_px),
            min_distance_px: options.min_distance_px.min(spacing_px.max(MIN_SPACING_PX)),
            border_px: options.border_px.min((spacing_px.min(1000.0) as u32).max(MIN_BORDER_PX)),
        }
    }
}

/// Displacement of a target between two frames, for small targets.
///
/// `None` for a target that fills the window at the coarsest level, which shows its motion.
pub fn shift(options: &VideoOptions, from: Option<Extent>, to: Option<Extent>) -> Option<Vector2<f32>> {
    let coarsest_px = f64::from(options.window_radius_px) * 2f64.powi(options.pyramid_levels);
    let (from, to) = (from?, to?);
    (from.side_px.max(to.side_px) < coarsest_px).then(|| to.middle - from.middle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_has_a_middle_and_a_side() {
        let mask = Mask::from_fn(60, 40, |x, y| (10..30).contains(&x) && (20..25).contains(&y));
        let found = Extent::of(&mask).unwrap();
        assert_eq!((found.middle, found.side_px), (Point2::new(20.0, 22.5), 10.0));
        assert_eq!(Extent::of(&Mask::empty(60, 40)), None);
    }

    #[test]
    fn small_targets_get_small_patches_and_large_ones_those_of_the_options() {
        let options = VideoOptions::object();
        let reach = |side_px| SearchRange::new(&options, Some(Extent { middle: Point2::origin(), side_px }));
        let large = SearchRange::new(&options, None);
        assert_eq!(large.patch_radius_px, options.patch_radius_px);
        assert_eq!((reach(60.0), large.min_distance_px, large.border_px), (large, 4.0, 2));
        assert_eq!(
            reach(21.0),
            SearchRange { window_radius_px: 4, patch_radius_px: 4, min_distance_px: 2.1, border_px: 2 }
        );
        assert_eq!((reach(15.0).border_px, reach(1.0).patch_radius_px), (1, 3));
    }

    #[test]
    fn only_small_targets_are_searched_at_the_displacement_of_their_mask() {
        let options = VideoOptions::object();
        let at = |x, side_px| Some(Extent { middle: Point2::new(x, 5.0), side_px });
        assert_eq!(shift(&options, at(3.0, 20.0), at(10.0, 21.0)), Some(Vector2::new(7.0, 0.0)));
        assert_eq!(shift(&options, at(3.0, 100.0), at(10.0, 100.0)), None);
        assert_eq!(shift(&options, None, at(10.0, 20.0)), None);
    }
}
