//! Map frame of a background by photo positions or a log alone; the stage `metric` uses all sources.
//!
//! Written at the end of `tractrix sfm` and not by the stage: a new log must not require a new reconstruction.

use std::path::Path;

use crate::metric::{Kind, Offset, Support, frame_on_map, fuse};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::driver::workspace::read_state;
use crate::pipeline::inputs::alignment::{self, FittedLog};
use crate::pipeline::inputs::telemetry::{self, Origin};
use crate::pipeline::{Result, TelemetryChoice};
use crate::scene::{Metric, MetricFrame, Reconstruction};

/// File name of the frame; the file may contain `null`.
const FILE: &str = "background-frame.json";

/// Map frame of the background in an output folder of `tractrix sfm`; `None` if it has none.
pub fn background_frame(output: &Path) -> Option<MetricFrame> {
    read_state(output, FILE).ok().flatten()
}

/// Meters per unit of a background by its telemetry; writes the map frame for [`background_frame`].
///
/// # Errors
/// A file that cannot be written.
pub(in crate::pipeline) fn write(run: &Run, background: &Reconstruction) -> Result<Option<Metric>> {
    let metric = fit(run, background).and_then(|(fitted, origin)| metric(&fitted, origin));
    run.workspace.write_state(FILE, &metric.as_ref().and_then(|metric| metric.frame.as_ref()))?;
    Ok(metric)
}

/// Alignment of the input's telemetry with the background's camera trajectory, and its origin; `None` without
/// telemetry, or if it does not fit.
fn fit(run: &Run, background: &Reconstruction) -> Option<(FittedLog, Origin)> {
    if run.options.metric.telemetry == TelemetryChoice::None || background.points.is_empty() {
        return None;
    }
    let telemetry = telemetry::find(run, &mut Outcome::default())?;
    let without_support = |offset: Offset, _| Support { offset, gravity: None, orientation: None };
    let say = |reason| tracing::info!("{}: positions give no frame on the map: {reason}", telemetry.path.display());
    let fitted = alignment::fit(run, background, &telemetry, without_support).map_err(say).ok()?;
    Some((fitted, telemetry.origin))
}

fn metric(fitted: &FittedLog, of_log: Origin) -> Option<Metric> {
    let FittedLog { alignment, map, .. } = fitted;
    let fused = fuse(&[alignment.source(of_log.source_name(), Kind::Telemetry)])?;
    Some(Metric {
        verdict: fused.verdict,
        frame: Some(frame_on_map(&fused, alignment, map.origin)),
        shares: fused.shares,
        ..Metric::default()
    })
}
