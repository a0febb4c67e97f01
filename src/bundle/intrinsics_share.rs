//! Contribution of the intrinsics to the uncertainty of camera centers.
//!
//! An error δθ of the intrinsics displaces all centers jointly by J δθ, with J = Cov(c, θ) Cov(θ)⁻¹ from the adjustment
//! in which both are free (eq. 16). A similarity of the whole trajectory does not count as an error. Therefore the
//! least-squares similarity is subtracted from every column of J. With P the projector that does this, the contribution
//! to a center's covariance is P J Σ_θ Jᵀ Pᵀ.

use nalgebra::{DMatrix, Matrix3, Point3, Vector3};

use super::clustered::Groups;
use super::covariance::System;
use super::layout::{Layout, NONE};
use super::options::Options;
use super::problem::{BundleError, Problem};
use crate::math::centroid;

/// Covariances of the centers of all poses caused by the free intrinsics of a problem, with Σ_θ = Cov(θ).
///
/// Zero for poses that do not depend on them.
///
/// # Errors
/// As [`super::covariances`].
pub(super) fn intrinsics_share(problem: &Problem, options: &Options) -> Result<Vec<Matrix3<f64>>, BundleError> {
    let layout = Layout::new(problem, options, false);
    let mut system = System::new(problem, options, &layout, false, &Groups::default())?;
    let rows: Vec<usize> = (0..problem.cameras.len()).filter_map(|k| system.rows_of_camera(k)).flatten().collect();
    let (columns, own) = system.inverse(&rows);
    let (size, count) = (system.size, rows.len());
    let information = own.cholesky().ok_or(BundleError::Singular { pivot: size - count })?.inverse();
    let mut moved: Vec<Vec<Vector3<f64>>> =
        (0..count).map(|k| system.moved_centers(&columns[k * size..(k + 1) * size])).collect();
    let centers: Vec<Point3<f64>> = problem.poses.iter().map(|pose| pose.cam_from_world.center()).collect();
    moved.iter_mut().for_each(|column| subtract_similarity(&centers, column));
    let of_pose = |pose: usize| {
        let by = |r: usize, c: usize| moved[r][pose] * moved[c][pose].transpose() * information[(r, c)];
        (0..count).flat_map(|r| (0..count).map(move |c| (r, c))).map(|(r, c)| by(r, c)).sum()
    };
    Ok((0..centers.len()).map(of_pose).collect())
}

impl System<'_> {
    /// Displacement of each pose's center, c' = c − Rᵀ v, for a step of the reduced system.
    fn moved_centers(&self, step: &[f64]) -> Vec<Vector3<f64>> {
        let moved = |(pose, block): (&super::PoseBlock, &u32)| {
            if *block == NONE {
                return Vector3::zeros();
            }
            let block = *block as usize;
            let mask = &self.layout.pose_mask[block];
            let v = Vector3::from_fn(|k, _| if mask[3 + k] { step[block * self.dim + 3 + k] } else { 0.0 });
            -(pose.cam_from_world.rotation.inverse() * v)
        };
        self.problem.poses.iter().zip(&self.layout.block_of_pose).map(moved).collect()
    }
}

/// Subtracts the least-squares infinitesimal similarity from displacements of centers.
fn subtract_similarity(centers: &[Point3<f64>], steps: &mut [Vector3<f64>]) {
    let count = centers.len().max(1) as f64;
    let middle = centroid(centers);
    let mean = steps.iter().sum::<Vector3<f64>>() / count;
    let arm = |k: usize| centers[k] - middle;
    // Rotation vector and change of scale: d = ω × a + s a.
    let basis = |a: Vector3<f64>| [Vector3::x().cross(&a), Vector3::y().cross(&a), Vector3::z().cross(&a), a];
    let (mut normal, mut right) = (DMatrix::<f64>::zeros(4, 4), DMatrix::<f64>::zeros(4, 1));
    for (k, step) in steps.iter_mut().enumerate() {
        *step -= mean;
        let basis = basis(arm(k));
        for r in 0..4 {
            right[(r, 0)] += basis[r].dot(step);
            (0..4).for_each(|c| normal[(r, c)] += basis[r].dot(&basis[c]));
        }
    }
    // The rotation about a straight trajectory is undetermined: the pseudoinverse sets it to zero.
    let tolerance = 1e-9 * normal.trace();
    let Ok(inverse) = normal.pseudo_inverse(tolerance) else { return };
    let found = inverse * right;
    for (k, step) in steps.iter_mut().enumerate() {
        let basis = basis(arm(k));
        *step -= (0..4).map(|r| basis[r] * found[(r, 0)]).sum::<Vector3<f64>>();
    }
}
