//! Vehicles with a 3D model: structure from motion of the vehicle in the window, placed by the adjustment with the
//! ground, as in a run.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::Arc;

use nalgebra::{Matrix3, Point3};

use super::map::{MIN_TRACK, WorldMap};
use super::window::{Limits, evenly, register, sub_table};
use crate::features::TrackTable;
use crate::mapper::{self, Intrinsics};
use crate::pipeline::{Options, PipelineError, object_pose_priors};
use crate::scene::{Frame, FrameId, ObjectId, ObjectPose, ObjectTrajectory, TimeBase};
use crate::trajectory::{self, Candidate, Evidence, ModelOrigin, ObjectDescription, Outlines, verdicts};

/// Maximum number of views of a model; other frames are registered by resection. Time grows faster than their number:
/// in five rendered drives 30 left positions 0.13 m off about their mean, 60 0.08 m, in up to 2.5 s a map.
const MAX_VIEWS: usize = 60;
/// Maximum number of views of all models of a map together: before a dashcam 60 each took 3.9 s, in which the camera
/// left the map.
const TOTAL_VIEWS: usize = 100;
/// Number of views allowed for every model, regardless of the number of models.
const FEW_VIEWS: usize = 20;
/// Minimum number of views of a model.
const MIN_VIEWS: usize = 8;
/// Limits of the pose of an additional view: those of the mapper for objects.
const LIMITS: Limits = Limits { max_error_px: 3.0, min_inliers: 7, min_inlier_ratio: 0.25 };

/// A vehicle of the window.
pub(super) struct Subject {
    /// Provisional id of the tracker.
    pub(super) object: ObjectId,
    pub(super) class: String,
    pub(super) confidence: f64,
    pub(super) table: TrackTable,
}

/// Vehicles of a window, and the map in which they are placed.
pub(super) struct Request {
    pub(super) map: Arc<WorldMap>,
    pub(super) subjects: Vec<Subject>,
    pub(super) outlines: Outlines,
    pub(super) frames: Vec<Frame>,
}

/// Model of a vehicle with its positions in the map.
pub(super) struct Model {
    pub(super) trajectory: ObjectTrajectory,
    /// Covariance of each position without that of the scale ratio, units of the map.
    pub(super) covariances: BTreeMap<FrameId, Matrix3<f64>>,
}

impl Model {
    /// Covariance of a position, without the error of the scale ratio.
    pub(super) fn covariance(&self, frame: FrameId) -> Matrix3<f64> {
        // That of the nearest view of the adjustment.
        let before = self.covariances.range(..=frame).next_back();
        let nearest = before.or_else(|| self.covariances.range(frame..).next());
        nearest.map_or_else(Matrix3::zeros, |(_, covariance)| *covariance)
    }

    /// Covariance of the center of the body, common to all frames.
    pub(super) fn body_covariance(&self, frame: FrameId) -> Matrix3<f64> {
        let center = self.trajectory.body_center.zip(self.pose(frame));
        center.map_or_else(Matrix3::zeros, |(center, pose)| center.covariance_in_world(&pose.world_from_object))
    }

    /// Position in a frame, in the frame of the map.
    pub(super) fn position(&self, frame: FrameId) -> Option<Point3<f64>> {
        Some(Point3::from(self.pose(frame)?.position))
    }

    fn pose(&self, frame: FrameId) -> Option<&ObjectPose> {
        let place = self.trajectory.poses.binary_search_by_key(&frame, |pose| pose.frame).ok()?;
        self.trajectory.poses.get(place)
    }
}

/// Reconstructs the vehicles of a window: models by their provisional ids.
///
/// # Errors
/// [`PipelineError::Mapper`], which would be a bug.
pub(super) fn place_all(request: &Request, options: &Options) -> Result<BTreeMap<ObjectId, Model>, PipelineError> {
    let max_views = (TOTAL_VIEWS / request.subjects.len().max(1)).clamp(FEW_VIEWS, MAX_VIEWS);
    let mut models = BTreeMap::new();
    for subject in &request.subjects {
        models.extend(place(subject, request, options, max_views)?.map(|model| (subject.object, model)));
    }
    Ok(models)
}

/// Reconstructs a vehicle and places it; `None` where its window does not determine it.
fn place(
    subject: &Subject,
    request: &Request,
    options: &Options,
    max_views: usize,
) -> Result<Option<Model>, PipelineError> {
    let Request { map, outlines, frames, .. } = request;
    let Subject { object: id, class, confidence, table } = subject;
    let registered: Vec<usize> =
        (0..table.views.len()).filter(|&view| map.model.images.contains_key(&table.views[view].image)).collect();
    let chosen: Vec<usize> = evenly(&registered, max_views).collect();
    if chosen.len() < MIN_VIEWS {
        return Ok(without_model(*id, &format!("{} views in the map", chosen.len())));
    }
    let sparse = sub_table(table, &chosen, MIN_TRACK);
    let chain = map.ground.chain(&map.model, options);
    let poses = object_pose_priors(&chain, *id, &sparse, options);
    let mapper_options = mapper::Options { max_starts: 1, ..options.objects.mapper.clone() };
    let (model, _) = mapper::reconstruct_watched(
        sparse,
        &[map.camera],
        Intrinsics::FIXED,
        &mapper_options,
        options.seed,
        poses.as_ref(),
        &mut |_| {},
    )?;
    if model.images.len() < MIN_VIEWS {
        return Ok(without_model(*id, &format!("{} of {} views registered", model.images.len(), chosen.len())));
    }
    let planes = chain.planes(*id, &model, &options.ground, options.seed).planes;
    let silhouettes = outlines.get(id).cloned().unwrap_or_default();
    let description = ObjectDescription { id: *id, class: class.clone(), confidence: *confidence };
    let evidence = Evidence {
        description: description.clone(),
        origin: ModelOrigin::Reconstructed,
        background: &map.model,
        object: &model,
        planes: &planes,
        silhouettes: &silhouettes,
        frames,
        focal_std: map.focal_std,
    };
    let placed = trajectory::place(&evidence, &options.scale);
    let found = match placed.trajectory {
        Ok(found) => found,
        Err(why) => return Ok(without_model(*id, &why)),
    };
    let candidate = Candidate {
        trajectory: &found,
        tracked: None,
        object: &placed.object,
        background: &map.model,
        planes: &planes,
    };
    if found.scale.degenerate {
        return Ok(without_model(*id, &"the scale ratio is not determined"));
    }
    let verdicts = verdicts(&[candidate], TimeBase::Seconds, &[]);
    if let Some(refuted) = verdicts.iter().find(|verdict| verdict.is_refuted()) {
        let reasons: Vec<&str> = refuted.against().map(|reason| reason.says.as_str()).collect();
        return Ok(without_model(*id, &reasons.join("; ")));
    }
    let mut whole = placed.object;
    register(&mut whole, table, registered, &map.camera, &LIMITS);
    let mut trajectory = trajectory::assemble(description, &map.model, &whole, found.scale, frames);
    let subject = trajectory::Subject {
        trajectory: &trajectory,
        object: &whole,
        background: &map.model,
        planes: &planes,
        silhouettes: &silhouettes,
        options: &options.scale,
    };
    let center = trajectory::extents(&subject).center;
    center.into_iter().for_each(|center| trajectory.refer_to(center));
    Ok(Some(Model { trajectory, covariances: placed.pose_covariances }))
}

fn without_model(id: ObjectId, why: &dyn Display) -> Option<Model> {
    tracing::debug!("object {}: no model: {why}", id.0);
    None
}
