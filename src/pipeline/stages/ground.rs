//! Stage `ground`: selection of the ground points, and the local plane of every object in every frame.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{background, objects, track};
use crate::ground::{
    BodyShape, DominantPlane, GroundChain, HoveringGround, Mount, TiltContradiction, TiltEstimate,
    dominant_plane_points, find_mount, label_points,
};
use crate::io::{RunFolder, masks};
use crate::networks::{GroundSegmenter, load_ground_segmenter};
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::given_masks::MaskFolder;
use crate::pipeline::inputs::networks::{hashes_by_name, of_networks};
use crate::pipeline::inputs::{hovering, images};
use crate::pipeline::{GroundLabels, Options, Result, Stage};
use crate::scene::{
    Frame, FrameId, Ground, GroundSource, LabelMap, Movement, ObjectId, Point3dId, Reconstruction, Rect, Topic, Warning,
};

/// File name of the sources of planes, for vehicles whose planes are computed later.
const SOURCES: &str = "ground-sources.json";

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let labels = match &run.options.ground_labels {
        GroundLabels::Geometric => json!("geometric"),
        GroundLabels::Masks { folder, label } => json!({ "masks": fingerprint::of_content(folder)?, "label": label }),
        GroundLabels::Model(path) => json!({
            "model": of_networks(run, std::slice::from_ref(path))?,
            "options": run.options.ground_segmentation,
        }),
    };
    Ok(json!({
        "labels": labels,
        "options": run.options.ground,
        "hovering": background::hovers(run).then(|| hovering::cache_key(run)).transpose()?,
        "shape": body_shape(run.options),
        "seed": run.options.seed,
    }))
}

/// Assumptions on the shape of vehicles.
pub(super) fn body_shape(options: &Options) -> BodyShape {
    let contact = &options.scale.joint.contact;
    BodyShape { clearance: contact.lowest[0], max_deviation: contact.max_deviation }
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let background = run.workspace.read_background()?;
    let found = match background.is_empty() {
        true => GroundResults::default(),
        false => find(run, &background, outcome)?,
    };
    let mut ground = Ground { source: found.source(), point_ids: found.point_ids(), planes: BTreeMap::new() };
    let mut bases: BTreeMap<String, BTreeMap<&str, usize>> = BTreeMap::new();
    let chain = found.chain(&background, run.options);
    for (id, report) in objects::reports(run)? {
        let Some(object) = objects::as_reconstructed(run, id, &report)? else { continue };
        let found = chain.planes(id, &object, &run.options.ground, run.options.seed);
        if let Some(first) = found.skipped.first() {
            let (missing, all) = (found.skipped.len(), found.skipped.len() + found.planes.len());
            let text = format!("object {id}: {missing} of {all} frames without a ground plane: {}", first.reason);
            outcome.warn(Topic::FramesWithoutGroundPlane.warning(text));
        }
        let counts = bases.entry(id.to_string()).or_default();
        found.planes.values().for_each(|plane| *counts.entry(plane.basis.name()).or_default() += 1);
        ground.planes.extend(found.planes.into_iter().map(|(frame, plane)| ((id, frame), plane)));
    }
    if let GroundLabels::Model(path) = &run.options.ground_labels {
        outcome.figure("networks", hashes_by_name([path])?);
    }
    outcome.figure("source", json!(ground.source));
    outcome.figure("num_points", ground.point_ids.len());
    outcome.figure("num_planes", ground.planes.len());
    outcome.figure("bases", json!(bases));
    if let Some(ground) = &found.hovering {
        let of_source = |tilt: &TiltEstimate| {
            let std = tilt.std.map(|std| std.map(f64::to_degrees));
            json!({ "source": tilt.source, "tilt_deg": tilt.angles.map(f64::to_degrees), "std_deg": std })
        };
        outcome.figure(
            "hovering",
            json!({
                "pitch_deg": ground.pitch.to_degrees(),
                "tilt_std_deg": ground.total_tilt_std().to_degrees(),
                "num_vehicles": ground.num_vehicles,
                "sources": ground.sources.iter().chain(&ground.by_vehicles).map(of_source).collect::<Vec<_>>(),
            }),
        );
    }
    if let Some(mount) = &found.mount {
        outcome.figure(
            "mount",
            json!({
                "height": mount.height,
                "height_std": mount.height_std,
                "wander": mount.drift,
                "num_points": mount.num_points,
            }),
        );
    }
    let path = run.workspace.ground();
    run.workspace.put_file(&path, |fresh| crate::io::ground::write(fresh, &ground))?;
    outcome.outputs.push(path);
    run.keep(SOURCES, &found, outcome)
}

