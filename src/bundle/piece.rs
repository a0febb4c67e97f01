//! Pieces of the points, which threads process one by one, and the input of a pass over them.

use std::ops::Range;

use super::layout::{Layout, NONE};
use super::pattern::Pattern;
use super::problem::Observation;
use crate::math::RobustLoss;

/// Maximum number of pieces processed at a time, each with separate sums.
pub(super) const MAX_DESKS: usize = 8;
/// Blocks of the reduced system per additional [`MAX_DESKS`] pieces: keeps the sums of concurrent pieces small.
const BLOCKS_PER_WAVE: usize = 1 << 17;
/// Minimum work in a piece, in rank-2 updates of one block: less does not justify a task.
const PART_WORK: usize = 15_000;
/// Work of linearizing one observation, in the same unit.
const OBSERVATION_WORK: usize = 5;
/// Minimum number of rank-2 updates per duplicated block, which must be cleared and added up.
const WORK_PER_BLOCK: usize = 60;

/// A run of consecutive points with their observations and slots.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    pub points: Range<usize>,
    pub obs: Range<usize>,
    pub slots: Range<usize>,
}

/// Splits the points into pieces of about equal work.
///
/// Their number is limited by the cost of blocks of the reduced system that several pieces share, and by the memory of
/// these duplicates, which must not exceed that of the system itself.
pub(super) fn pieces(layout: &Layout, pattern: &Pattern) -> Vec<Piece> {
    let work: Vec<usize> = (0..layout.points.len())
        .scan(0, |sum, point| {
            let count = layout.obs_of_point(point).len();
            let pairs = if pattern.is_of_single_views() { count } else { count * (count + 1) / 2 };
            *sum += count * OBSERVATION_WORK + pairs;
            Some(*sum)
        })
        .collect();
    let total = work.last().copied().unwrap_or(0);
    let mut count = MAX_DESKS * (1 + pattern.len() / BLOCKS_PER_WAVE);
    while count > 1 {
        let pieces = cut(layout, &work, count);
        let blocks = |piece: &Piece| {
            let views = reach(layout, piece);
            pattern.start[views.end] - pattern.start[views.start]
        };
        let doubled = pieces.iter().map(blocks).sum::<usize>().saturating_sub(pattern.len());
        if total >= count * PART_WORK && total >= doubled * WORK_PER_BLOCK && doubled <= pattern.len() {
            return pieces;
        }
        count /= 2;
    }
    cut(layout, &work, 1)
}

/// Splits into at most `count` pieces; `work` is the cumulative work of the points.
fn cut(layout: &Layout, work: &[usize], count: usize) -> Vec<Piece> {
    let total = work.last().copied().unwrap_or(0);
    let mut first = 0;
    let mut out = Vec::with_capacity(count);
    for k in 1..=count {
        let end = if k == count { work.len() } else { work.partition_point(|sum| sum * count <= total * k) };
        if end > first {
            let obs = layout.point_start[first] as usize..layout.point_start[end] as usize;
            let slots = layout.slot_start[first] as usize..layout.slot_start[end] as usize;
            out.push(Piece { points: first..end, obs, slots });
            first = end;
        }
    }
    out
}

/// Range of views that observe the points of a piece.
pub(super) fn reach(layout: &Layout, piece: &Piece) -> Range<usize> {
    let (mut first, mut end) = (usize::MAX, 0);
    for block in layout.obs_block[piece.obs.clone()].iter().filter(|block| **block != NONE) {
        (first, end) = (first.min(*block as usize), end.max(*block as usize + 1));
    }
    if end == 0 { 0..0 } else { first..end }
}

/// Read-only input of the passes.
#[derive(Clone, Copy)]
pub(super) struct Pass<'a> {
    pub layout: &'a Layout,
    /// Observations in the order of the problem.
    pub observations: &'a [Observation],
    pub loss: RobustLoss,
    pub parallel: bool,
}

impl Pass<'_> {
    /// Measurement, by the order of the layout.
    #[inline(always)]
    pub fn measured(&self, o: usize) -> &Observation {
        &self.observations[self.layout.obs[o] as usize]
    }
}
