//! The tree of options: everything that decides a result.

mod ablation;
mod method;
mod metres;
mod public;
mod reference;
mod schema;
mod tree;
mod vehicles;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use ablation::Ablation;
pub use method::Method;
pub use metres::{MetricOptions, TelemetryChoice};
pub use reference::{OptionRow, OptionSection};
pub use vehicles::{DetectorChoice, MaskChoice, MotionChoice, VehicleOptions};

use super::Result;
use crate::camera::Camera;
use crate::checks::{Checked, OptionError, under, within};
use crate::ffi::onnx::{Provider, Resources};
use crate::io::interchange::colmap::Encoding;
use crate::mapper::Intrinsics;
use crate::memory::MemoryLimit;
use crate::networks::{DetectorOptions, GroundOptions, PromptOptions, SegmentationOptions};
use crate::scene::ObjectId;
use crate::tracking::TrackerOptions;
use crate::{ground, sfm, trajectory, video};

/// Where the vehicles' masks come from.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Instances {
    /// No vehicles: the whole image is background.
    #[default]
    None,
    /// Folder of given masks: an 8-bit PNG per frame, 0 for background, k for object k.
    Masks(PathBuf),
    /// ONNX model for instance segmentation, with tracking by optical flow.
    Model(PathBuf),
    /// Bundled networks and motion, as set in `vehicles`.
    Vehicles,
}

/// Where the ground labels come from.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum GroundLabels {
    /// Geometry only: the dominant plane below the camera.
    #[default]
    Geometric,
    /// Folder of given masks: an 8-bit PNG per frame; `label` is the ground's value, all but 0 if missing.
    Masks {
        /// The folder.
        folder: PathBuf,
        /// The value that means ground; without it every value but 0 does.
        label: Option<u8>,
    },
    /// ONNX model for semantic segmentation.
    Model(PathBuf),
}

/// Where the camera's intrinsics are known from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum IntrinsicsSource {
    /// fx, fy, cx, cy, k1, k2 and optionally p1, p2, k3, in pixels of the source; center of the first pixel at (0.5,
    /// 0.5).
    Given(Vec<f64>),
    /// COLMAP `cameras.txt` or `cameras.bin`.
    File(PathBuf),
}

impl FromStr for IntrinsicsSource {
    type Err = String;

    /// `fx,fy,cx,cy[,k1,k2[,p1,p2[,k3]]]`, or the path of a COLMAP cameras file.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|field| field.trim().parse::<f64>()).collect();
        let Ok(numbers) = numbers else {
            if text.ends_with(".txt") || text.ends_with(".bin") {
                return Ok(Self::File(text.into()));
            }
            return Err(format!("'{text}': expected {INTRINSICS} or a COLMAP cameras.txt"));
        };
        let camera = Camera::prior(1, 1).with_parameters(&numbers);
        let camera = camera.ok_or_else(|| not_intrinsics(numbers.len()))?;
        let values = if numbers.len() > 6 { camera.parameters().to_vec() } else { camera.intrinsics().to_vec() };
        if !values.iter().all(|v| v.is_finite()) || values[0] <= 0.0 || values[1] <= 0.0 {
            return Err("focal lengths must be positive and all numbers finite".to_owned());
        }
        Ok(Self::Given(values))
    }
}

/// Form in which intrinsics are given.
const INTRINSICS: &str = "fx,fy,cx,cy[,k1,k2[,p1,p2[,k3]]]";

/// Message for a wrong number of values.
pub(super) fn not_intrinsics(count: usize) -> String {
    format!("{INTRINSICS}: expected 4, 5, 6, 8 or 9 numbers, found {count}")
}

/// Kind of image points and of their matching across frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureKind {
    /// `video` for frames of a video, `sift` for unordered frames.
    #[default]
    Auto,
    /// Points tracked from frame to frame.
    Video,
    /// SIFT features, matched between frames.
    Sift,
}

/// Temporal order of the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FrameOrder {
    /// Videos and folders with a frame rate are ordered; other folders are tested on a few images.
    #[default]
    Auto,
    /// Frames are in temporal order.
    Time,
    /// Unordered photographs.
    None,
}

