//! Many evaluations as one: the paper's summary over a data set of sequences.
//!
//! A sequence has an error for every scale estimator, or it failed for that estimator, with a reason; it never
//! disappears. Every mean says over how many sequences it goes and how many failed, and a second median ranks the
//! failed ones behind all others, which needs no invented penalty ([`Statistics`]).
//!
//! The paper's own 35 sequences are such a set, too ([`paper::published`]), so that its table is made by the same code.

mod ablation;
pub mod paper;
mod statistics;
mod summary;

pub use ablation::{AblatedRun, Ablations, Effect, Means};
pub use statistics::Statistics;
pub use summary::{Figures, Row, Summary, summarise};

use std::collections::{BTreeMap, BTreeSet};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::figures::{Alternative, Evaluation, ReferenceFigures, RegisteredFrames, ScaleFigures};
use super::outcome::Outcome;
use crate::scene::{ModelState, ScaleMethod};

/// The results on a data set.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Benchmark {
    /// Version of this format.
    pub version: u32,
    /// Label of these results in comparisons.
    pub label: String,
    /// Version of the program that made them.
    pub program: String,
    /// The command line.
    pub arguments: Vec<String>,
    /// Sequences that the benchmark is about, done or not.
    pub num_sequences: usize,
    /// Those that are done, in the order of their folders' names.
    pub sequences: Vec<Entry>,
    /// Folders that are no sequences.
    pub left_out: Vec<String>,
    /// The same sequences by the published method (`--method paper`), as far as they are done.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub paper: Vec<Entry>,
}

/// The result on one sequence. Lengths are metres of the true world.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Entry {
    /// Name of its folder, which is unique.
    pub folder: String,
    /// Type of the target vehicle.
    pub vehicle: String,
    /// Type of the trajectory.
    pub trajectory: String,
    /// Why there is no trajectory of the target, where there is none.
    pub failure: Option<String>,
    /// Numbers of frames with a pose.
    pub registered: Option<RegisteredFrames>,
    /// Root mean square distance of the background's camera centres from the true ones.
    pub camera_rmse_m: Option<f64>,
    /// The run's scale ratio.
    pub scale: Option<ScaleFigures>,
    /// Why the run does not trust its scale ratio, where it does not.
    pub verdict: Option<String>,
    /// Trajectory error of the run.
    pub trajectory_error_m: Option<f64>,
    /// The ratio that a perfect estimator would find.
    pub reference_ratio: Option<f64>,
    /// Trajectory error at the reference ratio: what the two reconstructions alone cost.
    pub floor_m: Option<f64>,
    /// The same on the target as structure from motion left it; `None` where the target was not adjusted with the
    /// ground.
    pub floor_as_reconstructed_m: Option<f64>,
    /// Result of every estimator, by its name: `joint` on the target that it adjusted, the others on the target as
    /// structure from motion left it, which is what `--scale-method` with their name gives.
    pub estimators: BTreeMap<ScaleMethod, EstimatorResult>,
    /// Reasons of the estimators that leave the ratio undetermined.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub undetermined: BTreeMap<ScaleMethod, String>,
    /// Cost of the run when its stages were done.
    pub cost: Option<Cost>,
    /// Warnings of the run.
    pub warnings: Vec<String>,
}

/// Result of one estimator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EstimatorResult {
    /// Which of the target's models it speaks of.
    pub model: ModelState,
    /// Its scale ratio; `None` where it was not published.
    pub ratio: Option<f64>,
    /// |r − r_ref| / r_ref; `None` without a reference.
    pub deviation: Option<f64>,
    /// Mean trajectory error at this ratio; `None` where none can be computed.
    pub trajectory_error_m: Option<f64>,
    /// Standard deviation of the ratio, where the estimator states one apart from the run's choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<f64>,
}

impl EstimatorResult {
    fn on(model: ModelState, from: &Alternative) -> Self {
        let Alternative { ratio, deviation, trajectory_error_m } = *from;
        Self { model, ratio: Some(ratio), deviation, trajectory_error_m, std: None }
    }
}

/// Cost of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Cost {
    /// Elapsed time, seconds.
    pub wall_s: f64,
    /// User and system time of all threads, seconds.
    pub cpu_s: f64,
    /// The part of `cpu_s` for features and reconstructions.
    pub sfm_cpu_s: f64,
    /// Largest resident memory, MiB.
    pub peak_rss_mib: f64,
}

