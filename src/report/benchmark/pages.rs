//! The Markdown page, and its first part, which is also printed to the terminal.

use std::collections::{BTreeMap, BTreeSet};

use super::estimators::is_reference;
use super::table::{NONE, Table, number};
use crate::eval::benchmark::{Benchmark, Cost, Entry, Estimator, Figures, Quantity, Row, Statistics, paper, summarise};
use crate::report::words::count;

/// Trajectory error above which a sequence is listed with its remarks, meters.
pub const ATTENTION_ERROR_M: f64 = 0.3;
/// Registered share of the object's or background's frames below which a sequence is listed with its remarks.
pub const ATTENTION_FRACTION: f64 = 0.98;

/// The whole page: summary, every sequence, comparison with others, and remarks.
pub fn markdown(own: &Benchmark, others: &[Benchmark]) -> String {
    let mut page = format!("# Benchmark: {}\n\ntractrix {}", own.label, own.program);
    if !own.arguments.is_empty() {
        page += &format!("\n\n    {}", own.arguments.join(" "));
    }
    page += "\n\n";
    page += &summary(own, others);
    page += "\n![Trajectory error](trajectory-error.svg)\n\n![Scale deviation](scale-deviation.svg)\n\n\
             ![Estimators](estimators.svg)\n";
    page += "\n## Every sequence\n\
         \n\
         Lengths in meters, camera centers in millimeters, deviations in percent; ± is the reported standard deviation \
         of the ratio.\n\
         \n";
    page += &sequences(own);
    let comparison = comparison(own, others);
    if !comparison.is_empty() {
        page += "\n## Comparison with others\n\nTrajectory error in meters, by sequence.\n\n";
        page += &comparison;
    }
    page + &super::estimators::estimators(own, others) + &attention(own)
}

/// The paper's table, twice: trajectory error and scale deviation per vehicle and estimator, the paper's own values
/// below.
pub fn summary(own: &Benchmark, others: &[Benchmark]) -> String {
    let published = paper::published();
    let same = published.restricted_to(own);
    let mut sets: Vec<(String, &Benchmark)> = vec![(own.label.clone(), own)];
    sets.extend(others.iter().map(|other| (other.label.clone(), other)));
    sets.push(("paper".into(), &published));
    if !same.sequences.is_empty() && same.sequences.len() < published.sequences.len() {
        sets.push((format!("paper, the same {}", same.sequences.len()), &same));
    }
    let vehicles = own.vehicles();
    let part = |title: &str, note: &str, digits: usize, choose: fn(&Row) -> &Figures| {
        let last = ["mean", "median", "median, failed last", "largest", "sequences"];
        let head = ["estimator"].into_iter().map(str::to_owned).chain(vehicles.iter().cloned());
        let mut table = Table::new(head.chain(last.map(str::to_owned)));
        for (label, set) in &sets {
            for row in &summarise(set, &vehicles).rows {
                let is_floor = matches!(row.estimator, Estimator::Reference | Estimator::ReferenceAsReconstructed);
                let is_trivial = is_floor && digits == 4;
                if !is_trivial {
                    table.row(figures_row(format!("{label}: {}", name(&row.estimator, set)), choose(row), digits));
                }
            }
        }
        format!("## {title}\n\n{note}\n\n{}\n", table.render(1))
    };
    let note = "Mean over the sequences of each vehicle and over all; in brackets the number of sequences with a \
         value, where some failed.";
    let error = part("Trajectory error, meters", note, 3, |row| &row.trajectory_error_m);
    let deviation = part("Scale ratio, deviation from the reference", note, 4, |row| &row.scale_deviation);
    heading(own) + &error + &deviation + &costs(own)
}

