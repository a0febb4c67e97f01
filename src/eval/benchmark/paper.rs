//! The values that the paper published, read from the coordinates of its two bar charts (figures *Quantitative
//! evaluation of the trajectory error in meter* and *of the scale ratio*), five digits of each.
//!
//! Its vehicles stand under the names of the types here that come nearest: Lancer `saloon`, Lincoln Navigator `suv`,
//! Smart `smart`, Golf `hatchback`, Van `van`. Other vehicles, another world, other flights: the values say what kind
//! of error the paper's pipeline had on what kind of sequence, no more.

use super::{Benchmark, Entry, EstimatorResult};
use crate::scene::{ModelState, ScaleMethod};

/// The baseline.
pub(super) const BASELINE: ScaleMethod = ScaleMethod::Intersection;
/// The paper's own estimator.
pub(super) const METHOD: ScaleMethod = ScaleMethod::ConstantDistance;

/// Its vehicles, in its order.
pub const VEHICLES: [&str; 5] = ["saloon", "suv", "smart", "hatchback", "van"];
/// Its trajectories, in its order.
pub const TRAJECTORIES: [&str; 7] =
    ["right_curves", "left_curves", "crossing", "overtaking", "bridge", "steep_street", "bumpy_road"];

/// Vehicle, trajectory, trajectory errors in metres and scale deviations, each of (baseline, method).
type Published = (&'static str, &'static str, [f64; 2], [f64; 2]);

#[rustfmt::skip]
const PUBLISHED: [Published; 35] = [
    ("saloon", "right_curves", [0.053598, 0.077982], [0.0011728, 0.0066826]),
    ("saloon", "left_curves", [0.60248, 0.29464], [0.099446, 0.0060101]),
    ("saloon", "crossing", [0.13453, 0.16422], [0.0155, 0.020918]),
    ("saloon", "overtaking", [1.3798, 0.14733], [0.15798, 0.062044]),
    ("saloon", "bridge", [0.46757, 0.49124], [0.039985, 0.16698]),
    ("saloon", "steep_street", [0.042924, 0.047936], [0.0011134, 0.002377]),
    ("saloon", "bumpy_road", [0.25073, 0.19589], [0.0066435, 0.022555]),
    ("suv", "right_curves", [0.26988, 0.10632], [0.034024, 0.0020824]),
    ("suv", "left_curves", [0.77008, 0.07308], [0.13789, 0.00090793]),
    ("suv", "crossing", [0.35409, 0.13776], [0.049946, 0.013111]),
    ("suv", "overtaking", [0.57375, 0.81036], [0.014905, 0.053619]),
    ("suv", "bridge", [0.67083, 0.14589], [0.11757, 0.025775]),
    ("suv", "steep_street", [0.93973, 0.090522], [0.12147, 0.020488]),
    ("suv", "bumpy_road", [0.15566, 0.23246], [0.020802, 0.15748]),
    ("smart", "right_curves", [0.25394, 0.1282], [0.020953, 0.026687]),
    ("smart", "left_curves", [0.35169, 0.17728], [0.011497, 0.042206]),
    ("smart", "crossing", [0.22566, 0.096172], [0.017333, 0.017707]),
    ("smart", "overtaking", [0.15338, 1.223], [0.013245, 0.10514]),
    ("smart", "bridge", [0.05062, 0.25215], [0.0040747, 0.034663]),
    ("smart", "steep_street", [0.20912, 0.065827], [0.025666, 0.00044493]),
    ("smart", "bumpy_road", [0.47422, 0.38233], [0.00031671, 0.024782]),
    ("hatchback", "right_curves", [0.10807, 0.28585], [0.00021143, 0.080596]),
    ("hatchback", "left_curves", [0.53953, 0.30652], [0.02417, 0.046697]),
    ("hatchback", "crossing", [0.24862, 0.85736], [0.021836, 0.077122]),
    ("hatchback", "overtaking", [4.8118, 0.38944], [0.37759, 0.11239]),
    ("hatchback", "bridge", [0.60183, 0.066504], [0.092935, 0.0014222]),
    ("hatchback", "steep_street", [0.24229, 0.18356], [0.033471, 0.033841]),
    ("hatchback", "bumpy_road", [0.12117, 0.24027], [0.0034603, 0.08219]),
    ("van", "right_curves", [6.2542, 0.63017], [0.41494, 0.12567]),
    ("van", "left_curves", [4.0037, 0.74899], [0.35358, 0.016766]),
    ("van", "crossing", [0.17845, 0.36866], [0.032929, 0.025301]),
    ("van", "overtaking", [0.45577, 0.64811], [0.022515, 0.25082]),
    ("van", "bridge", [0.35945, 0.3867], [0.048287, 0.052158]),
    ("van", "steep_street", [0.23643, 0.14482], [0.026429, 0.010752]),
    ("van", "bumpy_road", [0.25378, 0.33364], [0.0011551, 0.046134]),
];

