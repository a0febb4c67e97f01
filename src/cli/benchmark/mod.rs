//! `tractrix benchmark DIR`: every sequence of a data set, one table.
//!
//! Each sequence is a run of its own in `OUT/<folder>`, evaluated against its truth; what an earlier benchmark finished
//! is taken over. The tables are written again after every sequence, so that a stopped benchmark has those of what is
//! done.

mod ablate;
pub(super) mod sequences;
pub(super) mod single;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::json;

use super::Call;
use super::common::{CommonArgs, lossy};
use super::job::use_machine;
use super::output::{Failure, show};
use crate::eval::benchmark::{Benchmark, Entry, summarise};
use crate::io::{self, OwnedFolder, PathRole, RunFolder, refuse_own_input};
use crate::pipeline::{Ablation, Method, Options};
use crate::report::benchmark as pages;
use crate::scene::Topic;
use crate::video::Position;
use ablate::Ablating;
use sequences::{SequenceFolders, find, role};
use single::Attempt;

/// Version of `benchmark.json`.
const VERSION: u32 = 1;
const JSON: &str = "benchmark.json";
const MARKDOWN: &str = "benchmark.md";
const TRAJECTORY_ERROR: &str = "trajectory-error.svg";
const SCALE_DEVIATION: &str = "scale-deviation.svg";
const ESTIMATORS: &str = "estimators.svg";
const SCALE_METHOD_HELP: &str = "Scale method used for the result; the others are evaluated for comparison";

#[derive(Clone, Debug, clap::Args)]
#[command(mut_arg("scale_method", |flag| flag.help(SCALE_METHOD_HELP)))]
pub(super) struct Args {
    /// Folder of sequences: all subfolders with a scene.json
    #[arg(value_name = "DIR")]
    pub(super) folder: PathBuf,
    /// Folder for the results: one output folder per sequence, benchmark.json, benchmark.md and three charts
    #[arg(long, short, value_name = "OUT", default_value = "benchmark")]
    pub(super) output: PathBuf,
    /// Replace results of sequences that have changed
    #[arg(long)]
    pub(super) overwrite: bool,
    /// Only sequences whose folder name contains this text; may be repeated
    #[arg(long, value_name = "TEXT")]
    pub(super) only: Vec<String>,
    /// Skip the reference column: every sequence by --method paper, too
    #[arg(long)]
    pub(super) no_paper: bool,
    /// Label of these results in tables
    #[arg(long, value_name = "NAME", default_value = "tractrix")]
    pub(super) label: String,
    /// benchmark.json of another benchmark, added to the tables for comparison; may be repeated
    #[arg(long, value_name = "FILE")]
    pub(super) compare: Vec<PathBuf>,
    /// Run every sequence again without each of these mechanisms: all, or names separated by commas
    ///
    /// Only stages that depend on the mechanism run again. Writes ablation.json and ablation.md. The mechanisms are
    /// listed in docs/decisions/README.md.
    #[arg(long, value_name = "LIST")]
    pub(super) ablate: Option<String>,

    /// COLMAP models of all sequences, used unchanged: DIR/<sequence>/background and DIR/<sequence>/object
    #[arg(
        long,
        value_name = "DIR",
        help_heading = "Geometry",
        conflicts_with_all = ["background_models", "object_models"]
    )]
    pub(super) models: Option<PathBuf>,
    /// COLMAP models of the backgrounds: DIR/<sequence>
    #[arg(long, value_name = "DIR", help_heading = "Geometry")]
    pub(super) background_models: Option<PathBuf>,
    /// COLMAP models of the target vehicles: DIR/<sequence>
    #[arg(long, value_name = "DIR", help_heading = "Geometry")]
    pub(super) object_models: Option<PathBuf>,

    /// End (exclusive) of every sequence: seconds or a frame index (30f)
    #[arg(long, value_name = "TIME", help_heading = "Frames")]
    pub(super) end: Option<Position>,
    /// Use every N-th frame; the others count as not registered
    #[arg(long, value_name = "N", help_heading = "Frames")]
    pub(super) every: Option<u32>,

    #[command(flatten)]
    pub(super) common: CommonArgs,
}

