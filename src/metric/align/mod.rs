//! Alignment of a camera trajectory to a receiver's fixes.
//!
//! Unknown are the similarity `metric_from_world` and the time offset δ between log and video. A fix at time τ of the
//! log's clock shows
//!
//! `p = s R (c(τ − δ) − c̄) + m + b(τ) + e`
//!
//! with the camera's centre c, its mean c̄, a correlated bias b (a Gauss–Markov process, part of the covariance and not
//! a parameter) and noise e that is independent between fixes. The solution is generalised least squares over
//! (log s, R, m, δ), with priors on the vertical, the camera's attitude and the offset as further observations;
//! `docs/maths/metric.md`, eqs. 1–5.
//!
//! Fixes that jump are detected by their residuals against the other fixes and downweighted. Parameters that the motion
//! does not determine keep a large standard deviation: in a straight flight only the vertical determines the roll, and
//! hovering does not determine the scale. A log of another flight is rejected: [`Refusal`].

pub(super) mod covariance;
#[cfg(test)]
mod flights;
mod refine;
mod search;
mod start;
#[cfg(test)]
mod tests;

use nalgebra::{Point3, SMatrix, UnitQuaternion, Vector3};

use super::fix::distinct;
use super::{CameraPath, Kind, PositionFix, Source};
use crate::math::Sim3;

/// Prior on the offset between the log's clock and the video's: log = video + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Offset {
    /// The log was written with the video, or clocks were compared.
    Known {
        /// Seconds.
        mean_s: f64,
        /// Standard deviation, seconds.
        std_s: f64,
    },
    /// No prior: all offsets at which log and video overlap are searched.
    Unknown,
}

impl Offset {
    /// Prior for a log inside the video or in its subtitles: the latency of receivers.
    pub const SAME_FILE: Self = Self::Known { mean_s: 0.0, std_s: 0.2 };
    /// Prior for a log whose times count from its own beginning: both recordings were started by hand.
    pub const TWO_BUTTONS: Self = Self::Known { mean_s: 0.0, std_s: 2.0 };
}

/// Vertical in the frame of the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    /// Unit vector.
    pub up_in_world: Vector3<f64>,
    /// Standard deviation of its tilt, radians.
    pub std: f64,
}

/// Rotation of the background's frame, from the camera's attitude in a log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// East, north, up from the background's axes.
    pub metric_from_world: UnitQuaternion<f64>,
    /// Standard deviation of the tilt, radians.
    pub tilt_std: f64,
    /// Standard deviation of north, radians.
    pub heading_std: f64,
}

/// Priors of the alignment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Support {
    /// Time between the clocks.
    pub offset: Offset,
    /// The vertical.
    pub gravity: Option<Gravity>,
    /// The camera's attitude.
    pub orientation: Option<Orientation>,
}

/// Number of parameters: log s, rotation (3), position of c̄ (3), time offset.
pub(super) const NUM_PARAMETERS: usize = 8;

/// Covariance of log s, rotation vector (axes east, north, up; radians), and the position of
/// [`Alignment::anchor_in_world`] (metres).
pub type Covariance = SMatrix<f64, 7, 7>;

/// Alignment of a path to its fixes.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// Metres east, north, up from units of the background.
    pub metric_from_world: Sim3,
    /// Mean of the path: the point at which `covariance` is taken.
    pub anchor_in_world: Point3<f64>,
    /// Covariance.
    pub covariance: Covariance,
    /// Log = video + this, seconds.
    pub offset_s: f64,
    /// Its standard deviation, seconds.
    pub offset_std_s: f64,
    /// Fixes in the time of the video.
    pub num_fixes: usize,
    /// Share of them that are rejected as jumps.
    pub rejected_share: f64,
    /// Estimated over stated standard deviation of the independent noise of a fix, horizontal.
    pub noise_factor: f64,
}

impl Alignment {
    /// Standard deviation of log s: that of the metres per unit as a share of them.
    pub fn log_scale_std(&self) -> f64 {
        self.covariance[(0, 0)].sqrt()
    }

    /// Meters per unit by the alignment.
    pub fn source(&self, name: &str, kind: Kind) -> Source {
        let (log_scale, std) = (self.metric_from_world.scale.ln(), self.log_scale_std());
        Source { name: name.to_owned(), kind, log_scale, std }
    }

    /// Standard deviation of up, radians.
    pub fn tilt_std(&self) -> f64 {
        (0.5 * (self.covariance[(1, 1)] + self.covariance[(2, 2)])).sqrt()
    }

    /// Standard deviation of north, radians.
    pub fn heading_std(&self) -> f64 {
        self.covariance[(3, 3)].sqrt()
    }
}

