use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::PipelineError;
use crate::camera::Camera;
use crate::perception::{FlowOptions, GroundOptions, SegmentationOptions, TrackerOptions};
use crate::scene::ObjectId;
use crate::{ground, sfm, trajectory, video};

/// Where the vehicles' masks come from.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Instances {
    /// No vehicles are looked for: the whole picture is background.
    #[default]
    None,
    /// Given: a folder with one 8-bit PNG per frame, 0 background, k = object k.
    Masks(PathBuf),
    /// An ONNX model for instance segmentation, and tracking by optical flow.
    Model(PathBuf),
}

/// Where the ground labels come from.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GroundLabels {
    /// From geometry alone: the dominant plane below the camera.
    #[default]
    Geometric,
    /// Given: a folder with one 8-bit PNG per frame.
    Masks {
        /// The folder.
        folder: PathBuf,
        /// The value that means ground; without it every value but 0 does.
        label: Option<u8>,
    },
    /// An ONNX model for semantic segmentation.
    Model(PathBuf),
}

/// What is known of the camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Intrinsics {
    /// fx, fy, cx, cy, k1, k2 in pixels of the source, first pixel centre at (0.5, 0.5).
    Given([f64; 6]),
    /// A COLMAP `cameras.txt` or `cameras.bin` with one camera.
    File(PathBuf),
}

impl FromStr for Intrinsics {
    type Err = String;

    /// `fx,fy,cx,cy[,k1,k2]`, or the path of a COLMAP cameras file.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|field| field.trim().parse::<f64>()).collect();
        let Ok(numbers) = numbers else {
            if text.ends_with(".txt") || text.ends_with(".bin") {
                return Ok(Self::File(text.into()));
            }
            return Err(format!("'{text}' is neither fx,fy,cx,cy[,k1,k2] nor a COLMAP cameras.txt"));
        };
        let values = match numbers[..] {
            [fx, fy, cx, cy] => [fx, fy, cx, cy, 0.0, 0.0],
            [fx, fy, cx, cy, k1] => [fx, fy, cx, cy, k1, 0.0],
            [fx, fy, cx, cy, k1, k2] => [fx, fy, cx, cy, k1, k2],
            _ => return Err(format!("fx,fy,cx,cy[,k1,k2] are four to six numbers, not {}", numbers.len())),
        };
        if !values.iter().all(|v| v.is_finite()) || values[0] <= 0.0 || values[1] <= 0.0 {
            return Err("focal lengths must be positive and all numbers finite".to_owned());
        }
        Ok(Self::Given(values))
    }
}

/// How image points are found and told again in other frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureKind {
    /// As the order of the frames wants it: `Video` in time, `Sift` without order.
    #[default]
    Auto,
    /// Points followed from frame to frame.
    Video,
    /// SIFT in every frame, matched between frames.
    Sift,
}

/// Whether frames follow one another in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameOrder {
    /// A video file does, and a folder whose rate is given; of other folders a few pictures and their successors are
    /// looked at.
    #[default]
    Auto,
    /// They do.
    Time,
    /// They do not: photographs.
    None,
}

/// Everything that decides a result. Stages nest the options of what they use.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Which frames are taken, and how large.
    pub video: video::Options,
    /// Where the vehicles' masks come from.
    pub instances: Instances,
    /// An ONNX model for optical flow; `None` is OpenCV's DIS.
    pub flow_model: Option<PathBuf>,
    /// Where the ground labels come from.
    pub ground_labels: GroundLabels,
    /// How image points are found.
    pub features: FeatureKind,
    /// Whether frames follow one another in time.
    pub order: FrameOrder,
    /// The camera; `None` is EXIF where a photograph has it, else a guess that is refined.
    pub intrinsics: Option<Intrinsics>,
    /// A COLMAP model of the background, taken as it is instead of reconstructing one.
    pub background_model: Option<PathBuf>,
    /// COLMAP models of objects, taken as they are.
    pub object_models: BTreeMap<ObjectId, PathBuf>,
    /// Objects that are reconstructed; empty is all. The others are still kept out of the background.
    pub only_objects: BTreeSet<ObjectId>,
    /// How instances are found in a frame.
    pub segmentation: SegmentationOptions,
    /// Optical flow.
    pub flow: FlowOptions,
    /// How instances become tracks.
    pub tracker: TrackerOptions,
    /// How the background keeps away from what moves.
    pub masking: MaskingOptions,
    /// Structure from motion of the background.
    pub background: sfm::Options,
    /// Structure from motion of an object.
    pub objects: sfm::Options,
    /// How a semantic model's classes become ground.
    pub ground_segmentation: GroundOptions,
    /// Ground points and local planes.
    pub ground: ground::Options,
    /// The scale ratio.
    pub scale: trajectory::Options,
    /// Seed of every random choice.
    pub seed: u64,
    /// Threads; `None` is one per core. Results agree whatever the number.
    pub threads: Option<usize>,
}

/// How the background keeps away from what moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MaskingOptions {
    /// Growth of the masks, as a share of the frame's longer side.
    pub dilation: f64,
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
            background_model: None,
            object_models: BTreeMap::new(),
            only_objects: BTreeSet::new(),
            segmentation: SegmentationOptions::default(),
            flow: FlowOptions::default(),
            tracker: TrackerOptions::default(),
            masking: MaskingOptions::default(),
            background: sfm::Options::background(),
            objects: sfm::Options::object(),
            ground_segmentation: GroundOptions::default(),
            ground: ground::Options::default(),
            scale: trajectory::Options::default(),
            seed: 0,
            threads: None,
        }
    }
}

