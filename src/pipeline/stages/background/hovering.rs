//! The background of a camera that does not translate: its rotations, and no points.

use super::{ModelReport, failure};
use crate::mapper::rotating_camera;
use crate::pipeline::PipelineError;
use crate::pipeline::driver::run::Run;
use crate::pipeline::driver::threads::on_threads;
use crate::pipeline::inputs::cameras;
use crate::pipeline::stages::features;
use crate::scene::{CameraId, Image, Reconstruction, Topic};

/// The one camera of a video.
const CAMERA: CameraId = CameraId(1);

/// Rotations of the views, with their report; `None` where rotations do not explain them.
pub(super) fn reconstruct(run: &Run) -> Result<Option<(Reconstruction, ModelReport)>, PipelineError> {
    let table = features::of_background(run)?;
    let first = cameras::first(run)?;
    let Some(found) = on_threads(run.options.threads, || rotating_camera(&table, &first.camera))? else {
        return Ok(None);
    };
    let mut model = Reconstruction { cameras: [(CAMERA, first.camera)].into(), ..Reconstruction::default() };
    let text = format!(
        "camera does not translate (rotations fit to {:.1} px): no points of the background; ground from the sizes of \
         vehicles and --camera-pitch, unit is the camera's height; give --camera-height for meters{}",
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
    let focal_std = first.known.focal;
    report.describe_cameras(&model, &[(focal_std > 0.0).then_some(focal_std)]);
    Ok(Some((model, report)))
}
