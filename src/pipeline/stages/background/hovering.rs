//! The background of a camera that does not translate: its rotations, and no points.

use super::{ModelReport, failure};
use crate::mapper::{SwayGround, rotating_camera, sway_ground};
use crate::pipeline::PipelineError;
use crate::pipeline::driver::run::Run;
use crate::pipeline::driver::threads::on_threads;
use crate::pipeline::inputs::cameras::{self, InitialCamera};
use crate::pipeline::stages::features;
use crate::scene::{CameraId, Image, Reconstruction, Topic};

/// The one camera of a video.
const CAMERA: CameraId = CameraId(1);

/// The ground by the sway of the camera, or `null`.
const SWAY: &str = "sway-ground.json";
/// Standard deviation of a normal beyond which the adjustment is not linear, and the sway shows none, radians. With
/// half of it the focal length of a flight at 46 m, known to 2 %, was lost, too.
const MAX_TILT_STD: f64 = 0.3;

/// The ground by the sway of a camera that hovers; `None` where it shows none. The stage must be done.
pub(in crate::pipeline) fn sway(run: &Run) -> Option<SwayGround> {
    // A model that was given has no such file.
    run.workspace.read_state(SWAY).ok().flatten()
}

/// Rotations of the views, with their report; `None` where rotations do not explain them.
pub(super) fn reconstruct(run: &Run) -> Result<Option<(Reconstruction, ModelReport)>, PipelineError> {
    let table = features::of_background(run)?;
    let InitialCamera { mut camera, known, .. } = cameras::first(run)?;
    let mut focal_std = known.focal;
    let found = on_threads(run.options.threads, || {
        let found = rotating_camera(&table, &camera)?;
        let rotations: Vec<_> = found.poses.iter().map(|pose| pose.map(|pose| pose.rotation)).collect();
        let sway = sway_ground(&table, &camera, &rotations, focal_std).filter(|sway| sway.tilt_std() <= MAX_TILT_STD);
        let Some(SwayGround { log_focal: [log_focal, std], .. }) = sway else { return Some((found, sway)) };
        (camera.focal, focal_std) = (camera.focal.map(|focal| focal * log_focal.exp()), std);
        Some((rotating_camera(&table, &camera)?, sway))
    })?;
    let Some((found, sway)) = found else { return Ok(None) };
    run.workspace.write_state(SWAY, &sway)?;
    let mut model = Reconstruction { cameras: [(CAMERA, camera)].into(), ..Reconstruction::default() };
    let text = format!(
        "camera does not translate (rotations fit to {:.1} px): no points of the background; ground from its sway, the \
         sizes of vehicles, --camera-pitch, telemetry or --map-points, unit is the camera's height; give \
         --camera-height for meters{}",
        found.error_px,
        failure::reasons(run)?
    );
    let remarks = vec![Topic::CameraHovers.warning(text)];
    let mut report = ModelReport { num_visible: table.views.len(), remarks, ..ModelReport::default() };
    for (view, pose) in table.views.iter().zip(&found.poses) {
        let Some(cam_from_world) = *pose else {
            let reason = "its points do not agree on a rotation".to_owned();
            report.unregistered.insert(view.image.frame(), reason);
            continue;
        };
        let image = Image { name: view.name.clone(), camera: CAMERA, cam_from_world, observations: Vec::new() };
        model.images.insert(view.image, image);
    }
    report.num_registered = model.images.len();
    report.describe_points(&model);
    report.describe_cameras(&model, &[(focal_std > 0.0).then_some(focal_std)]);
    Ok(Some((model, report)))
}
