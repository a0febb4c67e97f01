//! Coupling of views and points, for problems in which few points have many views (eqs. 8a–8b).
//!
//! A vehicle far ahead has fifty points in two hundred frames. Then the reduced camera system is almost dense and much
//! larger than the system of the points, and it is cheaper not to form it. The diagonal blocks of the views and the
//! coupling of every view with every point that it observes suffice to solve it ([`super::solver`]).

use super::layout::{Layout, NONE};

/// Number of unknowns up to which forming and factorizing the reduced system is always fastest.
const FEW_UNKNOWNS: usize = 300;
/// Minimum ratio of multiplications, formed to not formed: the kernels of the formed system have higher throughput.
const CLEAR_GAIN: f64 = 2.0;

/// The observations of one point in one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair {
    /// Index in [`Layout::points`].
    pub point: u32,
    /// First observation.
    pub first_obs: u32,
    /// Number of observations: more than one if an image observes a point twice.
    pub num_obs: u32,
}

/// Blocks JᵀQ (D × 3), and their assignment to views.
pub(super) struct Coupling<const D: usize> {
    /// One block per observation, in the order of the layout; zero for observations without a view block.
    pub blocks: Vec<[[f64; 3]; D]>,
    /// Pairs of all views, sorted by view, then by point, ascending.
    pairs: Vec<Pair>,
    /// First pair of each view, and the end of the last.
    start: Vec<usize>,
    /// Number of points.
    pub num_points: usize,
}

impl<const D: usize> Coupling<D> {
    /// Coupling of a problem for which not forming the reduced camera system is cheaper; `None` for all others.
    pub fn where_it_pays(layout: &Layout) -> Option<Self> {
        if layout.num_blocks() * D <= FEW_UNKNOWNS || !layout.shared.is_empty() {
            return None;
        }
        // Most problems have far too many points.
        if layout.points.len() * 3 >= layout.num_blocks() * D {
            return None;
        }
        let coupling = Self::new(layout);
        (CLEAR_GAIN * coupling.work() < work_of_views::<D>(layout)).then_some(coupling)
    }

    fn new(layout: &Layout) -> Self {
        let mut of_views = vec![Vec::new(); layout.num_blocks()];
        for point in 0..layout.points.len() {
            let obs = layout.obs_of_point(point);
            let mut first_obs = obs.start;
            for same in layout.obs_block[obs].chunk_by(|a, b| a == b) {
                if same[0] != NONE {
                    let num_obs = same.len() as u32;
                    of_views[same[0] as usize].push(Pair { point: point as u32, first_obs: first_obs as u32, num_obs });
                }
                first_obs += same.len();
            }
        }
        let ends = of_views.iter().scan(0, |end, pairs| {
            *end += pairs.len();
            Some(*end)
        });
        Self {
            blocks: vec![[[0.0; 3]; D]; layout.num_obs()],
            start: std::iter::once(0).chain(ends).collect(),
            pairs: of_views.concat(),
            num_points: layout.points.len(),
        }
    }

    /// Number of views.
    pub fn num_views(&self) -> usize {
        self.start.len() - 1
    }

    /// Points that a view observes.
    pub fn pairs(&self, view: usize) -> &[Pair] {
        &self.pairs[self.start[view]..self.start[view + 1]]
    }

    /// Σ JᵀQ of a pair.
    pub fn block(&self, pair: &Pair) -> [[f64; 3]; D] {
        let mut sum = [[0.0; 3]; D];
        for block in &self.blocks[pair.first_obs as usize..][..pair.num_obs as usize] {
            for (cell, value) in sum.as_flattened_mut().iter_mut().zip(block.as_flattened()) {
                *cell += value;
            }
        }
        sum
    }

    /// Multiplications per step if the reduced system is not formed.
    fn work(&self) -> f64 {
        let of_views = (0..self.num_views()).map(|view| (3 * self.pairs(view).len() * D) as f64);
        let sums: f64 = of_views.map(|size| size * size / (2 * D) as f64 + size * D as f64 / 2.0).sum();
        sums + (3.0 * self.num_points as f64).powi(3) / 6.0
    }
}

/// Multiplications per step if the reduced camera system is formed, and factorized within its envelope.
fn work_of_views<const D: usize>(layout: &Layout) -> f64 {
    let pairs_of = |count: usize| (count * (count + 1) / 2) as f64;
    let pairs: f64 = (0..layout.points.len()).map(|point| pairs_of(layout.blocks_of_point(point).len())).sum();
    let widths = layout.first_rows().into_iter().enumerate().map(|(j, first)| ((j + 1 - first as usize) * D) as f64);
    let factor: f64 = widths.map(|width| width * width * D as f64 / 2.0).sum();
    pairs * (3 * D * D) as f64 + factor
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_for_few_points_in_many_views() {
        assert!(Coupling::<6>::where_it_pays(&Layout::of_world(120, 40)).is_some());
        assert!(Coupling::<6>::where_it_pays(&Layout::of_world(120, 400)).is_none());
        assert!(Coupling::<6>::where_it_pays(&Layout::of_world(20, 30)).is_none());
    }

    #[test]
    fn every_observation_with_a_view_is_in_one_pair() {
        let layout = Layout::of_world(60, 25);
        let coupling = Coupling::<6>::new(&layout);
        let mut seen = vec![0; layout.num_obs()];
        for view in 0..coupling.num_views() {
            assert!(coupling.pairs(view).is_sorted_by_key(|pair| pair.point));
            for pair in coupling.pairs(view) {
                for o in pair.first_obs..pair.first_obs + pair.num_obs {
                    assert_eq!(layout.obs_block[o as usize] as usize, view);
                    assert!(layout.obs_of_point(pair.point as usize).contains(&(o as usize)));
                    seen[o as usize] += 1;
                }
            }
        }
        for (o, block) in layout.obs_block.iter().enumerate() {
            assert_eq!(seen[o], usize::from(*block != NONE));
        }
    }
}
