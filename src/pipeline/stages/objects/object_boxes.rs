//! The box of an object in every view, including occluded parts.
//!
//! The box of a view's features is that of the object only if all of it is visible. An occluder hides features, but the
//! others still follow the object. A side of the box is therefore estimated over as many views as a track lasts, in
//! which the object's appearance hardly changes: relative to the path of the features, it has the same offset as in
//! most views that show it.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use crate::features::tracks::{TrackTable, View};
use crate::math::{median, quantile};
use crate::scene::{FrameId, Rect};

/// Minimum number of features that determine an object's position or motion.
const MIN_FEATURES: usize = 5;
/// Minimum share of the views in which a side of an object is visible; with a smaller one, single outliers would move
/// the side.
const VISIBLE_SHARE: f64 = 0.1;
/// Number of consecutive views below which all may have the same side occluded.
const MIN_VIEWS: usize = 5;

/// The box of a view's features, and their motion since the previous view, pixels.
struct VisibleBox {
    frame: FrameId,
    bounds: Rect,
    /// `None` if too few features of the previous view are left.
    motion: Option<Vector2<f64>>,
}

/// Boxes of the object in the frames with enough features.
pub(super) fn object_boxes(table: &TrackTable) -> BTreeMap<FrameId, Rect> {
    let visible = table.views.iter().zip(motions(table)).filter_map(|(view, motion)| VisibleBox::of(view, motion));
    let visible: Vec<VisibleBox> = visible.collect();
    let reach = median(table.tracks.iter().map(|track| track.len() as f64).collect()).unwrap_or(0.0) as usize;
    let stretches: Vec<&[VisibleBox]> = visible.chunk_by(|_, next| next.motion.is_some()).collect();
    let longest = stretches.iter().map(|stretch| stretch.len()).max().unwrap_or(0);
    let is_long = |stretch: &&[VisibleBox]| stretch.len() >= MIN_VIEWS.min(longest);
    stretches.into_iter().filter(is_long).flat_map(|stretch| complete(stretch, reach)).collect()
}

/// The boxes of consecutive views, including occluded parts.
///
/// * `reach` – number of views before and after a view in which the object's appearance hardly changes.
fn complete(stretch: &[VisibleBox], reach: usize) -> Vec<(FrameId, Rect)> {
    let motion = |k: usize| stretch[k].motion.filter(|_| k > 0).unwrap_or_default();
    let path: Vec<Vector2<f64>> = (0..stretch.len())
        .scan(Vector2::zeros(), |at, k| {
            *at += motion(k);
            Some(*at)
        })
        .collect();
    let complete = |k: usize| {
        let near = k.saturating_sub(reach)..(k + reach + 1).min(stretch.len());
        let side = |axis: usize, share: f64, side: fn(&Rect) -> f64| {
            let mut offsets: Vec<f64> = near.clone().map(|i| side(&stretch[i].bounds) - path[i][axis]).collect();
            path[k][axis] + quantile(&mut offsets, share).unwrap_or_default()
        };
        let (least, most) = (VISIBLE_SHARE, 1.0 - VISIBLE_SHARE);
        let [x0, y0] = [side(0, least, |bounds| bounds.x0), side(1, least, |bounds| bounds.y0)];
        let [x1, y1] = [side(0, most, |bounds| bounds.x1), side(1, most, |bounds| bounds.y1)];
        (stretch[k].frame, Rect { x0, y0, x1, y1 })
    };
    (0..stretch.len()).map(complete).collect()
}

impl VisibleBox {
    fn of(view: &View, motion: Option<Vector2<f64>>) -> Option<Self> {
        let bounds = Rect::around(&view.pixels).filter(|_| view.pixels.len() >= MIN_FEATURES)?;
        Some(Self { frame: view.image.frame(), bounds, motion })
    }
}

