//! Meters per unit by one vehicle: a mixture over the segments of its class (docs/maths/metric.md, eq. 8).

use nalgebra::{DMatrix, DVector};

use super::segments::{self, Segment};
use super::{Extent, SHARED_BY_PLACE, SHARED_BY_VEHICLE, UNCONFIRMED};

/// Joint estimate from the extents of one vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct SizeEstimate {
    /// Id of the vehicle.
    pub(super) vehicle: u32,
    /// Logarithm of metres per unit.
    pub(super) log_scale: f64,
    /// Its standard deviation, without the common part of all vehicles of a location and without [`UNCONFIRMED`].
    pub(super) std: f64,
    /// True if nothing confirms its measurement: no proportions, or an unconfirmed trajectory.
    pub(super) is_unconfirmed: bool,
    /// Number of known extents.
    pub(super) num_extents: usize,
    /// Distance of its proportions from those of the nearest segment, standard deviations.
    pub(super) misfit: f64,
}

impl SizeEstimate {
    /// The part of its standard deviation that all unconfirmed vehicles have in common.
    pub(super) fn common_std(&self) -> f64 {
        if self.is_unconfirmed { UNCONFIRMED } else { 0.0 }
    }

    /// Standard deviation of this vehicle alone.
    pub(super) fn total_std(&self) -> f64 {
        self.std.hypot(self.common_std())
    }
}

/// Likelihood of the extents under one segment.
struct Member {
    log_weight: f64,
    log_scale: f64,
    variance: f64,
    chi2: f64,
}

/// Estimate of one vehicle; `None` without extents. All extents are positive and finite.
pub(super) fn answer(extents: &[Extent]) -> Option<SizeEstimate> {
    let first = extents.first()?;
    let members: Vec<Member> = segments::of(first.class).iter().filter_map(|s| member(s, extents)).collect();
    let highest = members.iter().map(|m| m.log_weight).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = members.iter().map(|m| (m.log_weight - highest).exp()).collect();
    let total: f64 = weights.iter().sum();
    let mean = |value: &dyn Fn(&Member) -> f64| -> f64 {
        members.iter().zip(&weights).map(|(m, weight)| weight / total * value(m)).sum()
    };
    let log_scale = mean(&|m| m.log_scale);
    let spread = mean(&|m| m.variance + (m.log_scale - log_scale).powi(2));
    let chi2 = members.iter().map(|m| m.chi2).fold(f64::INFINITY, f64::min);
    let freedom = extents.len().saturating_sub(1).max(1) as f64;
    // Proportions that differ by more than their standard deviations widen the estimate (Birge).
    let variance = spread * (chi2 / freedom).max(1.0) + first.ratio_std.powi(2);
    let num_extents = extents.len();
    let answer = SizeEstimate {
        vehicle: first.vehicle,
        log_scale,
        std: variance.sqrt(),
        is_unconfirmed: num_extents == 1 || first.is_unconfirmed,
        num_extents,
        misfit: chi2.sqrt(),
    };
    [answer.log_scale, answer.std, answer.misfit].iter().all(|x| x.is_finite()).then_some(answer)
}

/// Probability that a vehicle labeled as a large one is a car, by its extents and the meters per unit of other sources
/// (logarithm and standard deviation).
pub(super) fn probability_of_car(extents: &[Extent], known: Option<(f64, f64)>) -> f64 {
    let Some(first) = extents.first() else { return 0.0 };
    let unconfirmed = if extents.len() == 1 || first.is_unconfirmed { UNCONFIRMED } else { 0.0 };
    let own = first.ratio_std.powi(2) + unconfirmed.powi(2);
    let log_weight = |member: &Member| {
        let of_scale = known.map_or(0.0, |(log_scale, std)| {
            let variance = member.variance + own + std.powi(2) + SHARED_BY_PLACE.powi(2);
            (member.log_scale - log_scale).powi(2) / variance + variance.ln()
        });
        member.log_weight - 0.5 * of_scale
    };
    let log_weights = |segments: &[Segment]| -> Vec<f64> {
        segments.iter().filter_map(|segment| member(segment, extents)).map(|member| log_weight(&member)).collect()
    };
    let [all, cars] = [segments::of(first.class), segments::cars_among(first.class)].map(log_weights);
    let highest = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let total = |weights: &[f64]| weights.iter().map(|weight| (weight - highest).exp()).sum::<f64>();
    total(&cars) / total(&all)
}

/// Generalised least squares with one unknown.
fn member(segment: &Segment, extents: &[Extent]) -> Option<Member> {
    let n = extents.len();
    let spread = |k: usize| segment.spread[extents[k].dimension.index()];
    let logs = DVector::from_fn(n, |k, _| segment.median_m[extents[k].dimension.index()].ln() - extents[k].value.ln());
    let covariance = DMatrix::from_fn(n, n, |j, k| {
        let shared = SHARED_BY_VEHICLE * spread(j) * spread(k);
        let own = (1.0 - SHARED_BY_VEHICLE) * spread(j).powi(2) + (extents[j].std / extents[j].value).powi(2);
        if j == k { shared + own } else { shared }
    });
    let cholesky = covariance.cholesky()?;
    let weights = cholesky.solve(&DVector::repeat(n, 1.0));
    let information = weights.sum();
    let log_scale = weights.dot(&logs) / information;
    let residuals = logs.add_scalar(-log_scale);
    let chi2 = residuals.dot(&cholesky.solve(&residuals)).max(0.0);
    let log_determinant: f64 = cholesky.l_dirty().diagonal().iter().map(|d| 2.0 * d.ln()).sum();
    let log_weight = segment.share.ln() - 0.5 * (chi2 + log_determinant + information.ln());
    (information > 0.0).then_some(Member { log_weight, log_scale, variance: information.recip(), chi2 })
}
