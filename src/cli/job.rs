//! Request for a run: its flags, combined with the options file and the input's own folder.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::common::{CommonArgs, named};
use super::output::Failure;
use crate::io::{IoError, Sequence};
use crate::mapper::Intrinsics;
use crate::metric::{KnownLength, Measured, TimeOffset, UtcOffset};
use crate::pipeline::{
    DetectorChoice, FeatureKind, FrameOrder, GroundLabels, Instances, IntrinsicsSource, MaskChoice, MetricOptions,
    MotionChoice, Options, Stage, TelemetryChoice,
};
use crate::scene::ObjectId;
use crate::video::{Position, Turning};
use crate::{files, memory};

/// Flags that exclude those of the program's own perception.
const OWN_MASKS: [&str; 2] = ["masks", "segmentation_model"];

#[derive(Debug, clap::Args)]
pub(super) struct JobArgs {
    /// Video file, folder of images, folder of a ground-truth sequence (one with a scene.json), or `-`
    ///
    /// `-` records the video of standard input in the output folder, byte for byte, and runs on the recording.
    /// Of a sequence, images, masks, ground labels and intrinsics are used, unless given otherwise.
    pub(super) input: PathBuf,
    /// Folder for the results; created if missing, resumed if an earlier run was stopped
    #[arg(long, short, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Replace the results of another input in the output folder
    #[arg(long)]
    pub(super) overwrite: bool,

