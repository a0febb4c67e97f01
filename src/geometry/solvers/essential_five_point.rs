//! Relative pose of two calibrated views from five correspondences.
//!
//! D. Nistér, *An Efficient Solution to the Five-Point Relative Pose Problem*, PAMI 2004: E is sought in the null space
//! of the five epipolar constraints as x X + y Y + z Z + W; the ten cubic constraints `det E = 0` and
//! `2 E Eᵀ E − tr(E Eᵀ) E = 0` are eliminated to a 3 × 3 matrix of polynomials in z, whose determinant has degree ten.

use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::math::{epipolar_row, null_matrices, polynomial::real_roots};

/// Exponents of x, y, z of the twenty monomials up to degree three, in the order of Nistér's elimination.
const MONOMIALS: [[u8; 3]; 20] = [
    [3, 0, 0],
    [0, 3, 0],
    [2, 1, 0],
    [1, 2, 0],
    [2, 0, 1],
    [2, 0, 0],
    [0, 2, 1],
    [0, 2, 0],
    [1, 1, 1],
    [1, 1, 0],
    [1, 0, 2],
    [1, 0, 1],
    [1, 0, 0],
    [0, 1, 2],
    [0, 1, 1],
    [0, 1, 0],
    [0, 0, 3],
    [0, 0, 2],
    [0, 0, 1],
    [0, 0, 0],
];

type Constraints = SMatrix<f64, 10, 20>;

/// Essential matrices E with `ray2ᵀ E ray1 = 0` for five pairs of rays (any length): zero to ten, of unit norm.
pub fn essential_five_point(rays1: &[Vector3<f64>; 5], rays2: &[Vector3<f64>; 5]) -> Vec<Matrix3<f64>> {
    let rows = rays1.iter().zip(rays2).map(|(a, b)| epipolar_row(a, b));
    let Some(basis) = null_matrices(rows) else { return Vec::new() };
    let Some(reduced) = eliminated(constraints(&basis)) else { return Vec::new() };
    let rows: [[[f64; 5]; 3]; 3] = [(4, 5), (6, 7), (8, 9)].map(|(a, b)| polynomial_row(&reduced, a, b));
    real_roots(&determinant(&rows))
        .into_iter()
        .filter_map(|z| {
            let at_z = Matrix3::from_fn(|i, j| evaluate(&rows[i][j], z));
            // (x, y, 1) spans the null space of the polynomial matrix at the root.
            let solution = cross_null_vector(&at_z)?;
            let (x, y) = (solution.x / solution.z, solution.y / solution.z);
            let essential = basis[0] * x + basis[1] * y + basis[2] * z + basis[3];
            let norm = essential.norm();
            (norm.is_finite() && norm > 0.0).then(|| essential / norm)
        })
        .collect()
}

/// A polynomial in x, y, z of degree up to three, over [`MONOMIALS`].
#[derive(Clone, Copy)]
struct Cubic([f64; 20]);

impl Cubic {
    const ZERO: Self = Self([0.0; 20]);

    fn scaled_sum(self, factor: f64, other: &Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + factor * other.0[k]))
    }

    /// Adds `factor` times the product of a polynomial of degree two with a linear one.
    fn add_product(&mut self, factor: f64, quadratic: &Self, linear: &Linear) {
        for (i, a) in QUADRATIC.into_iter().map(|i| (i, factor * quadratic.0[i])) {
            for (j, b) in LINEAR.into_iter().zip(linear) {
                self.0[PRODUCTS[i][j] as usize] += a * b;
            }
        }
    }

    /// The same with two linear ones.
    fn add_linear_product(&mut self, factor: f64, first: &Linear, second: &Linear) {
        for (i, a) in LINEAR.into_iter().zip(first) {
            for (j, b) in LINEAR.into_iter().zip(second) {
                self.0[PRODUCTS[i][j] as usize] += factor * a * b;
            }
        }
    }
}

/// Coefficients of x, y, z and 1.
type Linear = [f64; 4];
/// Indices of these in [`MONOMIALS`].
const LINEAR: [usize; 4] = [12, 15, 18, 19];
/// Indices of the monomials of degree two and less.
const QUADRATIC: [usize; 10] = [5, 7, 9, 11, 12, 14, 15, 17, 18, 19];

/// Index of the product of two monomials; 255 where its degree is above three.
const PRODUCTS: [[u8; 20]; 20] = {
    let mut table = [[255u8; 20]; 20];
    let mut i = 0;
    while i < 20 {
        let mut j = 0;
        while j < 20 {
            let mut k = 0;
            while k < 20 {
                if MONOMIALS[k][0] == MONOMIALS[i][0] + MONOMIALS[j][0]
                    && MONOMIALS[k][1] == MONOMIALS[i][1] + MONOMIALS[j][1]
                    && MONOMIALS[k][2] == MONOMIALS[i][2] + MONOMIALS[j][2]
                {
                    table[i][j] = k as u8;
                }
                k += 1;
            }
            j += 1;
        }
        i += 1;
    }
    table
};

