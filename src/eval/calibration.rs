//! Calibration of reported standard deviations: many runs, the error of each in its own standard deviations.
//!
//! The error of a run is ln(r / r_ref), which is the relative error where it is small and treats "half as large" and
//! "twice as large" alike; the stated deviation is std / r. If deviations are those of a normal distribution, 68.3 % of
//! the errors lie within one of them, 95.4 % within two, 99.7 % within three. A share over n cases has an interval of
//! its own (Wilson, 95 %). Cases of one sequence have errors in common, so that the true interval is wider.
//!
//! Runs that say themselves that the ratio is undetermined state no deviation: they are counted, not judged.

use serde::{Deserialize, Serialize};

use super::figures::Evaluation;
use super::spread::Spread;
use crate::math::median;
use crate::scene::{ObjectTrajectory, Trust};

/// Result of a calibration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Version of this format.
    pub version: u32,
    /// Version of the program.
    pub program: String,
    /// The command line.
    pub arguments: Vec<String>,
    /// Every run, in the order of sequences and variants.
    pub cases: Vec<Case>,
    /// Vehicles of real clips in two runs, in the order of clips and variants.
    #[serde(default)]
    pub spreads: Vec<Spread>,
}

/// One run of one sequence in one variant.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Name of the sequence's folder.
    pub sequence: String,
    /// Name of the variant.
    pub variant: String,
    /// Quantity that the variant changes; variants of one kind differ in `level` alone.
    pub kind: String,
    /// By how much.
    pub level: f64,
    /// ln(r / r_ref); `None` where there is no ratio or no reference.
    pub error: Option<f64>,
    /// std / r as the run states it.
    pub relative_std: Option<f64>,
    /// True if the run marks the ratio as undetermined.
    pub degenerate: bool,
    /// The run's verdict on the trajectory.
    pub verdict: Option<Trust>,
    /// Mean trajectory error, metres.
    pub trajectory_error_m: Option<f64>,
    /// Frames in which the target has a place.
    pub num_placed: usize,
    /// Frames in which it is seen.
    pub num_visible: usize,
    /// Median over the frames of the longer side of the target's mask, pixels.
    pub object_px: Option<f64>,
    /// Largest less least height of the camera over the target, as a share of the mean.
    pub climb: Option<f64>,
    /// Mean error of a stationary vehicle's points seen by the background's cameras, as a share of its distance;
    /// `None` for other vehicles.
    #[serde(default)]
    pub residual: Option<f64>,
    /// Why there is no error, where there is none.
    pub failure: Option<String>,
}

impl Case {
    /// Fills in what the evaluation of a run says.
    pub fn with_evaluation(self, evaluation: &Evaluation, verdict: Option<Trust>) -> Self {
        let scale = evaluation.scale.as_ref();
        let reference = evaluation.reference_scale.as_ref();
        let found = scale.ok().zip(reference.ok());
        let ratio = scale.ok().map(|scale| scale.ratio);
        Self {
            error: found.map(|(scale, reference)| (scale.ratio / reference.ratio).ln()).filter(|e| e.is_finite()),
            relative_std: scale.ok().and_then(|scale| Some(scale.std? / ratio?)).filter(|std| std.is_finite()),
            degenerate: scale.is_ok_and(|scale| scale.degenerate),
            verdict,
            trajectory_error_m: evaluation.trajectory.as_ref().ok().map(|error| error.mean_m),
            num_placed: evaluation.registered.num_both,
            num_visible: evaluation.registered.num_visible,
            failure: scale.err().or(reference.err()).map(str::to_owned),
            ..self
        }
    }

    /// A stationary vehicle of a clip: its ratio by the camera path is the reference of the ratio without it, with the
    /// standard deviations of both. `None` where the run has no ratio by the camera path.
    pub fn of_stationary(clip: &str, variant: &str, vehicle: &ObjectTrajectory) -> Option<Self> {
        let path = vehicle.scale.camera_path?;
        let std = path.std_without.map(|std| (std / path.ratio_without).hypot(path.std / path.ratio));
        Some(Self {
            sequence: format!("{clip}, vehicle {}", vehicle.id),
            variant: variant.to_owned(),
            kind: "stationary".to_owned(),
            error: Some((path.ratio_without / path.ratio).ln()).filter(|error| error.is_finite()),
            relative_std: std.filter(|std| std.is_finite()),
            degenerate: path.degenerate_without,
            verdict: vehicle.verdict.as_ref().map(|verdict| verdict.state),
            num_placed: vehicle.poses.len(),
            num_visible: vehicle.poses.len(),
            residual: Some(path.residual),
            ..Self::default()
        })
    }

