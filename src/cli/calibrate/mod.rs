//! `tractrix calibrate DIR`: do stated deviations mean what they say, and where does the method break down?
//!
//! Every sequence runs in every variant, each an ordinary run in `OUT/<sequence>/<variant>`. Worse pictures and masks
//! are written into `OUT/.tractrix` and deleted after the run. Tables and curves are written again after every case, so
//! that a stopped calibration has those of what is done.

mod case;
mod clip;
mod degrade;
#[cfg(test)]
mod tests;
mod variant;

use std::path::{Path, PathBuf};

use serde_json::json;

use self::case::Setting;
use self::variant::{Kind, Variant};
use super::Call;
use super::benchmark::sequences::{find, role};
use super::benchmark::single::stands_in_every_way;
use super::common::{CommonArgs, lossy, named};
use super::job::use_machine;
use super::output::{Failure, show};
use crate::eval::calibration::{Calibration, Case, summarise, summarise_spreads};
use crate::eval::spread::RunResult;
use crate::io::{OwnedFolder, PathRole};
use crate::pipeline::Overwrite;
use crate::report::benchmark as pages;
use crate::scene::{StationaryVehicles, Topic};

/// Version of `calibration.json`.
const VERSION: u32 = 1;
const JSON: &str = "calibration.json";
const MARKDOWN: &str = "calibration.md";
const CURVES: &str = "breakdown-";

#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// Folder of sequences: all subfolders with a scene.json
    #[arg(value_name = "DIR", required_unless_present = "clip")]
    pub(super) folder: Option<PathBuf>,
    /// Real clip without truth: its variants are compared with the unmodified clip; may be repeated
    #[arg(long, value_name = "VIDEO")]
    pub(super) clip: Vec<PathBuf>,
    /// Folder for the results: one output folder per sequence and variant, calibration.json, calibration.md, curves
    #[arg(long, short, value_name = "OUT", default_value = "calibration")]
    pub(super) output: PathBuf,
    /// Replace results of sequences that have changed
    #[arg(long)]
    pub(super) overwrite: bool,
    /// Only sequences whose folder name contains this text; may be repeated
    #[arg(long, value_name = "TEXT")]
    pub(super) only: Vec<String>,
    /// Variants: calibration, breakdown, or single ones, such as noise-8 or frames-30
    ///
    /// as-it-is, raw (no given masks or intrinsics), frames-N, window-FIRST (20 frames), seed-N, blur-PIXELS,
    /// compression-QUALITY, noise-LEVELS, scale-FACTOR, erosion-PIXELS, dilation-PIXELS, jitter-PIXELS (of the masks),
    /// hidden-SHARE (of the frames).
    #[arg(long, value_name = "NAME", value_delimiter = ',', default_value = "calibration")]
    pub(super) variants: Vec<String>,

    /// Stationary vehicles of the clips are references: `all` vehicles, or those `found` to be stationary
    ///
    /// The background's cameras, from which its points are triangulated, determine the scale ratio of a stationary
    /// vehicle. The table has the mean error of the points, and the error of the ratio by the ground.
    #[arg(long, value_name = "WHICH", value_parser = named::<StationaryVehicles>, requires = "clip")]
    pub(super) stationary: Option<StationaryVehicles>,

    #[command(flatten)]
    pub(super) common: CommonArgs,
}

