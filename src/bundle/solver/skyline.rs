//! Cholesky of a band, in the order of the views.
//!
//! S = L Lᵀ has no fill outside the envelope of S, from the first block of each row to its diagonal. Neighboring views
//! form one *stripe* of L, a dense matrix that begins at the smallest column of its views. Stripe J is computed from
//! those before it, block by block:
//!
//! ```text
//! L_JI = (S_JI − Σ_{K<I} L_JK L_IKᵀ) L_II⁻ᵀ,    L_JJ L_JJᵀ = S_JJ − Σ_{K<J} L_JK L_JKᵀ
//! ```
//!
//! (A. George, J. Liu, *Computer Solution of Large Sparse Positive Definite Systems*, 1981, chapter 4). S is copied
//! into the memory of L, so the system takes no memory beyond that of its envelope. Shared cameras are the last stripe.

use faer::dyn_stack::MemBuffer;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::prelude::ReborrowMut;
use faer::{Accum, MatMut, MatRef, Par};

use super::dense::{factor_in_place, scratch};
use crate::bundle::camera_sums::CAMERA_DIM;
use crate::bundle::schur::Reduced;

/// Views of a stripe: wide enough for fast products, and narrow next to a band of a hundred views.
const VIEWS: usize = 8;

/// Neighboring rows of L.
struct Stripe {
    /// First row.
    start: usize,
    /// Rows.
    width: usize,
    /// First column, aligned to a stripe.
    first: usize,
    /// Columns `first` to the end of the diagonal block, each of `width` entries; unused above the diagonal.
    values: Vec<f64>,
}

impl Stripe {
    fn new(start: usize, width: usize, first: usize) -> Self {
        Self { start, width, first, values: vec![0.0; (start + width - first) * width] }
    }

    /// Index of an entry in `values`.
    fn place(&self, row: usize, column: usize) -> usize {
        (column - self.first) * self.width + row - self.start
    }

    /// Columns `from` to `to`.
    fn columns(&self, from: usize, to: usize) -> MatRef<'_, f64> {
        let range = (from - self.first) * self.width..(to - self.first) * self.width;
        MatRef::from_column_major_slice(&self.values[range], self.width, to - from)
    }

    /// The diagonal block.
    fn diagonal(&self) -> MatRef<'_, f64> {
        self.columns(self.start, self.start + self.width)
    }

    /// Updates the columns of another stripe from S to L, given all columns before them.
    fn eliminate(&mut self, other: &Self) {
        let (width, end) = (self.width, other.start + other.width);
        let from = self.first.max(other.first);
        let (before, rest) = self.values.split_at_mut((other.start - self.first) * width);
        let own = &mut rest[..(end - other.start) * width];
        let mut own = MatMut::from_column_major_slice_mut(own, width, other.width);
        if from < other.start {
            let left =
                MatRef::from_column_major_slice(&before[(from - self.first) * width..], width, other.start - from);
            let right = other.columns(from, other.start).transpose();
            matmul(own.rb_mut(), Accum::Add, left, right, -1.0, Par::Seq);
        }
        solve_lower_triangular_in_place(other.diagonal(), own.transpose_mut(), Par::Seq);
    }

    /// Factorizes the diagonal block, given all columns before it.
    fn factor(&mut self, scratch: &mut MemBuffer) -> Result<(), usize> {
        let (start, width) = (self.start, self.width);
        let (before, own) = self.values.split_at_mut((start - self.first) * width);
        let left = MatRef::from_column_major_slice(before, width, start - self.first);
        let mut own = MatMut::from_column_major_slice_mut(own, width, width);
        if start > self.first {
            matmul(own.rb_mut(), Accum::Add, left, left.transpose(), -1.0, Par::Seq);
        }
        factor_in_place(own, Par::Seq, scratch).map_err(|index| start + index)
    }

    /// y = L_JJ⁻¹ (b − Σ_{K<J} L_JK y_K), for the rows of this stripe; `x` holds y before them and b in them.
    fn forward(&self, x: &mut [f64]) {
        let (known, own) = x.split_at_mut(self.start);
        let own = &mut own[..self.width];
        for (column, y) in self.values.chunks_exact(self.width).zip(&known[self.first..]) {
            own.iter_mut().zip(column).for_each(|(b, l)| *b -= l * y);
        }
        let diagonal = &self.values[(self.start - self.first) * self.width..];
        for (k, column) in diagonal.chunks_exact(self.width).enumerate() {
            own[k] /= column[k];
            let y = own[k];
            own[k + 1..].iter_mut().zip(&column[k + 1..]).for_each(|(b, l)| *b -= l * y);
        }
    }

    /// x = L_JJ⁻ᵀ y for the rows of this stripe; their contribution is then subtracted from all y before them.
    fn backward(&self, x: &mut [f64]) {
        let (before, own) = x.split_at_mut(self.start);
        let own = &mut own[..self.width];
        let diagonal = &self.values[(self.start - self.first) * self.width..];
        for (k, column) in diagonal.chunks_exact(self.width).enumerate().rev() {
            let sum: f64 = own[k + 1..].iter().zip(&column[k + 1..]).map(|(x, l)| x * l).sum();
            own[k] = (own[k] - sum) / column[k];
        }
        for (column, y) in self.values.chunks_exact(self.width).zip(&mut before[self.first..]) {
            *y -= column.iter().zip(own.iter()).map(|(l, x)| l * x).sum::<f64>();
        }
    }
}