/// Results that do not depend on objects.
#[derive(Default, Serialize, Deserialize)]
pub(in crate::pipeline) struct GroundResults {
    /// Labeled points and the origin of the labels.
    pub(super) labelled: Option<(GroundSource, Vec<Point3dId>)>,
    pub(super) dominant: Option<DominantPlane>,
    pub(super) mount: Option<Mount>,
    /// The ground below a camera that does not translate.
    pub(in crate::pipeline) hovering: Option<HoveringGround>,
}

impl GroundResults {
    fn source(&self) -> GroundSource {
        self.labelled.as_ref().map_or(GroundSource::Geometric, |(source, _)| *source)
    }

    fn point_ids(&self) -> Vec<Point3dId> {
        match (&self.labelled, &self.dominant) {
            (Some((_, labelled)), _) => labelled.clone(),
            (None, Some(dominant)) => dominant.point_ids.clone(),
            (None, None) => Vec::new(),
        }
    }

    /// The chain of these sources.
    pub(in crate::pipeline) fn chain<'a>(
        &'a self,
        background: &'a Reconstruction,
        options: &Options,
    ) -> GroundChain<'a> {
        GroundChain {
            background,
            labeled: self.labelled.as_ref().map_or(&[], |(_, points)| points),
            dominant: self.dominant.as_ref(),
            mount: self.mount.as_ref(),
            hovering: self.hovering.as_ref(),
            shape: body_shape(options),
        }
    }
}

/// Creates all sources of the chain, for the whole scene.
fn find(run: &Run, background: &Reconstruction, outcome: &mut Outcome) -> Result<GroundResults> {
    if background.points.is_empty() {
        let hovering = hovering_ground(run, background)?;
        match &hovering {
            None => {
                let text = "no ground found: the camera does not translate, and neither straight lines nor the sizes \
                            of vehicles show the ground; give --intrinsics, --camera-pitch or --map-points";
                outcome.warn(Topic::NoGroundFound.warning(text));
            }
            Some(ground) => ground.contradictions.iter().for_each(|found| outcome.warn(contradiction(found))),
        }
        return Ok(GroundResults { hovering, ..GroundResults::default() });
    }
    let labelled = labelled_points(run, background, outcome)?;
    let options = &run.options.ground;
    if options.labels_only {
        return Ok(GroundResults { labelled, ..GroundResults::default() });
    }
    let dominant = dominant_plane_points(background, options, run.options.seed);
    if let (Err(error), None) = (&dominant, &labelled) {
        outcome.warn(Topic::NoGroundFound.warning(format!("no ground found: {error}")));
    }
    let points = labelled.as_ref().map(|(_, points)| points.as_slice());
    let of_labels = points.and_then(|points| find_mount(background, Some(points), options, run.options.seed).ok());
    let mount = match of_labels {
        Some(mount) => Ok(mount),
        None => find_mount(background, None, options, run.options.seed),
    };
    match &mount {
        Ok(_) => tracing::info!("camera mount: one plane in the camera's frame is the ground"),
        Err(reason) => tracing::debug!("camera mount not assumed: {reason}"),
    }
    Ok(GroundResults { labelled, dominant: dominant.ok(), mount: mount.ok(), hovering: None })
}

/// The ground below a camera that does not translate; `None` without evidence.
fn hovering_ground(run: &Run, background: &Reconstruction) -> Result<Option<HoveringGround>> {
    // The headings of stationary vehicles are unknown.
    let mut tracked = run.workspace.read_tracked()?;
    tracked.retain(|object| object.movement.state == Movement::Moving);
    let mut vehicles: BTreeMap<ObjectId, BTreeMap<FrameId, Rect>> = BTreeMap::new();
    for frame in run.frames()? {
        for (id, mask) in track::masks_of(run, &tracked, frame)? {
            let whole = mask.bounding_box().filter(|bounds| !bounds.is_truncated(mask.width(), mask.height()));
            let Some(bounds) = whole else { continue };
            vehicles.entry(id).or_default().insert(frame.id, bounds.into());
        }
    }
    let vehicles: Vec<_> = vehicles.into_values().collect();
    let tilts = hovering::tilts(run, background, background::normal_by_lines(run).as_ref())?;
    let focal_std = background::focal_deviation(run)?.unwrap_or(0.0);
    Ok(crate::ground::hovering_ground(background, &vehicles, tilts, focal_std))
}

fn contradiction(found: &TiltContradiction) -> Warning {
    Topic::SourcesContradict.warning(format!(
        "{}: contradicts the other sources of the ground's tilt by {:.1}° ({:.1} standard deviations); check it",
        found.source,
        found.angle.to_degrees(),
        found.deviations
    ))
}

