//! Arguments of the command line.

use clap::{Parser, Subcommand};

use super::job::{self, JobArgs};
use super::terminal::ProgressKind;
use crate::pipeline::Stage;

/// Meaning of the exit codes.
const EXIT_CODES: &str = "Exit codes: 0 success, 1 failure on the input, 2 wrong usage, 75 run the same command again \
     (stopped by SIGTERM or SIGHUP, or another process uses the output folder), 130 stopped by Ctrl-C.";

/// Estimate 3D vehicle trajectories from one video of a moving camera
#[derive(Debug, Parser)]
#[command(name = "tractrix", version = crate::VERSION, max_term_width = 100, after_help = EXIT_CODES)]
pub(super) struct Args {
    /// Command to run
    #[command(subcommand)]
    pub(super) command: Command,
    /// Print errors only: no progress, no warnings, no results except those of --json
    #[arg(long, global = true)]
    pub(super) quiet: bool,
    /// Print details on stderr
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    pub(super) verbose: bool,
    /// Print the result, or the error, as one JSON object
    #[arg(long, global = true)]
    pub(super) json: bool,
    /// Progress on stderr: auto, bar, plain (lines), json (one object per line), none
    #[arg(long, global = true, value_name = "KIND", value_enum, default_value_t, hide_possible_values = true)]
    pub(super) progress: ProgressKind,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Run all stages: from a video to trajectories and a report
    ///
    /// Can be stopped at any time; the same command resumes without repeating finished work.
    Run(Box<JobArgs>),
    /// Record a video and locate its vehicles while it is recorded
    ///
    /// The input is `-`, a named pipe or a file that may still grow. Prints one JSON object per vehicle and frame, also
    /// in live.jsonl of the output folder. When the source ends, the ordinary run on the recording follows.
    Live(Box<super::live::LiveArgs>),
    /// Detect the vehicles in every frame
    #[command(mut_args(|flag| job::shown_up_to(Stage::Segment, flag)))]
    Segment(Box<JobArgs>),
    /// Track the vehicles over all frames (after `segment`)
    #[command(mut_args(|flag| job::shown_up_to(Stage::Track, flag)))]
    Track(Box<JobArgs>),
    /// Reconstruct the background and every tracked vehicle
    ///
    /// Without --masks or --segmentation-model no vehicles are detected, and all pixels are background.
    #[command(mut_args(|flag| job::shown_up_to(Stage::Objects, flag)))]
    Sfm(Box<JobArgs>),
    /// Estimate the ground, and its local plane near every vehicle (after `sfm`)
    #[command(mut_args(|flag| job::shown_up_to(Stage::Ground, flag)))]
    Ground(Box<JobArgs>),
    /// Estimate scale ratios and trajectories (after `ground`)
    #[command(mut_args(|flag| job::shown_up_to(Stage::Scale, flag)))]
    Scale(Box<JobArgs>),
    /// Estimate the scale in meters and georeferenced positions (after `scale`)
    Metric(Box<JobArgs>),
    /// Run many videos: one job of a list, for schedulers, or all jobs in parallel
    ///
    /// Every job has its own output folder. After any interruption the same command runs what remains.
    Batch(Box<super::batch::Args>),
    /// Compare a result with the ground truth of its sequence
    Evaluate(super::evaluate::Args),
    /// Run all sequences of a data set and summarize their errors
    ///
    /// Can be stopped and resumed like `run`. Exit code 1 if a sequence failed; the tables are written nevertheless.
    Benchmark(Box<super::benchmark::Args>),
    /// Check whether reported standard deviations are calibrated, and where the method fails
    ///
    /// Runs the sequences of a data set in many variants (shorter, smaller, blurred, with worse masks and so on) and
    /// counts the errors within 1, 2 and 3 reported standard deviations. Can be stopped and resumed like `run`.
    Calibrate(Box<super::calibrate::Args>),
    /// Compare two reconstructions of the same images
    Compare(super::compare::Args),
    /// Convert a reconstruction to another format
    Convert(super::convert::Args),
    /// Export results as tables, maps, poses, an animated scene or an annotated video
    Export(super::export::Args),
    /// Count vehicles at lines and in zones, with speeds and headways
    Analyse(super::analyse::Args),
    /// Combine the results of many runs in one table
    ///
    /// Exit code 1 if a folder could not be read; the table has the others nevertheless.
    Summary(super::summarize::Args),
    /// Solve a "Bundle Adjustment in the Large" problem
    Bal(super::bal::Args),
    /// Show what was parsed from a telemetry file
    Telemetry(super::telemetry::Args),
    /// List all options and their effective values
    Options(Box<super::options::Args>),
    /// Print the JSON Schemas of results
    Schema(super::schema::Args),
    /// Check installed libraries and networks
    Doctor(super::doctor::Args),
    /// Print a completion script for a shell
    Completions(super::manual::CompletionsArgs),
    /// Write the manual pages, one per command
    Manual(super::manual::ManualArgs),
}