/// Reason why fixes give no metric scale.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Too few fixes in the time of the video.
    #[error(
        "{num} of the log's {of} distinct positions are within the time of the video, at least {least} needed: log of \
         another flight, or a clock in another time zone",
        least = MIN_FIXES
    )]
    NoOverlap {
        /// Number of fixes in it.
        num: usize,
        /// Number of fixes.
        of: usize,
    },
    /// Too few fixes to estimate the clock offset.
    #[error(
        "clock offset unknown: estimating it needs {least} positions within the time of the video, found {num}; give \
         --time-offset",
        least = MIN_FIXES_FOR_OFFSET
    )]
    TooFewForOffset {
        /// Number of fixes in it.
        num: usize,
    },
    /// The camera hardly moved, by the receiver's measure.
    #[error(
        "camera moved too little: meters per unit would be known to {percent:.0} % only (path of {extent_m:.1} m, \
         receiver error {std_m:.1} m)"
    )]
    Motionless {
        /// Standard deviation of the scale, per cent.
        percent: f64,
        /// Diagonal of the box round the fixes, metres.
        extent_m: f64,
        /// Standard deviation of a fix, metres.
        std_m: f64,
    },
    /// The fixes do not follow the path.
    #[error(
        "log and video show different motion: {rejected_percent:.0} % of the positions are outliers, the others \
         deviate {noise_factor:.1} times as much as expected"
    )]
    AnotherMotion {
        /// Share of outliers, per cent.
        rejected_percent: f64,
        /// Estimated over stated standard deviation.
        noise_factor: f64,
    },
    /// Two offsets fit equally well.
    #[error("clock offset ambiguous: {offset_s:.1} s and {other_s:.1} s fit equally well; give --time-offset")]
    Ambiguous {
        /// The better one, seconds.
        offset_s: f64,
        /// The other one, seconds.
        other_s: f64,
    },
}

/// Minimum number of fixes; fewer leave no redundancy to check the fit.
const MIN_FIXES: usize = 4;

/// Minimum number of fixes to estimate the offset. With fewer a wrong offset fits as well as the right one, at a small
/// standard deviation of its scale: six fixes of a receiver with drift gave scales up to half as large again.
const MIN_FIXES_FOR_OFFSET: usize = 8;

/// Aligns a camera path to fixes.
///
/// # Errors
/// [`Refusal`] gives the reason why the fixes do not determine the scale.
pub fn align_to_fixes(path: &CameraPath, fixes: &[PositionFix], support: &Support) -> Result<Alignment, Refusal> {
    let fixes = distinct(fixes);
    let starts = search::starts(path, &fixes, support);
    let mut found: Vec<refine::Refined> =
        starts.iter().filter_map(|start| refine::refine(path, &fixes, support, start)).collect();
    found.sort_by(|a, b| a.badness().total_cmp(&b.badness()));
    let Some(least) = found.first().map(refine::Refined::badness) else {
        let num = search::most_overlapping(path, &fixes, support.offset);
        return Err(Refusal::NoOverlap { num, of: fixes.len() });
    };
    found.retain(|fit| fit.badness() <= least + fit.badness_by_chance());
    // Among equally good fits, the one with the most inliers wins. The sort is stable: among equal ones, the best.
    found.sort_by_key(|fit| std::cmp::Reverse(fit.alignment.num_fixes));
    let [fit, others @ ..] = &found[..] else { return Err(Refusal::NoOverlap { num: 0, of: 0 }) };
    judge(fit, &fixes)?;
    let best = &fit.alignment;
    if support.offset == Offset::Unknown && best.num_fixes < MIN_FIXES_FOR_OFFSET {
        return Err(Refusal::TooFewForOffset { num: best.num_fixes });
    }
    if let Some(other) = others.iter().map(|other| &other.alignment).find(|other| contradicts(best, other)) {
        return Err(Refusal::Ambiguous { offset_s: best.offset_s, other_s: other.offset_s });
    }
    Ok(best.clone())
}

/// Accepts or rejects a fit.
fn judge(fit: &refine::Refined, fixes: &[PositionFix]) -> Result<(), Refusal> {
    let best = &fit.alignment;
    // If a third of the fixes are outliers, or all residuals are this large, the alignment is wrong and not the fixes.
    if best.rejected_share > 0.34 || best.noise_factor > 3.0 {
        let rejected_percent = 100.0 * best.rejected_share;
        return Err(Refusal::AnotherMotion { rejected_percent, noise_factor: best.noise_factor });
    }
    let log_scale_std = best.log_scale_std();
    // A scale known to a quarter at best is undetermined: first-order arithmetic with logarithms is invalid beyond.
    if !(log_scale_std <= 0.25) {
        let percent = (100.0 * log_scale_std).min(999.0);
        let std_m = fixes.iter().map(|fix| fix.horizontal_std_m).fold(f64::INFINITY, f64::min);
        return Err(Refusal::Motionless { percent, extent_m: fit.extent_m, std_m });
    }
    Ok(())
}

/// Another fit with as many inliers as this one, at another offset.
fn contradicts(best: &Alignment, other: &Alignment) -> bool {
    let apart_s = (other.offset_s - best.offset_s).abs();
    let std_s = best.offset_std_s.hypot(other.offset_std_s);
    // The other fit is as good if it has at least this share of the inliers.
    other.num_fixes as f64 >= 0.9 * best.num_fixes as f64 && apart_s > 3.0 * std_s + 1.0
}