/// Everything that decides a result. Stages nest the options of what they use.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Selection of frames.
    pub video: video::Options,
    /// Source of the vehicles' masks.
    pub instances: Instances,
    /// ONNX model for optical flow; `None` for OpenCV's DIS.
    pub flow_model: Option<PathBuf>,
    /// Source of the ground labels.
    pub ground_labels: GroundLabels,
    /// Front end of background and objects: `auto` is `video`, or `sift` for unordered frames; other values override
    /// `front_end.kind` of both.
    pub features: FeatureKind,
    /// Temporal order of the frames.
    pub order: FrameOrder,
    /// Camera intrinsics; `None` for EXIF data of photographs, otherwise a guess that is refined.
    pub intrinsics: Option<IntrinsicsSource>,
    /// Standard deviations of given intrinsics, those of `background_model` included; 0 holds them.
    pub intrinsics_std: Intrinsics,
    /// Model of the background to be used instead of a reconstruction, in any format that `tractrix convert` reads.
    pub background_model: Option<PathBuf>,
    /// Models of objects, by id, to be used instead of reconstructions.
    pub object_models: BTreeMap<ObjectId, PathBuf>,
    /// Format of the COLMAP models written.
    pub model_files: Encoding,
    /// Ids of the objects to be reconstructed; empty for all. Others are only kept out of the background.
    pub only_objects: BTreeSet<ObjectId>,
    /// Vehicle detection by the bundled networks and by motion.
    pub vehicles: VehicleOptions,
    /// Implementation and device that run networks.
    pub provider: Provider,
    /// Vehicle detector.
    pub detector: DetectorOptions,
    /// Segmentation of boxes.
    pub prompt: PromptOptions,
    /// Instance segmentation by a network of the user.
    pub segmentation: SegmentationOptions,
    /// Tracking of vehicles.
    pub tracker: TrackerOptions,
    /// Masking of moving objects in the background.
    pub masking: MaskingOptions,
    /// Structure from motion of the background.
    pub background: sfm::Options,
    /// Structure from motion of an object.
    pub objects: sfm::Options,
    /// Ground labels by a semantic segmentation network.
    pub ground_segmentation: GroundOptions,
    /// Ground points and local ground planes.
    pub ground: ground::Options,
    /// Scale ratio between vehicle and background.
    pub scale: trajectory::Options,
    /// Sources of the metric scale besides typical vehicle sizes; all are fused.
    pub metric: MetricOptions,
    /// Seed of all random numbers.
    #[schemars(extend("unit" = "any whole number"))]
    pub seed: u64,
    /// Number of threads; `None` for one per core. Results agree to 1e-8.
    #[schemars(extend("unit" = "threads"))]
    pub threads: Option<usize>,
    /// Memory limit for input files, images and networks, such as `2GiB`; `None` for four fifths of the machine's or
    /// control group's. Results do not depend on it.
    #[schemars(with = "Option<String>", extend("unit" = "MiB or GiB"))]
    pub memory_limit: Option<MemoryLimit>,
}

/// Masking of moving objects in the background.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MaskingOptions {
    /// Dilation of the masks of moving objects before the rest counts as background.
    #[schemars(extend("unit" = "share of the longer side"))]
    pub dilation: f64,
}

