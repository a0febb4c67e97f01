//! Propagation of masks to the next frame by optical flow.

use super::affine::{Affine, length};
use super::occlusion::{ImagePair, Occlusion, PropagatedObject};
use super::region::Region;
use crate::math::upper_median;
use crate::scene::{BoundingBox, Flow, Mask, Rect};

/// Object propagated to the next frame.
#[derive(Clone, Debug)]
pub(super) struct Propagated {
    /// Its visible pixels, holes closed.
    pub(super) region: Region,
    /// Its whole outline, including occluded parts.
    pub(super) whole: Region,
    /// Occluded part.
    pub(super) occlusion: Occlusion,
    /// Median displacement, pixels.
    pub(super) displacement: [f64; 2],
    /// Share of its visible pixels whose flow is an inlier.
    pub(super) inlier_ratio: f64,
    /// Motion from the previous frame.
    pub(super) motion: Affine,
}

impl Propagated {
    /// Visible share of the outline below which an object is partly occluded.
    const MOSTLY_VISIBLE: f64 = 0.9;
    /// Minimum visible share of an object that is mostly occluded.
    const MIN_VISIBLE_SHARE: f64 = 0.06;

    pub(super) fn is_partly_occluded(&self) -> bool {
        self.visible_share() < Self::MOSTLY_VISIBLE
    }

    pub(super) fn is_nearly_occluded(&self) -> bool {
        self.visible_share() < Self::MIN_VISIBLE_SHARE
    }

    fn visible_share(&self) -> f64 {
        self.region.area() as f64 / self.whole.area().max(1) as f64
    }
}

/// Maximum residual of an inlier's flow from the object's median, pixels: other pixels belong to the mask's rim or to
/// an occluder.
const MAX_RESIDUAL_PX: f64 = 3.0;
/// The same in multiples of the object's own spread of flow, for large objects that approach or turn.
const MAX_RESIDUAL_SPREADS: f64 = 4.0;

/// Inliers of the flow in a region.
struct FlowInliers {
    pixels: Vec<(u32, u32)>,
    /// Median displacement, pixels.
    displacement: [f64; 2],
}

/// Pixels of a region whose flow is consistent and close to the median; `None` if there are none.
fn flow_inliers(region: &Region, flow: &Flow) -> Option<FlowInliers> {
    let consistent: Vec<(u32, u32)> = region.iter().filter(|&(x, y)| flow.is_consistent(x, y)).collect();
    let displacement = median_flow(&consistent, flow)?;
    let residual = |x: u32, y: u32| {
        let d = flow.at(x, y);
        length([f64::from(d[0]) - displacement[0], f64::from(d[1]) - displacement[1]])
    };
    let spread = upper_median(consistent.iter().map(|&(x, y)| residual(x, y)).collect())?;
    let limit = MAX_RESIDUAL_PX.max(MAX_RESIDUAL_SPREADS * spread);
    let pixels = consistent.into_iter().filter(|&(x, y)| residual(x, y) <= limit).collect();
    Some(FlowInliers { pixels, displacement })
}

/// Component-wise median of the flow at some pixels; `None` without any.
fn median_flow(pixels: &[(u32, u32)], flow: &Flow) -> Option<[f64; 2]> {
    let median = |c: usize| upper_median(pixels.iter().map(|&(x, y)| f64::from(flow.at(x, y)[c])).collect());
    Some([median(0)?, median(1)?])
}

/// Object in the previous frame.
pub(super) struct PreviousObject<'a> {
    /// Its visible pixels.
    pub(super) region: &'a Region,
    /// Its whole outline.
    pub(super) whole: &'a Region,
    /// Its occluded part.
    pub(super) occlusion: &'a Occlusion,
}

