//! `tractrix export OUT --format NAMES`: results in the files that other programs open.

use std::path::PathBuf;

use serde::Serialize;

use super::output::{Failure, Form, show};
use super::terminal::TerminalProgress;
use crate::export::{
    self, ExportError, Exported, Format, MissingFormats, Need, Pictures, RATES, Results, Target, Units,
};
use crate::io::RunFolder;
use crate::pipeline::{self, Progress};
use crate::scene::{Topic, Trust};

/// Export the results of a run for other programs (docs/export.md describes every column)
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// Output folder of `tractrix run`
    #[arg(value_name = "OUT")]
    pub(super) run: PathBuf,
    /// Formats: csv, geojson, kml, gpx, tum, kitti, gltf, video, sumo, levelx, cot, colmap, trajectories-v2;
    /// several
    /// separated by commas; or all
    ///
    /// csv: tables of vehicles, of vehicles frame by frame, and of the camera. geojson, kml, gpx: georeferenced
    /// positions, which need --telemetry in the run. tum, kitti: poses. gltf: animated scene. video: masks, ids, speeds
    /// and paths drawn into the video. sumo, levelx: trajectories for traffic research, in meters. cot: events of
    /// Cursor on Target; needs --telemetry with dates. colmap: images,
    /// masks and the background, ready for densification. all: everything that these results allow.
    #[arg(long, value_name = "NAMES", value_parser = asked)]
    pub(super) format: Formats,
    /// Leave out vehicles with a lower verdict, and ground tracks
    #[arg(long, value_name = "VERDICT", value_parser = min_verdict)]
    pub(super) min_verdict: Option<Trust>,
    /// Rows per second in csv, geojson, kml, gpx, tum, kitti, sumo, levelx, cot; interpolated between neighboring
    /// frames, not across gaps [default: the frames]
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub(super) rate: Option<f64>,
    /// Units in csv and geojson: m/s, km/h or mph, and m or ft; separated by a comma, such as mph,ft [default: m/s,m]
    #[arg(long, value_name = "UNITS", default_value = "m/s,m", hide_default_value = true)]
    pub(super) units: Units,
    /// Output folder [default: OUT/export]
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Current path of the video or image folder, if it was moved; video and colmap need it
    #[arg(long, value_name = "INPUT")]
    pub(super) input: Option<PathBuf>,
}

fn min_verdict(text: &str) -> Result<Trust, String> {
    let found = [Trust::Good, Trust::Fair, Trust::Doubtful].into_iter().find(|trust| trust.name() == text);
    found.ok_or_else(|| "expected good, fair or doubtful".to_owned())
}

fn rate(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|rate| RATES.contains(rate));
    found.ok_or_else(|| format!("expected samples per second from {} to {}", RATES.start(), RATES.end()))
}

/// The formats that were asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Formats {
    formats: Vec<Format>,
    asked: MissingFormats,
}

fn asked(list: &str) -> Result<Formats, String> {
    let formats = Format::listed(list)?;
    Ok(Formats { formats, asked: if list.trim() == "all" { MissingFormats::ForAll } else { MissingFormats::ByName } })
}

#[derive(Debug, Serialize)]
struct Output {
    output: PathBuf,
    #[serde(flatten)]
    exported: Exported,
}

impl Output {
    /// The files, one a line.
    fn as_text(&self) -> String {
        let files = self.exported.written.iter().flat_map(|written| &written.files);
        files.map(|file| format!("{}\n", file.display())).collect()
    }
}

/// Writes and says what was written.
///
/// # Errors
/// Why a format that was asked for by name cannot be made.
pub(super) fn run(args: &Args, form: Form, talk: &TerminalProgress) -> Result<(), Failure> {
    let folder = RunFolder::at(&args.run);
    let frames = pipeline::known_frames(&args.run);
    let mut results = Results::read(&folder, frames.as_deref())?;
    if let Some(lowest) = args.min_verdict {
        results.keep_trusted(lowest);
    }
    results.units = args.units;
    let needs_pictures = args.format.formats.iter().any(|format| format.need() == Need::Pictures);
    let opened = needs_pictures.then(|| pipeline::reopen(&args.run, args.input.as_deref()));
    let source = match &opened {
        Some(Ok(source)) => Ok(source),
        Some(Err(error)) => Err(error.to_string()),
        None => Err("no format requires it".to_owned()),
    };
    talk.begin("export", None);
    let on_step = || talk.step();
    let pictures = Pictures::new(&folder, source, &on_step).of_frames(frames.as_deref());
    let exported = export::write(&results, &args.format.formats, args.format.asked, args.rate, &pictures, || {
        target(args, &folder)
    });
    talk.end();
    talk.finish();
    let exported = exported?;
    for left in &exported.passed_over {
        tracing::warn!("{}", Topic::ExportSkipped.warning(&left.reason));
    }
    if args.output.is_none() {
        link_from_page(args);
    }
    let output = Output { output: args.output.clone().unwrap_or_else(|| folder.exports()), exported };
    show(form, &output, || output.as_text())
}

/// The page of the run links to what lies next to it.
fn link_from_page(args: &Args) {
    if let Err(error) = pipeline::link_exports(&args.run) {
        let page = args.run.join("report.html");
        let text = format!("{}: exports not linked: {error}", page.display());
        tracing::warn!("{}", Topic::ExportSkipped.warning(text));
    }
}

fn target(args: &Args, folder: &RunFolder) -> Result<Target, ExportError> {
    let input = args.input.as_deref();
    let mut reads = vec![("OUT", args.run.as_path())];
    reads.extend(input.map(|input| ("--input", input)));
    Ok(match &args.output {
        Some(output) => Target::at(output, &reads)?,
        None => Target::in_run(folder)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_listed_and_unknown_ones_refused() {
        assert_eq!(
            asked("csv,gltf").unwrap(),
            Formats { formats: vec![Format::Csv, Format::Gltf], asked: MissingFormats::ByName }
        );
        assert_eq!(asked("all").unwrap().asked, MissingFormats::ForAll);
        assert!(asked("shapefile").unwrap_err().contains("'shapefile': unknown format; expected csv"));
    }
}
