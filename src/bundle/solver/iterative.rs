//! Conjugate gradients on the reduced system, with the inverses of its diagonal blocks as preconditioner.

use crate::bundle::camera_sums::CAMERA_DIM;
use crate::bundle::schur::Reduced;

/// Relative residual at which a step is good enough (the forcing term of an inexact Newton method).
const FORCING: f64 = 0.01;
/// Most iterations of one solve.
const MAX_ITERATIONS: usize = 500;

/// Work space.
pub(in crate::bundle) struct IterativeSolver {
    residual: Vec<f64>,
    direction: Vec<f64>,
    preconditioned: Vec<f64>,
    product: Vec<f64>,
}

impl IterativeSolver {
    pub fn new(size: usize) -> Self {
        let zeros = || vec![0.0; size];
        Self { residual: zeros(), direction: zeros(), preconditioned: zeros(), product: zeros() }
    }

    /// Solves S x = `step` in place. `Err` where a diagonal block is not positive definite.
    pub fn solve<const D: usize>(&mut self, reduced: &Reduced<D>, step: &mut [f64]) -> Result<(), usize> {
        let factors = Preconditioner::new(reduced)?;
        self.residual.copy_from_slice(step);
        step.fill(0.0);
        factors.apply(&self.residual, &mut self.preconditioned);
        self.direction.copy_from_slice(&self.preconditioned);
        let mut rho = dot(&self.residual, &self.preconditioned);
        let target = rho * FORCING * FORCING;
        for _ in 0..MAX_ITERATIONS {
            if !(rho > target) {
                break;
            }
            multiply(reduced, &self.direction, &mut self.product);
            let curvature = dot(&self.direction, &self.product);
            if !(curvature > 0.0) {
                return Err(0);
            }
            let alpha = rho / curvature;
            add_scaled(step, alpha, &self.direction);
            add_scaled(&mut self.residual, -alpha, &self.product);
            factors.apply(&self.residual, &mut self.preconditioned);
            let next = dot(&self.residual, &self.preconditioned);
            let beta = next / rho;
            rho = next;
            for (d, p) in self.direction.iter_mut().zip(&self.preconditioned) {
                *d = p + beta * *d;
            }
        }
        Ok(())
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn add_scaled(into: &mut [f64], factor: f64, from: &[f64]) {
    for (a, b) in into.iter_mut().zip(from) {
        *a += factor * b;
    }
}

/// S x from the blocks of the upper triangle.
fn multiply<const D: usize>(reduced: &Reduced<D>, x: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    let (views, n) = (reduced.views.len(), reduced.camera_reduced.len());
    for j in 0..views {
        for index in reduced.pattern.panel(j) {
            let (i, block) = (reduced.pattern.rows[index] as usize, &reduced.blocks[index]);
            for r in 0..D {
                out[i * D + r] += dot(&block[r], &x[j * D..(j + 1) * D]);
                if i != j {
                    add_scaled(&mut out[j * D..(j + 1) * D], x[i * D + r], &block[r]);
                }
            }
        }
    }
    let num_shared = n / CAMERA_DIM;
    for (index, block) in reduced.border.iter().enumerate() {
        let (view, first) = (index / num_shared, views * D + index % num_shared * CAMERA_DIM);
        for r in 0..D {
            out[view * D + r] += dot(&block[r], &x[first..first + CAMERA_DIM]);
            add_scaled(&mut out[first..first + CAMERA_DIM], x[view * D + r], &block[r]);
        }
    }
    for r in 0..n {
        out[views * D + r] += dot(&reduced.camera_block[r * n..(r + 1) * n], &x[views * D..]);
    }
}

/// Cholesky factors of the diagonal blocks.
struct Preconditioner {
    /// (size, row-major lower triangle) of each block.
    factors: Vec<(usize, Vec<f64>)>,
}

impl Preconditioner {
    fn new<const D: usize>(reduced: &Reduced<D>) -> Result<Self, usize> {
        let (views, n) = (reduced.views.len(), reduced.camera_reduced.len());
        let mut factors = Vec::with_capacity(views + n / CAMERA_DIM);
        for j in 0..views {
            let Some(block) = reduced.blocks[reduced.pattern.panel(j)].last() else { continue };
            factors.push((D, cholesky(block.as_flattened().to_vec(), D).ok_or(j * D)?));
        }
        for camera in 0..n / CAMERA_DIM {
            let cell = |k: usize| {
                let (r, c) = (camera * CAMERA_DIM + k / CAMERA_DIM, camera * CAMERA_DIM + k % CAMERA_DIM);
                reduced.camera_block[r * n + c]
            };
            let block = (0..CAMERA_DIM * CAMERA_DIM).map(cell).collect();
            factors.push((CAMERA_DIM, cholesky(block, CAMERA_DIM).ok_or(views * D)?));
        }
        Ok(Self { factors })
    }

    fn apply(&self, from: &[f64], into: &mut [f64]) {
        into.copy_from_slice(from);
        let mut rest = into;
        for (size, factor) in &self.factors {
            let (x, tail) = rest.split_at_mut(*size);
            solve_block(factor, x);
            rest = tail;
        }
    }
}

fn cholesky(mut a: Vec<f64>, n: usize) -> Option<Vec<f64>> {
    for i in 0..n {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let value = a[i * n + j] - sum;
            if i == j {
                if !(value > 0.0) {
                    return None;
                }
                a[i * n + i] = value.sqrt();
            } else {
                a[i * n + j] = value / a[j * n + j];
            }
        }
    }
    Some(a)
}

fn solve_block(l: &[f64], x: &mut [f64]) {
    let n = x.len();
    for i in 0..n {
        let sum: f64 = (0..i).map(|k| l[i * n + k] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i * n + i];
    }
    for i in (0..n).rev() {
        let sum: f64 = (i + 1..n).map(|k| l[k * n + i] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i * n + i];
    }
}
