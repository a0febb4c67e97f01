//! Stage `objects`: a model of every object, reconstructed or given.
//!
//! First every object is reconstructed and stored individually. Then one pass through the frames compares all models
//! with the masks, and removes the points that project outside them. A run that was killed resumes with the remaining
//! objects, and repeats the pass.

mod footing;
mod object_boxes;

use crate::mapper;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::background::{self, ModelReport};
use super::track;
use super::track::movement::{PointFinding, PointFindings};
use super::{follow, ground};
use crate::camera::Camera;
use crate::features::Target;
use crate::features::TrackTable;
use crate::io::interchange::colmap;
use crate::io::{atomic, json};
use crate::mapper::silhouette::{SilhouetteOptions, SilhouetteVotes};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::{given_models, order};
use crate::pipeline::{Result, Stage};
use crate::scene::{
    BoundingBox, Image, ImageId, Mask, Movement, ObjectId, Reconstruction, StationaryVehicles, Topic, TrackedObject,
};
use footing::ObjectGround;
pub use footing::object_pose_priors;

const REPORTS: &str = "objects-report.json";
/// Reason for a missing model that does not depend on the object.
const NO_BACKGROUND: &str = "no background to place it in";
/// The same if vehicles have ground tracks: a model would have depth only as far as its vehicle rotates relative to the
/// line of sight (docs/decisions/041-ground-tracks-below-a-hovering-camera.md).
const HOVERS: &str = "the camera does not translate";

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let given: Result<BTreeMap<_, _>> =
        run.options.object_models.iter().map(|(id, path)| Ok((id, given_models::fingerprint(path)?))).collect();
    let (_, objects) = order::sfm_options(run)?;
    Ok(json!({
        "models": given?,
        "model_files": run.options.model_files,
        "only": run.options.only_objects,
        "options": objects.mapper,
        "ground": run.options.ground,
        "stationary": run.options.scale.stationary,
        "shape": ground::body_shape(run.options),
        "seed": run.options.seed,
    }))
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let tracked = run.workspace.read_tracked()?;
    let wanted: Vec<&TrackedObject> = tracked.iter().filter(|object| run.options.wants(object.id)).collect();
    let background = run.workspace.read_background()?;
    let camera = background.cameras.values().next().copied().filter(|_| !background.is_empty());
    let by_points = track::movement::by_points(run)?;
    let context =
        ObjectContext { camera, background: &background, by_points, footing: ObjectGround::new(run, &background) };
    // Steps of progress: the frames of every object, and then all frames again for the masks.
    let num_views: usize = wanted.iter().map(|object| object.frames.len()).sum();
    run.progress.begin("objects", Some(num_views as u64));
    let folder = run.workspace.intermediate(Stage::Objects, &outcome.fingerprint)?;
    let mut reports = BTreeMap::new();
    let mut num_done = 0;
    for object in wanted {
        run.check_stop()?;
        let (before, of_this) = (num_done, object.frames.len());
        let mut watch = |share: f64| run.progress.reach(before + (share * of_this as f64) as u64);
        reports.insert(object.id, one_object(run, object, &context, &folder, &mut watch)?);
        num_done += of_this as u64;
        run.progress.reach(num_done);
    }
    check_silhouettes(run, &tracked, &folder, &mut reports)?;
    for (id, report) in &reports {
        describe(*id, report, outcome);
    }
    let has_model = |id: &ObjectId| reports.get(id).is_some_and(|report| report.failure.is_none());
    run.workspace.keep_objects(&run.workspace.all_as_reconstructed(), |id| has_model(&id))?;
    outcome.outputs.extend(reports.keys().filter(|id| has_model(id)).map(|&id| run.workspace.as_reconstructed(id)));
    run.keep(REPORTS, &reports, outcome)?;
    // Reports first: a run that is killed here must find no report without its model.
    reports.keys().try_for_each(|id| atomic::remove(&report_in(&folder, *id)))?;
    Ok(atomic::remove_folder(&folder)?)
}

/// The report of a reconstructed object, until all objects are finished.
fn report_in(folder: &Path, id: ObjectId) -> PathBuf {
    folder.join(format!("{id}.json"))
}