/// Propagates an object by the affine motion that best fits the consistent flow of its pixels.
///
/// `None` if no flow in it is usable or if it leaves the frame.
///
/// Flow is smooth across outlines, so that a mask whose pixels are propagated one by one loses its rim: on rendered
/// sequences a tenth to a quarter of its overlap with the truth in one frame. A vehicle is rigid, and its outline moves
/// with its interior.
///
/// * `images` – of the previous frame and this one; without them no occlusion is detected.
pub(super) fn propagate_object(
    object: &PreviousObject<'_>,
    flow: &Flow,
    images: Option<ImagePair<'_>>,
) -> Option<Propagated> {
    let inliers = flow_inliers(object.region, flow)?;
    let displacement = inliers.displacement;
    let motion = Affine::fit(&inliers.pixels, flow).unwrap_or_else(|| Affine::shift(displacement));
    let propagated = motion.apply(object.region)?;
    let whole = motion.apply(object.whole).unwrap_or_else(|| propagated.clone());
    let moved = PropagatedObject { before: object.region, visible: &propagated, whole: &whole, motion: &motion };
    let occlusion = images.map(|images| object.occlusion.advance(&moved, flow, images)).unwrap_or_default();
    let region = occlusion.cut(&propagated)?;
    // Newly occluded pixels have no usable flow, and none is required.
    let occluded = 1.0 - region.area() as f64 / propagated.area() as f64;
    let inlier_ratio = inliers.pixels.len() as f64 / (object.region.area() as f64 * (1.0 - occluded)).max(1.0);
    Some(Propagated { region, whole, occlusion, displacement, inlier_ratio: inlier_ratio.min(1.0), motion })
}

/// Background motion around a box: the median flow of the ring around it.
///
/// Pixels that `occupied` assigns to an object do not count. `None` where too few remain.
pub(super) fn background_displacement(flow: &Flow, bounds: BoundingBox, occupied: &Mask) -> Option<[f64; 2]> {
    /// Minimum number of pixels for a meaningful median.
    const MIN_SAMPLES: usize = 12;
    /// Samples along the longer side of the ring.
    const GRID: u32 = 24;
    let margin = bounds.width().max(bounds.height()).max(8);
    let BoundingBox { x0, y0, x1, y1 } = bounds.grown(margin, (flow.width, flow.height));
    let step = ((x1 - x0).max(y1 - y0) / GRID).max(1) as usize;
    let is_background = |&(x, y): &(u32, u32)| flow.is_consistent(x, y) && !occupied.get(i64::from(x), i64::from(y));
    let grid = (y0..y1).step_by(step).flat_map(|y| (x0..x1).step_by(step).map(move |x| (x, y)));
    let samples: Vec<(u32, u32)> = grid.filter(is_background).collect();
    median_flow(&samples, flow).filter(|_| samples.len() >= MIN_SAMPLES)
}

/// Moves a box by the median flow at its center; `None` if it leaves the frame.
///
/// Without usable flow the box is not moved.
pub(super) fn propagate_rect(rect: &Rect, flow: &Flow) -> Option<Rect> {
    let [dx, dy] = median_flow(&central_pixels(rect, flow), flow).unwrap_or_default();
    let moved = rect.moved([dx, dy]).clipped(flow.width, flow.height);
    (moved.area_px2() >= 1.0).then_some(moved)
}

/// Median flow at the center of a box outside a region, pixels; `None` without usable flow.
pub(super) fn displacement_outside(region: &Region, rect: &Rect, flow: &Flow) -> Option<[f64; 2]> {
    let outside = central_pixels(rect, flow).into_iter().filter(|&(x, y)| !region.contains(x, y));
    median_flow(&outside.collect::<Vec<_>>(), flow)
}

