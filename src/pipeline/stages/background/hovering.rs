//! The background of a camera that does not translate: rotations without points.

use super::{ModelReport, failure};
use crate::features::TrackTable;
use crate::features::lines::ImageLines;
use crate::mapper::{HoveringCamera, LineNormal, hovering_camera, rotating_camera};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::cameras::{self, InitialCamera};
use crate::pipeline::inputs::hovering::camera_by_map_points;
use crate::pipeline::inputs::images;
use crate::pipeline::stages::features;
use crate::pipeline::{Result, Stage};
use crate::scene::{Reconstruction, Topic};

/// File name of the ground's normal by straight lines; the file may contain `null`.
const NORMAL: &str = "normal-by-lines.json";

/// The ground's normal by straight lines; `None` if they determine none. The stage must be done.
pub(in crate::pipeline) fn normal_by_lines(run: &Run) -> Option<LineNormal> {
    // A given model has no such file.
    run.workspace.read_state(NORMAL).ok().flatten()
}

/// Returns true if the camera does not translate: a map could then only be one of vehicles, or of rotations mistaken
/// for translation.
pub(super) fn camera_only_rotates(run: &Run, table: &TrackTable) -> Result<bool> {
    Ok(rotating_camera(table, &cameras::first(run)?.camera).is_some_and(|found| found.is_still()))
}

/// Rotations of the views, with their report; `None` if pure rotation does not explain the views.
pub(super) fn reconstruct(run: &Run, outcome: &mut Outcome) -> Result<Option<(Reconstruction, ModelReport)>> {
    let table = features::of_background(run)?;
    let InitialCamera { camera, known, .. } = cameras::first(run)?;
    let lines = lines_of_first(run, &table, outcome)?;
    let (camera, focal_std) = camera_by_map_points(&run.options.metric, &table, &camera, known.focal);
    let found = hovering_camera(&table, &camera, focal_std, &lines);
    let Some(HoveringCamera { rotations: found, camera, focal_std, by_lines }) = found else { return Ok(None) };
    run.workspace.write_state(NORMAL, &by_lines)?;
    let model = found.model(&table, &camera);
    let text = format!(
        "camera does not translate (rotations fit to {:.1} px): no points of the background; ground from straight \
         lines, the sizes of vehicles, --camera-pitch, telemetry or --map-points, unit is the camera's height; give \
         --camera-height for meters{}",
        found.error_px,
        failure::reasons(run)?
    );
    let remarks = vec![Topic::CameraHovers.warning(text)];
    let mut report = ModelReport { num_visible: table.views.len(), remarks, ..ModelReport::default() };
    let lost = table.views.iter().filter(|view| !model.images.contains_key(&view.image));
    let reason = "its points do not agree on a rotation";
    report.unregistered.extend(lost.map(|view| (view.image.frame(), reason.to_owned())));
    report.num_registered = model.images.len();
    report.describe_points(&model);
    report.describe_cameras(&model, &[(focal_std > 0.0).then_some(focal_std)]);
    Ok(Some((model, report)))
}

/// Straight lines of some of the first views; fewer if frames cannot be decoded.
fn lines_of_first(run: &Run, table: &TrackTable, outcome: &mut Outcome) -> Result<Vec<ImageLines>> {
    // Spaced views differ in compression and moving vehicles. They average noise; beyond five nothing changes.
    let views = table.views.iter().filter(|view| !view.pixels.is_empty()).step_by(6).take(5);
    let chosen = views.map(|view| view.image.frame()).collect();
    let mut found = Vec::new();
    images::for_each(run, Stage::Background, chosen, outcome, |frame, picture| {
        // OpenCV may have been built without the detector.
        found.extend(ImageLines::of(&picture, frame.id.into()).ok());
        Ok(())
    })?;
    Ok(found)
}
