//! Homography and fundamental matrix from correspondences.
//!
//! Normalized direct linear transforms (Hartley, Zisserman, *Multiple View Geometry*, algorithms 4.2 and 11.1).

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::{svd3, symmetric_eigen};

type Row = SVector<f64, 9>;

/// The homography with `b ~ H (a, 1)` in the least-squares sense; `None` for fewer than four pairs or degenerate ones.
pub fn homography_from_points(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let (a, b) = normalizations(from, to, 4)?;
    let rows = from.iter().zip(to).flat_map(|(p, q)| {
        let (p, q) = (apply(&a, p), apply(&b, q));
        [
            [-p.x, -p.y, -1.0, 0.0, 0.0, 0.0, q.x * p.x, q.x * p.y, q.x].into(),
            [0.0, 0.0, 0.0, -p.x, -p.y, -1.0, q.y * p.x, q.y * p.y, q.y].into(),
        ]
    });
    let [homography] = null_matrices(rows)?;
    unit(b.try_inverse()? * homography * a)
}

/// The fundamental matrix with `(b, 1)ᵀ F (a, 1) = 0` in the least-squares sense, of rank two; `None` for fewer than
/// eight pairs or degenerate ones, as all points of a plane are.
pub fn fundamental_from_points(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let (a, b) = normalizations(from, to, 8)?;
    let rows = from.iter().zip(to).map(|(p, q)| epipolar_row(&apply(&a, p).push(1.0), &apply(&b, q).push(1.0)));
    let [fundamental] = null_matrices(rows)?;
    let mut svd = svd3(fundamental)?;
    let smallest = svd.singular_values.imin();
    svd.singular_values[smallest] = 0.0;
    unit(b.transpose() * svd.recompose().ok()? * a)
}

/// The N null vectors of rows of nine, in the least-squares sense, as row-major matrices, best first.
///
/// `None` if one more is equally good.
pub(crate) fn null_matrices<const N: usize>(rows: impl Iterator<Item = Row>) -> Option<[Matrix3<f64>; N]> {
    let gram = rows.fold(SMatrix::<f64, 9, 9>::zeros(), |gram, row| gram + row * row.transpose());
    let eigen = symmetric_eigen(gram)?;
    let mut order: [usize; 9] = std::array::from_fn(|i| i);
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    // One more vanishing eigenvalue: as of points on a line, which leave a family of solutions.
    let is_all = eigen.eigenvalues[order[N]] > 1e-12 * eigen.eigenvalues[order[8]];
    let matrix = |k: usize| Matrix3::from_fn(|i, j| eigen.eigenvectors[(3 * i + j, order[k])]);
    is_all.then(|| std::array::from_fn(matrix))
}

/// Coefficients of the nine elements of F in `secondᵀ F first`.
pub(crate) fn epipolar_row(first: &Vector3<f64>, second: &Vector3<f64>) -> Row {
    Row::from_fn(|i, _| second[i / 3] * first[i % 3])
}

fn unit(matrix: Matrix3<f64>) -> Option<Matrix3<f64>> {
    let norm = matrix.norm();
    (norm.is_finite() && norm > 0.0).then(|| matrix / norm)
}

fn normalizations(from: &[Vector2<f64>], to: &[Vector2<f64>], fewest: usize) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
    let enough = from.len() >= fewest && from.len() == to.len();
    enough.then(|| Some((normalization(from)?, normalization(to)?)))?
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

    #[test]
    fn exact_pairs_give_the_exact_fundamental_matrix() {
        let turn = nalgebra::Rotation3::from_euler_angles(0.1, -0.2, 0.05);
        let step = nalgebra::Vector3::new(1.0, 0.2, -0.1);
        let mut rng = crate::math::seeded_rng(3, 0);
        let mut number = || rand::Rng::random_range(&mut rng, -1.0..1.0);
        let points: Vec<_> = (0..8).map(|_| nalgebra::Vector3::new(number(), number(), 4.0 + number())).collect();
        let flat = |p: nalgebra::Vector3<f64>| Vector2::new(500.0 * p.x / p.z + 320.0, 500.0 * p.y / p.z + 240.0);
        let from: Vec<_> = points.iter().map(|p| flat(*p)).collect();
        let to: Vec<_> = points.iter().map(|p| flat(turn * p + step)).collect();
        let k = Matrix3::new(500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0).try_inverse().unwrap();
        let truth = k.transpose() * step.cross_matrix() * turn.matrix() * k;
        let found = fundamental_from_points(&from, &to).unwrap();
        let truth = truth / truth.norm() * truth.dot(&found).signum();
        assert!((found - truth).norm() < 1e-8, "{found} {truth}");
        assert!(fundamental_from_points(&from[..7], &to[..7]).is_none());
        let plane: Vec<_> = from.iter().map(|p| p * 0.5).collect();
        assert!(fundamental_from_points(&from, &plane).is_none());
    }
}
