//! Solver of the view step by factorization of a matrix over the points, for few points (eqs. 8a–8b).

use faer::Par;

use super::dense::DenseSolver;
use crate::bundle::coupling::{Coupling, Pair};
use crate::bundle::schur::Reduced;
use crate::bundle::simd::{Fused, Task, wide};

/// Solves S δ = −b for an S that is not formed.
pub(in crate::bundle) struct PointsSolver {
    /// I − Σ ZᵀZ over the views (eq. 8b).
    matrix: DenseSolver,
    /// Lower triangles of the Cholesky factors of the views' blocks, row-major, D × D each.
    factors: Vec<f64>,
    /// Z of all views, concatenated: D rows, three columns for each point that the view observes.
    scaled: Vec<f64>,
    /// One entry for each coordinate of each point.
    of_points: Vec<f64>,
}

impl PointsSolver {
    pub fn new<const D: usize>(coupling: &Coupling<D>, par: Par) -> Self {
        let unknowns = 3 * coupling.num_points;
        Self {
            matrix: DenseSolver::new(unknowns, par),
            factors: Vec::new(),
            scaled: Vec::new(),
            of_points: vec![0.0; unknowns],
        }
    }

    /// Solves in place, −b becoming δ. `Err` contains the pivot that is not positive.
    pub fn solve<const D: usize>(
        &mut self,
        reduced: &Reduced<D>,
        coupling: &Coupling<D>,
        step: &mut [f64],
    ) -> Result<(), usize> {
        wide(Scale { solver: self, reduced, coupling, step })?;
        self.matrix.factor_columns().map_err(|pivot| step.len() + pivot)?;
        self.matrix.solve(&mut self.of_points);
        wide(Finish { solver: self, coupling, step });
        Ok(())
    }
}

/// Fills the matrix and the right-hand side of the points, and writes L⁻¹ (−b) to `step`.
struct Scale<'a, const D: usize> {
    solver: &'a mut PointsSolver,
    reduced: &'a Reduced<D>,
    coupling: &'a Coupling<D>,
    step: &'a mut [f64],
}

impl<const D: usize> Task for Scale<'_, D> {
    type Output = Result<(), usize>;

    #[inline(always)]
    fn run<F: Fused>(self) -> Result<(), usize> {
        let Self { solver, reduced, coupling, step } = self;
        let PointsSolver { matrix, factors, scaled, of_points } = solver;
        factors.clear();
        scaled.clear();
        of_points.fill(0.0);
        for k in 0..of_points.len() {
            let column = matrix.column(k);
            column[k..].fill(0.0);
            column[k] = 1.0;
        }
        let mut products = Vec::new();
        for (view, step) in step.chunks_exact_mut(D).enumerate() {
            let factor = cholesky(&reduced.blocks[view]).map_err(|pivot| view * D + pivot)?;
            forward_solve(&factor, step);
            let pairs = coupling.pairs(view);
            let width = 3 * pairs.len();
            let start = scaled.len();
            scaled.resize(start + D * width, 0.0);
            let z = &mut scaled[start..];
            for (place, pair) in pairs.iter().enumerate() {
                let block = coupling.block(pair);
                for c in 0..3 {
                    let mut column: [f64; D] = std::array::from_fn(|r| block[r][c]);
                    forward_solve(&factor, &mut column);
                    for (r, value) in column.iter().enumerate() {
                        z[r * width + 3 * place + c] = *value;
                        of_points[3 * pair.point as usize + c] += value * step[r];
                    }
                }
            }
            subtract_products::<D, F>(matrix, pairs, z, &mut products);
            factors.extend_from_slice(factor.as_flattened());
        }
        Ok(())
    }
}

/// Columns of ZᵀZ computed at a time: as many as fit the registers with the three columns they are multiplied by.
const WIDTH: usize = 12;

