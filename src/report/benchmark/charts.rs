//! The paper's two bar charts, and the second one for every estimator.

use super::estimators::is_undetermined;
use super::pages::name;
use crate::eval::benchmark::{Benchmark, Entry, Estimator, Quantity, paper};
use crate::report::ReportError;
use crate::report::bars::{Bar, BarChart, Filling, Height, panels_svg};
use crate::scene::ScaleMethod;

/// Trajectory error per trajectory, vehicle and estimator, as SVG.
///
/// # Errors
/// [`ReportError::Chart`] if it cannot be laid out.
pub fn trajectory_error_chart(benchmark: &Benchmark) -> Result<String, ReportError> {
    let quantity = Quantity::TrajectoryError;
    chart(benchmark, quantity, "Trajectory error", "trajectory error, meters", drawn(benchmark)).svg()
}

/// Deviation of the scale ratio from the reference, as SVG.
///
/// # Errors
/// [`ReportError::Chart`] if it cannot be laid out.
pub fn scale_deviation_chart(benchmark: &Benchmark) -> Result<String, ReportError> {
    let quantity = Quantity::ScaleDeviation;
    let title = "Scale ratio: deviation from the reference";
    chart(benchmark, quantity, title, SCALE_LABEL, drawn(benchmark)).svg()
}

/// Deviation of the scale ratio from the reference, a chart per estimator with values, as one SVG.
///
/// # Errors
/// [`ReportError::Chart`] if it cannot be laid out.
pub fn estimators_chart(benchmark: &Benchmark) -> Result<String, ReportError> {
    let of = |estimator: Estimator| {
        let name = name(&estimator, benchmark);
        let drawn = vec![(estimator, Filling::Solid, String::new())];
        chart(benchmark, Quantity::ScaleDeviation, &name, SCALE_LABEL, drawn)
    };
    let has_any = |estimator: &Estimator| {
        benchmark.sequences.iter().any(|entry| entry.value(estimator, Quantity::ScaleDeviation).is_some())
    };
    panels_svg(&benchmark.estimators().into_iter().filter(has_any).map(of).collect::<Vec<_>>())
}

const SCALE_LABEL: &str = "|r − reference| / reference";

fn chart(
    benchmark: &Benchmark,
    quantity: Quantity,
    title: &str,
    y_label: &str,
    estimators: Vec<(Estimator, Filling, String)>,
) -> BarChart {
    let published = paper::published();
    let (vehicles, trajectories) = (benchmark.vehicles(), benchmark.trajectories());
    let bars = |trajectory: &String| {
        let bars = |vehicle: &String| {
            let here = |entry: &&Entry| entry.vehicle == *vehicle && entry.trajectory == *trajectory;
            let entries: Vec<&Entry> = benchmark.sequences.iter().filter(here).collect();
            estimators.iter().map(|(estimator, ..)| bar(&entries, &published, estimator, quantity)).collect()
        };
        vehicles.iter().map(bars).collect()
    };
    BarChart {
        title: format!("{title}, {}", benchmark.label),
        y_label: y_label.into(),
        groups: trajectories.iter().map(|name| words(name)).collect(),
        bars: trajectories.iter().map(bars).collect(),
        clusters: vehicles.iter().map(|name| words(name)).collect(),
        fillings: estimators.into_iter().map(|(_, filling, name)| (filling, name)).collect(),
    }
}

/// The paper's two estimators, and the run's choice where it is not always the paper's.
fn drawn(benchmark: &Benchmark) -> Vec<(Estimator, Filling, String)> {
    let method = ScaleMethod::ConstantDistance;
    let papers = |scale: &crate::eval::ScaleFigures| scale.method == method;
    let differs = benchmark.sequences.iter().any(|entry| entry.scale.as_ref().is_some_and(|scale| !papers(scale)));
    let mut drawn = vec![
        (Estimator::Named(ScaleMethod::Intersection), Filling::Outline, "intersection (baseline)".to_owned()),
        (
            Estimator::Named(method),
            if differs { Filling::Pale } else { Filling::Solid },
            "constant distance".to_owned(),
        ),
    ];
    if differs {
        let said = benchmark.only_choice().map_or("as run".to_owned(), |method| format!("{} (as run)", method.name()));
        drawn.push((Estimator::Chosen, Filling::Solid, said));
    }
    drawn
}

