//! Covariance of camera centers under errors correlated within groups of observations.
//!
//! With the scores s_g = Σ Jᵀ (r − Q z) of the reduced system over the points of each group g, the covariance is
//! S⁻¹ (Σ s_g s_gᵀ) S⁻¹ (the sandwich of P. Huber, *The behavior of maximum likelihood estimates under nonstandard
//! conditions*, 1967; eq. 18). It uses the actual residuals, whatever noise is assumed.

use nalgebra::{Matrix3, Vector3};

use super::covariance::System;
use super::layout::NONE;
use super::one_point::OnePoint;
use super::piece::Pass;
use super::problem::BundleError;
use super::simd::Two;
use super::state::State;

/// Groups of points within which observation errors are correlated.
#[derive(Default)]
pub(super) struct Groups {
    /// Group of each point of the problem.
    pub of_point: Vec<usize>,
    /// Number of groups.
    pub count: usize,
}

/// Σ Jᵀ (r − Q z) over the observations of each group's points, minus their mean, which is 0 at the minimum.
///
/// * `size` – number of unknowns of the reduced system.
pub(super) fn scores<const D: usize>(pass: &Pass, state: &State, groups: &Groups, size: usize) -> Vec<Vec<f64>> {
    let layout = pass.layout;
    let mut scores = vec![vec![0.0; size]; groups.count];
    if scores.is_empty() {
        return scores;
    }
    let mut one = OnePoint::<D>::new(layout, 0..layout.points.len());
    for place in 0..layout.points.len() {
        one.work_out::<Two>(pass, state, place, 0.0);
        let score = &mut scores[groups.of_point[layout.points[place] as usize]];
        let z = Vector3::from(one.terms.half_step);
        let seen = layout.obs_of_point(place).zip(&one.residuals);
        for (o, residual) in seen.filter(|(o, _)| layout.obs_block[*o] != NONE) {
            let first = layout.obs_block[o] as usize * D;
            for row in 0..2 {
                let left = residual.value[row] - Vector3::from(residual.eliminated[row]).dot(&z);
                for (k, d) in residual.d_view[row].iter().enumerate() {
                    score[first + k] += d * left;
                }
            }
        }
    }
    let mean: Vec<f64> =
        (0..size).map(|k| scores.iter().map(|score| score[k]).sum::<f64>() / groups.count as f64).collect();
    scores.iter_mut().for_each(|score| score.iter_mut().zip(&mean).for_each(|(s, mean)| *s -= mean));
    scores
}

impl System<'_> {
    /// Covariance of a camera center from the scores of the groups of points.
    pub fn clustered_center(&mut self, pose: usize) -> Result<Matrix3<f64>, BundleError> {
        let block = self.block_of_pose(pose)?;
        let (size, first) = (self.size, block * self.dim + 3);
        let (columns, _) = self.inverse(&[first, first + 1, first + 2]);
        let mask = &self.layout.pose_mask[block];
        let shift = |score: &Vec<f64>, k: usize| -> f64 {
            if !mask[3 + k] {
                return 0.0;
            }
            columns[k * size..(k + 1) * size].iter().zip(score).map(|(a, b)| a * b).sum()
        };
        let mut sum = Matrix3::zeros();
        for score in &self.scores {
            let shift = Vector3::from_fn(|k, _| shift(score, k));
            sum += shift * shift.transpose();
        }
        let world_from_cam = self.world_from_cam(pose);
        Ok(world_from_cam * sum * world_from_cam.transpose())
    }
}