/// Grid pixels with consistent flow in the center of a box, half as wide and high.
fn central_pixels(rect: &Rect, flow: &Flow) -> Vec<(u32, u32)> {
    /// Samples along each side of the center.
    const GRID: u32 = 12;
    let at = |from: f64, length: f64, i: u32| from + length * (0.25 + 0.5 * (f64::from(i) + 0.5) / f64::from(GRID));
    let mut samples: Vec<(u32, u32)> = Vec::new();
    for (i, j) in (0..GRID).flat_map(|j| (0..GRID).map(move |i| (i, j))) {
        let (x, y) = (at(rect.x0, rect.width(), i), at(rect.y0, rect.height(), j));
        let inside = (0.0..f64::from(flow.width)).contains(&x) && (0.0..f64::from(flow.height)).contains(&y);
        if inside && flow.is_consistent(x as u32, y as u32) {
            samples.push((x as u32, y as u32));
        }
    }
    samples
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flow(width: u32, height: u32, at: impl Fn(u32, u32) -> Option<[f32; 2]>) -> Flow {
        let pixels: Vec<Option<[f32; 2]>> =
            (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect();
        Flow {
            width,
            height,
            displacement: pixels.iter().map(|p| p.unwrap_or([99.0, 99.0])).collect(),
            consistent: pixels.iter().map(Option::is_some).collect(),
        }
    }

    fn whole(region: &Region, flow: &Flow) -> Option<Propagated> {
        propagate_object(&PreviousObject { region, whole: region, occlusion: &Occlusion::default() }, flow, None)
    }

    fn block(x: u32, y: u32, w: u32, h: u32) -> Region {
        Region::from_mask(&Mask::from_fn(60, 40, |u, v| (x..x + w).contains(&u) && (y..y + h).contains(&v))).unwrap()
    }

    #[test]
    fn a_whole_region_keeps_its_rim_where_flow_fails() {
        // The rim follows the background, as in dense flow.
        let rim = |x: u32, y: u32| !(13..29).contains(&x) || !(13..29).contains(&y);
        let field = flow(60, 40, |x, y| Some(if rim(x, y) { [0.0, 0.0] } else { [5.0, -2.0] }));
        let propagated = whole(&block(10, 10, 22, 22), &field).unwrap();
        assert_eq!(propagated.region, block(15, 8, 22, 22));
        assert!((propagated.inlier_ratio - 256.0 / 484.0).abs() < 1e-12);
        let growing = flow(60, 40, |x, y| Some([(x as f32 - 20.5) * 0.1, (y as f32 - 20.5) * 0.1]));
        let grown = whole(&block(11, 11, 20, 20), &growing).unwrap();
        assert_eq!(grown.region, block(10, 10, 22, 22));
        let leaving = flow(60, 40, |_, _| Some([100.0, 0.0]));
        assert!(whole(&block(30, 10, 20, 20), &leaving).is_none());
        assert!(whole(&block(30, 10, 5, 5), &flow(60, 40, |_, _| None)).is_none());
    }

    #[test]
    fn motions_compose_and_invert() {
        let first = Affine { origin: [20.0, 15.0], rows: [[24.0, 1.1, 0.1], [14.0, -0.05, 1.0]] };
        let second = Affine { origin: [10.0, 5.0], rows: [[8.0, 0.9, 0.0], [6.5, 0.02, 1.05]] };
        let both = first.then(&second);
        for point in [[3.0, 4.0], [31.0, 22.5]] {
            let (one, two) = (both.at(point), second.at(first.at(point)));
            assert!((one[0] - two[0]).abs() < 1e-9 && (one[1] - two[1]).abs() < 1e-9, "{one:?} {two:?}");
        }
        let region = block(20, 10, 20, 12);
        let there = both.apply(&region).unwrap();
        assert!(there.iou(&region) < 0.9);
        assert!(both.apply_inverse(&there).unwrap().iou(&region) > 0.9);
        assert_eq!(Affine::shift([5.0, -2.0]).apply_inverse(&block(15, 8, 9, 9)), Some(block(10, 10, 9, 9)));
    }

    #[test]
    fn background_motion_excludes_objects() {
        let object = block(20, 10, 12, 12);
        let field = flow(60, 40, |x, y| Some(if object.contains(x, y) { [9.0, 9.0] } else { [1.0, 2.0] }));
        let occupied = object.mask();
        assert_eq!(background_displacement(&field, object.bounds(), occupied), Some([1.0, 2.0]));
        let nothing = flow(60, 40, |_, _| None);
        assert_eq!(background_displacement(&nothing, object.bounds(), occupied), None);
    }
}
