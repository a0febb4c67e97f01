//! Comparison of all scale estimators: determined and undetermined ratios, their errors, coverage of their σ, sources.

use super::pages::name;
use super::table::{NONE, Table, number};
use crate::eval::benchmark::{Benchmark, Entry, Estimator, Quantity, Statistics, paper};

/// Multiples of σ whose coverage is shown.
const FACTORS: [f64; 2] = [1.0, 2.0];

/// The section; empty unless the runs computed reference methods. The program's estimators are followed by those of the
/// other sets and the paper's published values.
pub(super) fn estimators(own: &Benchmark, others: &[Benchmark]) -> String {
    let all = own.estimators();
    if !all.iter().any(is_reference) {
        return String::new();
    }
    let head = ["estimator", "determined", "undetermined", "failed", "median %", "mean %", "max %"];
    let coverage = FACTORS.map(|factor| format!("within {factor:.0}σ"));
    let mut table = Table::new(head.map(str::to_owned).into_iter().chain(coverage).chain(["source".to_owned()]));
    for estimator in &all {
        table.row(row(own, name(estimator, own), estimator));
    }
    for set in others.iter().chain([&paper::published()]) {
        for estimator in set.estimators().iter().filter(|estimator| !is_reference(estimator)) {
            table.row(row(set, format!("{}: {}", set.label, name(estimator, set)), estimator));
        }
    }
    let mut each = Table::new(["sequence".to_owned()].into_iter().chain(all.iter().map(|e| name(e, own))));
    for entry in &own.sequences {
        each.row([entry.folder.clone()].into_iter().chain(all.iter().map(|estimator| cell(entry, estimator))));
    }
    format!(
        "\n## Estimators: error of the scale ratio\n\nReference methods use the targets as structure from motion left \
         them. Undetermined: no solution, or a standard deviation beyond the limit. Sources and assumptions: \
         docs/estimators.md. `method paper`: the published method without additions (docs/paper.md); `paper`: its \
         published values.\n\n{}\nError ± reported standard deviation, %:\n\n{}",
        table.render(1),
        each.render(1),
    )
}

pub(super) fn is_reference(estimator: &Estimator) -> bool {
    matches!(estimator, Estimator::Named(method) if method.is_reference())
}

fn row(set: &Benchmark, label: String, estimator: &Estimator) -> Vec<String> {
    let errors = || set.sequences.iter().map(|entry| entry.value(estimator, Quantity::ScaleDeviation));
    let all = Statistics::new(errors());
    let undetermined = set.sequences.iter().filter(|entry| is_undetermined(entry, estimator)).count();
    let percent = |value: Option<f64>| number(value.map(|value| 100.0 * value), 2);
    let surprises: Vec<f64> = set
        .sequences
        .iter()
        .filter_map(|e| Some(e.value(estimator, Quantity::ScaleDeviation)? / e.std_of(estimator)?))
        .collect();
    let within = |factor: f64| match surprises.len() {
        0 => NONE.to_owned(),
        count => format!("{} of {count}", surprises.iter().filter(|surprise| **surprise <= factor).count()),
    };
    let mut cells = vec![label, all.num.to_string(), undetermined.to_string()];
    cells.push((all.num_failed - undetermined.min(all.num_failed)).to_string());
    cells.extend([all.median, all.mean, all.max].map(percent));
    cells.extend(FACTORS.map(within));
    cells.push(match estimator {
        Estimator::Named(method) => method.info().citation.to_owned(),
        _ => set.only_choice().map_or(NONE.to_owned(), |method| method.info().citation.to_owned()),
    });
    cells
}

pub(super) fn is_undetermined(entry: &Entry, estimator: &Estimator) -> bool {
    matches!(estimator, Estimator::Named(method) if entry.undetermined.contains_key(method))
}

fn cell(entry: &Entry, estimator: &Estimator) -> String {
    let error = entry.value(estimator, Quantity::ScaleDeviation);
    match (error, entry.std_of(estimator)) {
        (Some(error), Some(std)) => format!("{:.2} ± {:.2}", 100.0 * error, 100.0 * std),
        (Some(error), None) => format!("{:.2}", 100.0 * error),
        (None, _) if is_undetermined(entry, estimator) => "undetermined".to_owned(),
        (None, _) => "failed".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eval::benchmark::EstimatorResult;
    use crate::eval::benchmark::tests::{benchmark, entry};
    use crate::scene::{ModelState, ScaleMethod};

    #[test]
    fn undetermined_ratios_are_counted_apart() {
        let mut set = benchmark(vec![
            entry("van", "bridge", [Some(0.1); 3]),
            entry("suv", "bridge", [Some(0.1); 3]),
            entry("smart", "bridge", [None; 3]),
        ]);
        assert_eq!(estimators(&set, &[]), "");
        let result = EstimatorResult {
            model: ModelState::AsReconstructed,
            ratio: Some(2.0),
            deviation: Some(0.03),
            trajectory_error_m: Some(0.3),
            std: Some(0.04),
        };
        set.sequences[0].estimators.insert(ScaleMethod::OzdenHeading, result);
        set.sequences[1].undetermined.insert(ScaleMethod::OzdenHeading, "no direction of motion".into());
        let mut by_paper = set.sequences[0].clone();
        by_paper.estimators.insert(ScaleMethod::RobustLeastSquares, result);
        set.paper = vec![by_paper.of_paper()];
        let text = estimators(&set, &[set.paper_set().unwrap()]);
        let row = text.lines().find(|line| line.starts_with("| ozden-heading")).unwrap();
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        assert_eq!(cells[2..10], ["1", "1", "1", "3.00", "3.00", "3.00", "0 of 1", "1 of 1"], "{row}");
        let row = |start: &str| text.lines().filter(|line| line.starts_with(start)).count();
        assert_eq!((row("| method paper: constant-distance"), row("| method paper: least-squares")), (1, 0), "{text}");
        assert!(text.contains("| paper: intersection") && text.contains(" 2.42 "), "{text}");
        assert!(text.contains("3.00 ± 2.00") && text.contains("undetermined") && text.contains("failed"), "{text}");
    }
}