/// Subtracts ZᵀZ of one view, by three columns at a time, in the lower triangle.
///
/// * `products` – scratch space for three columns.
#[inline(always)]
fn subtract_products<const D: usize, F: Fused>(
    matrix: &mut DenseSolver,
    pairs: &[Pair],
    z: &[f64],
    products: &mut Vec<[f64; 3]>,
) {
    let width = 3 * pairs.len();
    for (place, pair) in pairs.iter().enumerate() {
        let first = 3 * place;
        let own: [[f64; 3]; D] = std::array::from_fn(|r| std::array::from_fn(|c| z[r * width + first + c]));
        products.clear();
        products.resize(width - first, [0.0; 3]);
        let (whole, rest) = products.as_chunks_mut::<WIDTH>();
        for (chunk, sums) in whole.iter_mut().enumerate() {
            multiply::<D, WIDTH, F>(&own, z, width, first + chunk * WIDTH, sums);
        }
        let start = width - rest.len();
        for (chunk, sums) in rest.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            multiply::<D, 3, F>(&own, z, width, start + 3 * chunk, sums);
        }
        for c in 0..3 {
            let column = matrix.column(3 * pair.point as usize + c);
            for (other, product) in pairs[place..].iter().zip(products.as_chunks::<3>().0) {
                let cells = &mut column[3 * other.point as usize..][..3];
                (0..3).for_each(|k| cells[k] -= product[k][c]);
            }
        }
    }
}

/// The products of N columns of Z, from `from` on, with three others.
#[inline(always)]
fn multiply<const D: usize, const N: usize, F: Fused>(
    own: &[[f64; 3]; D],
    z: &[f64],
    width: usize,
    from: usize,
    out: &mut [[f64; 3]; N],
) {
    let mut sums = [[0.0; N]; 3];
    for (r, own) in own.iter().enumerate() {
        let row: &[f64] = &z[r * width + from..][..N];
        for (sums, factor) in sums.iter_mut().zip(own) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum = F::mul_add(*factor, *value, *sum);
            }
        }
    }
    for (k, out) in out.iter_mut().enumerate() {
        *out = std::array::from_fn(|c| sums[c][k]);
    }
}

/// δ = L⁻ᵀ (L⁻¹ (−b) + Z u), with u of the points.
struct Finish<'a, const D: usize> {
    solver: &'a PointsSolver,
    coupling: &'a Coupling<D>,
    step: &'a mut [f64],
}

impl<const D: usize> Task for Finish<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<F: Fused>(self) {
        let Self { solver, coupling, step } = self;
        let mut scaled = solver.scaled.as_slice();
        for (view, step) in step.chunks_exact_mut(D).enumerate() {
            let pairs = coupling.pairs(view);
            let width = 3 * pairs.len();
            let (z, rest) = scaled.split_at(D * width);
            scaled = rest;
            for (r, value) in step.iter_mut().enumerate() {
                for (pair, z) in pairs.iter().zip(z[r * width..(r + 1) * width].as_chunks::<3>().0) {
                    let u = &solver.of_points[3 * pair.point as usize..][..3];
                    *value = F::mul_add(z[0], u[0], F::mul_add(z[1], u[1], F::mul_add(z[2], u[2], *value)));
                }
            }
            back_solve::<D>(&solver.factors[view * D * D..][..D * D], step);
        }
    }
}

/// Lower triangle, with zeros above; `Err` contains the pivot that is not positive.
#[inline(always)]
fn cholesky<const D: usize>(matrix: &[[f64; D]; D]) -> Result<[[f64; D]; D], usize> {
    let mut factor = [[0.0; D]; D];
    for c in 0..D {
        for r in c..D {
            let sum: f64 = matrix[r][c] - (0..c).map(|k| factor[r][k] * factor[c][k]).sum::<f64>();
            if r > c {
                factor[r][c] = sum / factor[c][c];
            } else if sum > 0.0 && sum.is_finite() {
                factor[c][c] = sum.sqrt();
            } else {
                return Err(c);
            }
        }
    }
    Ok(factor)
}

/// L⁻¹ v in place.
#[inline(always)]
fn forward_solve<const D: usize>(factor: &[[f64; D]; D], v: &mut [f64]) {
    for r in 0..D {
        let known: f64 = (0..r).map(|k| factor[r][k] * v[k]).sum();
        v[r] = (v[r] - known) / factor[r][r];
    }
}

/// L⁻ᵀ v in place; L row-major.
#[inline(always)]
fn back_solve<const D: usize>(factor: &[f64], v: &mut [f64]) {
    for r in (0..D).rev() {
        let known: f64 = (r + 1..D).map(|k| factor[k * D + r] * v[k]).sum();
        v[r] = (v[r] - known) / factor[r * D + r];
    }
}