    /// The error in stated deviations; `None` where the run makes no statement.
    pub fn deviations(&self) -> Option<f64> {
        let std = self.relative_std.filter(|std| *std > 0.0 && !self.degenerate)?;
        self.error.map(|error| error.abs() / std)
    }
}

/// A share with its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Share {
    /// The share, 0 to 1.
    pub share: f64,
    /// Ends of the interval that holds the true share 95 times in 100, if the cases are independent.
    pub interval: [f64; 2],
}

impl Share {
    /// `hits` of `all`, which must not be 0: Wilson, Probable inference, the law of succession, and statistical
    /// inference, 1927.
    pub fn new(hits: usize, all: usize) -> Self {
        // 95 % of a normal distribution lie within ±Z.
        const Z: f64 = 1.959_964;
        let (n, share) = (all as f64, hits as f64 / all as f64);
        let middle = (share + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
        let half = Z / (1.0 + Z * Z / n) * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
        Self { share, interval: [(middle - half).max(0.0), (middle + half).min(1.0)] }
    }
}

/// Calibration of a group of runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Common property of the runs.
    pub name: String,
    /// Runs.
    pub num: usize,
    /// Those with a ratio, a reference and a stated deviation.
    pub num_judged: usize,
    /// Those that say themselves that the ratio is undetermined.
    pub num_degenerate: usize,
    /// Those without a trajectory.
    pub num_failed: usize,
    /// Share of the judged ones within 1, 2 and 3 deviations; `None` where none is judged.
    pub within: Option<[Share; 3]>,
    /// Median of the errors' sizes, of all that have one.
    pub median_error: Option<f64>,
    /// Median of the stated deviations.
    pub median_std: Option<f64>,
    /// The factor by which the stated deviations would have to be multiplied for the middle error to be where it should
    /// be: the median error in deviations over 0.6745.
    pub factor: Option<f64>,
    /// Runs that are more than 3 deviations off, and are not called doubtful or worse.
    pub num_sure_and_wrong: usize,
}

/// Differences between runs of real clips, in standard deviations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpreadRow {
    /// Vehicles that two runs place.
    pub num: usize,
    /// Those of which both runs state a deviation.
    pub num_judged: usize,
    /// Share of the judged ones within 1, 2 and 3 deviations; `None` where none is judged.
    pub within: Option<[Share; 3]>,
    /// Median of the sizes of the differences.
    pub median_difference: Option<f64>,
}

/// All vehicles of all clips together.
pub fn summarise_spreads(spreads: &[Spread]) -> SpreadRow {
    let judged: Vec<f64> = spreads.iter().filter_map(Spread::deviations).collect();
    SpreadRow {
        num: spreads.len(),
        num_judged: judged.len(),
        within: within(&judged),
        median_difference: median(spreads.iter().map(|spread| spread.difference.abs()).collect()),
    }
}

/// Shares within 1, 2 and 3 deviations.
fn within(judged: &[f64]) -> Option<[Share; 3]> {
    let share = |limit: f64| Share::new(judged.iter().filter(|d| **d <= limit).count(), judged.len());
    (!judged.is_empty()).then(|| [1.0, 2.0, 3.0].map(share))
}

/// Median of the absolute value of a standard normal variable.
const MEDIAN_OF_NORMAL: f64 = 0.6745;

/// One row for all cases, and one for every kind of variant, in the order in which they first appear.
pub fn summarise(cases: &[Case]) -> Vec<Row> {
    let mut kinds: Vec<&str> = Vec::new();
    for case in cases {
        if !kinds.contains(&case.kind.as_str()) {
            kinds.push(&case.kind);
        }
    }
    let of_kind = |kind: &&str| row(kind, cases.iter().filter(|case| case.kind == *kind).collect());
    std::iter::once(row("all", cases.iter().collect())).chain(kinds.iter().map(of_kind)).collect()
}