impl Command {
    /// The last stage that a command does.
    pub(super) fn goal(&self) -> Stage {
        match self {
            Self::Segment(_) => Stage::Segment,
            Self::Track(_) => Stage::Track,
            Self::Sfm(_) => Stage::Objects,
            Self::Ground(_) => Stage::Ground,
            Self::Scale(_) => Stage::Scale,
            Self::Metric(_) => Stage::Metric,
            _ => Stage::Report,
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::scene::{ObjectId, ScaleMethod};

    #[test]
    fn the_definition_is_consistent() {
        Args::command().debug_assert();
    }

    #[test]
    fn names_that_other_programs_use_are_kept() {
        let line = "tractrix run in.mp4 --output out --masks m --ground-masks g --intrinsics 1,1,2,3 --flow-model \
                    f.onnx --background-model b --object-model 1=o --object-model 2=p --threads 2 --seed 7 --quiet \
                    --json";
        let args = Args::try_parse_from(line.split_whitespace()).unwrap();
        let Command::Run(job) = args.command else { panic!("run is run") };
        assert_eq!(job.object_model, [(ObjectId(1), "o".into()), (ObjectId(2), "p".into())]);
        assert!(args.quiet && args.json);
        assert_eq!((job.common.threads, job.common.seed), (Some(2), Some(7)));
        let line = "tractrix benchmark d --threads 2 --seed 7 --options o.json --scale-method intersection";
        let Command::Benchmark(benchmark) = Args::try_parse_from(line.split_whitespace()).unwrap().command else {
            panic!("benchmark is benchmark")
        };
        assert_eq!((benchmark.common.threads, benchmark.common.seed), (Some(2), Some(7)));
        assert_eq!(benchmark.common.scale_method, Some(ScaleMethod::Intersection));
        let models = "tractrix sfm in --output out --segmentation-model s.onnx --ground-model g.onnx";
        assert!(Args::try_parse_from(models.split_whitespace()).is_ok());
    }

    #[test]
    fn the_help_of_a_part_lists_what_that_part_uses() {
        let mut command = Args::command();
        let mut help = |name: &str| command.find_subcommand_mut(name).unwrap().render_long_help().to_string();
        let flags = ["--segmentation-model", "--flow-model", "--intrinsics", "--ground-model", "--scale-method"];
        for (name, num_shown) in [("segment", 1), ("track", 3), ("sfm", 3), ("ground", 4), ("scale", 5), ("run", 5)] {
            let help = help(name);
            let shown: Vec<bool> = flags.iter().map(|flag| help.contains(flag)).collect();
            assert_eq!(shown, flags.map(|flag| flags[..num_shown].contains(&flag)), "{name}");
        }
        assert!(help("sfm").contains("--telemetry") && !help("sfm").contains("--camera-height"));
        // The same flags serve every part.
        assert!(Args::try_parse_from("tractrix segment in -o out --scale-method joint".split_whitespace()).is_ok());
    }

    #[test]
    fn nonsense_is_refused() {
        for tail in [
            "--object-model 0=a",
            "--only-object 0",
            "--object-model a",
            "--scale-method x",
            "--start -1",
            "--features orb",
            "--order up",
            "--ground-label 3",
        ] {
            let line = format!("tractrix run in --output out {tail}");
            assert!(Args::try_parse_from(line.split_whitespace()).is_err(), "{tail}");
        }
    }
}