/// Number of sequences, failures, and comparison of the choice with the floor.
fn heading(own: &Benchmark) -> String {
    let (num, failed) = (own.sequences.len(), own.failed().count());
    let mut text = format!("{num} sequences, {failed} failed.");
    if num < own.num_sequences {
        text = format!("UNFINISHED: {num} of {} sequences are done, {failed} failed.", own.num_sequences);
    }
    let of = |estimator| Statistics::new(own.sequences.iter().map(|e| e.value(&estimator, Quantity::TrajectoryError)));
    let (chosen, floor) = (of(Estimator::Chosen), of(Estimator::Reference));
    if let (Some(mean), Some(floor)) = (chosen.mean, floor.mean) {
        text += &format!(
            " Mean trajectory error as run {} m over {} of {}, {:.2} times the {} m at the reference ratio.",
            number(Some(mean), 3),
            chosen.num,
            chosen.num_all(),
            mean / floor,
            number(Some(floor), 3),
        );
    }
    let doubted = own.sequences.iter().filter(|entry| entry.verdict.is_some()).count();
    if doubted > 0 {
        let sure = own.sequences.iter().filter(|entry| entry.verdict.is_none());
        let sure = Statistics::new(sure.map(|entry| entry.trajectory_error_m));
        text += &format!(
            " {} rejected; mean over the other {} of {}: {} m.",
            count(doubted, "vehicle"),
            sure.num,
            sure.num_all(),
            number(sure.mean, 3),
        );
    }
    text += &calibration(own).unwrap_or_default();
    if own.has_adjusted() {
        text += " `joint` adjusts each target's reconstruction together with the ground; the other estimators use the \
             model from structure from motion unchanged.";
    }
    if !own.left_out.is_empty() {
        text += &format!(" Folders skipped (no scene.json): {}.", own.left_out.join(", "));
    }
    text + "\n\n"
}

/// Comparison of the ratios' errors with their reported standard deviations; `None` where there are none.
fn calibration(own: &Benchmark) -> Option<String> {
    let errors = own.sequences.iter().filter_map(|entry| {
        let deviation = entry.value(&Estimator::Chosen, Quantity::ScaleDeviation)?;
        entry.relative_std().filter(|std| *std > 0.0).map(|std| deviation / std)
    });
    let errors: Vec<f64> = errors.collect();
    let largest = errors.iter().copied().reduce(f64::max)?;
    let mean_square = errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64;
    Some(format!(
        " Errors of the ratios of {} runs in units of their reported standard deviations: RMS {:.2}, maximum \
         {largest:.2}.",
        errors.len(),
        mean_square.sqrt(),
    ))
}

fn costs(own: &Benchmark) -> String {
    let costs: Vec<Cost> = own.sequences.iter().filter_map(|entry| entry.cost).collect();
    let sum = |of: fn(&Cost) -> f64| costs.iter().map(of).sum::<f64>();
    if costs.is_empty() {
        return String::new();
    }
    format!(
        "Cost of {} runs: {:.0} CPU s ({:.1} per sequence, {:.1} of them structure from motion), {:.0} s wall, peak \
         memory {:.0} MiB.\n",
        costs.len(),
        sum(|cost| cost.cpu_s),
        sum(|cost| cost.cpu_s) / costs.len() as f64,
        sum(|cost| cost.sfm_cpu_s) / costs.len() as f64,
        sum(|cost| cost.wall_s),
        costs.iter().map(|cost| cost.peak_rss_mib).fold(0.0, f64::max),
    )
}

fn figures_row(label: String, figures: &Figures, digits: usize) -> Vec<String> {
    let all = &figures.all;
    let mut cells = vec![label];
    cells.extend(figures.vehicles.iter().map(|statistics| mean_of(statistics, digits)));
    cells.extend([all.mean, all.median, all.median_failed_last, all.max].map(|value| number(value, digits)));
    cells.push(format!("{} of {}", all.num, all.num_all()));
    cells
}

/// A mean, with the number of sequences where some failed.
fn mean_of(statistics: &Statistics, digits: usize) -> String {
    match (statistics.num_all(), statistics.num_failed) {
        (0, _) => NONE.to_owned(),
        (_, 0) => number(statistics.mean, digits),
        (all, _) => format!("{} ({}/{all})", number(statistics.mean, digits), statistics.num),
    }
}

