//! Effect of single mechanisms: the same sequences with and without each.

use serde::{Deserialize, Serialize};

use super::Entry;

/// Results of a benchmark without some mechanisms, one at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ablations {
    /// Version of this format.
    pub version: u32,
    /// Version of the program that made them.
    pub program: String,
    /// Options of the runs with all mechanisms, as JSON.
    pub options: serde_json::Value,
    /// Results without one mechanism.
    pub runs: Vec<AblatedRun>,
}

/// Result on one sequence without a mechanism.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AblatedRun {
    /// Name of the mechanism.
    pub without: String,
    /// Decision record that introduced it.
    pub decision: u32,
    /// The result.
    pub entry: Entry,
}

/// Effect of one mechanism.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Effect {
    /// Name of the mechanism.
    pub name: String,
    /// Decision record that introduced it.
    pub decision: u32,
    /// Figures with it.
    pub with: Means,
    /// Figures without it, of the same sequences.
    pub without: Means,
}

/// Figures over some sequences.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Means {
    /// Number of sequences.
    pub num_sequences: usize,
    /// Number of sequences without a trajectory.
    pub num_failed: usize,
    /// Mean trajectory error over the sequences that have one with and without the mechanism, metres.
    pub trajectory_error_m: Option<f64>,
    /// Share of these ratios within one and two reported standard deviations of the reference.
    pub coverage: Option<[f64; 2]>,
    /// CPU time of all sequences, seconds; that of reused stages counts as measured when they ran.
    pub cpu_s: f64,
}

impl Ablations {
    /// The effect of each mechanism, in the order of the runs.
    ///
    /// * `with` – results with all mechanisms.
    pub fn effects(&self, with: &[Entry]) -> Vec<Effect> {
        let mut effects: Vec<Effect> = Vec::new();
        for run in &self.runs {
            if effects.iter().any(|effect| effect.name == run.without) {
                continue;
            }
            let without = self.runs.iter().filter(|other| other.without == run.without);
            let pairs: Vec<[&Entry; 2]> = without
                .filter_map(|run| Some([with.iter().find(|entry| entry.folder == run.entry.folder)?, &run.entry]))
                .collect();
            let means = |side: usize| Means::of(&pairs, side);
            effects.push(Effect {
                name: run.without.clone(),
                decision: run.decision,
                with: means(0),
                without: means(1),
            });
        }
        effects
    }
}

impl Means {
    fn of(pairs: &[[&Entry; 2]], side: usize) -> Self {
        let error = |entry: &Entry| entry.trajectory_error_m.filter(|error| error.is_finite());
        let both: Vec<&Entry> =
            pairs.iter().filter(|pair| pair.iter().all(|e| error(e).is_some())).map(|pair| pair[side]).collect();
        let errors: Vec<f64> = both.iter().filter_map(|entry| error(entry)).collect();
        let relative: Vec<f64> = both.iter().filter_map(|entry| error_in_stds(entry)).collect();
        let within = |limit: f64| relative.iter().filter(|stds| **stds <= limit).count() as f64 / relative.len() as f64;
        let entries = || pairs.iter().map(|pair| pair[side]);
        Self {
            num_sequences: pairs.len(),
            num_failed: entries().filter(|entry| entry.failure.is_some()).count(),
            trajectory_error_m: (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64),
            coverage: (!relative.is_empty()).then(|| [within(1.0), within(2.0)]),
            cpu_s: entries().filter_map(|entry| entry.cost).map(|cost| cost.cpu_s).sum(),
        }
    }
}

/// Error of the ratio in reported standard deviations; `None` without a reference or a standard deviation.
fn error_in_stds(entry: &Entry) -> Option<f64> {
    let (scale, reference) = (entry.scale.as_ref()?, entry.reference_ratio?);
    Some((scale.ratio - reference).abs() / scale.std?).filter(|stds| stds.is_finite())
}

#[cfg(test)]
mod tests {
    use super::super::Cost;
    use super::*;

    fn entry(folder: &str, error: Option<f64>, cpu_s: f64) -> Entry {
        Entry {
            folder: folder.into(),
            trajectory_error_m: error,
            failure: error.is_none().then(|| "no trajectory".to_owned()),
            cost: Some(Cost { cpu_s, ..Cost::default() }),
            ..Entry::default()
        }
    }

    #[test]
    fn effects_compare_the_same_sequences() {
        let with = [entry("a", Some(0.1), 10.0), entry("b", Some(0.3), 20.0), entry("c", Some(0.9), 30.0)];
        let run = |without: &str, entry: Entry| AblatedRun { without: without.into(), decision: 24, entry };
        let runs = vec![
            run("first", entry("a", Some(0.2), 11.0)),
            run("second", entry("a", Some(0.1), 10.0)),
            run("first", entry("b", None, 12.0)),
        ];
        let effects = Ablations { runs, ..Ablations::default() }.effects(&with);
        let names: Vec<&str> = effects.iter().map(|effect| effect.name.as_str()).collect();
        assert_eq!(names, ["first", "second"]);
        let Effect { with, without, .. } = &effects[0];
        assert_eq!((with.num_sequences, with.num_failed, without.num_failed), (2, 0, 1));
        assert_eq!((with.trajectory_error_m, without.trajectory_error_m), (Some(0.1), Some(0.2)));
        assert_eq!((with.cpu_s, without.cpu_s, with.coverage), (30.0, 23.0, None));
    }
}
