//! Reports on models: registered frames, cameras, errors.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::scene::{CameraId, FocalChange, FrameId, Reconstruction, Warning};

/// Report on a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ModelReport {
    /// True for a model given by the user.
    pub given: bool,
    /// Frames in which the target is visible.
    pub num_visible: usize,
    /// Registered frames.
    pub num_registered: usize,
    /// Unregistered frames in which the target is visible, with the reasons.
    pub unregistered: BTreeMap<FrameId, String>,
    /// Reason for a missing model, if there is none.
    pub failure: Option<String>,
    /// Points.
    pub num_points: usize,
    /// Points that were rejected behind a camera that observes them, or at infinity.
    pub num_infinite_points: usize,
    /// Mean reprojection error, pixels; `None` without observations.
    pub mean_error_px: Option<f64>,
    /// Weaknesses of the model: a planar scene, forward motion, ...
    pub remarks: Vec<Warning>,
    /// True if its cameras are those of the background: the target is reconstructed as stationary.
    pub shares_cameras: bool,
    /// Points that were removed because they project outside the object's masks.
    pub num_outside_masks: usize,
    /// The first of its cameras.
    pub camera: Option<Camera>,
    /// Focal length of the first camera, pixels.
    pub focal_length_px: Option<f64>,
    /// Standard deviation of that focal length, pixels; `None` if it was given and not estimated.
    pub focal_std_px: Option<f64>,
    /// Changes of the focal length during the video, which the model takes for motion.
    pub focal_changes: Vec<FocalChange>,
    /// All cameras of a reconstructed model.
    pub cameras: Vec<CameraReport>,
}

/// A camera of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraReport {
    /// Its id in the model.
    pub id: CameraId,
    /// Its intrinsics.
    pub camera: Camera,
    /// Standard deviation of its focal length, pixels; `None` if it was given, or if eight other cameras took more
    /// images.
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

    /// * `focal_deviations` – relative standard deviations, by index of the camera.
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

    /// Standard deviation of the focal length as a share of it; `None` if it was given.
    pub(in crate::pipeline) fn focal_deviation(&self) -> Option<f64> {
        Some(self.focal_std_px? / self.focal_length_px?)
    }
}