    /// Vehicle masks: one 8-bit PNG per frame with the frame's stem, 0 background, k = vehicle k
    #[arg(long, value_name = "DIR", conflicts_with = "segmentation_model", help_heading = "Vehicles")]
    pub(super) masks: Option<PathBuf>,
    /// ONNX model for instance segmentation (YOLO-seg or Mask R-CNN family) instead of the bundled networks
    #[arg(long, value_name = "FILE", help_heading = "Vehicles")]
    pub(super) segmentation_model: Option<PathBuf>,
    /// Vehicle detector: `default` (bundled), `none`, or an ONNX file (YOLOX family)
    #[arg(long, value_name = "default|none|FILE", conflicts_with_all = OWN_MASKS, help_heading = "Vehicles")]
    pub(super) detector: Option<DetectorChoice>,
    /// Detection of vehicles by motion: `on` (default) or `off`
    #[arg(
        long,
        value_name = "on|off",
        value_parser = named::<MotionChoice>,
        conflicts_with_all = OWN_MASKS,
        help_heading = "Vehicles"
    )]
    pub(super) motion: Option<MotionChoice>,
    /// Mask network: `default` (by size), `small` (faster), or `none` (coarse masks by color)
    #[arg(
        long,
        value_name = "default|small|none",
        value_parser = named::<MaskChoice>,
        conflicts_with_all = OWN_MASKS,
        help_heading = "Vehicles"
    )]
    pub(super) mask_network: Option<MaskChoice>,
    /// Interval of the mask network, frames; optical flow propagates masks in between [default: 0.4 seconds]
    #[arg(long, value_name = "N", conflicts_with_all = OWN_MASKS, help_heading = "Vehicles")]
    pub(super) segment_every: Option<u32>,
    /// ONNX model for optical flow [default: OpenCV's DIS]
    #[arg(long, value_name = "FILE", help_heading = "Vehicles")]
    pub(super) flow_model: Option<PathBuf>,

    /// Ground masks: one 8-bit PNG per frame, non-zero = ground
    #[arg(long, value_name = "DIR", conflicts_with = "ground_model", help_heading = "Ground")]
    pub(super) ground_masks: Option<PathBuf>,
    /// Value of ground in --ground-masks [default: every non-zero value]
    #[arg(long, value_name = "VALUE", requires = "ground_masks", help_heading = "Ground")]
    pub(super) ground_label: Option<u8>,
    /// ONNX model for semantic segmentation [default: the dominant plane below the camera]
    #[arg(long, value_name = "FILE", help_heading = "Ground")]
    pub(super) ground_model: Option<PathBuf>,

    /// Intrinsics fx,fy,cx,cy[,k1,k2[,p1,p2[,k3]]] in pixels of the source, or a COLMAP cameras.txt; adjusted with the
    /// background (see --intrinsics-std, --fixed) [default: from EXIF, or estimated]
    ///
    /// The center of the upper left pixel is (0.5, 0.5). For videos with non-square pixels, the source size is the one
    /// at which players show it.
    #[arg(long, value_name = "NUMBERS|FILE", help_heading = "Geometry")]
    pub(super) intrinsics: Option<IntrinsicsSource>,
    /// Hold the given intrinsics, those of --background-model included; otherwise they are adjusted within their
    /// standard deviations
    #[arg(long, conflicts_with = "intrinsics_std", help_heading = "Geometry")]
    pub(super) fixed: bool,
    /// Standard deviations of given intrinsics: shares of the focal length and, for the principal point, of the longer
    /// side of the image; radial distortion [default: 0.01,0.01,0.1]
    #[arg(long, value_name = "F[,C[,K]]", value_parser = intrinsics_std, help_heading = "Geometry")]
    pub(super) intrinsics_std: Option<Intrinsics>,
    /// Front end: `video` tracks image points from frame to frame, `sift` matches features between frames [default:
    /// video for frames in order of time, otherwise sift]
    #[arg(long, value_name = "KIND", value_parser = named::<FeatureKind>, help_heading = "Geometry")]
    pub(super) features: Option<FeatureKind>,
    /// Order of the frames: `time` or `none` (photographs: similar and near ones are matched)
    ///
    /// Default: time for videos, and for folders with --fps, --features video or a scene.json. For other folders some
    /// images are compared with their successors: with fewer than 60 % of the corners tracked, they are treated as
    /// photographs.
    #[arg(long, value_name = "ORDER", value_parser = named::<FrameOrder>, help_heading = "Frames")]
    pub(super) order: Option<FrameOrder>,
    /// Background model by another program (COLMAP, OpenMVG, OpenSfM, NVM, Bundler), used unchanged
    #[arg(long, value_name = "PATH", help_heading = "Geometry")]
    pub(super) background_model: Option<PathBuf>,
    /// Model of vehicle ID by another program, used unchanged; may be repeated
    #[arg(long, value_name = "ID=PATH", value_parser = object_model, help_heading = "Geometry")]
    pub(super) object_model: Vec<(ObjectId, PathBuf)>,
    /// Reconstruct only this vehicle; may be repeated [default: all]
    #[arg(long, value_name = "ID", value_parser = object_id, help_heading = "Geometry")]
    pub(super) only_object: Vec<ObjectId>,

    /// First frame: seconds (12.5) or a frame index (120f)
    #[arg(long, value_name = "TIME", help_heading = "Frames")]
    pub(super) start: Option<Position>,
    /// End (exclusive): seconds or a frame index
    #[arg(long, value_name = "TIME", help_heading = "Frames")]
    pub(super) end: Option<Position>,
    /// Use every N-th frame
    #[arg(long, value_name = "N", help_heading = "Frames")]
    pub(super) every: Option<u32>,
    /// Maximum longer side of the frames, pixels; larger ones are downscaled, and results are at that resolution
    #[arg(long, value_name = "PIXELS", help_heading = "Frames")]
    pub(super) max_dimension: Option<u32>,
    /// Frames per second of a folder of images
    #[arg(long, value_name = "RATE", help_heading = "Frames")]
    pub(super) fps: Option<f64>,
    /// Video track to read, counted from 0 among the file's video tracks [default: the first with moving images]
    #[arg(long, value_name = "N", help_heading = "Frames")]
    pub(super) video_track: Option<u32>,

    /// Telemetry log: subtitles of a drone, GPX, KML, NMEA, table (also by image name), or a video that has one, such
    /// as a GoPro's [default: found next to or inside the video]
    #[arg(long, value_name = "FILE", conflicts_with = "no_telemetry", help_heading = "Meters")]
    pub(super) telemetry: Option<PathBuf>,
    /// Ignore telemetry, including that found next to or inside the video
    #[arg(long, help_heading = "Meters")]
    pub(super) no_telemetry: bool,
    /// Time of the telemetry minus time of the video, seconds: 0.7±0.1 [default: from the files, or estimated]
    ///
    /// The time of a log with a clock (GPX, NMEA) counts from its first position. Default standard deviation: 0.2 s.
    #[arg(long, value_name = "SECONDS[±STD]", allow_hyphen_values = true, help_heading = "Meters")]
    pub(super) time_offset: Option<TimeOffset>,
    /// Local time minus UTC for logs or photographs without a time zone: +02:00 [default: dates stay local, without Z]
    #[arg(long, value_name = "±HH:MM", allow_hyphen_values = true, help_heading = "Meters")]
    pub(super) utc_offset: Option<UtcOffset>,
    /// Mean height of the camera above ground, meters: 1.45±0.05 (standard deviation)
    #[arg(long, value_name = "METERS[±STD]", help_heading = "Meters")]
    pub(super) camera_height: Option<Measured>,
    /// Inclination of a hovering camera below the horizon in the first frame, degrees: 45±1 [default: from straight
    /// lines, telemetry, map points and the sizes of vehicles]
    #[arg(long, value_name = "DEGREES[±STD]", help_heading = "Meters")]
    pub(super) camera_pitch: Option<Measured>,
    /// Points of the ground for a hovering camera: GeoJSON points with properties x, y (pixel) and frame (index,
    /// default: the first); with heights, if it is not level
    #[arg(long, value_name = "FILE", help_heading = "Meters")]
    pub(super) map_points: Option<PathBuf>,
    /// Known length, width or height of vehicle ID, meters: 1:length=4.47±0.02; may be repeated
    #[arg(long, value_name = "ID:NAME=METERS[±STD]", help_heading = "Meters")]
    pub(super) known_length: Vec<KnownLength>,
    /// Known meters per unit of the background: 12.3±0.1 (standard deviation)
    #[arg(long, value_name = "METERS[±STD]", help_heading = "Meters")]
    pub(super) scale: Option<Measured>,

    #[command(flatten)]
    pub(super) common: CommonArgs,
}

