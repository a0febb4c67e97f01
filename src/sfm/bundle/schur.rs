//! The reduced camera system S δ = −b that is left when the points are eliminated (eqs. 8–10).
//!
//! S is stored by *panels*: panel j holds the blocks (i, j), i ≤ j, of the pairs of views that see a common point. One task
//! fills one panel and walks over the observations of view j; no two tasks write to the same place, and the order of every
//! sum is that of the points. Shared cameras form a dense border.

use rayon::prelude::*;

use super::layout::{Layout, NONE};
use super::linearize::{Linearization, Pass, Piece};
use super::point::damping_scale;
use super::priors::{PriorTarget, PriorTerms};
use super::residual::Residual;
use super::simd::{Fused, Task, wide};

/// Freedoms reserved for a shared camera.
pub(super) const CAMERA_DIM: usize = 6;
/// Parts into which the sum over points of the shared cameras' own block is cut, whatever the number of threads.
const CAMERA_PARTS: usize = 8;
/// With at most this many views every pair gets a block, and no pattern has to be found.
const ALL_PAIRS_LIMIT: usize = 64;

/// Which pairs of views have a block.
pub(super) struct Pattern {
    /// First block of each panel, and the end of the last.
    pub start: Vec<usize>,
    /// Row (first view of the pair) of every block, ascending within a panel; the last of a panel is its own view.
    pub rows: Vec<u32>,
    /// Smallest row of each panel.
    first_row: Vec<u32>,
    /// Start of each panel's part of `place`.
    place_start: Vec<usize>,
    /// Place within its panel of the block of each row from `first_row`, or [`NONE`].
    place: Vec<u32>,
}

impl Pattern {
    pub fn new(layout: &Layout) -> Self {
        if layout.num_blocks() <= ALL_PAIRS_LIMIT { Self::all_pairs(layout.num_blocks()) } else { Self::seen(layout) }
    }

    fn all_pairs(n: usize) -> Self {
        Self {
            start: (0..=n).map(|j| j * (j + 1) / 2).collect(),
            rows: (0..n as u32).flat_map(|j| 0..=j).collect(),
            first_row: vec![0; n],
            place_start: vec![0; n],
            place: (0..n as u32).collect(),
        }
    }

    /// Marks the pairs of every point in the envelope of the matrix.
    fn seen(layout: &Layout) -> Self {
        let n = layout.num_blocks();
        let mut first_row: Vec<u32> = (0..n as u32).collect();
        for point in 0..layout.points.len() {
            let obs = layout.obs_of_point(point);
            let first = layout.obs_block[obs.start];
            for o in obs.take_while(|o| layout.obs_block[*o] != NONE) {
                let row = &mut first_row[layout.obs_block[o] as usize];
                *row = (*row).min(first);
            }
        }
        let mut place_start = Vec::with_capacity(n);
        let mut len = 0;
        for (j, first) in first_row.iter().enumerate() {
            place_start.push(len);
            len += j + 1 - *first as usize;
        }
        let mut pattern = Self { start: vec![0], rows: Vec::new(), first_row, place_start, place: vec![NONE; len] };
        for j in 0..n {
            pattern.mark_panel(layout, j);
        }
        pattern
    }

    fn mark_panel(&mut self, layout: &Layout, j: usize) {
        let first = self.first_row[j] as usize;
        let place = &mut self.place[self.place_start[j]..][..j + 1 - first];
        place[j - first] = 0;
        for o in layout.obs_of_block(j) {
            let start = layout.obs_of_point(layout.obs_point[*o as usize] as usize).start;
            for i in &layout.obs_block[start..*o as usize] {
                place[*i as usize - first] = 0;
            }
        }
        let marked = place.iter_mut().enumerate().filter(|(_, cell)| **cell != NONE);
        for (count, (row, cell)) in (0..).zip(marked) {
            *cell = count;
            self.rows.push((first + row) as u32);
        }
        self.start.push(self.rows.len());
    }

    /// Blocks of panel j.
    pub fn panel(&self, j: usize) -> std::ops::Range<usize> {
        self.start[j]..self.start[j + 1]
    }

