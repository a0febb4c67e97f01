//! The metric frame of a map, by the sources that a run has.

use super::super::georeference;
use super::{Ground, Mapper};
use crate::ground::camera_height;
use crate::metric::{Fused, Gravity, Kind, Level, Measured, Source, frame_on_ground, fuse};
use crate::scene::{Frame, MetricFrame, Reconstruction};

/// Time from the first map on over which the camera's height is measured, seconds. Then the scale is fixed: a local
/// frame with a unit that changes as the camera climbs would be useless.
const HEIGHT_S: f64 = 3.0;
/// Distance from camera to ground that a unit of a frame without meters represents; as in the stage `metric`.
const NOMINAL_HEIGHT_M: f64 = 10.0;

impl Mapper {
    /// The metric frame, and whether its meters are known.
    pub(super) fn metric(
        &mut self,
        model: &Reconstruction,
        ground: &Ground,
        focal_std: f64,
        frames: &[Frame],
    ) -> (MetricFrame, bool) {
        let time_s = frames.last().map_or(0.0, |frame| frame.time_s);
        let none = Vec::new();
        let points = ground.dominant.as_ref().map_or(&none, |dominant| &dominant.point_ids);
        let below = match &ground.hovering {
            Some(hovering) => Some(hovering.camera_height(model)),
            None => camera_height(model, points, &self.options.ground, self.options.seed).ok(),
        };
        let mount = ground.mount.as_ref().and_then(|mount| Measured::new(mount.height, mount.height_std));
        let found = mount.or_else(|| below.as_ref().and_then(|below| Measured::new(below.mean, below.std)));
        if let Some(found) = found.filter(|_| self.held.height.is_none() || time_s - self.begin_s <= HEIGHT_S) {
            let (mean, count) = self.held.height.map_or((0.0, 0.0), |(mean, count)| (mean.value, count));
            let value = (mean * count + found.value) / (count + 1.0);
            // Maps share their frames: their errors do not average out. The focal length is that of these maps.
            let mean = Measured { value, std: (found.std / found.value).hypot(focal_std) * value };
            self.held.height = Some((mean, count + 1.0));
        }
        let height = self.held.height.map(|(mean, _)| mean);
        let drift = self.held.drift;
        let surveyed = |name: &str, (log_scale, std): (f64, f64)| {
            let std = std.hypot(drift.sqrt());
            Source { name: name.to_owned(), kind: Kind::Surveyed, log_scale, std }
        };
        let metric = &self.options.metric;
        let of_scale = metric.scale.map(|scale| surveyed("given scale", scale.log()));
        let of_height = metric.camera_height.zip(height);
        let of_height = of_height.map(|(given, units)| surveyed("camera height", given.log_ratio(&units)));
        let of_map = self.held.on_map.as_ref().map(|map| map.of_map_points());
        let of_map = of_map.map(|source| Source { std: source.std.hypot(drift.sqrt()), ..source });
        let mut sources: Vec<Source> = of_scale.into_iter().chain(of_height).chain(of_map).collect();
        if let Some(georeferencer) = &mut self.georeferencer {
            let options = metric;
            let gravity = below.as_ref().map(|below| Gravity { up_in_world: below.up_in_world, std: below.tilt_std() });
            // Only a frame that began with the hovering camera has its origin there.
            let hovering = self.hovering.as_ref().filter(|hovering| hovering.is_own).and(height);
            let update = georeference::Update { model, frames, gravity, drift, sources: &sources, options, hovering };
            georeferencer.update(&update);
            sources.extend(georeferencer.scale(drift));
        }
        let level = *self.held.level.get_or_insert_with(|| {
            let up = below.as_ref().map(|below| (below.up_in_world, below.tilt_std()));
            Level::of_background(model, up, below.as_ref().map(|below| below.foot_in_world))
        });
        let known = fuse(&sources);
        let is_metric = known.is_some();
        let nominal = *self.held.nominal.get_or_insert(height.map_or(1.0, |height| NOMINAL_HEIGHT_M / height.value));
        let fused = known.unwrap_or_else(|| Fused::of_scale(nominal, 0.0));
        (frame_on_ground(&fused, &level), is_metric)
    }
}