/// Median motion of the features since the previous view, by view, pixels; `None` if too few are in both.
fn motions(table: &TrackTable) -> Vec<Option<Vector2<f64>>> {
    let mut steps = vec![Vec::new(); table.views.len()];
    for track in &table.tracks {
        for pair in track.windows(2).filter(|pair| pair[1].view == pair[0].view + 1) {
            steps[pair[1].view as usize].push(table.pixel(pair[1]) - table.pixel(pair[0]));
        }
    }
    let along = |steps: &[Vector2<f64>], axis: usize| median(steps.iter().map(|step| step[axis]).collect());
    let motion = |steps: Vec<Vector2<f64>>| {
        let is_enough = steps.len() >= MIN_FEATURES;
        is_enough.then(|| Some(Vector2::new(along(&steps, 0)?, along(&steps, 1)?))).flatten()
    };
    steps.into_iter().map(motion).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::tracks::Feature;
    use nalgebra::Point2;

    const LENGTH: f64 = 80.0;
    const HEIGHT: f64 = 40.0;

    /// Upper left corner of an object in a view: it accelerates to the right and descends.
    fn corner(view: usize) -> Vector2<f64> {
        let t = view as f64;
        Vector2::new(100.0 + 3.0 * t + 0.05 * t * t, 200.0 + 0.5 * t)
    }

    /// Tracks of features on a grid over the object, visible where `is_visible(view, x)` is true; a feature that
    /// vanishes starts a new track where it returns.
    fn table(num_views: usize, is_visible: impl Fn(usize, f64) -> bool) -> TrackTable {
        let grid = |i: usize, n: usize| i as f64 / (n - 1) as f64;
        let points: Vec<Vector2<f64>> =
            (0..9 * 5).map(|k| Vector2::new(LENGTH * grid(k % 9, 9), HEIGHT * grid(k / 9, 5))).collect();
        let mut views: Vec<View> = Vec::new();
        let mut tracks: Vec<Vec<Feature>> = Vec::new();
        let mut open: Vec<Option<usize>> = vec![None; points.len()];
        for view in 0..num_views {
            let mut pixels = Vec::new();
            for (point, open) in points.iter().zip(&mut open) {
                if !is_visible(view, point.x) {
                    *open = None;
                    continue;
                }
                let track = *open.get_or_insert_with(|| {
                    tracks.push(Vec::new());
                    tracks.len() - 1
                });
                tracks[track].push(Feature { view: view as u32, feature: pixels.len() as u32 });
                pixels.push(Point2::from(corner(view) + point));
            }
            let image = FrameId(view as u32).into();
            views.push(View { image, name: String::new(), camera: 0, pixels, rgb: Vec::new(), whitening: Vec::new() });
        }
        TrackTable { views, tracks }
    }

    fn max_error(found: &BTreeMap<FrameId, Rect>) -> f64 {
        let error = |(frame, found): (&FrameId, &Rect)| {
            let corner = corner(frame.0 as usize);
            let [least, most] = [Vector2::new(found.x0, found.y0), Vector2::new(found.x1, found.y1)];
            (least - corner).amax().max((most - corner - Vector2::new(LENGTH, HEIGHT)).amax())
        };
        found.iter().map(error).fold(0.0, f64::max)
    }

    #[test]
    fn occluded_sides_are_estimated_from_other_views() {
        // An edge moves over the object and back, and occludes up to three quarters of it for less than tracks last.
        let hidden = |view: usize| (1.2 - (view as f64 - 30.0).abs() / 10.0).clamp(0.0, 0.75) * LENGTH;
        let found = object_boxes(&table(60, |view, x| x >= hidden(view)));
        assert_eq!(found.len(), 60);
        assert!(max_error(&found) < 0.02 * LENGTH, "{}", max_error(&found));
    }

    #[test]
    fn an_object_that_enters_the_image_has_its_complete_box() {
        let left = corner(20).x;
        let table = table(40, |view, x| corner(view).x + x >= left);
        let found = object_boxes(&table);
        assert!(found.len() >= 38, "{}", found.len());
        assert!(max_error(&found) < 0.02 * LENGTH, "{}", max_error(&found));
    }

    #[test]
    fn stretches_on_both_sides_of_an_occlusion_are_independent() {
        let found = object_boxes(&table(60, |view, _| !(25..35).contains(&view)));
        assert_eq!(found.len(), 50);
        assert!(max_error(&found) < 0.02 * LENGTH, "{}", max_error(&found));
    }

    #[test]
    fn a_few_views_of_a_part_give_no_box() {
        let found = object_boxes(&table(40, |view, x| match view {
            0..30 => true,
            33..36 => x < 0.3 * LENGTH,
            _ => false,
        }));
        assert_eq!(found.len(), 30);
        assert!(object_boxes(&table(10, |_, _| false)).is_empty());
    }
}
