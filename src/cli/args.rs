//! What may stand on the command line.

use std::path::PathBuf;

use clap::{Parser, Subcommand};

use crate::pipeline::{FeatureKind, FrameOrder, Intrinsics, Stage};
use crate::scene::ObjectId;
use crate::video::Position;

use super::common::CommonArgs;
use super::doctor::DoctorArgs;

/// Three-dimensional trajectories of the vehicles in one video from a moving camera.
#[derive(Debug, Parser)]
#[command(name = "tractrix", version, max_term_width = 100)]
pub(super) struct Args {
    /// What to do
    #[command(subcommand)]
    pub(super) command: Command,
    /// Say nothing but errors
    #[arg(long, global = true)]
    pub(super) quiet: bool,
    /// Say more about what is going on
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    pub(super) verbose: bool,
    /// Print the result as one JSON object
    #[arg(long, global = true)]
    pub(super) json: bool,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Do everything: from a video to trajectories and a report
    ///
    /// Can be stopped and started again at any moment: what is finished is not done twice.
    Run(Box<JobArgs>),
    /// Find the vehicles in every frame
    Segment(Box<JobArgs>),
    /// Follow the vehicles from frame to frame (after `segment`)
    Track(Box<JobArgs>),
    /// Reconstruct the background, and every tracked vehicle
    ///
    /// Without --masks or --segmentation-model no vehicles are looked for, and all pixels are background.
    Sfm(Box<JobArgs>),
    /// Find the ground and its plane near every vehicle (after `sfm`)
    Ground(Box<JobArgs>),
    /// Find scale ratios and trajectories (after `ground`)
    Scale(Box<JobArgs>),
    /// Compare the result of a run with the ground truth of its sequence
    Evaluate(super::evaluate::Args),
    /// Run all sequences of a data set, and sum up how far they are from the truth
    ///
    /// Can be stopped and started again like `run`. Exit code 1 if a sequence failed; the tables are written all the same.
    Benchmark(Box<super::benchmark::Args>),
    /// Compare two reconstructions of the same images
    Compare(super::compare::Args),
    /// Write a reconstruction in another format
    Convert(super::convert::Args),
    /// Solve a problem of "Bundle Adjustment in the Large"
    Bal(super::bal::BalArgs),
    /// Say what is installed, what is missing, and how to get it
    Doctor(DoctorArgs),
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
            _ => Stage::Report,
        }
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct JobArgs {
    /// Video file, folder of images, or folder of a ground-truth sequence (one with a scene.json)
    ///
    /// Of a sequence, images, masks, ground labels and intrinsics are taken, unless given otherwise.
    pub(super) input: PathBuf,
    /// Folder for the results; made if missing, continued if an earlier run was stopped
    #[arg(long, short, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Replace the results of another input that are in the output folder
    #[arg(long)]
    pub(super) overwrite: bool,

    /// Given vehicle masks: one 8-bit PNG per frame with the frame's stem, 0 background, k = vehicle k
    #[arg(long, value_name = "DIR", conflicts_with = "segmentation_model", help_heading = "Vehicles")]
    pub(super) masks: Option<PathBuf>,
    /// ONNX model for instance segmentation (YOLO-seg family)
    #[arg(long, value_name = "FILE", help_heading = "Vehicles")]
    pub(super) segmentation_model: Option<PathBuf>,
    /// ONNX model for optical flow [default: OpenCV's DIS]
    #[arg(long, value_name = "FILE", help_heading = "Vehicles")]
    pub(super) flow_model: Option<PathBuf>,

    /// Given ground masks: one 8-bit PNG per frame, non-zero = ground
    #[arg(long, value_name = "DIR", conflicts_with = "ground_model", help_heading = "Ground")]
    pub(super) ground_masks: Option<PathBuf>,
    /// The value in --ground-masks that means ground, where others mean something else
    #[arg(long, value_name = "VALUE", requires = "ground_masks", help_heading = "Ground")]
    pub(super) ground_label: Option<u8>,
    /// ONNX model for semantic segmentation [default: the dominant plane below the camera]
    #[arg(long, value_name = "FILE", help_heading = "Ground")]
    pub(super) ground_model: Option<PathBuf>,

    /// fx,fy,cx,cy[,k1,k2] in pixels of the source, or a COLMAP cameras.txt [default: from EXIF, or found]
    ///
    /// The centre of the upper left pixel is (0.5, 0.5).
    #[arg(long, value_name = "NUMBERS|FILE", help_heading = "Geometry")]
    pub(super) intrinsics: Option<Intrinsics>,
    /// How image points are found: `video` follows them from frame to frame, `sift` matches them between frames
    ///
    /// Without it: `video` for frames in order of time, `sift` for others.
    #[arg(long, value_name = "KIND", value_parser = feature_kind, help_heading = "Geometry")]
    pub(super) features: Option<FeatureKind>,
    /// Whether frames follow one another in time: `time` or `none` (photographs: all pairs are matched)
    ///
    /// Without it: a video does, and so does a folder with --fps, --features video, or a scene.json. Of any other folder
    /// a few pictures are compared with their successors: where less than 60 % of the corners can be followed, they are
    /// taken for photographs.
    #[arg(long, value_name = "ORDER", value_parser = frame_order, help_heading = "Frames")]
    pub(super) order: Option<FrameOrder>,
    /// COLMAP model of the background, taken as it is
    #[arg(long, value_name = "DIR", help_heading = "Geometry")]
    pub(super) background_model: Option<PathBuf>,
    /// COLMAP model of vehicle ID, taken as it is; may be repeated
    #[arg(long, value_name = "ID=DIR", value_parser = object_model, help_heading = "Geometry")]
    pub(super) object_model: Vec<(ObjectId, PathBuf)>,
    /// Reconstruct this vehicle alone; may be repeated [default: all]
    #[arg(long, value_name = "ID", value_parser = object_id, help_heading = "Geometry")]
    pub(super) only_object: Vec<ObjectId>,

    /// First frame: seconds (12.5) or a frame index (120f)
    #[arg(long, value_name = "TIME", help_heading = "Frames")]
    pub(super) start: Option<Position>,
    /// End, itself left out: seconds or a frame index
    #[arg(long, value_name = "TIME", help_heading = "Frames")]
    pub(super) end: Option<Position>,
    /// Take every N-th frame
    #[arg(long, value_name = "N", help_heading = "Frames")]
    pub(super) every: Option<u32>,
    /// Make frames smaller whose longer side is larger, pixels; results are at that resolution
    #[arg(long, value_name = "PIXELS", help_heading = "Frames")]
    pub(super) max_dimension: Option<u32>,
    /// Frames per second of a folder of images
    #[arg(long, value_name = "RATE", help_heading = "Frames")]
    pub(super) fps: Option<f64>,

    #[command(flatten)]
    pub(super) common: CommonArgs,
}

