//! Pieces of the points, which threads process one by one, and what a pass over them reads.

use std::ops::Range;

use super::layout::{Layout, NONE};
use super::pattern::Pattern;
use super::problem::Observation;
use crate::math::RobustLoss;

/// Pieces that are worked on at a time at most, each with sums of its own.
pub(super) const MAX_DESKS: usize = 8;
/// There may be so many pieces more for every so many blocks of the reduced system: then the sums of those that are
/// worked on at a time stay small.
const BLOCKS_PER_WAVE: usize = 1 << 17;
/// Least work in a piece, in rank-2 updates of one block: less is not worth a task.
const PART_WORK: usize = 15_000;
/// Work that linearising one observation is worth, likewise.
const OBSERVATION_WORK: usize = 5;
/// Rank-2 updates for which a piece may have one more block to clear and to add up.
const WORK_PER_BLOCK: usize = 60;

/// A run of points and what belongs to them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    pub points: Range<usize>,
    pub obs: Range<usize>,
    pub slots: Range<usize>,
}

/// Cuts the points in pieces of about the same work: as many as there can be without each losing too much by blocks of
/// the reduced system that others have, too, and without these taking more memory than the system itself.
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

/// At most `count` pieces; `work` is that of all points up to each.
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

/// Views that see the points of a piece, and those between.
pub(super) fn reach(layout: &Layout, piece: &Piece) -> Range<usize> {
    let (mut first, mut end) = (usize::MAX, 0);
    for block in layout.obs_block[piece.obs.clone()].iter().filter(|block| **block != NONE) {
        (first, end) = (first.min(*block as usize), end.max(*block as usize + 1));
    }
    if end == 0 { 0..0 } else { first..end }
}

/// Everything that the passes read.
#[derive(Clone, Copy)]
pub(super) struct Pass<'a> {
    pub layout: &'a Layout,
    /// Those of the problem, in its order.
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
