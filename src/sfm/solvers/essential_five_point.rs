//! Relative pose of two calibrated views from five correspondences.
//!
//! D. Nistér, *An Efficient Solution to the Five-Point Relative Pose Problem*, PAMI 2004: E is sought in the null space
//! of the five epipolar constraints as x X + y Y + z Z + W; the ten cubic constraints `det E = 0` and
//! `2 E Eᵀ E − tr(E Eᵀ) E = 0` are eliminated to a 3 × 3 matrix of polynomials in z, whose determinant has degree ten.

use nalgebra::{DMatrix, Matrix3, SMatrix, Vector3};

use crate::math::polynomial::real_roots;

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
    let Some(basis) = null_space(rays1, rays2) else { return Vec::new() };
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

/// Four matrices that span the solutions of the five linear constraints.
fn null_space(rays1: &[Vector3<f64>; 5], rays2: &[Vector3<f64>; 5]) -> Option<[Matrix3<f64>; 4]> {
    // Padded to 9 × 9, so that the decomposition gives all right singular vectors.
    let mut system = DMatrix::<f64>::zeros(9, 9);
    for (row, (a, b)) in rays1.iter().zip(rays2).enumerate() {
        for i in 0..3 {
            for j in 0..3 {
                system[(row, 3 * i + j)] = b[i] * a[j];
            }
        }
    }
    let eigen = (system.transpose() * &system).symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    if !(eigen.eigenvalues[order[4]] > 1e-12 * eigen.eigenvalues[order[8]]) {
        return None;
    }
    let matrix = |k: usize| Matrix3::from_fn(|i, j| eigen.eigenvectors[(3 * i + j, order[k])]);
    Some([matrix(0), matrix(1), matrix(2), matrix(3)])
}

/// A polynomial in x, y, z of degree up to three, over [`MONOMIALS`].
#[derive(Clone, Copy)]
struct Cubic([f64; 20]);

impl Cubic {
    fn linear([x, y, z, one]: [f64; 4]) -> Self {
        let mut c = [0.0; 20];
        (c[12], c[15], c[18], c[19]) = (x, y, z, one);
        Self(c)
    }

    fn scaled_sum(self, factor: f64, other: &Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + factor * other.0[k]))
    }

    fn times(&self, other: &Self) -> Self {
        let mut product = [0.0; 20];
        for (i, a) in self.0.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            for (j, b) in other.0.iter().enumerate().filter(|(_, b)| **b != 0.0) {
                product[PRODUCTS[i][j] as usize] += a * b;
            }
        }
        Self(product)
    }
}

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
    let zero = Cubic([0.0; 20]);
    let e: [[Cubic; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| Cubic::linear(std::array::from_fn(|k| basis[k][(i, j)]))));
    let product = |a: &Cubic, b: &Cubic| a.times(b);
    let mut gram = [[zero; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                gram[i][j] = gram[i][j].scaled_sum(1.0, &product(&e[i][k], &e[j][k]));
            }
        }
    }
    let trace = gram[0][0].scaled_sum(1.0, &gram[1][1]).scaled_sum(1.0, &gram[2][2]);
    for (i, row) in gram.iter_mut().enumerate() {
        row[i] = row[i].scaled_sum(-0.5, &trace);
    }
    let mut rows = Constraints::zeros();
    let mut put = |row: usize, c: &Cubic| {
        for k in 0..20 {
            rows[(row, k)] = c.0[k];
        }
    };
    for i in 0..3 {
        for j in 0..3 {
            let sum = (0..3).fold(zero, |sum, k| sum.scaled_sum(1.0, &product(&gram[i][k], &e[k][j])));
            put(3 * i + j, &sum);
        }
    }
    let minor = |a: usize, b: usize| product(&e[1][a], &e[2][b]).scaled_sum(-1.0, &product(&e[1][b], &e[2][a]));
    let determinant = product(&e[0][0], &minor(1, 2))
        .scaled_sum(-1.0, &product(&e[0][1], &minor(0, 2)))
        .scaled_sum(1.0, &product(&e[0][2], &minor(0, 1)));
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

/// Row a minus z times row b: coefficients, ascending in z, of what stands before x, y and 1.
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
    // Degrees eleven and twelve vanish by construction: the entries before x and y have degree three.
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