fn row(name: &str, cases: Vec<&Case>) -> Row {
    let judged: Vec<f64> = cases.iter().filter_map(|case| case.deviations()).collect();
    let is_sure = |case: &&&Case| matches!(case.verdict, Some(Trust::Good | Trust::Fair));
    let is_wrong = |case: &&&Case| case.deviations().is_some_and(|d| d > 3.0);
    Row {
        name: name.to_owned(),
        num: cases.len(),
        num_judged: judged.len(),
        num_degenerate: cases.iter().filter(|case| case.degenerate).count(),
        num_failed: cases.iter().filter(|case| case.failure.is_some()).count(),
        within: within(&judged),
        median_error: median(cases.iter().filter_map(|case| case.error).map(f64::abs).collect()),
        median_std: median(cases.iter().filter_map(|case| case.relative_std).collect()),
        factor: median(judged).map(|middle| middle / MEDIAN_OF_NORMAL),
        num_sure_and_wrong: cases.iter().filter(is_sure).filter(is_wrong).count(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{CameraPathRatio, ObjectId, ScaleEstimate, ScaleMethod};

    fn case(kind: &str, error: f64, std: f64) -> Case {
        Case { kind: kind.into(), error: Some(error), relative_std: Some(std), ..Case::default() }
    }

    #[test]
    fn shares_are_counted_per_kind_and_failures_stay_in_the_count() {
        let mut cases = vec![case("noise", 0.01, 0.02), case("noise", -0.05, 0.02), case("blur", 0.09, 0.02)];
        cases[2].verdict = Some(Trust::Good);
        cases.push(Case { kind: "blur".into(), failure: Some("no points".into()), ..Case::default() });
        cases.push(Case { degenerate: true, ..case("blur", 0.5, 0.3) });
        let rows = summarise(&cases);
        assert_eq!(rows.iter().map(|row| row.name.as_str()).collect::<Vec<_>>(), ["all", "noise", "blur"]);
        let all = &rows[0];
        assert_eq!((all.num, all.num_judged, all.num_degenerate, all.num_failed), (5, 3, 1, 1));
        let within = all.within.unwrap().map(|share| share.share);
        assert_eq!(within, [1.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0]);
        assert_eq!((rows[1].num_sure_and_wrong, rows[2].num_sure_and_wrong), (0, 1));
        assert!((all.factor.unwrap() - 2.5 / MEDIAN_OF_NORMAL).abs() < 1e-9);
        assert_eq!(summarise(&[]).len(), 1);
    }

    #[test]
    fn a_stationary_vehicle_is_a_reference_of_its_own_ratio() {
        let path = CameraPathRatio {
            ratio: 2.0,
            std: 0.06,
            residual: 0.01,
            ratio_without: 2.2,
            std_without: Some(0.088),
            degenerate_without: false,
        };
        let vehicle = |camera_path| {
            let scale = ScaleEstimate { camera_path, ..ScaleEstimate::new(2.02, ScaleMethod::Joint) };
            ObjectTrajectory::new(ObjectId(4), "car", 1.0, scale)
        };
        let case = Case::of_stationary("street", "seed-1", &vehicle(Some(path))).unwrap();
        assert_eq!((case.sequence.as_str(), case.residual), ("street, vehicle 4", Some(0.01)));
        assert!((case.error.unwrap() - 1.1_f64.ln()).abs() < 1e-12);
        assert!((case.relative_std.unwrap() - 0.05).abs() < 1e-12, "that of both");
        assert_eq!(Case::of_stationary("street", "seed-1", &vehicle(None)), None);
    }

    #[test]
    fn a_share_has_its_interval() {
        // Wilson's interval for 8 of 10: 0.490 to 0.943.
        let share = Share::new(8, 10);
        assert!((share.interval[0] - 0.490).abs() < 1e-3 && (share.interval[1] - 0.943).abs() < 1e-3, "{share:?}");
        assert!((0.0..1e-12).contains(&Share::new(0, 3).interval[0]));
        assert!(Share::new(3, 3).interval[1] <= 1.0);
    }
}