/// The ten cubic constraints as rows of coefficients.
fn constraints(basis: &[Matrix3<f64>; 4]) -> Constraints {
    let e: [[Linear; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| std::array::from_fn(|k| basis[k][(i, j)])));
    let mut gram = [[Cubic::ZERO; 3]; 3];
    for i in 0..3 {
        for j in 0..=i {
            (0..3).for_each(|k| gram[i][j].add_linear_product(1.0, &e[i][k], &e[j][k]));
            gram[j][i] = gram[i][j];
        }
    }
    let trace = gram[0][0].scaled_sum(1.0, &gram[1][1]).scaled_sum(1.0, &gram[2][2]);
    for (i, row) in gram.iter_mut().enumerate() {
        row[i] = row[i].scaled_sum(-0.5, &trace);
    }
    let mut rows = Constraints::zeros();
    let mut put = |row: usize, c: &Cubic| (0..20).for_each(|k| rows[(row, k)] = c.0[k]);
    for i in 0..3 {
        for j in 0..3 {
            let mut sum = Cubic::ZERO;
            (0..3).for_each(|k| sum.add_product(1.0, &gram[i][k], &e[k][j]));
            put(3 * i + j, &sum);
        }
    }
    let mut determinant = Cubic::ZERO;
    for (a, [b, c], sign) in [(0, [1, 2], 1.0), (1, [0, 2], -1.0), (2, [0, 1], 1.0)] {
        let mut minor = Cubic::ZERO;
        minor.add_linear_product(1.0, &e[1][b], &e[2][c]);
        minor.add_linear_product(-1.0, &e[1][c], &e[2][b]);
        determinant.add_product(sign, &minor, &e[0][a]);
    }
    put(9, &determinant);
    rows
}

/// Gauss-Jordan elimination of the first ten columns, with row pivoting.
fn eliminated(mut m: Constraints) -> Option<Constraints> {
    for column in 0..10 {
        let pivot = (column..10).max_by(|&a, &b| m[(a, column)].abs().total_cmp(&m[(b, column)].abs()))?;
        if m[(pivot, column)].abs() < 1e-12 {
            return None;
        }
        m.swap_rows(pivot, column);
        let inverse = 1.0 / m[(column, column)];
        for k in column..20 {
            m[(column, k)] *= inverse;
        }
        for row in (0..10).filter(|&row| row != column) {
            let factor = m[(row, column)];
            if factor != 0.0 {
                for k in column..20 {
                    m[(row, k)] -= factor * m[(column, k)];
                }
            }
        }
    }
    Some(m)
}

/// Row a minus z times row b: polynomial coefficients of x, y and 1, ascending in z.
fn polynomial_row(m: &Constraints, a: usize, b: usize) -> [[f64; 5]; 3] {
    let group = |first: usize, degree: usize| {
        // Columns run from the highest power of z down to its zeroth.
        let mut c = [0.0; 5];
        for power in 0..=degree {
            c[power] += m[(a, first + degree - power)];
            c[power + 1] -= m[(b, first + degree - power)];
        }
        c
    };
    [group(10, 2), group(13, 2), group(16, 3)]
}

/// Determinant of the matrix of polynomials, ascending in z, degree ten.
fn determinant(rows: &[[[f64; 5]; 3]; 3]) -> [f64; 13] {
    let mut sum = [0.0; 13];
    for (i, j, k, sign) in
        [(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0), (0, 2, 1, -1.0), (1, 0, 2, -1.0), (2, 1, 0, -1.0)]
    {
        for (a, x) in rows[0][i].iter().enumerate() {
            for (b, y) in rows[1][j].iter().enumerate() {
                for (c, z) in rows[2][k].iter().enumerate() {
                    sum[a + b + c] += sign * x * y * z;
                }
            }
        }
    }
    // Degrees eleven and twelve vanish by construction: the coefficients of x and y have degree three.
    sum[11] = 0.0;
    sum[12] = 0.0;
    sum
}

fn evaluate(coefficients: &[f64; 5], z: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |value, c| value * z + c)
}

/// A null vector of a matrix of rank two: the longest cross product of two rows.
fn cross_null_vector(m: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let row = |i: usize| m.row(i).transpose();
    [(0, 1), (0, 2), (1, 2)]
        .map(|(i, j)| row(i).cross(&row(j)))
        .into_iter()
        .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))
        .filter(|v| v.z.abs() > 1e-14 * v.norm() && v.norm() > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use nalgebra::UnitQuaternion;
    use rand::Rng as _;

    #[test]
    fn the_true_matrix_is_among_the_solutions() {
        let mut rng = seeded_rng(11, 0);
        let mut found = 0;
        const TRIALS: usize = 200;
        for trial in 0..TRIALS {
            let mut draw = |scale: f64| Vector3::from_fn(|_, _| rng.random_range(-scale..scale));
            let rotation = UnitQuaternion::from_scaled_axis(draw(0.4));
            let translation = draw(1.0);
            // Every other trial is a planar scene, where an eight-point method would fail.
            let points = [(); 5].map(|()| {
                let mut p = draw(2.0) + Vector3::new(0.0, 0.0, 5.0);
                if trial % 2 == 0 {
                    p.z = 5.0 + 0.3 * p.x;
                }
                p
            });
            let truth = translation.cross_matrix() * rotation.to_rotation_matrix().matrix();
            let truth = truth / truth.norm();
            let all = essential_five_point(&points, &points.map(|p| rotation * p + translation));
            assert!(all.len() <= 10);
            found += usize::from(all.iter().any(|e| (e - truth).norm().min((e + truth).norm()) < 1e-5));
        }
        assert!(found >= TRIALS * 97 / 100, "{found} of {TRIALS}");
    }

    #[test]
    fn repeated_points_give_nothing() {
        let ray = Vector3::new(0.1, 0.2, 1.0);
        assert!(essential_five_point(&[ray; 5], &[ray; 5]).is_empty());
    }
}