impl JobArgs {
    /// Returns true if a flag configures the program's own detection of vehicles.
    fn asks_for_vehicles(&self) -> bool {
        self.detector.is_some() || self.motion.is_some() || self.mask_network.is_some() || self.segment_every.is_some()
    }

    /// Has relative paths begin at a folder: that of the list in which the job stands.
    pub(super) fn begin_at(&mut self, folder: &Path) {
        let files = [
            &mut self.masks,
            &mut self.segmentation_model,
            &mut self.flow_model,
            &mut self.ground_masks,
            &mut self.ground_model,
            &mut self.background_model,
            &mut self.telemetry,
            &mut self.map_points,
            &mut self.common.options,
        ];
        let objects = self.object_model.iter_mut().map(|(_, path)| path);
        let mut paths: Vec<&mut PathBuf> = files.into_iter().flatten().chain(objects).collect();
        paths.push(&mut self.input);
        if let Some(DetectorChoice::File(path)) = &mut self.detector {
            paths.push(path);
        }
        if let Some(IntrinsicsSource::File(path)) = &mut self.intrinsics {
            paths.push(path);
        }
        paths.into_iter().for_each(|path| *path = folder.join(&*path));
    }
}

/// The flag as the help of a part of a run shows it: not at all if it is used by later parts alone. It is taken
/// nevertheless, so that the same flags serve every part.
pub(super) fn shown_up_to(goal: Stage, flag: clap::Arg) -> clap::Arg {
    let first_use = match flag.get_id().as_str() {
        "intrinsics" | "fixed" | "intrinsics_std" | "features" | "background_model" | "telemetry" | "no_telemetry"
        | "time_offset" | "utc_offset" => Stage::Features,
        "flow_model" | "mask_network" | "motion" | "segment_every" => Stage::Track,
        "object_model" | "only_object" => Stage::Follow,
        "ground_masks" | "ground_label" | "ground_model" | "camera_pitch" | "map_points" => Stage::Ground,
        "scale_method" => Stage::Scale,
        "camera_height" | "known_length" | "scale" => Stage::Metric,
        _ => Stage::Frames,
    };
    flag.hide(first_use > goal)
}

