//! Reports on models: registered frames, cameras, errors.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::scene::{CameraId, FocalChange, FrameId, Reconstruction, Warning};

/// Report on a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ModelReport {
    /// True if the user gave it.
    pub given: bool,
    /// Frames in which the target is visible.
    pub num_visible: usize,
    /// Frames whose camera is known.
    pub num_registered: usize,
    /// Frames in which the target is visible and the camera is not known, and why.
    pub unregistered: BTreeMap<FrameId, String>,
    /// Why there is no model at all, where there is none.
    pub failure: Option<String>,
    /// Points.
    pub num_points: usize,
    /// Points that were rejected since they came to lie behind a camera that observes them, or at infinity.
    pub num_infinite_points: usize,
    /// Mean reprojection error, pixels; `None` without observations.
    pub mean_error_px: Option<f64>,
    /// Weaknesses of the model: a planar scene, forward motion, ...
    pub remarks: Vec<Warning>,
    /// True if its cameras are those of the background: the target is seen as something that does not move.
    pub shares_cameras: bool,
    /// Points that were taken out because they project next to the object's masks.
    pub num_outside_masks: usize,
    /// The first of its cameras.
    pub camera: Option<Camera>,
    /// Focal length of the first camera, pixels.
    pub focal_length_px: Option<f64>,
    /// Standard deviation of that focal length, pixels; `None` where it was given and not looked for.
    pub focal_std_px: Option<f64>,
    /// Changes of the focal length during the video, which the model takes for motion.
    pub focal_changes: Vec<FocalChange>,
    /// All cameras, of a model that was reconstructed.
    pub cameras: Vec<CameraReport>,
}

/// A camera of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraReport {
    /// Its id in the model.
    pub id: CameraId,
    /// Its intrinsics.
    pub camera: Camera,
    /// Standard deviation of its focal length, pixels; `None` where it was given, or where eight other cameras took
    /// more pictures.
    pub focal_std_px: Option<f64>,
    /// Its registered frames.
    pub frames: Vec<FrameId>,
}

impl ModelReport {
    pub(in crate::pipeline) fn describe_points(&mut self, model: &Reconstruction) {
        self.num_points = model.points.len();
        self.mean_error_px = model.mean_reprojection_error_px();
        self.camera = model.cameras.values().next().copied();
        self.focal_length_px = self.camera.as_ref().map(Camera::mean_focal);
    }

    /// `focal_deviations` are shares, by place of the camera.
    pub(super) fn describe_cameras(&mut self, model: &Reconstruction, focal_deviations: &[Option<f64>]) {
        let frames_of = |id: CameraId| {
            model.images.iter().filter(|(_, image)| image.camera == id).map(|(image, _)| image.frame()).collect()
        };
        let described = |(&id, camera): (&CameraId, &Camera)| {
            let share = (id.0 as usize).checked_sub(1).and_then(|place| *focal_deviations.get(place)?);
            let focal_std_px = share.map(|share| share * camera.mean_focal());
            CameraReport { id, camera: *camera, focal_std_px, frames: frames_of(id) }
        };
        self.cameras = model.cameras.iter().map(described).collect();
        self.focal_std_px = self.cameras.first().and_then(|first| first.focal_std_px);
    }

    /// Standard deviation of the focal length as a share of it; `None` where it was given.
    pub(in crate::pipeline) fn focal_deviation(&self) -> Option<f64> {
        Some(self.focal_std_px? / self.focal_length_px?)
    }
}
