//! Dense Cholesky.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltParams, LltRegularization};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::{Auto, MatMut, MatRef, Par, Spec};

use crate::bundle::camera_sums::CAMERA_DIM;
use crate::bundle::schur::Reduced;

/// A symmetric matrix and its Cholesky factor: the lower triangle by columns, factorized in place.
pub(in crate::bundle) struct DenseSolver {
    size: usize,
    /// Distance of columns: not a power of two, whose columns would share cache sets.
    stride: usize,
    values: Vec<f64>,
    par: Par,
    scratch: MemBuffer,
}

impl DenseSolver {
    pub fn new(size: usize, par: Par) -> Self {
        let stride = size.div_ceil(8).max(1) * 8 + 8;
        Self { size, stride, values: vec![0.0; stride * size], par, scratch: scratch(size, par) }
    }

    /// A column, of which only the entries from the diagonal on are used.
    pub fn column(&mut self, k: usize) -> &mut [f64] {
        &mut self.values[k * self.stride..][..self.size]
    }

    /// Factorizes the matrix of the columns; `Err` contains the first pivot that is not positive.
    pub fn factor_columns(&mut self) -> Result<(), usize> {
        if self.size == 0 {
            return Ok(());
        }
        let matrix =
            MatMut::from_column_major_slice_with_stride_mut(&mut self.values, self.size, self.size, self.stride);
        factor_in_place(matrix, self.par, &mut self.scratch)
    }

    /// Solves in place with the last factor, for any number of columns.
    pub fn solve(&mut self, columns: &mut [f64]) {
        if self.size == 0 {
            return;
        }
        let count = columns.len() / self.size;
        let factor = MatRef::from_column_major_slice_with_stride(&self.values, self.size, self.size, self.stride);
        let rhs = MatMut::from_column_major_slice_mut(columns, self.size, count);
        solve::solve_in_place(factor, rhs, Par::Seq, MemStack::new(&mut self.scratch));
    }

    /// Factorizes S; `Err` contains the first pivot that is not positive.
    pub fn factor<const D: usize>(&mut self, reduced: &Reduced<D>) -> Result<(), usize> {
        self.copy_views(reduced);
        self.copy_border(reduced);
        self.factor_columns()
    }

    /// Copies block (i, j) of the upper triangle, transposed, to rows j, columns i of the lower one.
    fn copy_views<const D: usize>(&mut self, reduced: &Reduced<D>) {
        let views = reduced.views.len();
        for i in 0..views {
            for r in 0..D {
                let column = self.column(i * D + r);
                for j in i..views {
                    let rows = &mut column[j * D..(j + 1) * D];
                    match reduced.pattern.find(i, j) {
                        Some(block) => rows.copy_from_slice(&reduced.blocks[block][r]),
                        None => rows.fill(0.0),
                    }
                }
            }
        }
    }

    fn copy_border<const D: usize>(&mut self, reduced: &Reduced<D>) {
        let (views, n) = (reduced.views.len(), reduced.cameras.reduced.len());
        let num_shared = n / CAMERA_DIM;
        for i in 0..views {
            for r in 0..D {
                let column = &mut self.column(i * D + r)[views * D..][..n];
                for (camera, rows) in column.chunks_exact_mut(CAMERA_DIM).enumerate() {
                    rows.copy_from_slice(&reduced.border[i * num_shared + camera][r]);
                }
            }
        }
        for r in 0..n {
            let column = &mut self.column(views * D + r)[views * D..][..n];
            column.copy_from_slice(&reduced.cameras.block[r * n..(r + 1) * n]);
        }
    }
}

/// Scratch memory to factorize a matrix of a size.
pub(super) fn scratch(size: usize, par: Par) -> MemBuffer {
    let params: Spec<LltParams, f64> = Spec::new(Auto::<f64>::auto());
    MemBuffer::new(factor::cholesky_in_place_scratch::<f64>(size, par, params))
}

/// Factorizes the lower triangle of a matrix in place; `Err` contains the first pivot that is not positive.
pub(super) fn factor_in_place(matrix: MatMut<'_, f64>, par: Par, scratch: &mut MemBuffer) -> Result<(), usize> {
    let (regularization, params) = (LltRegularization::default(), Spec::new(Auto::<f64>::auto()));
    let done = factor::cholesky_in_place(matrix, regularization, par, MemStack::new(scratch), params);
    done.map(drop).map_err(|LltError::NonPositivePivot { index }| index)
}