/// The sources of planes; the stage must be done.
pub(in crate::pipeline) fn sources(run: &Run) -> Result<GroundResults> {
    run.workspace.read_state(SOURCES)
}

/// The points labeled as ground; `None` without labels, or if they label no point as ground.
fn labelled_points(
    run: &Run,
    background: &Reconstruction,
    outcome: &mut Outcome,
) -> Result<Option<(GroundSource, Vec<Point3dId>)>> {
    let (source, points) = match &run.options.ground_labels {
        GroundLabels::Geometric => {
            let text = match run.options.ground.labels_only {
                true => "no ground labels: no ground; give --ground-model or --ground-masks",
                false => {
                    "no ground labels: the ground is estimated from 3D points; give --ground-model or --ground-masks \
                     to improve it"
                }
            };
            outcome.warn(Topic::NoGroundLabels.warning(text));
            return Ok(None);
        }
        GroundLabels::Masks { folder, label } => {
            (GroundSource::Masks, vote_of_masks(run, background, folder, *label, outcome)?)
        }
        GroundLabels::Model(path) => {
            let folder = ground_masks(run, background, path, outcome)?;
            (GroundSource::Model, vote_of_masks(run, background, &folder, None, outcome)?)
        }
    };
    if points.is_empty() {
        let text = "no background point is labeled as ground: the labels are ignored";
        outcome.warn(Topic::LabelsWithoutGround.warning(text));
        return Ok(None);
    }
    Ok(Some((source, points)))
}

/// Selects ground points by a vote of the labels at their observations, with one label map in memory at a time.
fn vote_of_masks(
    run: &Run,
    background: &Reconstruction,
    folder: &Path,
    label: Option<u8>,
    outcome: &mut Outcome,
) -> Result<Vec<Point3dId>> {
    let frames = run.frames()?;
    let files = MaskFolder::open(folder, frames, run.info())?;
    // Frames that are not registered have no mask of a semantic model, and are not missing.
    if matches!(run.options.ground_labels, GroundLabels::Masks { .. })
        && let Some(warning) = files.warning(folder, frames)
    {
        outcome.warn(warning);
    }
    let by_name: BTreeMap<&str, FrameId> = frames.iter().map(|frame| (frame.name.as_str(), frame.id)).collect();
    let mut current: Option<(String, Option<LabelMap>)> = None;
    let mut failure = None;
    let points = label_points(background, run.options.ground.min_observations, |image, pixel| {
        if current.as_ref().is_none_or(|(name, _)| *name != image.name) {
            let labels = by_name.get(image.name.as_str()).map_or(Ok(None), |&id| files.labels(id));
            let labels = labels.unwrap_or_else(|error| {
                failure.get_or_insert(error);
                None
            });
            current = Some((image.name.clone(), labels));
        }
        let labels = current.as_ref()?.1.as_ref()?;
        let value = value_at(labels, pixel.x, pixel.y)?;
        Some(label.map_or(value != 0, |label| value == label))
    });
    failure.map_or(Ok(points), Err)
}

/// The label of the pixel at an image position; `None` outside.
fn value_at(labels: &LabelMap, x: f64, y: f64) -> Option<u8> {
    let inside = x >= 0.0 && y >= 0.0 && x < f64::from(labels.width) && y < f64::from(labels.height);
    inside.then(|| labels.labels[y as usize * labels.width as usize + x as usize])
}

/// Loads the semantic model with the options of the run.
pub(in crate::pipeline) fn load(run: &Run, model: &Path) -> Result<GroundSegmenter> {
    Ok(load_ground_segmenter(model, &run.options.ground_segmentation, run.options.resources())?)
}

/// Runs the semantic model on every registered frame without a mask; returns the folder of the masks.
fn ground_masks(run: &Run, background: &Reconstruction, model: &Path, outcome: &mut Outcome) -> Result<PathBuf> {
    let folder = run.workspace.intermediate(Stage::Ground, &outcome.fingerprint)?;
    let mut segmenter = load(run, model)?;
    let registered: BTreeSet<&str> = background.images.values().map(|image| image.name.as_str()).collect();
    let is_open = |frame: &&Frame| {
        registered.contains(frame.name.as_str()) && !folder.join(RunFolder::mask_name(frame)).is_file()
    };
    let open = run.frames()?.iter().filter(is_open).map(|frame| frame.id).collect();
    images::for_each(run, Stage::Ground, open, outcome, |frame, picture| {
        Ok(masks::write_mask(&folder.join(RunFolder::mask_name(&frame)), &segmenter.ground_mask(&picture)?)?)
    })?;
    Ok(folder)
}
