//! Table of the effects of single mechanisms.

use super::table::{NONE, Table, number, percent};
use crate::eval::benchmark::{Effect, Means};

/// A row per mechanism: figures with and without it, and its effect. Negative changes of error and time are gains.
pub fn ablation_table(effects: &[Effect]) -> String {
    let mut table = Table::new([
        "mechanism",
        "decision",
        "sequences",
        "failed with / without",
        "error, m, with / without",
        "change by it, m",
        "within 1 σ, with / without",
        "within 2 σ, with / without",
        "CPU s, with / without",
        "change by it, s",
    ]);
    for Effect { name, decision, with, without } in effects {
        let error = |means: &Means| number(means.trajectory_error_m, 4);
        let change = with.trajectory_error_m.zip(without.trajectory_error_m).map(|(with, without)| with - without);
        let covered = |k: usize| {
            let share = |means: &Means| percent(means.coverage.map(|found| found[k]), 0);
            format!("{} / {}", share(with), share(without))
        };
        table.row([
            name.clone(),
            decision.to_string(),
            with.num_sequences.to_string(),
            format!("{} / {}", with.num_failed, without.num_failed),
            format!("{} / {}", error(with), error(without)),
            change.map_or(NONE.to_owned(), |change| format!("{change:+.4}")),
            covered(0),
            covered(1),
            format!("{:.1} / {:.1}", with.cpu_s, without.cpu_s),
            format!("{:+.1}", with.cpu_s - without.cpu_s),
        ]);
    }
    table.render(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_figures_with_and_without_and_their_difference() {
        let with =
            Means { num_sequences: 2, trajectory_error_m: Some(0.05), coverage: Some([0.5, 1.0]), ..Means::default() };
        let without = Means { trajectory_error_m: Some(0.06), cpu_s: 3.0, ..with };
        let table = ablation_table(&[Effect { name: "drift".into(), decision: 7, with, without }]);
        for text in ["drift", "0.0500 / 0.0600", "-0.0100", "50 % / 50 %", "0.0 / 3.0", "-3.0"] {
            assert!(table.contains(text), "{table}");
        }
    }
}
