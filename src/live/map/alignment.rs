//! Alignment of a map with the last one, and registration of the frames that are not keyframes.

use nalgebra::Point3;

use super::Mapper;
use crate::math::{Sim3, centroid, median, umeyama};
use crate::scene::{Point3d, Reconstruction};

/// Fewest points that two maps must share to be aligned.
const MIN_SHARED: usize = 20;
/// Effective number of independent points among those that two maps share: errors of neighbors are correlated.
const INDEPENDENT: f64 = 20.0;

impl Mapper {
    /// Brings a map into the frame of the last one; a map that shares too little begins a new frame.
    pub(super) fn align(&mut self, model: &mut Reconstruction) -> bool {
        let found = self.last.as_ref().and_then(|last| alignment(model, last));
        match found {
            Some((last_from_model, variance)) => {
                model.transform(&last_from_model);
                self.held.drift += variance;
                true
            }
            None => {
                self.restart();
                false
            }
        }
    }
}

/// The similarity between two maps by the points that they share, and the variance of its logarithmic scale.
fn alignment(model: &Reconstruction, last: &Reconstruction) -> Option<(Sim3, f64)> {
    let shared = |point: &Point3d| {
        let before = point.track.iter().find_map(|element| {
            last.images.get(&element.image)?.observations.get(element.observation_idx as usize)?.point
        })?;
        Some((point.position, last.points.get(&before)?.position))
    };
    let mut pairs: Vec<(Point3<f64>, Point3<f64>)> = model.points.values().filter_map(shared).collect();
    let mut found = None;
    // Points far away have large errors: only those within three times the median residual are used.
    for _ in 0..4 {
        if pairs.len() < MIN_SHARED {
            return None;
        }
        let (from, to): (Vec<_>, Vec<_>) = pairs.iter().copied().unzip();
        let similarity = umeyama(&from, &to)?;
        let residual = |(from, to): &(Point3<f64>, Point3<f64>)| (similarity * *from - to).norm();
        let typical = median(pairs.iter().map(residual).collect())?;
        let center = centroid(&to);
        let spread = median(to.iter().map(|p| (p - center).norm()).collect())?;
        let count = (pairs.len() as f64).min(INDEPENDENT);
        found = Some((similarity, (typical / spread).powi(2) / count));
        pairs.retain(|pair| residual(pair) <= 3.0 * typical);
    }
    found.filter(|(similarity, variance)| similarity.scale.is_finite() && variance.is_finite())
}
