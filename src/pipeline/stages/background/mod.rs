//! Stage `background`, and code shared with `objects`: a model, reconstructed or given.

pub(in crate::pipeline) mod calibration_check;
pub(in crate::pipeline) mod failure;
mod hovering;
pub(in crate::pipeline) mod map_frame;
pub(in crate::pipeline) mod model_report;
pub(in crate::pipeline) mod point_cloud;

pub(in crate::pipeline) use hovering::normal_by_lines;
pub use map_frame::background_frame;
pub use model_report::{CameraReport, ModelReport};

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::{Value, json};

use super::features;
use crate::bundle;
use crate::camera::{Camera, NUM_INTRINSICS};
use crate::features::Target;
use crate::io::interchange::colmap;
use crate::mapper::ModelWeakness;
use crate::mapper::{self, PosePriors};
use crate::math::rounding::ranges;
use crate::pipeline::Result;
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::given_models;
use crate::pipeline::inputs::{cameras, order};
use crate::scene::{CameraId, FocalChange, FrameId, Reconstruction, Topic, Warning};

const BACKGROUND_REPORT: &str = "background-report.json";

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let known: Vec<_> = cameras::initial(run)?.into_iter().map(|initial| (initial.origin, initial.known)).collect();
    let (background, _) = order::sfm_options(run)?;
    let given = run.options.background_model.as_deref().map(given_models::fingerprint).transpose()?;
    Ok(json!({
        "model": given,
        "model_files": run.options.model_files,
        "cameras": known,
        "intrinsics_std": run.options.intrinsics_std,
        "options": background.mapper,
        "seed": run.options.seed,
        "map_points": run.options.metric.map_points.as_deref().map(fingerprint::of_content).transpose()?,
    }))
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let (model, mut report) = match &run.options.background_model {
        Some(path) => given_models::read(path, Target::Background, run)?,
        None => reconstruct_views(run, outcome)?,
    };
    if !model.points.is_empty() {
        if order::found(run)?.in_time {
            report.focal_changes = focal_changes(run, &model, report.given)?;
        }
        calibration_check::check_fit(run, &model, &mut report, outcome)?;
    }
    if let Some(failure) = &mut report.failure {
        failure.push_str(&remedy_for_large_frames(run.size()));
        failure.push_str(&failure::reasons(run)?);
        let text = format!("background not reconstructed: {failure}");
        outcome.note(Topic::BackgroundNotReconstructed.warning(text));
    } else {
        report.remarks.iter().for_each(|remark| outcome.warn(remark.of("background")));
        report.focal_changes.iter().for_each(|change| outcome.warn(warning_of(change)));
        warn_of_gaps("background", &report, outcome);
    }
    if let Some(figures) = center_figures(&model, &prior_std(run, &model, report.given)?) {
        outcome.figure("camera_center_deviation", figures);
    }
    store(run, &run.workspace.background(), &model)?;
    outcome.outputs.push(run.workspace.background());
    run.keep(BACKGROUND_REPORT, &report, outcome)?;
    outcome.figure("num_registered", report.num_registered);
    outcome.figure("num_points", report.num_points);
    outcome.figure("num_infinite_points", report.num_infinite_points);
    outcome.figure("mean_error_px", report.mean_error_px);
    if let Some(camera) = model.cameras.values().next() {
        let values = if camera.higher.are_zero() { json!(camera.intrinsics()) } else { json!(camera.parameters()) };
        outcome.figure("intrinsics", values);
        outcome.figure("focal_length_px", report.focal_length_px);
        outcome.figure("focal_std_px", report.focal_std_px);
    }
    if !report.focal_changes.is_empty() {
        outcome.figure("focal_changes", json!(report.focal_changes));
    }
    if report.cameras.len() > 1 {
        outcome.figure("cameras", json!(report.cameras));
    }
    Ok(())
}

/// Reconstructs a map of the views, or rotations alone if the camera does not translate.
fn reconstruct_views(run: &Run, outcome: &mut Outcome) -> Result<(Reconstruction, ModelReport)> {
    let initial = cameras::initial(run)?;
    let cameras: Vec<_> = initial.iter().map(|initial| (initial.camera, initial.known)).collect();
    let table = features::of_background(run)?;
    let may_hover = order::found(run)?.in_time && !run.options.scale.method_only;
    if may_hover
        && hovering::camera_only_rotates(run, &table)?
        && let Some(found) = hovering::reconstruct(run, outcome)?
    {
        return Ok(found);
    }
    let num_frames = table.views.len() as u64;
    run.progress.begin("background", Some(num_frames));
    let mut watch = |share: f64| run.progress.reach((share * num_frames as f64) as u64);
    let found = reconstruct(run, table, &cameras, &order::sfm_options(run)?.0.mapper, None, &mut watch)?;
    let is_lost = may_hover && found.0.is_empty();
    Ok(if is_lost { hovering::reconstruct(run, outcome)? } else { None }.unwrap_or(found))
}

