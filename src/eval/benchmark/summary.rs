//! The paper's table: per vehicle and estimator.

use serde::{Deserialize, Serialize};

use super::{Benchmark, Entry, Estimator, Quantity, Statistics};

/// Both quantities for every estimator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Column heads of [`Figures::vehicles`].
    pub vehicles: Vec<String>,
    /// One row per estimator.
    pub rows: Vec<Row>,
}

/// Results of one estimator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Which estimator.
    pub estimator: Estimator,
    /// Trajectory error, metres.
    pub trajectory_error_m: Figures,
    /// Deviation of the scale ratio from the reference.
    pub scale_deviation: Figures,
}

/// One quantity over all sequences and over those of each vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Over all sequences.
    pub all: Statistics,
    /// Per vehicle, in the order of [`Summary::vehicles`].
    pub vehicles: Vec<Statistics>,
}

/// The summary of a set, with rows for the reference ratio where there is one.
pub fn summarise(benchmark: &Benchmark, vehicles: &[String]) -> Summary {
    let has_floor = benchmark.sequences.iter().any(|entry| entry.floor_m.is_some());
    let has_two = benchmark.has_adjusted();
    let floors = [(has_two, Estimator::ReferenceAsReconstructed), (has_floor, Estimator::Reference)];
    let floors = floors.into_iter().filter_map(|(is_there, estimator)| is_there.then_some(estimator));
    let estimators = benchmark.estimators().into_iter().chain(floors);
    let row = |estimator: Estimator| Row {
        trajectory_error_m: figures(benchmark, vehicles, &estimator, Quantity::TrajectoryError),
        scale_deviation: figures(benchmark, vehicles, &estimator, Quantity::ScaleDeviation),
        estimator,
    };
    Summary { vehicles: vehicles.to_vec(), rows: estimators.map(row).collect() }
}

fn figures(benchmark: &Benchmark, vehicles: &[String], estimator: &Estimator, quantity: Quantity) -> Figures {
    let over = |choose: &dyn Fn(&Entry) -> bool| {
        let chosen = benchmark.sequences.iter().filter(|entry| choose(entry));
        Statistics::new(chosen.map(|entry| entry.value(estimator, quantity)))
    };
    let of_vehicle = |vehicle: &String| over(&|entry| entry.vehicle == *vehicle);
    Figures { all: over(&|_| true), vehicles: vehicles.iter().map(of_vehicle).collect() }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{benchmark, entry};
    use super::*;
    use crate::scene::ScaleMethod;

    #[test]
    fn a_failed_sequence_is_in_every_count() {
        let all = benchmark(vec![
            entry("smart", "crossing", [Some(0.5), Some(0.1), Some(0.1)]),
            entry("van", "crossing", [Some(0.7), Some(0.3), Some(0.3)]),
            entry("van", "bridge", [None, None, None]),
        ]);
        let summary = summarise(&all, &all.vehicles());
        assert_eq!(summary.vehicles, ["smart", "van"]);
        let row = |estimator: &Estimator| summary.rows.iter().find(|row| row.estimator == *estimator).unwrap();
        let method = &row(&Estimator::Named(ScaleMethod::ConstantDistance)).trajectory_error_m;
        assert_eq!((method.all.num, method.all.num_failed), (2, 1));
        assert!((method.all.mean.unwrap() - 0.2).abs() < 1e-15);
        assert_eq!((method.vehicles[0].num_failed, method.vehicles[1].num_failed), (0, 1));
        assert_eq!(method.vehicles[1].mean, Some(0.3));
        assert_eq!(row(&Estimator::Chosen).trajectory_error_m, *method);
        let floor = &row(&Estimator::Reference).trajectory_error_m.all;
        assert!((floor.mean.unwrap() - 0.1).abs() < 1e-15 && floor.num_failed == 1);
        let deviation = &row(&Estimator::Named(ScaleMethod::Intersection)).scale_deviation.all;
        assert!((deviation.mean.unwrap() - 0.06).abs() < 1e-15);
    }
}
