//! Measured or given lengths, divided by the same lengths in units of the background.

use nalgebra::Vector3;

use super::super::background;
use super::super::ground::{self, GroundResults};
use crate::ground::{CameraHeight, HeightFailure, camera_height};
use crate::metric::{Kind, Level, Measured, Source};
use crate::pipeline::Result;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::scene::{Reconstruction, Topic};

/// The ground of the background, for sources of metres.
pub(super) struct Ground {
    /// Up by the ground's normal or a sensor, and its standard deviation as the vertical, radians.
    pub(super) normal: Option<(Vector3<f64>, f64)>,
    below: Result<CameraHeight, HeightFailure>,
    /// Height above the road of a camera fixed to a vehicle.
    mount: Option<Measured>,
    /// Relative standard deviation of the focal length. If it is too long, all lengths across the direction of motion
    /// are too small relative to those along it; the height of the camera by the same share.
    focal_std: f64,
}

/// Maximum angle between a sensor's vertical and the ground's normal, radians: beyond it, the vertical is that of
/// another or a rotated camera.
pub(super) const MAX_TILT: f64 = 0.35;

impl Ground {
    pub(super) fn of(run: &Run, background: &Reconstruction) -> Result<Self> {
        let GroundResults { hovering, mount, .. } = ground::sources(run)?;
        let below = match hovering {
            Some(hovering) => Ok(hovering.camera_height(background)),
            None => {
                let points = run.workspace.read_ground()?.point_ids;
                camera_height(background, &points, &run.options.ground, run.options.seed)
            }
        };
        let normal = below.as_ref().ok().map(|found| (found.up_in_world, found.tilt_std()));
        let focal_std = background::focal_deviation(run)?.unwrap_or(0.0);
        let mount =
            mount.and_then(|found| Measured::new(found.height, found.height_std.hypot(found.drift * found.height)));
        Ok(Self { normal, below, mount, focal_std })
    }

    /// Uses the vertical of a sensor instead of the ground's normal, unless the two contradict each other.
    pub(super) fn take_vertical(&mut self, vertical: Option<(Vector3<f64>, f64)>, outcome: &mut Outcome) {
        let Some((up_in_world, std)) = vertical else { return };
        if self.normal.is_some_and(|(normal, _)| normal.angle(&up_in_world) > MAX_TILT) {
            let text = "telemetry: the camera's gravity does not fit the ground; gravity ignored";
            outcome.warn(Topic::CameraAttitudeIgnored.warning(text));
            return;
        }
        self.normal = Some((up_in_world, std));
    }

    /// Height of the camera, units of the background.
    pub(super) fn height(&self) -> Result<Measured, String> {
        let of_planes = || {
            let found = self.below.as_ref().map_err(ToString::to_string)?;
            Measured::new(found.mean, found.std).ok_or_else(|| "the height above the ground is undetermined".to_owned())
        };
        let height = self.mount.map_or_else(of_planes, Ok)?;
        Ok(Measured { std: height.std.hypot(self.focal_std * height.value), ..height })
    }

    /// Change of the camera's height, as a share of the height.
    fn spread(&self) -> f64 {
        self.below.as_ref().map_or(0.0, |found| found.spread)
    }

    /// The vertical, and an origin for results without a map.
    pub(super) fn level(&self, background: &Reconstruction) -> Level {
        Level::of_background(background, self.normal, self.below.as_ref().ok().map(|found| found.foot_in_world))
    }
}

/// Measured or given lengths.
pub(super) fn measured(run: &Run, ground: &Ground, outcome: &mut Outcome) -> Vec<Source> {
    let options = &run.options.metric;
    let given = options.scale.map(|scale| source("given scale", scale.log()));
    given.into_iter().chain(options.camera_height.and_then(|height| of_height(height, ground, outcome))).collect()
}

fn source(name: &str, (log_scale, std): (f64, f64)) -> Source {
    Source { name: name.to_owned(), kind: Kind::Surveyed, log_scale, std }
}

/// Change of the camera's height, as a share of it, above which a single measured height hardly applies.
const MAX_SPREAD: f64 = 0.15;

fn of_height(given: Measured, ground: &Ground, outcome: &mut Outcome) -> Option<Source> {
    let unusable = |text: String| Topic::CameraHeightUnusable.warning(text);
    let no_scale = |reason: String| outcome.warn(unusable(format!("--camera-height gives no scale: {reason}")));
    let height = ground.height().map_err(no_scale).ok()?;
    if ground.spread() > MAX_SPREAD {
        outcome.warn(unusable(format!(
            "--camera-height: height above ground varies by ±{:.0} %; the value is taken as the mean over the frames",
            100.0 * ground.spread()
        )));
    }
    outcome.figure("camera_height", serde_json::json!({ "units": height.value, "units_std": height.std }));
    Some(source("camera height", given.log_ratio(&height)))
}