fn describe(id: ObjectId, report: &ModelReport, outcome: &mut Outcome) {
    match &report.failure {
        // The run reports it once.
        Some(failure) if [NO_BACKGROUND, HOVERS].contains(&failure.as_str()) => {
            outcome.note(Topic::VehicleNotReconstructed.warning(format!("object {id}: not reconstructed: {failure}")))
        }
        Some(failure) => {
            outcome.warn(Topic::VehicleNotReconstructed.warning(format!("object {id}: not reconstructed: {failure}")))
        }
        None => background::warn_of_gaps(&format!("object {id}"), report, outcome),
    }
    if report.given {
        report.remarks.iter().for_each(|remark| outcome.warn(remark.of(&format!("object {id}"))));
    }
    outcome.figure(
        &format!("object_{id}"),
        json!({
            "num_visible": report.num_visible,
            "num_registered": report.num_registered,
            "num_points": report.num_points,
            "mean_error_px": report.mean_error_px,
            "num_infinite_points": report.num_infinite_points,
            "num_outside_masks": report.num_outside_masks,
        }),
    );
}

/// The reports of all objects; the stage must be done.
pub(in crate::pipeline) fn reports(run: &Run) -> Result<BTreeMap<ObjectId, ModelReport>> {
    run.workspace.read_state(REPORTS)
}

/// One object's model before the adjustment with the ground, if it has one.
pub(in crate::pipeline) fn as_reconstructed(
    run: &Run,
    id: ObjectId,
    report: &ModelReport,
) -> Result<Option<Reconstruction>> {
    report.failure.is_none().then(|| Ok(run.workspace.read_as_reconstructed(id)?)).transpose()
}

/// Context of the objects' reconstructions.
struct ObjectContext<'a> {
    /// `None` without a background.
    camera: Option<Camera>,
    background: &'a Reconstruction,
    by_points: PointFindings,
    footing: ObjectGround<'a>,
}

impl ObjectContext<'_> {
    /// The model of a vehicle that may be stationary, triangulated from the background's cameras. `None` on request, or
    /// if its points or its contact with the ground show motion that only camera shake contradicts.
    fn stationary(
        &self,
        run: &Run,
        object: &TrackedObject,
        table: &TrackTable,
        camera: Camera,
        options: &mapper::Options,
    ) -> Result<Option<(Reconstruction, ModelReport)>> {
        let by_points = match run.options.scale.stationary {
            StationaryVehicles::None => return Ok(None),
            StationaryVehicles::Found => self.by_points.get(&object.id),
            StationaryVehicles::All => None,
        };
        if by_points.is_some_and(PointFinding::points_move) {
            return Ok(None);
        }
        let Some(found) = background::triangulate(table, camera, options, self.background)? else {
            return Ok(None);
        };
        let frames = run.frames()?;
        let moves = by_points.is_some_and(|by_points| {
            by_points.finding.state == Movement::Moving && by_points.at_rest_by_shaking(&found.0, frames).is_none()
        });
        Ok((!moves).then_some(found))
    }
}

/// One object's report and, in `folder`, its model, which is compared with the masks later unless it was given.
fn one_object(
    run: &Run,
    object: &TrackedObject,
    context: &ObjectContext<'_>,
    folder: &Path,
    watch: &mut (dyn FnMut(f64) + Send),
) -> Result<ModelReport> {
    let id = object.id;
    let kept = report_in(folder, id);
    if let Ok(report) = json::read(&kept) {
        return Ok(report);
    }
    let given = run.options.object_models.get(&id);
    let failed =
        |failure: String| (Reconstruction::default(), ModelReport { failure: Some(failure), ..ModelReport::default() });
    let (model, mut report) = match (given, context.camera) {
        (Some(path), _) => given_models::read(path, Target::Object, run)?,
        (None, _) if object.left_out.is_some() => failed(object.left_out.clone().unwrap_or_default()),
        (None, Some(_)) if context.background.points.is_empty() => failed(HOVERS.to_owned()),
        (None, Some(camera)) => {
            let table = follow::of_object(run, id)?;
            let options = order::sfm_options(run)?.1.mapper;
            match context.stationary(run, object, &table, camera, &options)? {
                Some(found) => found,
                None => {
                    let cameras = [(camera, mapper::Intrinsics::FIXED)];
                    let poses = if options.pose_priors { context.footing.poses(id, &table) } else { None };
                    background::reconstruct(run, table, &cameras, &options, poses.as_ref(), watch)?
                }
            }
        }
        (None, None) => failed(NO_BACKGROUND.to_owned()),
    };
    report.num_visible = object.frames.len();
    if report.failure.is_none() {
        let model_folder = folder.join(id.to_string());
        atomic::remove_folder(&model_folder)?;
        colmap::write(&model_folder, &model, colmap::Encoding::Auto)?;
    }
    atomic::write_json(&kept, &report)?;
    Ok(report)
}