    /// Place of block (i, j), i ≤ j, if there is one.
    pub fn find(&self, i: usize, j: usize) -> Option<usize> {
        let row = i.checked_sub(self.first_row[j] as usize)?;
        let place = self.place[self.place_start[j] + row];
        (place != NONE).then(|| self.start[j] + place as usize)
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Number of blocks in the envelope: from the first of each panel to its diagonal.
    pub fn envelope(&self) -> usize {
        self.first_row.iter().enumerate().map(|(j, first)| j + 1 - *first as usize).sum()
    }

    /// The lookup of one panel, to be indexed by `row - first`.
    fn lookup(&self, j: usize) -> (usize, &[u32]) {
        let first = self.first_row[j] as usize;
        (first, &self.place[self.place_start[j]..][..j + 1 - first])
    }
}

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

/// Per view: right-hand side, gradient, and the diagonal before elimination and damping.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewTerms<const D: usize> {
    pub reduced: [f64; D],
    pub gradient: [f64; D],
    pub diagonal: [f64; D],
}

struct PanelMut<'a, const D: usize> {
    j: usize,
    blocks: &'a mut [[[f64; D]; D]],
    view: &'a mut ViewTerms<D>,
    border: &'a mut [[[f64; CAMERA_DIM]; D]],
}