/// Input and options from the flags, the options file, and the folder of a sequence.
pub(super) fn resolve(job: &JobArgs, goal: Stage) -> Result<(PathBuf, Options), Failure> {
    resolve_over(Options::default(), job, goal)
}

/// As [`resolve`], over others than the default options.
pub(super) fn resolve_over(options: Options, job: &JobArgs, goal: Stage) -> Result<(PathBuf, Options), Failure> {
    let (input, options) = lay_over(options, job, goal)?;
    check(&options)?;
    if goal >= Stage::Ground {
        options.check_labels().map_err(|error| Failure::Usage(error.to_string()))?;
    }
    Ok((input, options))
}

/// Refuses options that cannot be, and files that they name and that are not there.
pub(super) fn check(options: &Options) -> Result<(), Failure> {
    options.check().map_err(|error| Failure::Usage(error.to_string()))?;
    check_paths(options)
}

/// As [`resolve_over`], without looking whether the files are there that are named.
pub(super) fn lay_over(options: Options, job: &JobArgs, goal: Stage) -> Result<(PathBuf, Options), Failure> {
    let mut options = job.common.over(options)?;
    apply_flags(job, &mut options);
    let mut input = job.input.clone();
    if input.join("scene.json").is_file() {
        input = apply_sequence(&Sequence::open(&job.input)?, &mut options)?;
    }
    let looks_for_vehicles = !matches!(goal, Stage::Frames | Stage::Objects);
    if looks_for_vehicles && options.instances == Instances::None {
        options.instances = Instances::Vehicles;
    }
    if options.video.turning == Turning::Auto && options.instances == Instances::None && input.is_dir() {
        options.video.turning = Turning::AsStored;
    }
    Ok((input, options))
}

pub(super) fn apply_flags(job: &JobArgs, options: &mut Options) {
    if let Some(folder) = &job.masks {
        options.instances = Instances::Masks(folder.clone());
    } else if let Some(model) = &job.segmentation_model {
        options.instances = Instances::Model(model.clone());
    } else if job.asks_for_vehicles() {
        options.instances = Instances::Vehicles;
    }
    let vehicles = &mut options.vehicles;
    vehicles.detector = job.detector.clone().unwrap_or(vehicles.detector.clone());
    vehicles.motion = job.motion.unwrap_or(vehicles.motion);
    vehicles.mask_network = job.mask_network.unwrap_or(vehicles.mask_network);
    vehicles.segment_every = job.segment_every.or(vehicles.segment_every);
    if let Some(folder) = &job.ground_masks {
        options.ground_labels = GroundLabels::Masks { folder: folder.clone(), label: job.ground_label };
    } else if let Some(model) = &job.ground_model {
        options.ground_labels = GroundLabels::Model(model.clone());
    }
    options.flow_model = job.flow_model.clone().or(options.flow_model.take());
    options.background_model = job.background_model.clone().or(options.background_model.take());
    options.object_models.extend(job.object_model.iter().cloned());
    options.only_objects.extend(job.only_object.iter().copied());
    options.intrinsics = job.intrinsics.clone().or(options.intrinsics.take());
    options.intrinsics_std = match job.fixed {
        true => Intrinsics::FIXED,
        false => job.intrinsics_std.unwrap_or(options.intrinsics_std),
    };
    options.video.start = job.start.or(options.video.start);
    options.video.end = job.end.or(options.video.end);
    options.video.every = job.every.unwrap_or(options.video.every);
    options.video.max_dimension = job.max_dimension.or(options.video.max_dimension);
    options.video.fps = job.fps.or(options.video.fps);
    options.video.track = job.video_track.or(options.video.track);
    options.features = job.features.unwrap_or(options.features);
    options.order = job.order.unwrap_or(options.order);
    apply_metres(job, &mut options.metric);
}

