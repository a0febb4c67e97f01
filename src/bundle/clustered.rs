//! Covariance of camera centres where observations err together.

use nalgebra::{Matrix3, Vector3};

use super::covariance::System;
use super::layout::{Layout, NONE};
use super::levenberg_marquardt::with_threads;
use super::options::Options;
use super::problem::{BundleError, Problem};

/// Covariances of camera centres where observations err together within groups of points: with the scores s_g = Σ Jᵀ (r
/// − Q z) of the reduced system over the points of each, S⁻¹ (Σ s_g s_gᵀ) S⁻¹ (the sandwich of P. Huber, *The behavior
/// of maximum likelihood estimates under nonstandard conditions*, 1967; eq. 18). Residuals count as they are, whatever
/// the noise is believed to be.
///
/// * `group_of_point` – by point of the problem: its group, below `num_groups`.
///
/// # Errors
/// As [`covariances`].
pub(super) fn clustered_centers(
    problem: &Problem,
    options: &Options,
    poses: &[usize],
    group_of_point: &[usize],
    num_groups: usize,
) -> Result<Vec<Matrix3<f64>>, BundleError> {
    with_threads(options.threads, |parallel| {
        let layout = Layout::new(problem, options, parallel);
        match layout.largest_block() {
            ..=6 => System::<6>::new(problem, options, &layout, parallel)?.clustered(poses, group_of_point, num_groups),
            7..=9 => {
                System::<9>::new(problem, options, &layout, parallel)?.clustered(poses, group_of_point, num_groups)
            }
            _ => System::<12>::new(problem, options, &layout, parallel)?.clustered(poses, group_of_point, num_groups),
        }
    })?
}

impl<const D: usize> System<'_, D> {
    fn clustered(
        mut self,
        poses: &[usize],
        group_of_point: &[usize],
        num_groups: usize,
    ) -> Result<Vec<Matrix3<f64>>, BundleError> {
        let scores = self.scores(group_of_point, num_groups);
        poses.iter().map(|pose| self.clustered_center(*pose, &scores)).collect()
    }

    /// Σ Jᵀ (r − Q z) over the observations of each group's points, less their mean, which is 0 at the minimum.
    fn scores(&self, group_of_point: &[usize], num_groups: usize) -> Vec<Vec<f64>> {
        let mut scores = vec![vec![0.0; self.reduced.size()]; num_groups];
        let mut one = self.one_point();
        for place in 0..self.layout.points.len() {
            self.work_out(&mut one, place);
            let score = &mut scores[group_of_point[self.layout.points[place] as usize]];
            let z = Vector3::from(one.terms.half_step);
            let seen = self.layout.obs_of_point(place).zip(&one.residuals);
            for (o, residual) in seen.filter(|(o, _)| self.layout.obs_block[*o] != NONE) {
                let first = self.layout.obs_block[o] as usize * D;
                for row in 0..2 {
                    let left = residual.value[row] - Vector3::from(residual.eliminated[row]).dot(&z);
                    for (k, d) in residual.d_view[row].iter().enumerate() {
                        score[first + k] += d * left;
                    }
                }
            }
        }
        let size = self.reduced.size();
        let mean: Vec<f64> =
            (0..size).map(|k| scores.iter().map(|score| score[k]).sum::<f64>() / num_groups.max(1) as f64).collect();
        scores.iter_mut().for_each(|score| score.iter_mut().zip(&mean).for_each(|(s, mean)| *s -= mean));
        scores
    }

    fn clustered_center(&mut self, pose: usize, scores: &[Vec<f64>]) -> Result<Matrix3<f64>, BundleError> {
        let block = self.layout.block_of_pose.get(pose).copied().unwrap_or(NONE);
        if block == NONE {
            return Err(BundleError::NoCovariance { what: "pose", index: pose });
        }
        let (size, first) = (self.reduced.size(), block as usize * D + 3);
        let mut columns = vec![0.0; size * 3];
        for k in 0..3 {
            columns[k * size + first + k] = 1.0;
        }
        self.solver.solve_columns(&mut columns);
        let mask = &self.layout.pose_mask[block as usize];
        let shift = |score: &Vec<f64>, k: usize| -> f64 {
            if !mask[3 + k] {
                return 0.0;
            }
            columns[k * size..(k + 1) * size].iter().zip(score).map(|(a, b)| a * b).sum()
        };
        let mut sum = Matrix3::zeros();
        for score in scores {
            let shift = Vector3::from_fn(|k, _| shift(score, k));
            sum += shift * shift.transpose();
        }
        let world_from_cam =
            self.problem.poses[pose].cam_from_world.rotation.inverse().to_rotation_matrix().into_inner();
        Ok(world_from_cam * sum * world_from_cam.transpose())
    }
}
