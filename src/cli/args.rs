//! Arguments of the command line.

use clap::{Parser, Subcommand};

use super::job::{self, JobArgs};
use super::terminal::ProgressKind;
use crate::pipeline::Stage;

/// Meaning of the exit codes.
const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed on the input, 2 wrong use, 75 to be started again with the same \
                          command (stopped by SIGTERM or SIGHUP, or another process has the output folder), 130 \
                          stopped by Ctrl-C.";

/// Three-dimensional trajectories of the vehicles in one video from a moving camera.
#[derive(Debug, Parser)]
#[command(name = "tractrix", version = crate::VERSION, max_term_width = 100, after_help = EXIT_CODES)]
pub(super) struct Args {
    /// Command to run
    #[command(subcommand)]
    pub(super) command: Command,
    /// Say nothing but errors: no progress, no warnings, and no results but those of --json
    #[arg(long, global = true)]
    pub(super) quiet: bool,
    /// Say more about what is going on
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    pub(super) verbose: bool,
    /// Print the result, or the error, as one JSON object
    #[arg(long, global = true)]
    pub(super) json: bool,
    /// Progress on stderr: auto, bar, plain (lines), json (an object a line), none
    #[arg(long, global = true, value_name = "KIND", value_enum, default_value_t, hide_possible_values = true)]
    pub(super) progress: ProgressKind,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Do everything: from a video to trajectories and a report
    ///
    /// Can be stopped and started again at any moment: what is finished is not done twice.
    Run(Box<JobArgs>),
    /// Find the vehicles in every frame
    #[command(mut_args(|flag| job::shown_up_to(Stage::Segment, flag)))]
    Segment(Box<JobArgs>),
    /// Follow the vehicles from frame to frame (after `segment`)
    #[command(mut_args(|flag| job::shown_up_to(Stage::Track, flag)))]
    Track(Box<JobArgs>),
    /// Reconstruct the background, and every tracked vehicle
    ///
    /// Without --masks or --segmentation-model no vehicles are looked for, and all pixels are background.
    #[command(mut_args(|flag| job::shown_up_to(Stage::Objects, flag)))]
    Sfm(Box<JobArgs>),
    /// Find the ground and its plane near every vehicle (after `sfm`)
    #[command(mut_args(|flag| job::shown_up_to(Stage::Ground, flag)))]
    Ground(Box<JobArgs>),
    /// Find scale ratios and trajectories (after `ground`)
    #[command(mut_args(|flag| job::shown_up_to(Stage::Scale, flag)))]
    Scale(Box<JobArgs>),
    /// Find metres and places on the map (after `scale`)
    Metric(Box<JobArgs>),
    /// Run many videos: one of a list for a scheduler, or all of them side by side
    ///
    /// Each is a run of its own in a folder of its own. Whatever happened, the same command again does what is left.
    Batch(Box<super::batch::Args>),
    /// Compare the result of a run with the ground truth of its sequence
    Evaluate(super::evaluate::Args),
    /// Run all sequences of a data set, and sum up how far they are from the truth
    ///
    /// Can be stopped and started again like `run`. Exit code 1 if a sequence failed; the tables are written all the
    /// same.
    Benchmark(Box<super::benchmark::Args>),
    /// See whether stated deviations mean what they say, and where the method breaks down
    ///
    /// Runs the sequences of a data set in many variants (shorter, smaller, blurred, with worse masks and so on) and
    /// counts how many errors lie within 1, 2 and 3 stated deviations. Can be stopped and started again like `run`.
    Calibrate(Box<super::calibrate::Args>),
    /// Compare two reconstructions of the same images
    Compare(super::compare::Args),
    /// Write a reconstruction in another format
    Convert(super::convert::Args),
    /// Write results as tables, maps, poses, a scene in motion, an annotated video
    Export(super::export::Args),
    /// Join the results of many runs in one table
    ///
    /// Exit code 1 if a folder could not be read; the table holds the others all the same.
    Summary(super::summarize::Args),
    /// Solve a problem of "Bundle Adjustment in the Large"
    Bal(super::bal::Args),
    /// Say what is understood of a file of telemetry
    Telemetry(super::telemetry::Args),
    /// Say what options there are, and which values they have with these flags
    Options(Box<super::options::Args>),
    /// Say what is installed, what is missing, and how to get it
    Doctor(super::doctor::Args),
    /// Print what a shell needs to complete commands and options
    Completions(super::manual::CompletionsArgs),
    /// Write the manual pages, one for each command
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
