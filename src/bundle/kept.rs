//! Parts of a linearization cached for the step of the points, if memory allows.
//!
//! The step of a point reuses the derivatives of its residuals by the views, its elimination and its normal equations
//! ([`super::trial`]). For a small problem they are cached, piece by piece, in flat lists: reading 170 bytes per
//! observation takes less time than recomputing them. For a large problem the cache would need more memory than
//! everything else, so they are recomputed. The numbers are the same, bit for bit.

use super::layout::Layout;
use super::one_point::{Eliminated, OnePoint};
use super::piece::{Pass, Piece};
use super::point::PointTerms;
use super::residual::Residual;
use super::simd::Fused;
use super::state::State;

/// Memory limit of the cache, bytes: some 350,000 observations, a map of 300 to 400 frames.
pub(super) const KEPT_BYTES: usize = 64 << 20;

/// Cached data of the points of one piece, in their order.
#[derive(Default)]
pub(super) struct Kept<const D: usize> {
    residuals: Vec<Residual<D>>,
    slots: Vec<[[f64; 6]; 3]>,
    terms: Vec<PointTerms>,
}

impl<const D: usize> Kept<D> {
    /// Memory needed to cache all points, bytes.
    pub fn bytes(layout: &Layout) -> usize {
        layout.num_obs() * size_of::<Residual<D>>()
            + layout.slots.len() * size_of::<[[f64; 6]; 3]>()
            + layout.points.len() * size_of::<PointTerms>()
    }

    /// Clears the cache and reserves memory for a piece.
    pub fn begin(&mut self, piece: &Piece) {
        self.residuals.clear();
        self.slots.clear();
        self.terms.clear();
        self.residuals.reserve_exact(piece.obs.len());
        self.slots.reserve_exact(piece.slots.len());
        self.terms.reserve_exact(piece.points.len());
    }

    /// Appends the next point of the piece.
    #[inline(always)]
    pub fn push(&mut self, one: Eliminated<D>) {
        self.residuals.extend_from_slice(one.residuals);
        self.slots.extend_from_slice(one.slots);
        self.terms.push(*one.terms);
    }

    #[inline(always)]
    fn point(&self, layout: &Layout, piece: &Piece, point: usize) -> Eliminated<'_, D> {
        let (obs, slots) = (layout.obs_of_point(point), layout.slots_of_point(point));
        Eliminated {
            residuals: &self.residuals[obs.start - piece.obs.start..obs.end - piece.obs.start],
            slots: &self.slots[slots.start - piece.slots.start..slots.end - piece.slots.start],
            terms: &self.terms[point - piece.points.start],
        }
    }
}

/// Source of the data for the step of the points.
pub(super) enum Source<'a, const D: usize> {
    /// Cached by the linearization.
    Kept(&'a Kept<D>),
    /// Recomputed for each point.
    Recomputed(Box<OnePoint<D>>),
}

impl<'a, const D: usize> Source<'a, D> {
    pub fn new(layout: &Layout, piece: &Piece, kept: Option<&'a Kept<D>>) -> Self {
        kept.map_or_else(|| Self::Recomputed(Box::new(OnePoint::new(layout, piece.points.clone()))), Self::Kept)
    }

    /// Data of a point of the piece, at the state and with the damping of the linearization.
    #[inline(always)]
    pub fn point<F: Fused>(
        &mut self,
        pass: &Pass,
        piece: &Piece,
        from: &State,
        point: usize,
        damping: f64,
    ) -> Eliminated<'_, D> {
        match self {
            Self::Kept(kept) => kept.point(pass.layout, piece, point),
            Self::Recomputed(one) => {
                one.work_out::<F>(pass, from, point, damping);
                one.eliminated(pass.layout, point)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::levenberg_marquardt::with_threads;
    use super::super::linearize::Linearization;
    use super::super::options::Options;
    use super::super::priors;
    use super::super::problem::{CameraBlock, PointPrior, Problem};
    use super::super::schur::Reduced;
    use super::super::trial::{Trial, try_step};
    use super::*;
    use crate::math::RobustLoss;
    use crate::synthetic::scene::{self, disturb, static_scene};

    const DAMPING: f64 = 1e-3;

    /// A noisy world in several pieces, with a constant point and a point with a prior.
    fn problem(camera_per_image: bool) -> Problem {
        let options = scene::Options { camera_per_image, num_images: 20, num_points: 3000, ..Default::default() };
        let mut start = static_scene(&options);
        disturb(&mut start, 0.01, 0.05, 5);
        let free = |camera| CameraBlock { camera, free: [true; 6], tie_focal: false };
        let mut problem = Problem::from_reconstruction(&start, |_, camera| free(*camera));
        problem.points[7].fixed = true;
        let position = problem.points[3].position;
        problem.priors.points.push(PointPrior { point: 3, position, sigma: 0.02 });
        problem
    }

    /// The second of two steps of the points, with a cache of at most `most_bytes`.
    fn second_step(problem: &Problem, most_bytes: usize, parallel: bool) -> (Trial, Vec<[f64; 3]>) {
        let options = Options { loss: RobustLoss::Cauchy { scale: 2.0 }, ..Options::default() };
        let layout = Layout::new(problem, &options, parallel);
        let pass = Pass { layout: &layout, observations: &problem.observations, loss: options.loss, parallel };
        let (mut state, mut reduced) = (State::new(problem, &layout), Reduced::<12>::new(&layout));
        let mut lin = Linearization::new(&pass, &reduced.pattern).keep_within(&layout, most_bytes);
        assert!(lin.pieces.len() > 1 && lin.kept.iter().all(|kept| kept.is_some() == (most_bytes > 0)));
        let step: Vec<f64> = (0..reduced.size()).map(|k| 1e-4 * (k as f64).sin()).collect();
        let mut last = Trial::default();
        for _ in 0..2 {
            lin.evaluate(&pass, &state, DAMPING, &mut reduced);
            reduced.finish(&priors::terms(problem, &layout, &state), DAMPING);
            let mut moved = state.clone();
            moved.move_cameras(&state, problem, &layout, &step, 12);
            last = try_step(&lin, &pass, &step, DAMPING, &state, &mut moved);
            state = moved;
        }
        (last, state.points)
    }

    #[test]
    fn what_is_kept_is_what_would_be_worked_out_anew() {
        for camera_per_image in [false, true] {
            let problem = problem(camera_per_image);
            let anew = second_step(&problem, 0, false);
            assert!(anew.0.cost.is_finite() && anew.0.decrease != 0.0, "{:?}", anew.0);
            for (bytes, threads) in [(KEPT_BYTES, 1), (KEPT_BYTES, 3), (0, 3)] {
                let step = with_threads(threads, |parallel| second_step(&problem, bytes, parallel)).unwrap();
                assert!(step == anew, "{bytes} bytes, {threads} threads: {:?}, {:?}", step.0, anew.0);
            }
        }
    }
}