pub(super) fn run(args: &Args, Call { arguments, form, talk }: Call) -> Result<(), Failure> {
    let variants = Variant::all(&args.variants).map_err(Failure::Usage)?;
    let mut options = args.common.options()?;
    if let Some(stationary) = args.stationary {
        options.scale.stationary = stationary;
    }
    options.check().map_err(|error| Failure::Usage(error.to_string()))?;
    let sequences = match &args.folder {
        Some(folder) => find(folder, &args.only, &args.output)?.sequences,
        None => Vec::new(),
    };
    let output = OwnedFolder::open(&args.output, "tractrix calibrate", place)?;
    use_machine(&options)?;
    talk.ends_in_order();
    let arguments = lossy(arguments);
    let setting = Setting {
        results: &output,
        options: &options,
        overwrite: if args.overwrite { Overwrite::AnyInput } else { Overwrite::SameInput },
        arguments: &arguments,
        talk,
    };
    let mut calibration = Calibration {
        version: VERSION,
        program: crate::VERSION.into(),
        arguments: arguments.clone(),
        ..Calibration::default()
    };
    let pairs = || sequences.iter().flat_map(|folder| variants.iter().map(move |variant| (folder, *variant)));
    let num = pairs().count();
    for (k, (folder, variant)) in pairs().enumerate() {
        let name = format!("{}, {variant}", folder.file_name().unwrap_or_default().to_string_lossy());
        talk.say(&format!("[{}/{num}] {name}", k + 1));
        let case = setting.case(folder, variant)?;
        talk.say(&format!("{name}: {}", said(&case)));
        calibration.cases.push(case);
        write(&calibration, &output)?;
    }
    for clip in &args.clip {
        clips(&setting, clip, &variants, args.stationary.is_some(), &mut calibration)?;
    }
    talk.finish();
    show(form, &with_summary(&calibration), || {
        let path = args.output.join(MARKDOWN);
        format!("{}\n{}\n", pages::calibration_summary(&calibration), path.display())
    })
}

/// One clip in all variants that can be made of it. What fails is reported, and the others go on.
///
/// * `has_references` – its stationary vehicles are references.
fn clips(
    setting: &Setting,
    clip: &Path,
    variants: &[Variant],
    has_references: bool,
    calibration: &mut Calibration,
) -> Result<(), Failure> {
    let talk = setting.talk;
    talk.say(&format!("{}, unmodified", clip.display()));
    let unmodified = Variant { kind: Kind::AsItIs, level: 0.0 };
    let as_it_is = setting.clip_run(clip, unmodified)?;
    let references = |variant: Variant, found: &RunResult| {
        if has_references { clip::stationary_cases(clip, variant, found) } else { Vec::new() }
    };
    calibration.cases.extend(references(unmodified, &as_it_is));
    write(calibration, setting.results)?;
    for variant in variants.iter().filter(|variant| clip::is_possible(**variant)) {
        let name = format!("{}, {variant}", clip.display());
        talk.say(&name);
        match setting.clip_run(clip, *variant) {
            Ok(found) => {
                let spreads = clip::spreads_of(clip, *variant, &found, &as_it_is);
                calibration.cases.extend(references(*variant, &found));
                talk.say(&format!("{name}: {} vehicles common to both", spreads.len()));
                calibration.spreads.extend(spreads);
            }
            Err(error) if stands_in_every_way(&error) => return Err(error.into()),
            Err(error) => {
                let text = format!("{name}: skipped: {}", Failure::Input(error));
                tracing::warn!("{}", Topic::SequenceSkipped.warning(text));
            }
        }
        write(calibration, setting.results)?;
    }
    Ok(())
}

fn place(relative: &Path) -> PathRole {
    role(relative, |name| [JSON, MARKDOWN].contains(&name) || name.starts_with(CURVES) && name.ends_with(".svg"))
}

fn write(calibration: &Calibration, output: &OwnedFolder) -> anyhow::Result<()> {
    let put = |name: &str, text: String| output.put_text(name, &text);
    output.put_json(JSON, &with_summary(calibration))?;
    put(MARKDOWN, pages::calibration(calibration))?;
    for (name, chart) in pages::breakdown_charts(calibration)? {
        put(&format!("{CURVES}{name}.svg"), chart)?;
    }
    Ok(())
}

/// Content of `calibration.json`: the cases, and the summary that follows from them.
fn with_summary(calibration: &Calibration) -> serde_json::Value {
    let mut value = json!(calibration);
    value["summary"] = json!(summarise(&calibration.cases));
    value["summary_of_clips"] = json!(summarise_spreads(&calibration.spreads));
    value
}

/// A case as a line.
fn said(case: &Case) -> String {
    let percent = |value: Option<f64>| value.map_or("unknown".to_owned(), |value| format!("{:.2} %", 100.0 * value));
    match &case.failure {
        Some(reason) => format!("FAILED: {reason}"),
        None => format!(
            "error {}, reported standard deviation {}",
            percent(case.error.map(f64::abs)),
            percent(case.relative_std)
        ),
    }
}
