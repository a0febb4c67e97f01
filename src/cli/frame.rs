//! Frames in which `convert` writes a model: that of the input, or meters, on the map if it is known.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::ValueEnum;
use serde_json::{Value, json};

use super::convert::TargetFrame;
use crate::io::RunFolder;
use crate::math::Sim3;
use crate::pipeline;
use crate::scene::{MetricAxes, MetricFrame};
use crate::telemetry::LocalFrame;

/// A frame, and its description for the file next to the model.
pub(super) struct Placed {
    pub(super) target_from_world: Sim3,
    pub(super) described: Value,
}

/// Frame of the model in an output folder; `None` for that of the input.
///
/// # Errors
/// An input that is no output folder, or a result without meters or without a map.
pub(super) fn of(frame: TargetFrame, input: &Path) -> anyhow::Result<Option<Placed>> {
    if frame == TargetFrame::World {
        return Ok(None);
    }
    let named = frame.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
    // `sfm` knows the frame of telemetry and photographs, `run` that of all sources.
    let metric = match (RunFolder::at(input).read_trajectories(), pipeline::background_frame(input)) {
        (Ok(trajectories), _) => trajectories.metric.and_then(|metric| metric.frame),
        (Err(_), Some(frame)) => Some(frame),
        (Err(error), None) => {
            return Err(error).with_context(|| {
                format!(
                    "--frame {named}: requires the output folder of `tractrix run`, or of `sfm` with positions \
                     (--telemetry FILE, or EXIF data) that fit the camera path"
                )
            });
        }
    };
    let Some(metric) = &metric else {
        bail!("--frame {named}: meters are unknown; run again with a source of them, such as --camera-height");
    };
    let on_map = (metric.axes == MetricAxes::EastNorthUp).then_some(metric.origin).flatten();
    let local = on_map.map(|origin| LocalFrame { origin });
    let grid = match (frame, local) {
        (TargetFrame::Enu | TargetFrame::Utm, None) => {
            bail!("--frame {named}: no georeferenced positions; run again with --telemetry FILE")
        }
        (TargetFrame::Utm, Some(local)) => Some(local.utm()),
        _ => None,
    };
    let metric_from_world = metric.metric_from_world();
    let target_from_world = grid.map_or(metric_from_world, |grid| grid.grid_from_local * metric_from_world);
    let axes = if grid.is_some() { "easting, northing, height" } else { axes(metric) };
    let described = json!({
        "frame": named,
        "unit": "meter",
        "axes": axes,
        "epsg": grid.map(|grid| grid.epsg),
        "origin": on_map,
        "std": metric.std,
        "target_from_world": target_from_world,
    });
    Ok(Some(Placed { target_from_world, described }))
}

fn axes(metric: &MetricFrame) -> &'static str {
    match metric.axes {
        MetricAxes::EastNorthUp => "east, north, up",
        MetricAxes::Up => "horizontal, horizontal, up",
    }
}

/// `frame.json` in a folder, `NAME.frame.json` next to a file.
pub(super) fn file_of(output: &Path) -> PathBuf {
    if output.extension().is_none() {
        return output.join("frame.json");
    }
    let mut name = output.file_name().unwrap_or_default().to_owned();
    name.push(".frame.json");
    output.with_file_name(name)
}