fn apply_metres(job: &JobArgs, metric: &mut MetricOptions) {
    if let Some(path) = &job.telemetry {
        metric.telemetry = TelemetryChoice::File(path.clone());
    } else if job.no_telemetry {
        metric.telemetry = TelemetryChoice::None;
    }
    metric.time_offset = job.time_offset.or(metric.time_offset);
    metric.utc_offset = job.utc_offset.or(metric.utc_offset);
    metric.camera_height = job.camera_height.or(metric.camera_height);
    metric.camera_pitch = job.camera_pitch.or(metric.camera_pitch);
    metric.map_points = job.map_points.clone().or(metric.map_points.take());
    metric.scale = job.scale.or(metric.scale);
    metric.known_lengths.extend(job.known_length.iter().copied());
}

/// Fills in what a ground-truth sequence knows and nobody gave; gives its folder of images or its video.
pub(super) fn apply_sequence(sequence: &Sequence, options: &mut Options) -> Result<PathBuf, IoError> {
    let input = sequence.input()?;
    let Some(first) = sequence.frames.first() else { return Ok(input) };
    let folder_of = |file: &Path| sequence.folder.join(file.parent().unwrap_or(Path::new("")));
    if options.instances == Instances::None {
        options.instances = Instances::Masks(folder_of(&first.mask));
    }
    if let (GroundLabels::Geometric, Some(semantic)) = (&options.ground_labels, &first.semantic) {
        let label = Some(crate::io::GROUND_LABEL);
        options.ground_labels = GroundLabels::Masks { folder: folder_of(semantic), label };
    }
    if options.intrinsics.is_none() {
        options.intrinsics = Some(IntrinsicsSource::Given(sequence.camera.intrinsics().to_vec()));
        // They are those of the renderer, and exact unless stated otherwise.
        if options.intrinsics_std == Intrinsics::GIVEN {
            options.intrinsics_std = Intrinsics::FIXED;
        }
    }
    if input.is_dir() {
        options.video.fps = options.video.fps.or(Some(sequence.fps));
    }
    Ok(input)
}

/// Says which file is missing before any work starts.
fn check_paths(options: &Options) -> Result<(), Failure> {
    // Telemetry is read whole before work begins, and what is wrong with it is reported then.
    for (flag, path) in options.named_paths().into_iter().filter(|(flag, _)| *flag != "--telemetry") {
        let found = fs::metadata(path).and_then(|found| if found.is_dir() { Ok(()) } else { files::check(path) });
        found.with_context(|| format!("{}: cannot be read; check {flag}", path.display()))?;
    }
    Ok(())
}

/// Takes as many threads and as much memory of the machine as the options say, where they do.
pub(super) fn use_machine(options: &Options) -> Result<(), Failure> {
    if let Some(limit) = options.memory_limit {
        memory::limit_process(limit);
    }
    let Some(threads) = options.threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("cannot start the threads")?;
    opencv::core::set_num_threads(i32::try_from(threads).unwrap_or(i32::MAX))?;
    Ok(())
}

fn object_id(text: &str) -> Result<ObjectId, String> {
    let id = text.parse().ok().filter(|id| *id > 0);
    id.map(ObjectId).ok_or_else(|| format!("'{text}': expected an id, 1 or larger"))
}

fn intrinsics_std(text: &str) -> Result<Intrinsics, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|field| field.trim().parse::<f64>()).collect();
    let given = Intrinsics::GIVEN;
    let std = match numbers.as_deref() {
        Ok(&[focal]) => Intrinsics { focal, ..given },
        Ok(&[focal, principal]) => Intrinsics { focal, principal, ..given },
        Ok(&[focal, principal, distortion]) => Intrinsics { focal, principal, distortion },
        _ => return Err(format!("'{text}': expected one to three numbers, such as 0.01,0.01,0.1")),
    };
    std.check().map_err(|error| error.to_string())?;
    Ok(std)
}

fn object_model(text: &str) -> Result<(ObjectId, PathBuf), String> {
    let parsed = text.split_once('=').and_then(|(id, path)| Some((id.parse().ok()?, path)));
    match parsed {
        Some((id, path)) if id > 0 && !path.is_empty() => Ok((ObjectId(id), path.into())),
        _ => Err(format!("'{text}': expected ID=PATH with an id of 1 or larger")),
    }
}