/// Changes of the focal length in a video's background.
fn focal_changes(run: &Run, model: &Reconstruction, is_given: bool) -> Result<Vec<FocalChange>> {
    let principal = match model.cameras.values().next() {
        Some(camera) if is_given => camera.principal,
        _ => cameras::first(run)?.camera.principal,
    };
    Ok(mapper::focal_changes(model, principal))
}

fn warning_of(change: &FocalChange) -> Warning {
    let text = format!("background: {change}, which looks like camera motion; cut the clip there or use a fixed zoom");
    Topic::FocalLengthChanges.warning(text)
}

fn warning_of_remark(remark: &ModelWeakness) -> Warning {
    let topic = match remark {
        ModelWeakness::PlanarScene { .. } => Topic::PlanarScene,
        ModelWeakness::ForwardMotion => Topic::ForwardMotion,
        ModelWeakness::LooseFocalLength { .. } => Topic::FocalLengthUncertain,
    };
    topic.warning(remark.to_string())
}

/// Remedy if large frames gave no model; empty for others. Points are tracked within a fixed number of pixels: in
/// larger frames those near the camera move too far between frames, and the rest are far away and have hardly any
/// parallax.
fn remedy_for_large_frames((width, height): (u32, u32)) -> String {
    // Longer side above which frames are large, and that of the remedy, pixels.
    const LARGE_PX: u32 = 1280;
    match width.max(height) > LARGE_PX {
        true => {
            format!(" (or frames of {width}x{height} pixels are too large: try --max-dimension {LARGE_PX})")
        }
        false => String::new(),
    }
}

/// Prior standard deviations of fx, fy, cx, cy, k1, k2 of a model's cameras.
fn prior_std(run: &Run, model: &Reconstruction, is_given: bool) -> Result<BTreeMap<CameraId, [f64; NUM_INTRINSICS]>> {
    let initial = if is_given { Vec::new() } else { cameras::initial(run)? };
    // Camera ids of a reconstructed model start at 1.
    let initial_of = |id: &CameraId| initial.get((id.0 as usize).checked_sub(1)?);
    let known = |id: &CameraId| match is_given {
        true => run.options.intrinsics_std,
        false => initial_of(id).map_or(mapper::Intrinsics::GUESSED, |initial| initial.known),
    };
    Ok(model.cameras.iter().map(|(id, camera)| (*id, known(id).std_of(camera))).collect())
}

/// Standard deviations of the camera positions, in units of the background; `None` with too little data.
fn center_figures(model: &Reconstruction, prior_std: &BTreeMap<CameraId, [f64; NUM_INTRINSICS]>) -> Option<Value> {
    // A model with undetermined parameters has no such values, which is no reason to stop. Sixteen images are enough
    // for a median.
    let found = bundle::center_deviations(model, 16, prior_std).ok()??;
    let mut centers: Vec<f64> = found.centers.into_values().collect();
    centers.sort_by(f64::total_cmp);
    let (median, largest) = (centers.get(centers.len() / 2)?, centers.last()?);
    Some(json!({ "median": median, "max": largest, "pixel_px": found.pixel_px }))
}

/// Report on the background's model; the stage must be done.
pub(in crate::pipeline) fn background_report(run: &Run) -> Result<ModelReport> {
    run.workspace.read_state(BACKGROUND_REPORT)
}

/// Returns true for a camera that does not translate; false before the stage is done.
pub(in crate::pipeline) fn hovers(run: &Run) -> bool {
    background_report(run).is_ok_and(|report| report.num_registered > 0 && report.num_points == 0)
}

/// Standard deviation of the background's focal length as a share of it, with the prior on lenses included; `None` if
/// it was given. The stage must be done.
pub(in crate::pipeline) fn focal_deviation(run: &Run) -> Result<Option<f64>> {
    Ok(background_report(run)?.focal_deviation())
}