impl MaskingOptions {
    /// Dilation in images of a size, pixels.
    pub fn dilation_px(&self, (width, height): (u32, u32)) -> u32 {
        (self.dilation * f64::from(width.max(height))).round() as u32
    }

    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`] names the option.
    pub fn check(&self) -> Checked {
        within("dilation", self.dilation, 0.0..=0.5)
    }
}

impl Default for MaskingOptions {
    fn default() -> Self {
        // Five pixels at 960: the tracked masks' borders are good to two or three, and shadows touch the wheels.
        Self { dilation: 0.005 }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            video: video::Options::default(),
            instances: Instances::None,
            flow_model: None,
            ground_labels: GroundLabels::Geometric,
            features: FeatureKind::Auto,
            order: FrameOrder::Auto,
            intrinsics: None,
            intrinsics_std: Intrinsics::GIVEN,
            background_model: None,
            object_models: BTreeMap::new(),
            model_files: Encoding::Auto,
            only_objects: BTreeSet::new(),
            vehicles: VehicleOptions::default(),
            provider: Provider::default(),
            detector: DetectorOptions::default(),
            prompt: PromptOptions::default(),
            segmentation: SegmentationOptions::default(),
            tracker: TrackerOptions::default(),
            masking: MaskingOptions::default(),
            background: sfm::Options::background(),
            objects: sfm::Options::object(),
            ground_segmentation: GroundOptions::default(),
            ground: ground::Options::default(),
            scale: trajectory::Options::default(),
            metric: MetricOptions::default(),
            seed: 0,
            threads: None,
            memory_limit: None,
        }
    }
}

impl Options {
    /// Returns true if an object is to be reconstructed.
    pub(super) fn wants(&self, id: ObjectId) -> bool {
        self.only_objects.is_empty() || self.only_objects.contains(&id)
    }

    /// Resources that a network may use.
    pub fn resources(&self) -> Resources {
        Resources { num_threads: self.threads.unwrap_or(0), memory: self.memory(), provider: self.provider }
    }

    /// Memory limit.
    pub(super) fn memory(&self) -> MemoryLimit {
        self.memory_limit.unwrap_or_else(MemoryLimit::of_machine)
    }

    /// Every file and folder that the options name, after the flag that sets it.
    pub fn named_paths(&self) -> Vec<(&'static str, &Path)> {
        let mut named: Vec<(&'static str, &Path)> = Vec::new();
        match &self.instances {
            Instances::None | Instances::Vehicles => {}
            Instances::Masks(folder) => named.push(("--masks", folder)),
            Instances::Model(model) => named.push(("--segmentation-model", model)),
        }
        if let (Instances::Vehicles, DetectorChoice::File(model)) = (&self.instances, &self.vehicles.detector) {
            named.push(("--detector", model));
        }
        match &self.ground_labels {
            GroundLabels::Geometric => {}
            GroundLabels::Masks { folder, .. } => named.push(("--ground-masks", folder)),
            GroundLabels::Model(model) => named.push(("--ground-model", model)),
        }
        if let Some(IntrinsicsSource::File(path)) = &self.intrinsics {
            named.push(("--intrinsics", path));
        }
        if let TelemetryChoice::File(path) = &self.metric.telemetry {
            named.push(("--telemetry", path));
        }
        named.extend(self.metric.map_points.iter().map(|path| ("--map-points", path.as_path())));
        named.extend(self.flow_model.iter().map(|path| ("--flow-model", path.as_path())));
        named.extend(self.named_models());
        named
    }

    /// The models that are given, after the flags that name them.
    pub(super) fn named_models(&self) -> Vec<(&'static str, &Path)> {
        let background = self.background_model.iter().map(|path| ("--background-model", path.as_path()));
        let objects = self.object_models.values().map(|path| ("--object-model", path.as_path()));
        background.chain(objects).collect()
    }

    /// Rejects what contradicts itself or cannot be worked with, at every level of the tree, before work starts.
    ///
    /// # Errors
    /// [`PipelineError::Option`](super::PipelineError::Option) names the option by its path in the tree.
    pub fn check(&self) -> Result<()> {
        let spelled = |error: OptionError| OptionError { key: public::spelled(&error.key), ..error };
        Ok(self.check_tree().map_err(spelled)?)
    }

    fn check_tree(&self) -> Checked {
        self.check_input()?;
        under("video", self.video.check())?;
        under("vehicles", self.vehicles.check())?;
        under("detector", self.detector.check())?;
        under("prompt", self.prompt.check())?;
        under("segmentation", self.segmentation.check())?;
        under("tracker", self.tracker.check())?;
        under("masking", self.masking.check())?;
        under("background", self.background.check())?;
        under("objects", self.objects.check())?;
        under("ground_segmentation", self.ground_segmentation.check())?;
        under("ground", self.ground.check())?;
        under("scale", self.scale.check())?;
        under("metric", self.metric.check())
    }

    /// Checks the options at the root of the tree.
    fn check_input(&self) -> Checked {
        if let Some(threads) = self.threads {
            within("threads", threads, 1..=MOST_THREADS)?;
        }
        if (self.features, self.order) == (FeatureKind::Video, FrameOrder::None) {
            let reason = "--features video needs frames in order of time; remove --order none, or give --features sift";
            return Err(OptionError::new("features", reason));
        }
        if self.object_models.keys().any(|id| id.0 == 0) {
            return Err(OptionError::new("object_models", "object ids start at 1"));
        }
        if self.only_objects.contains(&ObjectId(0)) {
            return Err(OptionError::new("only_objects", "object ids start at 1"));
        }
        under("intrinsics_std", self.intrinsics_std.check())?;
        match &self.intrinsics {
            Some(IntrinsicsSource::Given(values)) => check_intrinsics(values),
            _ => Ok(()),
        }
    }
}

/// More threads are no help to anybody, and to start them would take the memory that the work needs.
pub const MOST_THREADS: usize = 1024;

/// Pictures have some ten thousand pixels a side at the most; whatever camera took them, intrinsics are of that order.
fn check_intrinsics(values: &[f64]) -> Checked {
    let Some(camera) = Camera::prior(1, 1).with_parameters(values) else {
        return Err(OptionError::new("intrinsics", not_intrinsics(values.len())));
    };
    let [fx, fy, cx, cy, distortion @ ..] = camera.parameters();
    let checks = [fx, fy].map(|focal| within("focal length", focal, 1.0..=1e6));
    let centers = [cx, cy].map(|center| within("principal point", center, -1e6..=1e6));
    let distortion = distortion.map(|k| within("distortion", k, -100.0..=100.0));
    let all = checks.into_iter().chain(centers).chain(distortion).collect::<Checked>();
    all.map_err(|e| OptionError::new("intrinsics", format!("{}: {}", e.key, e.reason)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::PipelineError;

    #[test]
    fn intrinsics_are_numbers_or_a_file() {
        assert_eq!("880,880,480,270".parse(), Ok(IntrinsicsSource::Given(vec![880.0, 880.0, 480.0, 270.0, 0.0, 0.0])));
        assert_eq!("1,2,3,4,.5,-6".parse(), Ok(IntrinsicsSource::Given(vec![1.0, 2.0, 3.0, 4.0, 0.5, -6.0])));
        let all = vec![1.0, 2.0, 3.0, 4.0, 0.5, -6.0, 7.0, 8.0, 0.0];
        assert_eq!("1,2,3,4,.5,-6,7,8".parse(), Ok(IntrinsicsSource::Given(all)));
        assert!("1,2,3,4,5,6,7".parse::<IntrinsicsSource>().unwrap_err().contains("found 7"));
        assert_eq!("a/cameras.txt".parse(), Ok(IntrinsicsSource::File("a/cameras.txt".into())));
        for wrong in ["", "1,2,3", "0,1,2,3", "1,2,3,4,5,6,7", "nan,1,2,3", "model"] {
            assert!(wrong.parse::<IntrinsicsSource>().is_err(), "{wrong}");
        }
    }

    /// Options with everything given that is left out by default.
    fn full() -> Options {
        let options = Options::default();
        Options {
            video: video::Options { max_dimension: Some(640), fps: Some(25.0), ..options.video.clone() },
            ground_labels: GroundLabels::Masks { folder: "masks".into(), label: Some(3) },
            intrinsics: Some(IntrinsicsSource::Given(vec![800.0, 800.0, 480.0, 270.0, 0.0, 0.0])),
            only_objects: [ObjectId(1)].into(),
            threads: Some(2),
            ..options
        }
    }

    #[test]
    fn no_number_can_do_harm() {
        use serde_json::json;
        let wrong =
            [json!(0), json!(-1), json!(null), json!(1e300), json!(-1e300), json!(1e-300), json!(u64::MAX), json!(0.5)];
        let (mut tried, mut refused) = (0, 0);
        for options in [Options::default(), full()] {
            assert!(options.check().is_ok());
            let tree = json!(options);
            let paths = crate::checks::testing::numbers(&tree, "");
            assert!(paths.len() > 90, "{}", paths.len());
            for (path, value) in paths.iter().flat_map(|path| wrong.iter().map(move |value| (path, value))) {
                let mut given = tree.clone();
                *given.pointer_mut(path).unwrap() = value.clone();
                tried += 1;
                let name = path.rsplit('/').find(|name| name.parse::<usize>().is_err()).unwrap();
                let checked = options.with_tree(&given).map_err(PipelineError::from).and_then(|found| found.check());
                let Err(error) = checked else { continue };
                refused += 1;
                let PipelineError::Option(error) = error else { panic!("{path}: {error}") };
                let key = public::in_tree(&error.key).replace('.', "/");
                let is_named = format!("{path}/").starts_with(&format!("/{key}/"));
                assert!(is_named || error.to_string().contains(name), "{path}: {error}");
            }
        }
        assert!(2 * refused > tried, "{refused} of {tried}");
    }

    #[test]
    fn the_number_of_threads_stands_at_the_root_alone() {
        // All below the root may go into fingerprints, of which the number of threads is no part.
        for options in [Options::default(), full()] {
            let mut tree = serde_json::json!(options);
            tree.as_object_mut().unwrap().remove("threads");
            assert!(!tree.to_string().contains("threads"), "{tree}");
        }
    }

    #[test]
    fn limits_that_contradict_one_another_are_refused() {
        let wrong = [
            ("background.mapper.min_error_px", "5"),
            ("background.mapper.loss_scale_px", "0.01"),
            ("objects.mapper.max_starts", "0"),
            ("objects.front_end.video.patch_radius_px", "-1"),
            ("ground.min_points", "60"),
            ("tracker.min_detections", "0"),
            ("scale.joint.sigma_distance", "[0.2, 0.1]"),
            ("scale.joint.contact.side", "[0.1, 0]"),
            ("intrinsics.given", "[0, 800, 480, 270, 0, 0]"),
            ("threads", "0"),
            ("only_objects", "[0]"),
        ];
        for (key, value) in wrong {
            let options = Options::default().with_value(key, value).unwrap();
            let said = options.check().unwrap_err().to_string();
            assert!(said.contains(key.rsplit('.').next().unwrap()) || said.contains("intrinsics"), "{key}: {said}");
        }
    }

    #[test]
    fn points_cannot_be_followed_without_order() {
        let wrong = Options { features: FeatureKind::Video, order: FrameOrder::None, ..Options::default() };
        assert!(wrong.check().is_err());
        assert!(Options { order: FrameOrder::Auto, ..wrong }.check().is_ok());
    }
}