pub(super) fn name(estimator: &Estimator, set: &Benchmark) -> String {
    match estimator {
        Estimator::Named(method) => method.name().into(),
        Estimator::Reference if set.has_adjusted() => "at the reference ratio, adjusted".into(),
        Estimator::Reference => "at the reference ratio".into(),
        Estimator::ReferenceAsReconstructed => "at the reference ratio, as reconstructed".into(),
        Estimator::Chosen => {
            let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
            for scale in set.sequences.iter().filter_map(|entry| entry.scale.as_ref()) {
                *counts.entry(scale.method.name()).or_default() += 1;
            }
            let methods: Vec<String> = match counts.len() {
                1 => counts.keys().map(|method| (*method).to_owned()).collect(),
                _ => counts.iter().map(|(method, count)| format!("{method} {count} ×")).collect(),
            };
            if methods.is_empty() { "as run".into() } else { format!("as run ({})", methods.join(", ")) }
        }
    }
}

fn sequences(own: &Benchmark) -> String {
    let named: Vec<Estimator> = main(own).into_iter().filter(|e| *e != Estimator::Chosen).collect();
    let mut head: Vec<String> =
        ["sequence", "vehicle", "trajectory", "background", "object", "centers", "floor"].map(str::to_owned).to_vec();
    head.push(name(&Estimator::Chosen, own));
    head.extend(["error %", "±"].map(str::to_owned));
    for estimator in &named {
        head.extend([name(estimator, own), "error %".to_owned()]);
    }
    if own.has_adjusted() {
        head.push(short(&Estimator::ReferenceAsReconstructed).to_owned());
    }
    head.extend(["SfM CPU s", "CPU s", "wall s", "MiB", "remark"].map(str::to_owned));
    let mut table = Table::new(head);
    for entry in &own.sequences {
        let frames = |of: fn(&crate::eval::RegisteredFrames) -> (usize, usize)| {
            let counted = entry.registered.as_ref().map(of);
            counted.map_or(NONE.to_owned(), |(count, of)| format!("{count}/{of}"))
        };
        let mut cells = vec![entry.folder.clone(), entry.vehicle.clone(), entry.trajectory.clone()];
        cells.push(frames(|r| (r.num_background, r.num_frames)));
        cells.push(frames(|r| (r.num_object, r.num_visible)));
        cells.push(number(entry.camera_rmse_m.map(|m| 1000.0 * m), 2));
        cells.push(number(entry.floor_m, 3));
        for estimator in [Estimator::Chosen].iter().chain(&named) {
            cells.push(value(entry, estimator));
            let deviation = entry.value(estimator, Quantity::ScaleDeviation);
            cells.push(number(deviation.map(|d| 100.0 * d), 2));
            if *estimator == Estimator::Chosen {
                cells.push(number(entry.relative_std().map(|std| 100.0 * std), 2));
            }
        }
        if own.has_adjusted() {
            cells.push(number(entry.value(&Estimator::ReferenceAsReconstructed, Quantity::TrajectoryError), 3));
        }
        let cost = |of: fn(&Cost) -> f64| number(entry.cost.as_ref().map(of), 1);
        cells.extend([cost(|c| c.sfm_cpu_s), cost(|c| c.cpu_s), cost(|c| c.wall_s), cost(|c| c.peak_rss_mib)]);
        cells.push(remark(entry));
        table.row(cells);
    }
    table.render(3)
}

fn value(entry: &Entry, estimator: &Estimator) -> String {
    match entry.value(estimator, Quantity::TrajectoryError) {
        Some(metres) => number(Some(metres), 3),
        None => "failed".to_owned(),
    }
}

/// The estimators without reference methods, which have a separate section.
fn main(set: &Benchmark) -> Vec<Estimator> {
    set.estimators().into_iter().filter(|estimator| !is_reference(estimator)).collect()
}

