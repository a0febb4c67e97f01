//! The reduced camera system S δ = −b that is left when the points are eliminated (eqs. 8–10).
//!
//! S is stored by *panels*: panel j holds the blocks (i, j), i ≤ j, of the pairs of views that see a common point.
//! Every part of the points has sums of its own ([`Sums`]); here they are added up, in the order of the parts, with
//! priors and damping. Shared cameras form a dense border.

use super::accumulate::{Sums, ViewTerms};
use super::camera_sums::{CAMERA_DIM, CameraSums};
use super::layout::Layout;
use super::linearize::{Linearization, Pass};
use super::parallel::in_order;
use super::pattern::Pattern;
use super::point::damping_scale;
use super::priors::{PriorTarget, PriorTerms};

/// Blocks that one task adds up, about: fewer are added up faster than another thread wakes.
const BLOCKS_PER_TASK: usize = 4096;

/// S and b, and what the damping and the predicted decrease need.
pub(super) struct Reduced<const D: usize> {
    pub pattern: Pattern,
    /// Blocks (i, j) by panels; `[r][c]` couples freedom r of view i with freedom c of view j.
    pub blocks: Vec<[[f64; D]; D]>,
    /// One per view.
    pub views: Vec<ViewTerms<D>>,
    /// Blocks (view, shared camera), by view.
    pub border: Vec<[[f64; CAMERA_DIM]; D]>,
    /// The shared cameras' own block, row-major, both triangles.
    pub camera_block: Vec<f64>,
    /// Reduced gradient of the shared cameras.
    pub camera_reduced: Vec<f64>,
    /// Their gradient.
    pub camera_gradient: Vec<f64>,
    /// Diagonal of their normal equations.
    pub camera_diagonal: Vec<f64>,
}

/// Neighbouring panels, to be filled by one task.
struct PanelsMut<'a, const D: usize> {
    first_view: usize,
    first_block: usize,
    blocks: &'a mut [[[f64; D]; D]],
    views: &'a mut [ViewTerms<D>],
    border: &'a mut [[[f64; CAMERA_DIM]; D]],
}

impl<const D: usize> Reduced<D> {
    pub fn new(layout: &Layout) -> Self {
        let pattern = Pattern::new(layout);
        let cameras = layout.shared.len() * CAMERA_DIM;
        Self {
            blocks: vec![[[0.0; D]; D]; pattern.len()],
            pattern,
            views: vec![ViewTerms::ZERO; layout.num_blocks()],
            border: vec![[[0.0; CAMERA_DIM]; D]; layout.num_blocks() * layout.shared.len()],
            camera_block: vec![0.0; cameras * cameras],
            camera_reduced: vec![0.0; cameras],
            camera_gradient: vec![0.0; cameras],
            camera_diagonal: vec![0.0; cameras],
        }
    }

    /// Number of unknowns, held ones included.
    pub fn size(&self) -> usize {
        self.views.len() * D + self.camera_reduced.len()
    }

    /// Forms S + λD and b from a linearisation whose points are eliminated with the same λ.
    pub fn assemble(&mut self, pass: &Pass, lin: &Linearization<D>, priors: &[PriorTerms], damping: f64) {
        let num_shared = pass.layout.shared.len();
        let pattern = &self.pattern;
        let mut panels = Vec::new();
        let (mut blocks, mut border) = (self.blocks.as_mut_slice(), self.border.as_mut_slice());
        let (mut views, mut first_view) = (self.views.as_mut_slice(), 0);
        while !views.is_empty() {
            let first_block = pattern.start[first_view];
            let limit = first_block + BLOCKS_PER_TASK;
            let count = pattern.start[first_view + 1..].iter().take_while(|end| **end <= limit).count().max(1);
            let num_blocks = pattern.start[first_view + count] - first_block;
            let (blocks, views) = (take(&mut blocks, num_blocks), take(&mut views, count));
            let border = take(&mut border, count * num_shared);
            panels.push(PanelsMut { first_view, first_block, blocks, views, border });
            first_view += count;
        }
        in_order(pass.parallel, panels, |mut panels| {
            panels.add_up(lin, num_shared);
            panels.finish(pattern, priors, damping);
        });
        if num_shared > 0 {
            self.assemble_cameras(lin, priors, damping);
        }
    }