/// A mask dilated by the uncertainty of its border: a pixel, and a hundredth of its longer side.
fn grown(mask: &Mask, bounds: BoundingBox) -> Mask {
    let longer_px = f64::from(bounds.width().max(bounds.height()));
    // Uncertainty of a mask's border, pixels and as a share of the longer side of the mask.
    mask.dilated((1.0 + 0.01 * longer_px).round() as u32)
}

/// A reconstruction during the comparison with the masks.
struct Unchecked {
    model: Reconstruction,
    votes: SilhouetteVotes,
}

/// Stores all models, reconstructed ones without the points that project outside their masks; every mask is read once.
fn check_silhouettes(
    run: &Run,
    tracked: &[TrackedObject],
    folder: &Path,
    reports: &mut BTreeMap<ObjectId, ModelReport>,
) -> Result<()> {
    let store =
        |id: ObjectId, model: &Reconstruction| background::store(run, &run.workspace.as_reconstructed(id), model);
    let mut unchecked: BTreeMap<ObjectId, Unchecked> = BTreeMap::new();
    for (&id, report) in reports.iter().filter(|(_, report)| report.failure.is_none()) {
        let model = colmap::read(&folder.join(id.to_string()))?;
        if report.given {
            store(id, &model)?;
        } else {
            unchecked.insert(id, Unchecked { votes: SilhouetteVotes::new(&model), model });
        }
    }
    vote(run, tracked, &mut unchecked)?;
    for (id, Unchecked { mut model, votes }) in unchecked {
        let Some(report) = reports.get_mut(&id) else { continue };
        let outside = votes.outside(&SilhouetteOptions::default());
        model.remove_points(&outside);
        report.num_outside_masks = outside.len();
        drop_bare_views(&mut model, report);
        report.describe_points(&model);
        store(id, &model)?;
    }
    Ok(())
}

/// Removes the views with too few remaining points: their poses are undetermined, and the adjustment with the ground
/// would fail.
fn drop_bare_views(model: &mut Reconstruction, report: &mut ModelReport) {
    // Minimum number of points: three determine a pose, given an initial one.
    const MIN_POSE_POINTS: usize = 3;
    let num_seen = |image: &Image| image.observations.iter().filter(|seen| seen.point.is_some()).count();
    let bare: Vec<ImageId> =
        model.images.iter().filter(|(_, image)| num_seen(image) < MIN_POSE_POINTS).map(|(id, _)| *id).collect();
    for id in &bare {
        let reason = format!("fewer than {MIN_POSE_POINTS} of its visible points are inside the masks of other frames");
        report.unregistered.insert(id.frame(), reason);
    }
    model.remove_images(&bare);
    report.num_registered = model.images.len();
}

/// Compares reconstructions with the masks of all frames.
fn vote(run: &Run, tracked: &[TrackedObject], unchecked: &mut BTreeMap<ObjectId, Unchecked>) -> Result<()> {
    if unchecked.is_empty() {
        return Ok(());
    }
    let frames = run.frames()?;
    run.progress.begin(Stage::Objects.name(), Some(frames.len() as u64));
    for frame in frames {
        run.step()?;
        let image = ImageId::from(frame.id);
        if unchecked.values().all(|object| !object.model.images.contains_key(&image)) {
            continue;
        }
        let masks = track::masks_of(run, tracked, frame)?;
        for (id, mask) in &masks {
            let Some(Unchecked { model, votes }) = unchecked.get_mut(id) else { continue };
            let Some(bounds) = mask.bounding_box().filter(|_| model.images.contains_key(&image)) else { continue };
            let silhouette = grown(mask, bounds);
            let is_hidden = |x, y| masks.iter().any(|(other, mask)| other != id && mask.contains(x, y));
            votes.add(model, image, &silhouette, is_hidden);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Options, drive};

    #[test]
    fn views_of_three_points_stay_and_those_of_two_go() {
        let mut model = drive(&Options { num_frames: 8, ..Options::default() }, 1).object;
        let ids: Vec<ImageId> = model.images.keys().copied().collect();
        for (image, num_points) in model.images.values_mut().zip([3, 2]) {
            let seen = image.observations.iter_mut().filter(|seen| seen.point.is_some());
            seen.skip(num_points).for_each(|seen| seen.point = None);
        }
        let mut report = ModelReport::default();
        drop_bare_views(&mut model, &mut report);
        assert!(model.images.contains_key(&ids[0]) && !model.images.contains_key(&ids[1]));
        assert_eq!(report.num_registered, 7);
        assert_eq!(report.unregistered.keys().copied().collect::<Vec<_>>(), [ids[1].frame()]);
    }
}
