//! Park et al.: a path of few low frequencies, their number by cross-validation.
//!
//! H. S. Park, T. Shiratori, I. Matthews, Y. Sheikh, *3D Reconstruction of a Moving Point from a Series of 2D
//! Projections*, ECCV 2010; *3D Trajectory Reconstruction under Perspective Projection*, IJCV 2015; the authors'
//! program. With u_i the unit vector from the camera to the reference point and Θ the first K cosines of the discrete
//! cosine transform at the frames' times, the path X = Θ β minimizes
//!
//! ```text
//! Σ |(I − u_i u_iᵀ)(Θ_i β − c_i)|²,
//! ```
//!
//! K has the least error of direction in ten-fold cross-validation, and r = Σ (X_i − c_i) · v_i / Σ |v_i|². The size of
//! v_i is not used before the last step: this is triangulation of a moving point. The authors' final refinement of the
//! reprojection error is left out: it determines the ratio of no sequence that the linear solution leaves open.
//!
//! **Assumption**: the vehicle's path consists of K low frequencies and the camera's does not. **Blind** where the
//! camera's path consists of the same.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::motion::{Motion, positive};
use crate::trajectory::ScaleError;

/// Parts of the cross-validation, as in the source.
const NUM_FOLDS: usize = 10;
/// Most basis vectors; the source tries as many as the equations allow, whose cost grows with the fourth power of the
/// frames. Cross-validation chose 2 to 7 of them on five rendered sequences.
const MAX_BASIS: usize = 16;

/// First cosines of the discrete cosine transform, at the times of the frames.
fn cosines(motion: &Motion, num: usize) -> DMatrix<f64> {
    let first = motion.times.first().copied().unwrap_or(0.0);
    let count = motion.times.last().map_or(1.0, |last| last - first + 1.0);
    DMatrix::from_fn(motion.len(), num, |row, k| match k {
        0 => (1.0 / count).sqrt(),
        _ => {
            let angle = (2.0 * (motion.times[row] - first) + 1.0) * k as f64 * std::f64::consts::PI / (2.0 * count);
            (2.0 / count).sqrt() * angle.cos()
        }
    })
}

/// r by triangulation of the reference point.
pub(super) fn ratio(motion: &Motion) -> Result<f64, ScaleError> {
    let frames = Rays::new(motion);
    let folds: Vec<Normal> = (0..NUM_FOLDS).map(|fold| frames.normal(fold)).collect();
    let mut all = folds[0].clone();
    folds[1..].iter().for_each(|fold| all.add(fold, 1.0));
    let error = |num: usize| -> Option<f64> {
        let of_fold = |(k, fold): (usize, &Normal)| {
            let mut rest = all.clone();
            rest.add(fold, -1.0);
            Some(frames.error(&rest.solution(num)?, k))
        };
        folds.iter().enumerate().map(of_fold).sum()
    };
    // Every coefficient needs an equation of the frames that are not held out.
    let most = (2 * (motion.len() - motion.len().div_ceil(NUM_FOLDS)) / 3).clamp(1, MAX_BASIS);
    let errors = (1..=most).filter_map(|num| Some((num, error(num)?)));
    let best = errors.min_by(|a, b| a.1.total_cmp(&b.1)).and_then(|(num, _)| all.solution(num));
    let path = best.ok_or(ScaleError::Undetermined("rays and basis leave the path open"))?;
    frames.ratio(motion, &path)
}

/// Rays from the cameras towards the reference point.
struct Rays {
    basis: DMatrix<f64>,
    /// Camera centers minus their mean.
    centers: Vec<Vector3<f64>>,
    directions: Vec<Vector3<f64>>,
}

/// Normal equations; unknown 3 k + axis is the coefficient of basis vector k.
#[derive(Clone)]
struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Rays {
    fn new(motion: &Motion) -> Self {
        Self {
            basis: cosines(motion, MAX_BASIS),
            centers: super::ozden_independence::centered(&motion.centers),
            directions: motion.offsets.iter().map(Vector3::normalize).collect(),
        }
    }

    /// r of a path.
    fn ratio(&self, motion: &Motion, coefficients: &DVector<f64>) -> Result<f64, ScaleError> {
        let (mut along, mut squares) = (0.0, 0.0);
        for (k, offset) in motion.offsets.iter().enumerate() {
            along += self.position_relative_to_camera(coefficients, k).dot(offset);
            squares += offset.norm_squared();
        }
        positive(along / squares)
    }

    fn of_fold(&self, fold: usize) -> impl Iterator<Item = usize> {
        (fold..self.centers.len()).step_by(NUM_FOLDS)
    }

    /// Normal equations of the frames of one fold.
    fn normal(&self, fold: usize) -> Normal {
        let mut normal = Normal::zeros(MAX_BASIS);
        for frame in self.of_fold(fold) {
            let across = across(&self.directions[frame]);
            normal.add_frame(&self.basis, frame, &across, &(across * self.centers[frame]));
        }
        normal
    }

    /// From the camera of a frame to the path.
    fn position_relative_to_camera(&self, coefficients: &DVector<f64>, frame: usize) -> Vector3<f64> {
        let num = coefficients.len() / 3;
        let terms = (0..num).map(|k| self.basis[(frame, k)] * coefficients.fixed_rows::<3>(3 * k));
        terms.sum::<Vector3<f64>>() - self.centers[frame]
    }

    /// Σ of the squared angles between the rays of a fold and a path.
    fn error(&self, coefficients: &DVector<f64>, fold: usize) -> f64 {
        let angle = |frame: usize| {
            let towards = self.position_relative_to_camera(coefficients, frame);
            let direction = self.directions[frame];
            towards.cross(&direction).norm().atan2(towards.dot(&direction))
        };
        self.of_fold(fold).map(|frame| angle(frame).powi(2)).sum()
    }
}

/// Projection across a direction.
fn across(unit: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() - unit * unit.transpose()
}

impl Normal {
    fn zeros(num_basis: usize) -> Self {
        let size = 3 * num_basis;
        Self { matrix: DMatrix::zeros(size, size), right: DVector::zeros(size) }
    }

    /// Adds an equation of a frame's position.
    fn add_frame(&mut self, basis: &DMatrix<f64>, frame: usize, matrix: &Matrix3<f64>, right: &Vector3<f64>) {
        let num = self.right.len() / 3;
        for row in 0..num {
            let weight = basis[(frame, row)];
            let mut part = self.right.fixed_rows_mut::<3>(3 * row);
            part += weight * right;
            for column in 0..num {
                let mut block = self.matrix.view_mut((3 * row, 3 * column), (3, 3));
                block += weight * basis[(frame, column)] * matrix;
            }
        }
    }

    fn add(&mut self, other: &Self, factor: f64) {
        self.matrix += factor * &other.matrix;
        self.right += factor * &other.right;
    }

    /// Coefficients of the first `num` basis vectors; `None` where the equations leave them open.
    fn solution(&self, num: usize) -> Option<DVector<f64>> {
        let size = 3 * num;
        let matrix = self.matrix.view((0, 0), (size, size)).into_owned();
        let right = self.right.rows(0, size).into_owned();
        let found = matrix.cholesky()?.solve(&right);
        found.iter().all(|number| number.is_finite()).then_some(found)
    }
}