/// Whose answer is looked at.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// An estimator.
    Named(ScaleMethod),
    /// The run's own choice.
    Chosen,
    /// No estimator, but the reference ratio.
    Reference,
    /// The same on the target as structure from motion left it.
    ReferenceAsReconstructed,
}

/// Quantity of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Mean distance of the placed points to the true mesh, metres.
    TrajectoryError,
    /// |r − r_ref| / r_ref.
    ScaleDeviation,
}

impl Entry {
    /// From the evaluation of a run; cost and warnings are the caller's.
    pub fn of(evaluation: &Evaluation) -> Self {
        let trajectory = evaluation.trajectory.as_ref();
        let before = evaluation.as_reconstructed.as_ref().map(Outcome::as_ref);
        let is_lost = matches!(before, Some(Err(_)));
        let before = before.and_then(Result::ok);
        let chosen = evaluation.scale.as_ref().ok().map(|scale| scale.method);
        // An estimator's own answer is the one on the target as it was reconstructed, which replaces the one on the
        // adjusted target. Where the former is lost, the latter does not stand in for it, but for the run's own choice.
        let final_ones = evaluation.alternatives.iter().filter(|(method, _)| !is_lost || Some(**method) == chosen);
        let final_ones = final_ones.map(|(method, found)| (*method, EstimatorResult::on(evaluation.model(), found)));
        let first_ones = before.iter().flat_map(|before| &before.alternatives);
        let first_ones =
            first_ones.map(|(method, found)| (*method, EstimatorResult::on(ModelState::AsReconstructed, found)));
        let references = evaluation.references.iter().filter(|(_, found)| found.undetermined.is_none());
        let references = references.filter_map(|(method, ReferenceFigures { found, std, .. })| {
            let result = EstimatorResult::on(ModelState::AsReconstructed, found.as_ref()?);
            Some((*method, EstimatorResult { std: *std, ..result }))
        });
        Self {
            failure: trajectory.err().map(str::to_owned),
            registered: Some(evaluation.registered.clone()),
            camera_rmse_m: evaluation.cameras.as_ref().ok().map(|cameras| cameras.center_rmse_m),
            scale: evaluation.scale.as_ref().ok().cloned(),
            verdict: evaluation.scale.as_ref().ok().and_then(|scale| scale.reason.clone()),
            trajectory_error_m: trajectory.ok().map(|error| error.mean_m),
            reference_ratio: evaluation.reference_scale.as_ref().ok().map(|reference| reference.ratio),
            floor_m: evaluation.trajectory_at_reference.as_ref().ok().map(|error| error.mean_m),
            floor_as_reconstructed_m: before.map(|before| before.error_at_reference_m),
            estimators: final_ones.chain(first_ones).chain(references).collect(),
            undetermined: evaluation
                .references
                .iter()
                .filter_map(|(method, found)| Some((*method, found.undetermined.clone()?)))
                .collect(),
            ..Self::default()
        }
    }

    /// Only the estimators of the paper.
    pub fn of_paper(mut self) -> Self {
        self.estimators.retain(|method, _| [paper::BASELINE, paper::METHOD].contains(method));
        self
    }

    /// The value of an estimator; `None` if the sequence failed for it.
    pub fn value(&self, estimator: &Estimator, quantity: Quantity) -> Option<f64> {
        match (estimator, quantity) {
            (Estimator::Chosen, Quantity::TrajectoryError) => self.trajectory_error_m,
            // A ratio is worth something only where it places the vehicle.
            (Estimator::Chosen, Quantity::ScaleDeviation) => {
                self.scale.as_ref().filter(|_| self.trajectory_error_m.is_some())?.deviation
            }
            (Estimator::Reference, Quantity::TrajectoryError) => self.floor_m,
            (Estimator::ReferenceAsReconstructed, Quantity::TrajectoryError) => {
                self.floor_as_reconstructed_m.or(self.floor_m)
            }
            (Estimator::Reference | Estimator::ReferenceAsReconstructed, Quantity::ScaleDeviation) => {
                self.reference_ratio.map(|_| 0.0)
            }
            (Estimator::Named(name), Quantity::TrajectoryError) => self.estimators.get(name)?.trajectory_error_m,
            (Estimator::Named(name), Quantity::ScaleDeviation) => self.estimators.get(name)?.deviation,
        }
    }

    /// The standard deviation that the run gives for its scale ratio, as a share of it.
    pub fn relative_std(&self) -> Option<f64> {
        let scale = self.scale.as_ref().filter(|_| self.trajectory_error_m.is_some())?;
        scale.std.map(|std| std / scale.ratio.abs())
    }