pub(super) fn run(args: &Args, Call { arguments, form, talk }: Call) -> Result<(), Failure> {
    let options = options(args)?;
    let ablated = args.ablate.as_deref().map(Ablation::listed).transpose().map_err(Failure::Usage)?.unwrap_or_default();
    let SequenceFolders { sequences, left_out } = find(&args.folder, &args.only, &args.output)?;
    for name in &left_out {
        let text = format!("{}: skipped, no scene.json", args.folder.join(name).display());
        tracing::warn!("{}", Topic::SequenceSkipped.warning(text));
    }
    let of_paper = paper_options(args, &options)?;
    let others: Vec<Benchmark> = args.compare.iter().map(|path| read(path)).collect::<Result<_, _>>()?;
    for path in &args.compare {
        refuse_own_input(&args.output, place, "--compare", path)?;
    }
    let output = OwnedFolder::open(&args.output, "tractrix benchmark", place)?;
    use_machine(&options)?;
    talk.ends_in_order();
    let arguments = lossy(arguments);
    let mut benchmark = Benchmark {
        version: VERSION,
        label: args.label.clone(),
        program: crate::VERSION.into(),
        arguments: arguments.clone(),
        num_sequences: sequences.len(),
        left_out,
        ..Benchmark::default()
    };
    let mut ablating = Ablating::new(ablated, &options, &output);
    for (k, folder) in sequences.iter().enumerate() {
        talk.say(&format!("[{}/{}] {}", k + 1, sequences.len(), folder.display()));
        let attempt =
            Attempt { args, folder, results: &output, options: &options, output: None, arguments: &arguments, talk };
        let entry = single::sequence(&attempt)?;
        talk.say(&format!("{}: {}", entry.folder, said(&entry)));
        benchmark.sequences.push(entry);
        if let Some(options) = &of_paper {
            benchmark.paper.push(by_paper(&Attempt { options, ..attempt })?);
        }
        write(&benchmark, &others, &output)?;
        ablating.run(&attempt, &benchmark.sequences)?;
    }
    talk.finish();
    let failure = failure(&benchmark).map(|text| Failure::Partial(anyhow::anyhow!(text)));
    let mut value = with_summary(&benchmark);
    if let Some(failure) = &failure {
        value["error"] = failure.as_json();
    }
    if args.ablate.is_some() {
        value["ablation"] = json!(ablating.effects(&benchmark.sequences));
    }
    show(form, &value, || {
        let summary = pages::summary(&benchmark, &with_paper(&benchmark, &others));
        let ablation = args.ablate.as_ref().map_or_else(String::new, |_| ablating.table(&benchmark.sequences) + "\n");
        format!("{summary}\n{ablation}{}\n", args.output.join(MARKDOWN).display())
    })?;
    failure.map_or(Ok(()), Err)
}

/// Which sequences failed.
fn failure(benchmark: &Benchmark) -> Option<String> {
    let failed: Vec<&str> = benchmark.failed().map(|entry| entry.folder.as_str()).collect();
    (!failed.is_empty()).then(|| {
        let (num_failed, all) = (failed.len(), benchmark.sequences.len());
        format!("{num_failed} of {all} sequences failed: {}; see benchmark.md for the reasons", failed.join(", "))
    })
}

fn options(args: &Args) -> Result<Options, Failure> {
    let mut options = args.common.options()?;
    options.video.end = args.end.or(options.video.end);
    options.video.every = args.every.unwrap_or(options.video.every);
    options.scale.references = true;
    options.check().map_err(|error| Failure::Usage(error.to_string()))?;
    Ok(options)
}

/// Options of the reference column; `None` where it is not wanted, or the runs themselves are by a method of the paper.
fn paper_options(args: &Args, options: &Options) -> Result<Option<Options>, Failure> {
    if args.no_paper || Method::of(options) != Method::Default {
        return Ok(None);
    }
    let mut of_paper = Method::Paper.applied(options).map_err(|error| Failure::Usage(error.to_string()))?;
    of_paper.scale.references = false;
    Ok(Some(of_paper))
}

/// A sequence by the published method.
fn by_paper(attempt: &Attempt<'_>) -> Result<Entry, Failure> {
    let runs = attempt.results.root().join(RunFolder::STATE).join("paper");
    std::fs::create_dir_all(&runs).with_context(|| format!("{}: cannot be written; make room", runs.display()))?;
    let output = runs.join(attempt.folder.file_name().unwrap_or_default());
    let entry = single::sequence(&Attempt { output: Some(&output), ..*attempt })?.of_paper();
    attempt.talk.say(&format!("{} by --method paper: {}", entry.folder, said(&entry)));
    Ok(entry)
}

/// The reference column, before the benchmarks that are given for comparison.
fn with_paper(benchmark: &Benchmark, others: &[Benchmark]) -> Vec<Benchmark> {
    benchmark.paper_set().into_iter().chain(others.iter().cloned()).collect()
}

fn read(path: &Path) -> Result<Benchmark, Failure> {
    let benchmark: Benchmark =
        io::json::read(path).with_context(|| format!("{}: not a benchmark.json; check --compare", path.display()))?;
    io::json::check_version(path, benchmark.version, VERSION)?;
    Ok(benchmark)
}

fn place(relative: &Path) -> PathRole {
    let own = [JSON, MARKDOWN, TRAJECTORY_ERROR, SCALE_DEVIATION, ESTIMATORS, ablate::JSON, ablate::MARKDOWN];
    role(relative, |name| own.contains(&name))
}

fn write(benchmark: &Benchmark, others: &[Benchmark], output: &OwnedFolder) -> anyhow::Result<()> {
    let put = |name: &str, text: String| output.put_text(name, &text);
    output.put_json(JSON, &with_summary(benchmark))?;
    put(MARKDOWN, pages::markdown(benchmark, &with_paper(benchmark, others)))?;
    put(TRAJECTORY_ERROR, pages::trajectory_error_chart(benchmark)?)?;
    put(SCALE_DEVIATION, pages::scale_deviation_chart(benchmark)?)?;
    put(ESTIMATORS, pages::estimators_chart(benchmark)?)?;
    Ok(())
}

/// Content of `benchmark.json`: the results, and the summary that follows from them.
fn with_summary(benchmark: &Benchmark) -> serde_json::Value {
    let mut value = json!(benchmark);
    value["summary"] = json!(summarise(benchmark, &benchmark.vehicles()));
    value
}

/// A sequence's result as a line.
fn said(entry: &Entry) -> String {
    match (&entry.failure, entry.trajectory_error_m, entry.floor_m) {
        (Some(reason), ..) => format!("FAILED: {reason}"),
        (None, Some(error), Some(floor)) => format!("{error:.3} m ({floor:.3} m at the reference ratio)"),
        (None, error, _) => error.map_or("FAILED".into(), |error| format!("{error:.3} m")),
    }
}
