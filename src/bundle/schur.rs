//! The reduced camera system S δ = −b after elimination of the points (eqs. 8–10).
//!
//! S is stored by *panels*: panel j contains the blocks (i, j), i ≤ j, of the pairs of views that observe a common
//! point. Every piece of the points has separate sums ([`Sums`]); this module adds them up, in the order of the pieces,
//! with priors and damping. Shared cameras form a dense border.

use super::accumulate::{Sums, ViewTerms};
use super::camera_sums::{CAMERA_DIM, CameraSums};
use super::coupling::Coupling;
use super::layout::Layout;
use super::parallel::in_order;
use super::pattern::Pattern;
use super::point::damping_scale;
use super::prior_terms::{PriorTarget, PriorTerms};

/// Approximate number of blocks added up per task: fewer take less time than waking another thread.
const BLOCKS_PER_TASK: usize = 4096;

/// S and b, and the terms needed for the damping and the predicted decrease.
pub(super) struct Reduced<const D: usize> {
    pub pattern: Pattern,
    /// Blocks (i, j) by panels; `[r][c]` couples freedom r of view i with freedom c of view j.
    pub blocks: Vec<[[f64; D]; D]>,
    /// If present, S is not formed: only the blocks (i, i) exist, without elimination of points.
    pub coupling: Option<Coupling<D>>,
    /// One per view.
    pub views: Vec<ViewTerms<D>>,
    /// Blocks (view, shared camera), by view.
    pub border: Vec<[[f64; CAMERA_DIM]; D]>,
    /// The shared cameras' sums over all points.
    sums: CameraSums,
    /// The same sums with priors and damping.
    pub cameras: CameraSums,
}

impl<const D: usize> Reduced<D> {
    /// System that is always formed.
    pub fn new(layout: &Layout) -> Self {
        Self::with(layout, Pattern::new(layout), None)
    }

    /// System for solving steps only, which is not formed if the alternative is cheaper.
    pub fn for_steps(layout: &Layout) -> Self {
        match Coupling::where_it_pays(layout) {
            Some(coupling) => Self::with(layout, Pattern::of_single_views(layout.num_blocks()), Some(coupling)),
            None => Self::new(layout),
        }
    }

    fn with(layout: &Layout, pattern: Pattern, coupling: Option<Coupling<D>>) -> Self {
        let cameras = CameraSums::new(layout.shared.len() * CAMERA_DIM);
        Self {
            blocks: vec![[[0.0; D]; D]; pattern.len()],
            pattern,
            coupling,
            views: vec![ViewTerms::ZERO; layout.num_blocks()],
            border: vec![[[0.0; CAMERA_DIM]; D]; layout.num_blocks() * layout.shared.len()],
            sums: cameras.clone(),
            cameras,
        }
    }

    /// Number of unknowns, constant ones included.
    pub fn size(&self) -> usize {
        self.views.len() * D + self.cameras.reduced.len()
    }

    /// Clears the system.
    pub fn clear(&mut self) {
        self.blocks.fill([[0.0; D]; D]);
        self.views.fill(ViewTerms::ZERO);
        self.border.fill([[0.0; CAMERA_DIM]; D]);
        self.sums.clear();
    }

    /// Adds the sums of a piece.
    pub fn add(&mut self, sums: &Sums<D>, parallel: bool) {
        let num_shared = self.sums.reduced.len() / CAMERA_DIM;
        let into = self.blocks[sums.block_range.clone()].chunks_mut(BLOCKS_PER_TASK);
        let chunks = into.zip(sums.blocks.chunks(BLOCKS_PER_TASK)).collect();
        in_order(parallel, chunks, |(into, from)| add_blocks(into, from));
        for (into, from) in self.views[sums.view_range.clone()].iter_mut().zip(&sums.views) {
            into.add(from);
        }
        add_blocks(&mut self.border[sums.view_range.start * num_shared..], &sums.border);
        if let Some(coupling) = &mut self.coupling {
            coupling.blocks[sums.obs_range.clone()].copy_from_slice(&sums.coupling);
        }
        self.sums.merge(&sums.cameras);
    }

    /// Completes S + λD and b: adds priors and damping to the sums over all points.
    pub fn finish(&mut self, priors: &[PriorTerms], damping: f64) {
        for (j, view) in self.views.iter_mut().enumerate() {
            let own = &mut self.blocks[self.pattern.start[j + 1] - 1];
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
        self.finish_cameras(priors, damping);
    }

    fn finish_cameras(&mut self, priors: &[PriorTerms], damping: f64) {
        self.cameras.clone_from(&self.sums);
        let (total, n) = (&mut self.cameras, self.sums.reduced.len());
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
    }
}

fn add_blocks<const R: usize, const C: usize>(into: &mut [[[f64; C]; R]], from: &[[[f64; C]; R]]) {
    for (a, b) in into.as_flattened_mut().as_flattened_mut().iter_mut().zip(from.as_flattened().as_flattened()) {
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