    /// Relative standard deviation that an estimator states for its ratio.
    pub fn std_of(&self, estimator: &Estimator) -> Option<f64> {
        match estimator {
            Estimator::Chosen => self.relative_std(),
            Estimator::Named(method) => {
                let found = self.estimators.get(method)?;
                Some(found.std? / found.ratio?)
            }
            Estimator::Reference | Estimator::ReferenceAsReconstructed => None,
        }
    }

    /// Vehicle and trajectory in a form in which those of different data sets can be compared.
    pub fn cell(&self) -> (String, String) {
        (plain(&self.vehicle), plain(&self.trajectory))
    }
}

/// Lower case, words joined by `_`, without the plural's s: `Right Curves` and `right_curve` are one trajectory.
fn plain(name: &str) -> String {
    let joined: String = name.chars().map(|c| if c.is_alphanumeric() { c.to_ascii_lowercase() } else { '_' }).collect();
    joined.strip_suffix('s').unwrap_or(&joined).to_owned()
}

impl Benchmark {
    /// The sequences by the published method as a set of their own, if there are any.
    pub fn paper_set(&self) -> Option<Self> {
        let (label, sequences) = ("method paper".to_owned(), self.paper.clone());
        (!sequences.is_empty()).then(|| Self { label, sequences, paper: Vec::new(), ..self.clone() })
    }

    /// The method that gave the scale ratio of every run, if it was the same.
    pub fn only_choice(&self) -> Option<ScaleMethod> {
        let mut methods = self.sequences.iter().filter_map(|entry| entry.scale.as_ref()).map(|scale| scale.method);
        let first = methods.next()?;
        methods.all(|method| method == first).then_some(first)
    }

    /// Returns true if any target was adjusted after structure from motion.
    pub fn has_adjusted(&self) -> bool {
        self.sequences.iter().any(|entry| entry.floor_as_reconstructed_m.is_some())
    }

    /// Every estimator that was asked anywhere: the paper's baseline and method first, the run's own choice last,
    /// which represents an estimator that was always the choice.
    pub fn estimators(&self) -> Vec<Estimator> {
        let methods: BTreeSet<ScaleMethod> = self
            .sequences
            .iter()
            .flat_map(|entry| entry.estimators.keys().chain(entry.undetermined.keys()).copied())
            .collect();
        let mut methods: Vec<ScaleMethod> =
            methods.into_iter().filter(|method| Some(*method) != self.only_choice()).collect();
        methods.sort_by_key(|method| method.rank());
        let named = methods.into_iter().map(Estimator::Named);
        // The paper's published values hold no choice of a run.
        let chosen = self.sequences.iter().any(|e| e.scale.is_some() || e.failure.is_some() || e.cost.is_some());
        named.chain(chosen.then_some(Estimator::Chosen)).collect()
    }

    /// All vehicles: the paper's in its order, then others as they come.
    pub fn vehicles(&self) -> Vec<String> {
        in_order(self.sequences.iter().map(|entry| &entry.vehicle), &paper::VEHICLES)
    }

    /// All trajectories, likewise.
    pub fn trajectories(&self) -> Vec<String> {
        in_order(self.sequences.iter().map(|entry| &entry.trajectory), &paper::TRAJECTORIES)
    }

    /// The sequences of one vehicle on one trajectory.
    pub fn of_cell(&self, cell: &(String, String)) -> impl Iterator<Item = &Entry> {
        self.sequences.iter().filter(move |entry| entry.cell() == *cell)
    }

    /// Only the sequences whose vehicle and trajectory another set has, too.
    pub fn restricted_to(&self, other: &Self) -> Self {
        let cells: BTreeSet<_> = other.sequences.iter().map(Entry::cell).collect();
        let sequences: Vec<_> = self.sequences.iter().filter(|e| cells.contains(&e.cell())).cloned().collect();
        Self { num_sequences: sequences.len(), sequences, ..self.clone() }
    }

    /// Sequences without a trajectory of the target.
    pub fn failed(&self) -> impl Iterator<Item = &Entry> {
        self.sequences.iter().filter(|entry| entry.trajectory_error_m.is_none())
    }
}