impl Options {
    /// Whether an object is to be reconstructed.
    pub(super) fn wants(&self, id: ObjectId) -> bool {
        self.only_objects.is_empty() || self.only_objects.contains(&id)
    }

    /// Every file and folder that the options name, after the flag that sets it.
    pub fn named_paths(&self) -> Vec<(&'static str, &Path)> {
        let mut named: Vec<(&'static str, &Path)> = Vec::new();
        match &self.instances {
            Instances::None => {}
            Instances::Masks(folder) => named.push(("--masks", folder)),
            Instances::Model(model) => named.push(("--segmentation-model", model)),
        }
        match &self.ground_labels {
            GroundLabels::Geometric => {}
            GroundLabels::Masks { folder, .. } => named.push(("--ground-masks", folder)),
            GroundLabels::Model(model) => named.push(("--ground-model", model)),
        }
        if let Some(Intrinsics::File(path)) = &self.intrinsics {
            named.push(("--intrinsics", path));
        }
        named.extend(self.flow_model.iter().map(|path| ("--flow-model", path.as_path())));
        named.extend(self.background_model.iter().map(|path| ("--background-model", path.as_path())));
        named.extend(self.object_models.values().map(|path| ("--object-model", path.as_path())));
        named
    }

    /// Rejects contradictions before work starts.
    ///
    /// # Errors
    /// [`PipelineError`] says which option to change.
    pub fn check(&self) -> Result<(), PipelineError> {
        self.video.check()?;
        if self.threads == Some(0) {
            return Err(PipelineError::Options("--threads must be at least 1".to_owned()));
        }
        if (self.features, self.order) == (FeatureKind::Video, FrameOrder::None) {
            let text =
                "--features video needs frames in order of time; leave out --order none, or take --features sift";
            return Err(PipelineError::Options(text.to_owned()));
        }
        if !(0.0..=0.5).contains(&self.masking.dilation) {
            return Err(PipelineError::Options("masking.dilation must lie between 0 and 0.5".to_owned()));
        }
        if self.object_models.keys().any(|id| id.0 == 0) {
            return Err(PipelineError::Options("--object-model: object ids start at 1".to_owned()));
        }
        Ok(())
    }
}

/// The camera that the options and the input give, at the size of the frames, and whether it is known well enough to be
/// kept as it is.
pub(super) fn camera(
    intrinsics: Option<&Intrinsics>,
    info: &video::Info,
) -> Result<(Camera, CameraOrigin), PipelineError> {
    let at_source = |values: [f64; 6]| {
        let source = Camera::prior(info.source_width, info.source_height).with_intrinsics(values);
        source.resized(info.width, info.height)
    };
    match intrinsics {
        Some(Intrinsics::Given(values)) => Ok((at_source(*values), CameraOrigin::Given)),
        Some(Intrinsics::File(path)) => {
            let cameras = crate::io::colmap::read_cameras(path)?;
            let mut cameras = cameras.into_values();
            match (cameras.next(), cameras.next()) {
                (Some(camera), None) => Ok((camera.resized(info.width, info.height), CameraOrigin::Given)),
                _ => Err(PipelineError::Options(format!("{}: must hold exactly one camera", path.display()))),
            }
        }
        None => Ok(match info.exif_focal_px {
            Some(focal) => (Camera::with_focal(info.width, info.height, focal), CameraOrigin::Exif),
            None => (Camera::prior(info.width, info.height), CameraOrigin::Guess),
        }),
    }
}

/// Where intrinsics come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum CameraOrigin {
    /// The user.
    Given,
    /// The photographs.
    Exif,
    /// Nothing: 1.2 × the longer side.
    Guess,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intrinsics_are_numbers_or_a_file() {
        assert_eq!("880,880,480,270".parse(), Ok(Intrinsics::Given([880.0, 880.0, 480.0, 270.0, 0.0, 0.0])));
        assert_eq!("1,2,3,4,.5,-6".parse(), Ok(Intrinsics::Given([1.0, 2.0, 3.0, 4.0, 0.5, -6.0])));
        assert_eq!("a/cameras.txt".parse(), Ok(Intrinsics::File("a/cameras.txt".into())));
        for wrong in ["", "1,2,3", "0,1,2,3", "1,2,3,4,5,6,7", "nan,1,2,3", "model"] {
            assert!(wrong.parse::<Intrinsics>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn points_cannot_be_followed_without_order() {
        let wrong = Options { features: FeatureKind::Video, order: FrameOrder::None, ..Options::default() };
        assert!(wrong.check().is_err());
        assert!(Options { order: FrameOrder::Auto, ..wrong }.check().is_ok());
    }

    #[test]
    fn cameras_follow_the_frames_size() {
        let info = video::Info {
            kind: video::Kind::Video,
            width: 480,
            height: 270,
            source_width: 960,
            source_height: 540,
            fps: None,
            num_frames: None,
            rotation_deg: 0,
            exif_focal_px: None,
        };
        let given = Intrinsics::Given([880.0, 880.0, 480.0, 270.0, 0.0, 0.0]);
        let (camera, origin) = camera(Some(&given), &info).unwrap();
        assert_eq!((camera.focal, camera.principal, origin), ([440.0; 2], [240.0, 135.0], CameraOrigin::Given));
        let (camera, origin) = super::camera(None, &info).unwrap();
        assert_eq!((camera.focal, origin), ([576.0; 2], CameraOrigin::Guess));
    }
}