/// The factor, and scratch memory for its computation.
pub(in crate::bundle) struct SkylineSolver {
    size: usize,
    /// Stripes in order; the shared cameras last.
    stripes: Vec<Stripe>,
    scratch: MemBuffer,
}

impl SkylineSolver {
    pub fn new<const D: usize>(reduced: &Reduced<D>) -> Self {
        let (views, size) = (reduced.views.len(), reduced.size());
        let mut stripes: Vec<Stripe> = (0..views)
            .step_by(VIEWS)
            .map(|start| {
                let end = views.min(start + VIEWS);
                let first = (start..end).map(|j| reduced.pattern.first_row(j)).min().unwrap_or(start);
                Stripe::new(start * D, (end - start) * D, first / VIEWS * VIEWS * D)
            })
            .collect();
        if size > views * D {
            stripes.push(Stripe::new(views * D, size - views * D, 0));
        }
        let widest = stripes.iter().map(|stripe| stripe.width).max().unwrap_or(0);
        Self { size, stripes, scratch: scratch(widest, Par::Seq) }
    }

    /// Factorizes S; `Err` contains the first pivot that is not positive.
    pub fn factor<const D: usize>(&mut self, reduced: &Reduced<D>) -> Result<(), usize> {
        self.copy_views(reduced);
        self.copy_cameras(reduced);
        for j in 0..self.stripes.len() {
            let (done, rest) = self.stripes.split_at_mut(j);
            let stripe = &mut rest[0];
            let reached = done.partition_point(|other| other.start < stripe.first);
            done[reached..].iter().for_each(|other| stripe.eliminate(other));
            stripe.factor(&mut self.scratch)?;
        }
        Ok(())
    }

    /// Copies block (i, j) of the upper triangle, transposed, to rows j, columns i.
    fn copy_views<const D: usize>(&mut self, reduced: &Reduced<D>) {
        let pattern = &reduced.pattern;
        for (stripe, first_view) in self.stripes.iter_mut().zip((0..reduced.views.len()).step_by(VIEWS)) {
            stripe.values.fill(0.0);
            for j in first_view..first_view + stripe.width / D {
                for index in pattern.panel(j) {
                    for (r, row) in reduced.blocks[index].iter().enumerate() {
                        let place = stripe.place(j * D, pattern.rows[index] as usize * D + r);
                        stripe.values[place..place + D].copy_from_slice(row);
                    }
                }
            }
        }
    }

    fn copy_cameras<const D: usize>(&mut self, reduced: &Reduced<D>) {
        let (views, n) = (reduced.views.len(), reduced.cameras.reduced.len());
        let Some(stripe) = self.stripes.last_mut().filter(|_| n > 0) else { return };
        let (border, own) = stripe.values.split_at_mut(views * D * n);
        for (view, blocks) in reduced.border.chunks_exact(n / CAMERA_DIM).enumerate() {
            for (camera, block) in blocks.iter().enumerate() {
                for (r, row) in block.iter().enumerate() {
                    let place = (view * D + r) * n + camera * CAMERA_DIM;
                    border[place..place + CAMERA_DIM].copy_from_slice(row);
                }
            }
        }
        own.copy_from_slice(&reduced.cameras.block);
    }

    /// Solves in place with the last factor, for any number of columns.
    pub fn solve(&self, columns: &mut [f64]) {
        for column in columns.chunks_exact_mut(self.size.max(1)) {
            self.stripes.iter().for_each(|stripe| stripe.forward(column));
            self.stripes.iter().rev().for_each(|stripe| stripe.backward(column));
        }
    }
}