fn object_id(text: &str) -> Result<ObjectId, String> {
    let id = text.parse().ok().filter(|id| *id > 0);
    id.map(ObjectId).ok_or_else(|| format!("'{text}' is not an id from 1"))
}

fn object_model(text: &str) -> Result<(ObjectId, PathBuf), String> {
    let parsed = text.split_once('=').and_then(|(id, folder)| Some((id.parse().ok()?, folder)));
    match parsed {
        Some((id, folder)) if id > 0 && !folder.is_empty() => Ok((ObjectId(id), folder.into())),
        _ => Err(format!("'{text}' is not ID=DIR with an id from 1")),
    }
}

fn feature_kind(text: &str) -> Result<FeatureKind, String> {
    match text {
        "video" => Ok(FeatureKind::Video),
        "sift" => Ok(FeatureKind::Sift),
        _ => Err(format!("'{text}' is neither video nor sift")),
    }
}

fn frame_order(text: &str) -> Result<FrameOrder, String> {
    match text {
        "time" => Ok(FrameOrder::Time),
        "none" => Ok(FrameOrder::None),
        _ => Err(format!("'{text}' is neither time nor none")),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::scene::ScaleMethod;

    #[test]
    fn the_definition_is_consistent() {
        Args::command().debug_assert();
    }

    #[test]
    fn names_that_other_programs_use_are_kept() {
        let line = "tractrix run in.mp4 --output out --masks m --ground-masks g --intrinsics 1,1,2,3 --flow-model f.onnx \
                    --background-model b --object-model 1=o --object-model 2=p --threads 2 --seed 7 --quiet --json";
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
