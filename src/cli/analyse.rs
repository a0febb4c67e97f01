//! `tractrix analyse OUT --gates FILE`: counts, speeds and headways at lines and zones.

use std::fmt::Write;
use std::path::PathBuf;

use anyhow::{Context, anyhow};
use serde_json::Value;

use super::output::{Failure, Form, show};
use crate::export::Results;
use crate::export::crossings::{self, Analysis, Direction};
use crate::io::RunFolder;
use crate::io::json;
use crate::math::rounding::{counted, with_std};
use crate::pipeline;

/// Count vehicles at lines and in zones, with speeds and headways
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// Output folder of `tractrix run`
    #[arg(value_name = "OUT")]
    run: PathBuf,
    /// Lines and polygons as GeoJSON, drawn in a GIS: longitude and latitude where the run had --telemetry, else x and
    /// y of the metric frame
    #[arg(long, value_name = "FILE")]
    gates: PathBuf,
}

/// Reads, counts and prints.
///
/// # Errors
/// A folder without a result, a result without meters, or a file that has no lines and polygons.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let frames = pipeline::known_frames(&args.run);
    let results = Results::read(&RunFolder::at(&args.run), frames.as_deref())?;
    let document: Value = json::read(&args.gates).with_context(|| "--gates")?;
    let gates = crossings::gates(&document, &results)
        .map_err(|problem| Failure::Input(anyhow!("{}: {problem}", args.gates.display())))?;
    let found = crossings::analyse(&results, &gates)?;
    show(form, &found, || as_text(&found))
}

/// A line per crossing and visit, and the counts of each gate.
fn as_text(found: &Analysis) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    for group in found.crossings.chunk_by(|a, b| a.gate == b.gate) {
        let count = |direction| group.iter().filter(|crossing| crossing.direction == direction).count();
        let (right, left) = (count(Direction::ToRight), count(Direction::ToLeft));
        let _ = writeln!(
            text,
            "{}: {}, {right} to the right, {left} to the left",
            group[0].gate,
            counted(group.len(), "crossing")
        );
        for crossing in group {
            let way = if crossing.direction == Direction::ToRight { "right" } else { "left" };
            let time = with_std(crossing.time_s.value, crossing.time_s.std);
            let speed = with_std(3.6 * crossing.speed_m_s.value, 3.6 * crossing.speed_m_s.std);
            let headway = crossing.headway_s.map(|gap| format!(", headway {} s", with_std(gap.value, gap.std)));
            let end = crossing.from_end_m;
            let doubt = if end.value < 2.0 * end.std { ", uncertain: near the end of the line" } else { "" };
            let _ = writeln!(
                text,
                "  {} s  {} {} ({}) to the {way}, {speed} km/h{}{doubt}",
                time,
                crossing.vehicle,
                crossing.class,
                crossing.verdict,
                headway.unwrap_or_default()
            );
        }
    }
    for group in found.visits.chunk_by(|a, b| a.gate == b.gate) {
        let _ = writeln!(text, "{}: {}", group[0].gate, counted(group.len(), "visit"));
        for visit in group {
            let time = |at: Option<f64>, unknown: &str| at.map_or(unknown.to_owned(), |at| format!("{at:.2} s"));
            let (entry, exit) = (time(visit.entry_s, "before"), time(visit.exit_s, "after"));
            let _ = writeln!(
                text,
                "  {entry} to {exit}  {} {} ({}), {:.1} s inside, {:.1} km/h",
                visit.vehicle,
                visit.class,
                visit.verdict,
                visit.duration_s,
                3.6 * visit.mean_speed_m_s
            );
        }
    }
    if found.crossings.is_empty() && found.visits.is_empty() {
        text += "no crossings and no visits\n";
    }
    if found.num_rejected > 0 {
        let _ = writeln!(text, "not counted: {} rejected", counted(found.num_rejected, "vehicle"));
    }
    text
}