/// The only caller of structure from motion. `poses` are pose priors that initialize the map, if any; `watch` receives
/// the finished share.
pub(in crate::pipeline) fn reconstruct(
    run: &Run,
    mut table: crate::features::TrackTable,
    cameras: &[(Camera, mapper::Intrinsics)],
    options: &mapper::Options,
    poses: Option<&PosePriors>,
    watch: &mut (dyn FnMut(f64) + Send),
) -> Result<(Reconstruction, ModelReport)> {
    let seed = run.options.seed;
    let (cameras, known): (Vec<Camera>, Vec<mapper::Intrinsics>) = cameras.iter().copied().unzip();
    if let Some(view) = table.views.iter().find(|view| view.camera >= cameras.len()) {
        return Err(crate::features::FeatureError::NoCamera { camera: view.camera, count: cameras.len() }.into());
    }
    // Only videos have long tracks, and one camera.
    let of_video = known.first().copied().unwrap_or(mapper::Intrinsics::GUESSED);
    mapper::cut_long_tracks(&mut table, &cameras, of_video, options, seed);
    let (mut model, report) = mapper::reconstruct_watched(table, &cameras, known, options, seed, poses, watch)?;
    if model.is_empty() {
        // Even an empty model contains the cameras it would have had.
        model.cameras = (1..).map(CameraId).zip(cameras).collect();
    } else {
        let used: BTreeSet<CameraId> = model.images.values().map(|image| image.camera).collect();
        model.cameras.retain(|id, _| used.contains(id));
    }
    let described = described(&model, &report);
    Ok((model, described))
}

/// The model of a stationary target, by the cameras of the background; `None` if its points move.
pub(in crate::pipeline) fn triangulate(
    table: &crate::features::TrackTable,
    camera: Camera,
    options: &mapper::Options,
    background: &Reconstruction,
) -> Result<Option<(Reconstruction, ModelReport)>> {
    // Minimum share of explained points of a stationary vehicle: reflections, shadows and points seen through windows
    // are not explained.
    const MIN_EXPLAINED_SHARE: f64 = 0.8;
    let pose = |view: &crate::features::tracks::View| Some(background.images.get(&view.image)?.cam_from_world);
    let poses: Vec<_> = table.views.iter().map(pose).collect();
    let (model, report, explained) = mapper::triangulate(table, &[camera], &poses, options)?;
    let is_stationary = explained >= MIN_EXPLAINED_SHARE && model.points.len() >= options.min_initial_inliers / 2;
    tracing::debug!("{} points from the background's cameras explain {explained:.3}", model.points.len());
    Ok(is_stationary.then(|| {
        let described = ModelReport { shares_cameras: true, ..described(&model, &report) };
        (model, described)
    }))
}

fn described(model: &Reconstruction, report: &mapper::Report) -> ModelReport {
    let unregistered = report
        .views
        .iter()
        .filter_map(|view| Some((FrameId(view.image.0.checked_sub(1)?), view.failure.as_ref()?.to_string())))
        .collect();
    let failure =
        model.is_empty().then(|| report.failure.clone().unwrap_or_else(|| "no frame is registered".to_owned()));
    let mut described = ModelReport {
        num_visible: report.views.len(),
        num_registered: report.num_registered(),
        unregistered,
        failure,
        num_infinite_points: report.num_infinite_points,
        remarks: report.remarks.iter().map(warning_of_remark).collect(),
        ..ModelReport::default()
    };
    described.describe_points(model);
    described.describe_cameras(model, &report.focal_deviations);
    described
}

/// Stores a model as a public result, atomically.
pub(in crate::pipeline) fn store(run: &Run, folder: &Path, model: &Reconstruction) -> Result<()> {
    run.workspace.put_folder(folder, |fresh| Ok(colmap::write(fresh, model, run.options.model_files)?))
}

/// Warns if a target is visible in unregistered frames.
pub(in crate::pipeline) fn warn_of_gaps(target: &str, report: &ModelReport, outcome: &mut Outcome) {
    let missing = report.unregistered.len();
    if missing == 0 {
        return;
    }
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for reason in report.unregistered.values() {
        *reasons.entry(reason).or_default() += 1;
    }
    let commonest = reasons.iter().max_by_key(|(_, count)| **count).map_or("", |(reason, _)| *reason);
    outcome.warn(Topic::FramesNotRegistered.warning(format!(
        "{target}: {missing} of {} frames not registered ({}); most frequent reason: {commonest}",
        report.num_visible,
        ranges(report.unregistered.keys().map(|frame| frame.0))
    )));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_frames_have_a_remedy() {
        assert!(remedy_for_large_frames((1920, 1080)).contains("--max-dimension 1280"));
        assert_eq!(remedy_for_large_frames((720, 1280)), "");
    }
}