fn remark(entry: &Entry) -> String {
    match (&entry.failure, &entry.verdict) {
        (Some(reason), _) => format!("FAILED: {reason}"),
        (None, Some(_)) => "rejected by the run".to_owned(),
        _ => String::new(),
    }
}

/// Comparison of our errors with those of the others and the paper; empty if there is nothing to compare with.
fn comparison(own: &Benchmark, others: &[Benchmark]) -> String {
    let published = paper::published();
    let sets: Vec<(&Benchmark, Vec<Estimator>)> = [own]
        .into_iter()
        .chain(others)
        .chain([&published])
        .map(|set| {
            let floor = set.sequences.iter().any(|entry| entry.floor_m.is_some()).then_some(Estimator::Reference);
            (set, main(set).into_iter().chain(floor).collect())
        })
        .collect();
    let mut head = vec!["sequence".to_owned()];
    for (set, estimators) in &sets {
        head.extend(estimators.iter().map(|estimator| format!("{}: {}", set.label, short(estimator))));
    }
    let mut table = Table::new(head);
    for entry in &own.sequences {
        let mut cells = vec![entry.folder.clone()];
        let mut found_any = false;
        for (k, (set, estimators)) in sets.iter().enumerate() {
            let by_folder = set.sequences.iter().find(|other| other.folder == entry.folder);
            let found = by_folder.or_else(|| set.of_cell(&entry.cell()).next());
            found_any |= k > 0 && found.is_some();
            cells.extend(estimators.iter().map(|e| found.map_or(NONE.to_owned(), |found| value(found, e))));
        }
        if found_any {
            table.row(cells);
        }
    }
    if table.is_empty() { String::new() } else { table.render(1) }
}

fn short(estimator: &Estimator) -> &str {
    match estimator {
        Estimator::Named(method) => method.name(),
        Estimator::Chosen => "as run",
        Estimator::Reference => "floor",
        Estimator::ReferenceAsReconstructed => "floor, as reconstructed",
    }
}

/// Remarks on all sequences with problems.
fn attention(own: &Benchmark) -> String {
    let mut text = String::new();
    for entry in &own.sequences {
        let facts = facts(entry);
        if !facts.is_empty() {
            text += &format!("\n- **{}**: {}", entry.folder, facts.into_iter().collect::<Vec<_>>().join("; "));
        }
    }
    let percent = 100.0 * ATTENTION_FRACTION;
    let title = format!("\n## Failed, over {ATTENTION_ERROR_M} m, or under {percent:.0} % of frames\n");
    if text.is_empty() { title + "\nNone.\n" } else { title + &text + "\n" }
}

fn facts(entry: &Entry) -> Vec<String> {
    let mut facts = Vec::new();
    facts.extend(entry.failure.as_ref().map(|reason| format!("failed: {reason}")));
    if let Some(error) = entry.trajectory_error_m.filter(|error| *error > ATTENTION_ERROR_M) {
        let deviation = entry.value(&Estimator::Chosen, Quantity::ScaleDeviation);
        facts.push(format!(
            "{error:.3} m, of which {} m at the reference ratio; error of the ratio {} %",
            number(entry.floor_m, 3),
            number(deviation.map(|d| 100.0 * d), 2)
        ));
    }
    if let Some(registered) = &entry.registered {
        let few = |fraction: Option<f64>| fraction.is_some_and(|fraction| fraction < ATTENTION_FRACTION);
        let parts = [
            ("background", registered.background_fraction, registered.num_background, registered.num_frames),
            ("object", registered.object_fraction, registered.num_object, registered.num_visible),
        ];
        let few = parts.into_iter().filter(|(_, fraction, ..)| few(*fraction));
        facts.extend(few.map(|(what, _, count, of)| format!("{what}: {count} of {of} frames")));
    }
    if facts.is_empty() {
        return facts;
    }
    let warnings: BTreeSet<&String> = entry.warnings.iter().collect();
    facts.extend(warnings.into_iter().map(|warning| format!("warning: {warning}")));
    facts
}

#[cfg(test)]
mod tests;