impl<const D: usize> Reduced<D> {
    pub fn new(layout: &Layout) -> Self {
        let pattern = Pattern::new(layout);
        let cameras = layout.shared.len() * CAMERA_DIM;
        let none = ViewTerms { reduced: [0.0; D], gradient: [0.0; D], diagonal: [0.0; D] };
        Self {
            blocks: vec![[[0.0; D]; D]; pattern.len()],
            pattern,
            views: vec![none; layout.num_blocks()],
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
        let pattern = &self.pattern;
        let num_shared = pass.layout.shared.len();
        let mut panels = Vec::with_capacity(self.views.len());
        let (mut blocks, mut border) = (self.blocks.as_mut_slice(), self.border.as_mut_slice());
        for (j, view) in self.views.iter_mut().enumerate() {
            let (mine, rest) = std::mem::take(&mut blocks).split_at_mut(pattern.panel(j).len());
            let (my_border, border_rest) = std::mem::take(&mut border).split_at_mut(num_shared);
            (blocks, border) = (rest, border_rest);
            panels.push(PanelMut { j, blocks: mine, view, border: my_border });
        }
        let layout = pass.layout;
        let work = |panel: PanelMut<D>| wide(FillPanel { layout, lin, pattern, priors, damping, panel });
        if pass.parallel {
            // Late panels have most rows; the longest tasks go first.
            panels.into_par_iter().rev().with_max_len(1).for_each(work);
        } else {
            panels.into_iter().for_each(work);
        }
        if num_shared > 0 {
            self.assemble_cameras(pass, lin, priors, damping);
        }
    }

    fn assemble_cameras(&mut self, pass: &Pass, lin: &Linearization<D>, priors: &[PriorTerms], damping: f64) {
        let n = self.camera_reduced.len();
        let part_len = pass.pieces.len().div_ceil(CAMERA_PARTS).max(1);
        let parts: Vec<&[Piece]> = pass.pieces.chunks(part_len).collect();
        let work = |part: &[Piece]| {
            let mut sums = CameraSums::new(n);
            for piece in part {
                sums.add(pass.layout, lin, piece);
            }
            sums
        };
        let sums: Vec<CameraSums> = if pass.parallel {
            parts.into_par_iter().map(work).collect()
        } else {
            parts.into_iter().map(work).collect()
        };
        let mut total = CameraSums::new(n);
        for part in &sums {
            total.merge(part);
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

/// What fills a panel.
struct FillPanel<'a, const D: usize> {
    layout: &'a Layout,
    lin: &'a Linearization<D>,
    pattern: &'a Pattern,
    priors: &'a [PriorTerms],
    damping: f64,
    panel: PanelMut<'a, D>,
}

impl<const D: usize> Task for FillPanel<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<F: Fused>(self) {
        let Self { layout, lin, pattern, priors, damping, panel } = self;
        let PanelMut { j, blocks, view, border } = panel;
        let (first_row, lookup) = pattern.lookup(j);
        blocks.fill([[0.0; D]; D]);
        border.fill([[0.0; CAMERA_DIM]; D]);
        *view = ViewTerms { reduced: [0.0; D], gradient: [0.0; D], diagonal: [0.0; D] };
        let Some((own, others)) = blocks.split_last_mut() else { return };
        for o in layout.obs_of_block(j) {
            let o = *o as usize;
            let point = layout.obs_point[o] as usize;
            let mine = &lin.residuals[o];
            add_own::<D, F>(own, view, mine, &lin.points[point].half_step);
            if !border.is_empty() {
                add_border::<D, F>(layout, lin, o, point, border);
            }
            if layout.point_fixed[point] {
                continue;
            }
            let start = layout.obs_of_point(point).start;
            for (other, i) in lin.residuals[start..o].iter().zip(&layout.obs_block[start..o]) {
                if *i as usize == j {
                    // The same point twice in one image: both orders fall on the diagonal block.
                    subtract_pair::<D, F>(own, other, mine);
                    subtract_pair::<D, F>(own, mine, other);
                } else {
                    subtract_pair::<D, F>(&mut others[lookup[*i as usize - first_row] as usize], other, mine);
                }
            }
        }
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

/// One observation's part of its view's own block, gradients and diagonal (eqs. 7, 10): Jᵀ(I − QQᵀ)J and Jᵀ(r − Qz).
#[inline(always)]
fn add_own<const D: usize, F: Fused>(
    own: &mut [[f64; D]; D],
    view: &mut ViewTerms<D>,
    residual: &Residual<D>,
    z: &[f64; 3],
) {
    let ([a, b], [p, q], [r, s]) = (&residual.d_view, &residual.eliminated, residual.value);
    let dot = |u: &[f64; 3], v: &[f64; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    let (t, u) = (r - dot(p, z), s - dot(q, z));
    for k in 0..D {
        view.gradient[k] = F::mul_add(a[k], r, F::mul_add(b[k], s, view.gradient[k]));
        view.reduced[k] = F::mul_add(a[k], t, F::mul_add(b[k], u, view.reduced[k]));
        view.diagonal[k] = F::mul_add(a[k], a[k], F::mul_add(b[k], b[k], view.diagonal[k]));
    }
    let mixed = -dot(p, q);
    add_weighted::<D, F>(own, &residual.d_view, [[1.0 - dot(p, p), mixed], [mixed, 1.0 - dot(q, q)]], &residual.d_view);
}

/// Subtracts one pair's Jᵢᵀ Qᵢ Qⱼᵀ Jⱼ (eq. 8).
#[inline(always)]
fn subtract_pair<const D: usize, F: Fused>(out: &mut [[f64; D]; D], first: &Residual<D>, second: &Residual<D>) {
    let cell = |r: usize, c: usize| {
        let (u, v) = (&first.eliminated[r], &second.eliminated[c]);
        -F::mul_add(u[0], v[0], F::mul_add(u[1], v[1], u[2] * v[2]))
    };
    let weight = [[cell(0, 0), cell(0, 1)], [cell(1, 0), cell(1, 1)]];
    add_weighted::<D, F>(out, &first.d_view, weight, &second.d_view);
}

/// out += aᵀ m b, for two rows each.
#[inline(always)]
fn add_weighted<const D: usize, F: Fused>(
    out: &mut [[f64; D]; D],
    a: &[[f64; D]; 2],
    m: [[f64; 2]; 2],
    b: &[[f64; D]; 2],
) {
    let mut mb = [[0.0; D]; 2];
    for c in 0..D {
        mb[0][c] = F::mul_add(m[0][0], b[0][c], m[0][1] * b[1][c]);
        mb[1][c] = F::mul_add(m[1][0], b[0][c], m[1][1] * b[1][c]);
    }
    for r in 0..D {
        for c in 0..D {
            out[r][c] = F::mul_add(a[0][r], mb[0][c], F::mul_add(a[1][r], mb[1][c], out[r][c]));
        }
    }
}

/// One observation's part of the blocks between its view and all shared cameras that see its point.
#[inline(always)]
fn add_border<const D: usize, F: Fused>(
    layout: &Layout,
    lin: &Linearization<D>,
    o: usize,
    point: usize,
    border: &mut [[[f64; CAMERA_DIM]; D]],
) {
    let residual = &lin.residuals[o];
    for slot in layout.slots_of_point(point) {
        let mut b = if layout.obs_slot[o] as usize == slot { lin.d_shared[o] } else { [[0.0; CAMERA_DIM]; 2] };
        let y = &lin.slot_eliminated[slot];
        for (row, q) in b.iter_mut().zip(&residual.eliminated) {
            for c in 0..CAMERA_DIM {
                row[c] -= F::mul_add(q[0], y[0][c], F::mul_add(q[1], y[1][c], q[2] * y[2][c]));
            }
        }
        let (block, a) = (&mut border[layout.slots[slot] as usize], &residual.d_view);
        for r in 0..D {
            for c in 0..CAMERA_DIM {
                block[r][c] = F::mul_add(a[0][r], b[0][c], F::mul_add(a[1][r], b[1][c], block[r][c]));
            }
        }
    }
}

/// Sums over points for the shared cameras' own block.
struct CameraSums {
    n: usize,
    block: Vec<f64>,
    reduced: Vec<f64>,
    gradient: Vec<f64>,
    diagonal: Vec<f64>,
}

impl CameraSums {
    fn new(n: usize) -> Self {
        Self { n, block: vec![0.0; n * n], reduced: vec![0.0; n], gradient: vec![0.0; n], diagonal: vec![0.0; n] }
    }

    fn add<const D: usize>(&mut self, layout: &Layout, lin: &Linearization<D>, piece: &Piece) {
        for o in piece.obs.clone().filter(|o| layout.obs_slot[*o] != NONE) {
            let first = layout.slots[layout.obs_slot[o] as usize] as usize * CAMERA_DIM;
            let (d, value) = (&lin.d_shared[o], &lin.residuals[o].value);
            for r in 0..CAMERA_DIM {
                let g = d[0][r] * value[0] + d[1][r] * value[1];
                self.gradient[first + r] += g;
                self.reduced[first + r] += g;
                self.diagonal[first + r] += d[0][r] * d[0][r] + d[1][r] * d[1][r];
                for c in 0..CAMERA_DIM {
                    self.block[(first + r) * self.n + first + c] += d[0][r] * d[0][c] + d[1][r] * d[1][c];
                }
            }
        }
        for point in piece.points.clone().filter(|p| !layout.point_fixed[*p]) {
            let z = &lin.points[point].half_step;
            for slot in layout.slots_of_point(point) {
                let (first, y) = (layout.slots[slot] as usize * CAMERA_DIM, &lin.slot_eliminated[slot]);
                for r in 0..CAMERA_DIM {
                    self.reduced[first + r] -= y[0][r] * z[0] + y[1][r] * z[1] + y[2][r] * z[2];
                }
                for other in layout.slots_of_point(point) {
                    let (column, w) = (layout.slots[other] as usize * CAMERA_DIM, &lin.slot_eliminated[other]);
                    for r in 0..CAMERA_DIM {
                        for c in 0..CAMERA_DIM {
                            self.block[(first + r) * self.n + column + c] -=
                                y[0][r] * w[0][c] + y[1][r] * w[1][c] + y[2][r] * w[2][c];
                        }
                    }
                }
            }
        }
    }

    fn merge(&mut self, other: &Self) {
        let lists = [
            (&mut self.block, &other.block),
            (&mut self.reduced, &other.reduced),
            (&mut self.gradient, &other.gradient),
            (&mut self.diagonal, &other.diagonal),
        ];
        for (into, from) in lists {
            for (a, b) in into.iter_mut().zip(from) {
                *a += b;
            }
        }
    }

    fn add_prior(&mut self, first: usize, prior: &PriorTerms) {
        for r in 0..CAMERA_DIM {
            self.gradient[first + r] += prior.gradient[r];
            self.reduced[first + r] += prior.gradient[r];
            self.diagonal[first + r] += prior.hessian[r][r];
            for c in 0..CAMERA_DIM {
                self.block[(first + r) * self.n + first + c] += prior.hessian[r][c];
            }
        }
    }
}