/// The paper's 35 sequences.
pub fn published() -> Benchmark {
    let sequences: Vec<_> = PUBLISHED.iter().map(entry).collect();
    Benchmark { version: 1, label: "paper".into(), num_sequences: sequences.len(), sequences, ..Benchmark::default() }
}

fn entry((vehicle, trajectory, errors, deviations): &Published) -> Entry {
    let estimators = [BASELINE, METHOD].into_iter().zip(errors.iter().zip(deviations));
    let estimator = |(method, (error, deviation)): (ScaleMethod, (&f64, &f64))| {
        // The ratios themselves were not published.
        let (deviation, trajectory_error_m) = (Some(*deviation), Some(*error));
        let model = ModelState::AsReconstructed;
        (method, EstimatorResult { model, ratio: None, deviation, trajectory_error_m, std: None })
    };
    Entry {
        folder: format!("{trajectory}_{vehicle}"),
        vehicle: (*vehicle).to_owned(),
        trajectory: (*trajectory).to_owned(),
        estimators: estimators.map(estimator).collect(),
        ..Entry::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eval::benchmark::{Estimator, summarise};

    /// The charts' values give the table that the paper prints next to them.
    #[test]
    fn the_charts_give_the_papers_own_table() {
        let paper = published();
        let vehicles = paper.vehicles();
        assert_eq!(vehicles, VEHICLES);
        assert_eq!(paper.trajectories(), TRAJECTORIES);
        let summary = summarise(&paper, &vehicles);
        assert_eq!(summary.rows.len(), 2, "no choice of a run and no reference");
        let printed = [
            (BASELINE, [0.42, 0.53, 0.25, 0.95, 1.68], [0.05, 0.07, 0.01, 0.08, 0.13], [0.766, 0.270, 0.068, 0.024]),
            (METHOD, [0.20, 0.23, 0.33, 0.33, 0.47], [0.04, 0.04, 0.04, 0.06, 0.08], [0.312, 0.232, 0.051, 0.027]),
        ];
        for (row, (method, errors, deviations, [mean_m, median_m, mean, median])) in summary.rows.iter().zip(printed) {
            assert_eq!(row.estimator, Estimator::Named(method));
            let (error, deviation) = (&row.trajectory_error_m, &row.scale_deviation);
            assert_eq!((error.all.num, error.all.num_failed), (35, 0));
            for k in 0..vehicles.len() {
                assert!((error.vehicles[k].mean.unwrap() - errors[k]).abs() < 0.0051, "{method:?} {k}");
                assert!((deviation.vehicles[k].mean.unwrap() - deviations[k]).abs() < 0.0051, "{method:?} {k}");
            }
            let found = [error.all.mean, error.all.median, deviation.all.mean, deviation.all.median];
            for (found, expected) in found.into_iter().zip([mean_m, median_m, mean, median]) {
                assert!((found.unwrap() - expected).abs() < 0.00051, "{method:?}: {found:?}, {expected}");
            }
        }
    }
}
