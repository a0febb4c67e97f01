//! The background of a camera that does not translate: its rotations, and no points.

use super::{ModelReport, failure};
use crate::mapper::{HoveringCamera, SwayGround, hovering_camera};
use crate::pipeline::PipelineError;
use crate::pipeline::driver::run::Run;
use crate::pipeline::driver::threads::on_threads;
use crate::pipeline::inputs::cameras::{self, InitialCamera};
use crate::pipeline::inputs::hovering::camera_by_map_points;
use crate::pipeline::stages::features;
use crate::scene::{Reconstruction, Topic};

/// The ground by the sway of the camera, or `null`.
const SWAY: &str = "sway-ground.json";

/// The ground by the sway of a camera that hovers; `None` where it shows none. The stage must be done.
pub(in crate::pipeline) fn sway(run: &Run) -> Option<SwayGround> {
    // A model that was given has no such file.
    run.workspace.read_state(SWAY).ok().flatten()
}

/// Rotations of the views, with their report; `None` where rotations do not explain them.
pub(super) fn reconstruct(run: &Run) -> Result<Option<(Reconstruction, ModelReport)>, PipelineError> {
    let table = features::of_background(run)?;
    let InitialCamera { camera, known, .. } = cameras::first(run)?;
    let found = on_threads(run.options.threads, || {
        let (camera, focal_std) = camera_by_map_points(&run.options.metric, &table, &camera, known.focal);
        hovering_camera(&table, &camera, focal_std)
    })?;
    let Some(HoveringCamera { rotations: found, camera, focal_std, sway }) = found else { return Ok(None) };
    run.workspace.write_state(SWAY, &sway)?;
    let model = found.model(&table, &camera);
    let text = format!(
        "camera does not translate (rotations fit to {:.1} px): no points of the background; ground from its sway, the \
         sizes of vehicles, --camera-pitch, telemetry or --map-points, unit is the camera's height; give \
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
