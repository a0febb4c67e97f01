//! Eigenvalues and singular values of matrices with possibly non-finite entries.
//!
//! nalgebra iterates until its result converges, which a matrix that is not finite never does.

use nalgebra::allocator::Allocator;
use nalgebra::{Const, DefaultAllocator, DimDiff, DimSub, Matrix3, OMatrix, SVD, SymmetricEigen, U1};

/// Largest entry whose square is finite, with a margin for sums.
const LARGEST: f64 = 1e150;

/// Eigenvalues and eigenvectors of a symmetric matrix; `None` where an entry is not finite.
pub fn symmetric_eigen<D>(matrix: OMatrix<f64, D, D>) -> Option<SymmetricEigen<f64, D>>
where
    D: DimSub<U1>,
    DefaultAllocator: Allocator<D, D> + Allocator<D> + Allocator<DimDiff<D, U1>>,
{
    matrix.iter().all(|entry| entry.is_finite()).then(|| SymmetricEigen::new(matrix))
}

/// Singular value decomposition with U and Vᵀ; `None` where the square of an entry is not finite.
pub fn svd3(matrix: Matrix3<f64>) -> Option<SVD<f64, Const<3>, Const<3>>> {
    matrix.iter().all(|entry| entry.abs() <= LARGEST).then(|| matrix.svd(true, true))
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, Vector3};

    use super::*;

    #[test]
    fn matrices_that_are_not_finite_have_none() {
        for entry in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for k in 0..9 {
                let mut matrix = Matrix3::identity();
                matrix[k] = entry;
                assert!(symmetric_eigen(matrix).is_none() && svd3(matrix).is_none());
            }
        }
        assert!(svd3(Matrix3::repeat(1e200)).is_none());
        assert!(symmetric_eigen(SMatrix::<f64, 9, 9>::repeat(f64::NAN)).is_none());
    }

    #[test]
    fn finite_matrices_come_back() {
        for scale in [1e-100, 1.0, 1e140] {
            let matrix = Matrix3::new(2.0, 1.0, 0.0, 1.0, 3.0, -1.0, 0.0, -1.0, 1.0) * scale;
            let eigen = symmetric_eigen(matrix).unwrap();
            assert!((eigen.recompose() - matrix).norm() < 1e-12 * matrix.norm());
        }
        let matrix = Matrix3::from_diagonal(&Vector3::new(1e140, 3.0, 0.0));
        assert!((svd3(matrix).unwrap().recompose().unwrap() - matrix).norm() < 1e-12 * matrix.norm());
        assert!(symmetric_eigen(Matrix3::zeros()).is_some() && svd3(Matrix3::zeros()).is_some());
    }
}
