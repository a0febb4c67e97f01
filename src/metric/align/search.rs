//! Candidate time offsets between a log and a video.
//!
//! For every offset of a grid the path is aligned to the fixes in closed form. The mean distance has minima where the
//! motions agree. Unlike a correlation of speeds, this also uses the shape of the trajectory.

use super::start::{NUM_ROUNDS, Pairs, align, up};
use super::{CameraPath, MIN_FIXES, Offset, PositionFix, Support};
use crate::math::Sim3;

/// Initial offset and alignment.
pub(super) struct Start {
    pub(super) offset_s: f64,
    pub(super) metric_from_world: Sim3,
}

/// Initial alignments at the most likely offsets.
pub(super) fn starts(path: &CameraPath, fixes: &[PositionFix], support: &Support) -> Vec<Start> {
    let up = up(support);
    let grid = grid(path, fixes, support.offset);
    let most = grid.iter().map(|&offset_s| overlap_s(path, fixes, offset_s)).fold(0.0, f64::max);
    let curve: Vec<(f64, Option<f64>)> = grid
        .into_iter()
        .map(|offset_s| {
            // Log and video overlap nearly as much as possible.
            let enough = overlap_s(path, fixes, offset_s) >= 0.7 * most;
            // Mean distance after a quick alignment, meters.
            let misfit = || align(&pairs(path, fixes, offset_s)?, up, 3).map(|(_, mean)| mean);
            (offset_s, enough.then(misfit).flatten())
        })
        .collect();
    let start = |offset_s: f64| {
        let (metric_from_world, _) = align(&pairs(path, fixes, offset_s)?, up, NUM_ROUNDS)?;
        Some(Start { offset_s, metric_from_world })
    };
    minima(&curve).into_iter().filter_map(start).collect()
}

/// Maximum number of fixes within the time of the video, over all possible offsets.
pub(super) fn most_overlapping(path: &CameraPath, fixes: &[PositionFix], offset: Offset) -> usize {
    let count = |offset_s: f64| fixes.iter().filter(|fix| path.covers(fix.time_s - offset_s)).count();
    grid(path, fixes, offset).into_iter().map(count).max().unwrap_or(0)
}

/// Range of possible offsets.
fn grid(path: &CameraPath, fixes: &[PositionFix], offset: Offset) -> Vec<f64> {
    let (Some(first), Some(last)) = (fixes.first(), fixes.last()) else { return Vec::new() };
    let (start, end) = path.span_s();
    let (least, most) = (first.time_s - end, last.time_s - start);
    let (least, most) = match offset {
        Offset::Unknown => (least, most),
        // Search range for offsets of known clocks, standard deviations.
        Offset::Known { mean_s, std_s } => ((mean_s - 4.0 * std_s).max(least), (mean_s + 4.0 * std_s).min(most)),
    };
    if !(least <= most) {
        return Vec::new();
    }
    // A long grid has wider steps.
    let step_s = f64::max(0.2, (most - least) / 4000.0);
    let num = ((most - least) / step_s).floor() as usize;
    // The likeliest offset itself is on the grid.
    let origin = match offset {
        Offset::Known { mean_s, .. } if (least..=most).contains(&mean_s) => {
            mean_s - ((mean_s - least) / step_s).floor() * step_s
        }
        _ => least,
    };
    (0..=num).map(|i| origin + i as f64 * step_s).filter(|offset_s| *offset_s <= most).collect()
}

/// Overlap of log and video.
fn overlap_s(path: &CameraPath, fixes: &[PositionFix], offset_s: f64) -> f64 {
    let (start, end) = path.span_s();
    let (Some(first), Some(last)) = (fixes.first(), fixes.last()) else { return 0.0 };
    (end.min(last.time_s - offset_s) - start.max(first.time_s - offset_s)).max(0.0)
}

fn pairs(path: &CameraPath, fixes: &[PositionFix], offset_s: f64) -> Option<Pairs> {
    let begin = fixes.partition_point(|fix| fix.time_s - offset_s < path.span_s().0);
    let end = fixes.partition_point(|fix| fix.time_s - offset_s <= path.span_s().1);
    let inside = fixes.get(begin..end)?;
    // Number of fixes used by a single alignment of the grid.
    let every = inside.len().div_ceil(120).max(1);
    let used = inside.iter().step_by(every).filter(|fix| path.covers(fix.time_s - offset_s));
    let (mut centers, mut positions, mut std_m) = (Vec::new(), Vec::new(), f64::INFINITY);
    for fix in used {
        centers.push(path.at(fix.time_s - offset_s).0);
        positions.push([fix.east_north_m.x, fix.east_north_m.y, fix.up_m.unwrap_or(0.0)].into());
        std_m = std_m.min(fix.horizontal_std_m);
    }
    (centers.len() >= MIN_FIXES).then_some(Pairs { centers, positions, std_m })
}

/// The offsets of the five lowest minima of a curve, lowest first.
fn minima(curve: &[(f64, Option<f64>)]) -> Vec<f64> {
    let value = |i: usize| curve.get(i).and_then(|(_, value)| *value).unwrap_or(f64::INFINITY);
    let is_minimum = |&i: &usize| {
        let before = i.checked_sub(1).map_or(f64::INFINITY, value);
        value(i).is_finite() && value(i) <= before && value(i) < value(i + 1)
    };
    let mut found: Vec<usize> = (0..curve.len()).filter(is_minimum).collect();
    found.sort_by(|&a, &b| value(a).total_cmp(&value(b)));
    // Number of minima that are refined.
    found.into_iter().take(5).map(|i| curve[i].0).collect()
}
