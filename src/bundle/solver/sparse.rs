//! Sparse supernodal Cholesky with a symbolic factorization computed once.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltParams, LltRegularization};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Auto, Conj, MatMut, Par, Side, Spec};

use crate::bundle::camera_sums::CAMERA_DIM;
use crate::bundle::schur::Reduced;

/// Upper triangle in compressed columns, symbolic and numeric factor.
///
/// It runs on one thread: the supernodes of a band depend on one another, and a second thread was measured to slow them
/// down.
pub(in crate::bundle) struct SparseSolver {
    size: usize,
    column_start: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
    scratch: MemBuffer,
    solve_scratch: MemBuffer,
}

impl SparseSolver {
    /// Computes ordering and fill; `None` if memory runs out.
    pub fn new<const D: usize>(reduced: &Reduced<D>) -> Option<Self> {
        let size = reduced.size();
        let (column_start, rows) = structure(reduced);
        let pattern = SymbolicSparseColMatRef::new_checked(size, size, &column_start, None, &rows);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        let symbolic = factorize_symbolic_cholesky(pattern, Side::Upper, SymmetricOrdering::Amd, params).ok()?;
        let llt: Spec<LltParams, f64> = Spec::new(Auto::<f64>::auto());
        let scratch = MemBuffer::new(symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, llt));
        let solve_scratch = MemBuffer::new(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        let (values, factor) = (vec![0.0; rows.len()], vec![0.0; symbolic.len_val()]);
        Some(Self { size, column_start, rows, values, symbolic, factor, scratch, solve_scratch })
    }

    /// Factorizes S; `Err` contains the first pivot that is not positive, in the order of the factorization.
    pub fn factor<const D: usize>(&mut self, reduced: &Reduced<D>) -> Result<(), usize> {
        fill(reduced, &mut self.values);
        let pattern = SymbolicSparseColMatRef::new_checked(self.size, self.size, &self.column_start, None, &self.rows);
        let matrix = SparseColMatRef::new(pattern, &self.values);
        let stack = MemStack::new(&mut self.scratch);
        let (regularization, params) = (LltRegularization::default(), Spec::new(Auto::<f64>::auto()));
        let done = self.symbolic.factorize_numeric_llt(
            &mut self.factor,
            matrix,
            Side::Upper,
            regularization,
            Par::Seq,
            stack,
            params,
        );
        done.map(drop).map_err(|LltError::NonPositivePivot { index }| index)
    }

    /// Solves in place with the last factor, for any number of columns.
    pub fn solve(&mut self, columns: &mut [f64]) {
        let llt = LltRef::new(&self.symbolic, &self.factor);
        for column in columns.chunks_exact_mut(self.size) {
            let rhs = MatMut::from_column_major_slice_mut(column, self.size, 1);
            llt.solve_in_place_with_conj(Conj::No, rhs, Par::Seq, MemStack::new(&mut self.solve_scratch));
        }
    }
}

/// Starts of columns, and rows.
fn structure<const D: usize>(reduced: &Reduced<D>) -> (Vec<usize>, Vec<usize>) {
    let views = reduced.views.len();
    let (mut start, mut rows) = (vec![0], Vec::new());
    for j in 0..views {
        let others = &reduced.pattern.rows[reduced.pattern.panel(j)];
        for c in 0..D {
            for i in &others[..others.len() - 1] {
                rows.extend((0..D).map(|r| *i as usize * D + r));
            }
            rows.extend((0..=c).map(|r| j * D + r));
            start.push(rows.len());
        }
    }
    for k in 0..reduced.cameras.reduced.len() {
        rows.extend(0..=views * D + k);
        start.push(rows.len());
    }
    (start, rows)
}

/// Values in the order of [`structure`].
fn fill<const D: usize>(reduced: &Reduced<D>, values: &mut [f64]) {
    let (views, n) = (reduced.views.len(), reduced.cameras.reduced.len());
    let mut cells = values.iter_mut();
    let mut put = |value: f64| {
        if let Some(cell) = cells.next() {
            *cell = value;
        }
    };
    for j in 0..views {
        let panel = &reduced.blocks[reduced.pattern.panel(j)];
        let Some((diagonal, others)) = panel.split_last() else { continue };
        for c in 0..D {
            for block in others {
                block.iter().for_each(|row| put(row[c]));
            }
            diagonal[..=c].iter().for_each(|row| put(row[c]));
        }
    }
    let num_shared = n / CAMERA_DIM;
    for k in 0..n {
        for view in 0..views {
            let block = &reduced.border[view * num_shared + k / CAMERA_DIM];
            block.iter().for_each(|row| put(row[k % CAMERA_DIM]));
        }
        for r in 0..=k {
            put(reduced.cameras.block[r * n + k]);
        }
    }
}
