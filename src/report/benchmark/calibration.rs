//! Calibration of σ as Markdown.

use super::table::{NONE, Table, figure, number, percent};
use crate::eval::calibration::{Calibration, Case, Row, Share, summarise, summarise_spreads};
use crate::eval::spread::Spread;

/// The table of all cases together, and of each kind of variant.
pub fn calibration_summary(calibration: &Calibration) -> String {
    let mut table = Table::new([
        "variants",
        "runs",
        "judged",
        "within 1",
        "within 2",
        "within 3",
        "median error",
        "median std",
        "factor",
        "undetermined",
        "failed",
        "overconfident",
    ]);
    for row in summarise(&calibration.cases) {
        table.row(cells(&row));
    }
    let clips = if calibration.spreads.is_empty() { String::new() } else { clips_summary(&calibration.spreads) };
    table.render(1) + &clips
}

/// Differences between runs of real clips.
fn clips_summary(spreads: &[Spread]) -> String {
    let row = summarise_spreads(spreads);
    let shares = row.within.map_or(NONE.to_owned(), |shares| shares.map(share).join(", "));
    format!(
        "\nReal clips, each variant against the unmodified clip: {} vehicles placed by both runs, {} with standard \
         deviations; within 1, 2, 3σ: {shares}; median difference {}. This is a lower bound: errors common to both \
         runs do not show.\n",
        row.num,
        row.num_judged,
        percent(row.median_difference, 2)
    )
}

/// The whole page: the summary, and every case.
pub fn calibration(calibration: &Calibration) -> String {
    let mut cases = Table::new([
        "sequence",
        "variant",
        "error",
        "std",
        "in std",
        "trajectory error",
        "residual",
        "placed",
        "object",
        "verdict",
    ]);
    for case in &calibration.cases {
        cases.row(case_cells(case));
    }
    format!(
        "# Calibration\n\
         \n\
         Are reported standard deviations calibrated? `tractrix {}`, version {}.\n\
         \n\
         Targets: 68 ± 7 % within one reported standard deviation, at least 93 % within two, at least 99 % within \
         three. Intervals: 95 % for independent cases (Wilson); cases of one sequence are not fully independent. \
         `factor`: factor by which reported standard deviations would have to be multiplied, by the median. \
         `residual`: mean error of a stationary vehicle's points, as a share of its distance. \
         `overconfident`: error above three standard deviations, with verdict good or fair.\n\
         \n\
         {}\n\
         ## Every case\n\
         \n\
         {}",
        calibration.arguments.iter().skip(1).cloned().collect::<Vec<_>>().join(" "),
        calibration.program,
        calibration_summary(calibration),
        cases.render(2)
    ) + &clips(&calibration.spreads)
}

/// Every vehicle with a position in two runs of a clip.
fn clips(spreads: &[Spread]) -> String {
    let mut table =
        Table::new(["clip", "variant", "vehicle", "frames", "difference", "std", "in std", "worse verdict"]);
    for spread in spreads {
        table.row([
            spread.clip.clone(),
            spread.variant.clone(),
            format!("{} and {}", spread.objects[0], spread.objects[1]),
            spread.num_frames.to_string(),
            format!("{:.1} %", 100.0 * spread.difference),
            percent(spread.relative_std, 2),
            number(spread.deviations(), 2),
            spread.verdict.map_or(NONE, crate::scene::Trust::name).to_owned(),
        ]);
    }
    if table.is_empty() { String::new() } else { format!("\n## Real clips\n\n{}", table.render(3)) }
}

fn cells(row: &Row) -> Vec<String> {
    let within = |k: usize| row.within.map_or(NONE.to_owned(), |shares| share(shares[k]));
    vec![
        row.name.clone(),
        row.num.to_string(),
        row.num_judged.to_string(),
        within(0),
        within(1),
        within(2),
        percent(row.median_error, 2),
        percent(row.median_std, 2),
        number(row.factor, 2),
        row.num_degenerate.to_string(),
        row.num_failed.to_string(),
        row.num_sure_and_wrong.to_string(),
    ]
}

fn case_cells(case: &Case) -> Vec<String> {
    let verdict = match (&case.failure, case.verdict) {
        (Some(reason), _) => format!("failed: {reason}"),
        (None, verdict) => verdict.map_or(NONE, crate::scene::Trust::name).to_owned(),
    };
    vec![
        case.sequence.clone(),
        case.variant.clone(),
        percent(case.error, 2),
        percent(case.relative_std, 2),
        number(case.deviations(), 2),
        figure(case.trajectory_error_m, 3, " m"),
        percent(case.residual, 2),
        format!("{} of {}", case.num_placed, case.num_visible),
        figure(case.object_px, 0, " px"),
        verdict,
    ]
}

fn share(share: Share) -> String {
    let [low, high] = share.interval.map(|end| 100.0 * end);
    format!("{:.0} % ({low:.0}–{high:.0})", 100.0 * share.share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_has_its_line_and_nothing_is_nan() {
        let good = Case {
            sequence: "bridge_van".into(),
            variant: "noise-8".into(),
            kind: "noise".into(),
            level: 8.0,
            error: Some(-0.012),
            relative_std: Some(0.01),
            num_placed: 60,
            num_visible: 60,
            ..Case::default()
        };
        let failed = Case { failure: Some("no | points".into()), ..Case::default() };
        let all = Calibration { cases: vec![good, failed], ..Calibration::default() };
        let text = calibration(&all);
        assert!(text.contains("| bridge_van | noise-8 | -1.20 % | 1.00 % |"), "{text}");
        assert!(text.contains("failed: no \\| points") && !text.contains("NaN"), "{text}");
    }
}