fn in_order<'a>(names: impl Iterator<Item = &'a String>, first: &[&str]) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for name in names {
        if !found.contains(name) {
            found.push(name.clone());
        }
    }
    let rank = |name: &str| first.iter().position(|known| plain(known) == plain(name)).unwrap_or(first.len());
    found.sort_by_key(|name| rank(name));
    found
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A sequence with the given errors of (intersection, constant-distance, chosen).
    pub(crate) fn entry(vehicle: &str, trajectory: &str, errors: [Option<f64>; 3]) -> Entry {
        let answer = |error: f64| EstimatorResult {
            model: ModelState::AsReconstructed,
            ratio: Some(1.0 + error / 10.0),
            deviation: Some(error / 10.0),
            trajectory_error_m: Some(error),
            std: None,
        };
        let named = [ScaleMethod::Intersection, ScaleMethod::ConstantDistance].into_iter().zip(errors);
        let [_, _, chosen] = errors;
        Entry {
            folder: format!("{trajectory}_{vehicle}"),
            vehicle: vehicle.into(),
            trajectory: trajectory.into(),
            failure: chosen.is_none().then(|| "the object cannot be reconstructed".into()),
            trajectory_error_m: chosen,
            floor_m: chosen.map(|error| error / 2.0),
            estimators: named.filter_map(|(method, error)| Some((method, answer(error?)))).collect(),
            ..Entry::default()
        }
    }

    pub(crate) fn benchmark(sequences: Vec<Entry>) -> Benchmark {
        Benchmark {
            version: 1,
            label: "test".into(),
            program: "0".into(),
            num_sequences: sequences.len(),
            sequences,
            ..Benchmark::default()
        }
    }

    #[test]
    fn a_failed_sequence_has_no_value_and_keeps_its_place() {
        let failed = entry("van", "bridge", [Some(0.2), None, None]);
        let all = benchmark(vec![entry("van", "crossing", [Some(0.1), Some(0.2), Some(0.3)]), failed]);
        let value = |k: usize, method| all.sequences[k].value(&Estimator::Named(method), Quantity::TrajectoryError);
        assert_eq!(
            (value(0, ScaleMethod::ConstantDistance), value(1, ScaleMethod::ConstantDistance)),
            (Some(0.2), None)
        );
        assert_eq!(value(1, ScaleMethod::Intersection), Some(0.2));
        assert_eq!(all.failed().map(|e| e.folder.as_str()).collect::<Vec<_>>(), ["bridge_van"]);
        let named = [ScaleMethod::Intersection, ScaleMethod::ConstantDistance].map(Estimator::Named);
        assert_eq!(all.estimators(), [named[0].clone(), named[1].clone(), Estimator::Chosen]);
    }

    #[test]
    fn an_estimator_that_was_always_the_choice_has_no_row_of_its_own() {
        let scale = |method: ScaleMethod| ScaleFigures {
            ratio: 1.0,
            std: None,
            method,
            degenerate: false,
            reason: None,
            deviation: None,
        };
        let mut all = benchmark(vec![entry("van", "bridge", [Some(0.1); 3]), entry("suv", "bridge", [Some(0.1); 3])]);
        all.sequences.iter_mut().for_each(|entry| entry.scale = Some(scale(ScaleMethod::ConstantDistance)));
        let intersection = Estimator::Named(ScaleMethod::Intersection);
        assert_eq!(all.estimators(), [intersection, Estimator::Chosen]);
        all.sequences[1].scale = Some(scale(ScaleMethod::Intersection));
        assert_eq!(all.estimators().len(), 3);
    }

    #[test]
    fn names_of_different_sets_are_compared_in_plain_form() {
        let a = entry("Van", "Right Curves", [None; 3]);
        assert_eq!(a.cell(), entry("van", "right_curve", [None; 3]).cell());
        let set = benchmark(vec![a, entry("van", "bridge", [None; 3])]);
        let other = benchmark(vec![entry("van", "right-curves", [None; 3])]);
        let kept = set.restricted_to(&other);
        assert_eq!((kept.num_sequences, kept.sequences[0].trajectory.as_str()), (1, "Right Curves"));
    }

    #[test]
    fn the_papers_order_comes_first() {
        let all = benchmark(vec![
            entry("tractor", "ford", [None; 3]),
            entry("van", "bridge", [None; 3]),
            entry("saloon", "right_curve", [None; 3]),
        ]);
        assert_eq!(all.vehicles(), ["saloon", "van", "tractor"]);
        assert_eq!(all.trajectories(), ["right_curve", "bridge", "ford"]);
    }

    #[test]
    fn results_read_back_as_they_were_written() {
        let all = benchmark(vec![entry("van", "crossing", [Some(0.1), None, Some(0.3)])]);
        let text = serde_json::to_string(&all).unwrap();
        assert_eq!(serde_json::from_str::<Benchmark>(&text).unwrap(), all);
    }
}
