//! Homography from four or more correspondences.
//!
//! Normalised direct linear transform (Hartley, Zisserman, *Multiple View Geometry*, algorithm 4.2).

use nalgebra::{DMatrix, Matrix3, Vector2};

/// The homography with `b ~ H (a, 1)` in the least-squares sense; `None` for fewer than four pairs or degenerate ones.
pub fn homography_from_points(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    if from.len() < 4 || from.len() != to.len() {
        return None;
    }
    let (a, b) = (normalization(from)?, normalization(to)?);
    let mut gram = DMatrix::<f64>::zeros(9, 9);
    for (p, q) in from.iter().zip(to) {
        let (p, q) = (apply(&a, p), apply(&b, q));
        let rows = [
            [-p.x, -p.y, -1.0, 0.0, 0.0, 0.0, q.x * p.x, q.x * p.y, q.x],
            [0.0, 0.0, 0.0, -p.x, -p.y, -1.0, q.y * p.x, q.y * p.y, q.y],
        ];
        for row in rows {
            for i in 0..9 {
                for j in 0..9 {
                    gram[(i, j)] += row[i] * row[j];
                }
            }
        }
    }
    let eigen = gram.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    // A second vanishing eigenvalue: points on a line leave a family of solutions.
    if !(eigen.eigenvalues[order[1]] > 1e-12 * eigen.eigenvalues[order[8]]) {
        return None;
    }
    let h = Matrix3::from_fn(|i, j| eigen.eigenvectors[(3 * i + j, order[0])]);
    let h = b.try_inverse()? * h * a;
    let norm = h.norm();
    (norm.is_finite() && norm > 0.0).then(|| h / norm)
}

/// Moves the centroid to the origin and the mean distance to √2.
fn normalization(points: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let n = points.len() as f64;
    let mean = points.iter().sum::<Vector2<f64>>() / n;
    let spread = points.iter().map(|p| (p - mean).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / spread;
    s.is_finite().then(|| Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0))
}

fn apply(m: &Matrix3<f64>, p: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(m[(0, 0)] * p.x + m[(0, 2)], m[(1, 1)] * p.y + m[(1, 2)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_pairs_give_the_exact_homography() {
        let truth = Matrix3::new(1.1, 0.02, 30.0, -0.05, 0.9, -12.0, 1e-4, -2e-4, 1.0);
        let from: Vec<_> = [(0.0, 0.0), (500.0, 20.0), (480.0, 300.0), (10.0, 280.0), (200.0, 100.0)]
            .map(|(x, y)| Vector2::new(x, y))
            .to_vec();
        let image = |p: &Vector2<f64>| {
            let q = truth * p.push(1.0);
            Vector2::new(q.x / q.z, q.y / q.z)
        };
        let to: Vec<_> = from.iter().map(image).collect();
        for count in [4, 5] {
            let h = homography_from_points(&from[..count], &to[..count]).unwrap();
            assert!((h / h[(2, 2)] - truth).norm() < 1e-8);
        }
        let line: Vec<_> = (0..4).map(|i| Vector2::new(f64::from(i), f64::from(i))).collect();
        assert!(homography_from_points(&line, &line).is_none());
    }
}