    fn assemble_cameras(&mut self, lin: &Linearization<D>, priors: &[PriorTerms], damping: f64) {
        let n = self.camera_reduced.len();
        let mut total = CameraSums::new(n);
        for part in &lin.parts {
            total.merge(&part.sums.cameras);
        }
        for prior in priors {
            if let PriorTarget::Shared(camera) = prior.target {
                total.add_prior(camera * CAMERA_DIM, prior);
            }
        }
        for k in 0..n {
            let cell = &mut total.block[k * n + k];
            *cell += damping * damping_scale(total.diagonal[k]);
            if total.diagonal[k] == 0.0 {
                *cell = 1.0;
            }
        }
        self.camera_block = total.block;
        self.camera_reduced = total.reduced;
        self.camera_gradient = total.gradient;
        self.camera_diagonal = total.diagonal;
    }
}

impl<const D: usize> PanelsMut<'_, D> {
    /// Adds up the parts, in order.
    fn add_up(&mut self, lin: &Linearization<D>, num_shared: usize) {
        self.blocks.fill([[0.0; D]; D]);
        self.views.fill(ViewTerms::ZERO);
        self.border.fill([[0.0; CAMERA_DIM]; D]);
        for part in &lin.parts {
            let sums: &Sums<D> = &part.sums;
            for (into, from) in overlap(self.blocks, self.first_block, &sums.blocks, sums.block_range.start) {
                add_block(into, from);
            }
            for (into, from) in overlap(self.views, self.first_view, &sums.views, sums.view_range.start) {
                into.add(from);
            }
            let (here, there) = (self.first_view * num_shared, sums.view_range.start * num_shared);
            for (into, from) in overlap(self.border, here, &sums.border, there) {
                add_block(into, from);
            }
        }
    }

    /// Priors and damping.
    fn finish(&mut self, pattern: &Pattern, priors: &[PriorTerms], damping: f64) {
        let first_view = self.first_view;
        for (j, view) in (first_view..).zip(self.views.iter_mut()) {
            let own = &mut self.blocks[pattern.start[j + 1] - 1 - self.first_block];
            for prior in priors.iter().filter(|p| p.target == PriorTarget::Block(j)) {
                add_prior(own, view, prior);
            }
            for r in 0..D {
                if view.diagonal[r] == 0.0 {
                    own[r][r] = 1.0;
                } else {
                    own[r][r] += damping * damping_scale(view.diagonal[r]);
                }
            }
        }
    }
}

/// The places that two runs of one list have in common, given where each begins.
fn overlap<'a, T>(
    into: &'a mut [T],
    into_start: usize,
    from: &'a [T],
    from_start: usize,
) -> impl Iterator<Item = (&'a mut T, &'a T)> {
    let start = into_start.max(from_start);
    let into = into.get_mut(start - into_start..).unwrap_or_default();
    let from = from.get(start - from_start..).unwrap_or_default();
    into.iter_mut().zip(from)
}

#[inline(always)]
fn add_block<const R: usize, const C: usize>(into: &mut [[f64; C]; R], from: &[[f64; C]; R]) {
    for (a, b) in into.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *a += b;
    }
}

fn add_prior<const D: usize>(own: &mut [[f64; D]; D], view: &mut ViewTerms<D>, prior: &PriorTerms) {
    for r in 0..6.min(D - prior.offset) {
        let row = prior.offset + r;
        view.gradient[row] += prior.gradient[r];
        view.reduced[row] += prior.gradient[r];
        view.diagonal[row] += prior.hessian[r][r];
        for c in 0..6.min(D - prior.offset) {
            own[row][prior.offset + c] += prior.hessian[r][c];
        }
    }
}

/// The first `count` of a slice, cutting them off it.
fn take<'a, T>(slice: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (head, tail) = std::mem::take(slice).split_at_mut(count);
    *slice = tail;
    head
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_one_list_overlap_where_both_are() {
        let pairs = |into_start: usize, from_start: usize| {
            let (mut into, from) = ([0; 3], [10, 11]);
            let found = overlap(&mut into, into_start, &from, from_start);
            let mut places = Vec::new();
            found.for_each(|(cell, value)| {
                *cell = *value;
                places.push(*value);
            });
            (into, places)
        };
        assert_eq!(pairs(4, 5), ([0, 10, 11], vec![10, 11]));
        assert_eq!(pairs(5, 4), ([11, 0, 0], vec![11]));
        assert_eq!(pairs(0, 2), ([0, 0, 10], vec![10]));
        assert_eq!(pairs(0, 3).1, Vec::<i32>::new());
        assert_eq!(pairs(9, 3).1, Vec::<i32>::new());
    }
}