/// The mean over the sequences of one vehicle on one trajectory, which are usually one; failed if any failed.
fn bar(entries: &[&Entry], published: &Benchmark, estimator: &Estimator, quantity: Quantity) -> Bar {
    let mean_of = |estimator: &Estimator| {
        let values: Option<Vec<f64>> = entries.iter().map(|entry| entry.value(estimator, quantity)).collect();
        values.filter(|v| !v.is_empty()).map(|v| v.iter().sum::<f64>() / v.len() as f64)
    };
    let height = match mean_of(estimator) {
        _ if entries.is_empty() => Height::Absent,
        Some(mean) => Height::Value(mean),
        None if entries.iter().any(|entry| is_undetermined(entry, estimator)) => Height::Undetermined,
        None => Height::Failed,
    };
    let floor = match estimator {
        Estimator::Named(_) => Estimator::ReferenceAsReconstructed,
        _ => Estimator::Reference,
    };
    let floor = mean_of(&floor).filter(|_| quantity == Quantity::TrajectoryError);
    let cell = entries.first().map(|entry| entry.cell());
    let published = cell.and_then(|cell| published.of_cell(&cell).find_map(|entry| entry.value(estimator, quantity)));
    Bar { height, published, floor }
}

fn words(name: &str) -> String {
    name.replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eval::benchmark::tests::{benchmark, entry};

    fn chart_of(set: &Benchmark) -> BarChart {
        chart(set, Quantity::TrajectoryError, "t", "m", drawn(set))
    }

    fn paper_with_a_failure() -> Benchmark {
        let mut set = paper::published();
        set.sequences[3].estimators.remove(&ScaleMethod::ConstantDistance);
        set.sequences.pop();
        set
    }

    #[test]
    fn the_papers_own_chart_is_drawn() {
        let chart = chart_of(&paper_with_a_failure());
        assert_eq!((chart.groups.len(), chart.clusters.len(), chart.fillings.len()), (7, 5, 2));
        // Saloon overtaking: its baseline is valid, its method failed; the van's bumpy road is missing.
        let bars = &chart.bars[3][0];
        assert_eq!((bars[0].height, bars[1].height), (Height::Value(1.3798), Height::Failed));
        assert_eq!((bars[0].published, bars[1].published), (Some(1.3798), Some(0.14733)));
        assert_eq!(chart.bars[6][4][0].height, Height::Absent);
        assert!(chart.svg().unwrap().contains("steep street"));
    }

    #[test]
    fn every_bar_has_the_floor_of_its_own_reconstruction() {
        let mut adjusted = entry("van", "bridge", [Some(0.4), Some(0.3), Some(0.1)]);
        (adjusted.floor_m, adjusted.floor_as_reconstructed_m) = (Some(0.05), Some(0.2));
        let set = benchmark(vec![adjusted, entry("van", "crossing", [Some(0.4), Some(0.3), Some(0.1)])]);
        let estimators = [Estimator::Named(ScaleMethod::Intersection), Estimator::Chosen];
        let floor = |entry, estimator| bar(&[entry], &paper::published(), estimator, Quantity::TrajectoryError).floor;
        let floors = |entry| estimators.each_ref().map(|estimator| floor(entry, estimator));
        assert_eq!(floors(&set.sequences[0]), [Some(0.2), Some(0.05)]);
        assert_eq!(floors(&set.sequences[1]), [Some(0.05), Some(0.05)]);
    }

    #[test]
    fn several_seeds_of_one_cell_are_one_bar() {
        let mut set = paper::published();
        let mut twin = set.sequences[0].clone();
        twin.estimators.get_mut(&ScaleMethod::Intersection).unwrap().trajectory_error_m = Some(0.153598);
        set.sequences.push(twin);
        let drawn = chart_of(&set);
        assert!(matches!(drawn.bars[0][0][0].height, Height::Value(mean) if (mean - 0.103598).abs() < 1e-12));
        // Trajectories of different names are separate groups, even where the paper's values are equal.
        set.sequences[35].trajectory = "right_curve".into();
        let drawn = chart_of(&set);
        assert_eq!((drawn.groups.len(), drawn.bars[1][0][0].height), (8, Height::Value(0.153598)));
        assert_eq!(drawn.bars[1][0][0].published, Some(0.053598));
        set.sequences[35].trajectory = "right_curves".into();
        set.sequences[0].estimators.clear();
        let drawn = chart_of(&set);
        assert_eq!(drawn.bars[0][0][0].height, Height::Failed);
    }

    #[test]
    fn every_estimator_with_a_ratio_has_a_chart_and_undetermined_ratios_a_mark() {
        let mut set = paper::published();
        for method in [ScaleMethod::Yuan, ScaleMethod::OzdenPlane] {
            set.sequences[0].undetermined.insert(method, "the camera keeps its height".into());
        }
        let found = set.sequences[1].estimators[&ScaleMethod::Intersection];
        set.sequences[1].estimators.insert(ScaleMethod::Yuan, found);
        let svg = estimators_chart(&set).unwrap();
        for title in ["intersection, paper", "constant-distance, paper", "yuan, paper"] {
            assert_eq!(svg.matches(&format!("\n{title}\n")).count(), 1, "{title}");
        }
        assert!(!svg.contains("ozden-plane"), "no ratio at all");
        assert_eq!(svg.matches("\nundetermined\n").count(), 1);
        assert!(svg.contains("\nfailed\n"));
    }
}
