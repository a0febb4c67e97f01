//! Georeferencing: alignment of the camera's path of the last minute to the fixes of the telemetry.
//!
//! The path is in the frame of the first map, which all later maps continue, and is aligned to the fixes as in the
//! stage `metric` (docs/maths/metric.md, eqs. 1–5). It gives latitude, longitude and height of every position, with the
//! covariance of the alignment, and meters per unit. A later alignment replaces the previous one where it is more
//! precise at the camera; until then the drift of the maps is added to its variance.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};

use super::line::GeoPosition;
use super::telemetry::{Current, TelemetryFeed};
use crate::metric::{
    Alignment, CameraPath, DRIFT, Fused, Gravity, Kind, Measured, ObservedPoint, Offset, Source, Support,
    align_to_fixes, frame_on_map, fuse, place_std_m,
};
use crate::pipeline::{MetricOptions, OnMap, Station, dates_of_log, gimbal_orientation};
use crate::scene::{ClockZone, Frame, FrameId, MetricFrame, Reconstruction};
use crate::telemetry::{LocalFixes, LocalFrame, Log, TimeBase, date};

/// Length of the path, seconds: a baseline of hundreds of meters, over which maps drift by a few per cent.
const PATH_S: f64 = 60.0;
/// Standard deviations by which the arrival of a camera's own log may contradict its times.
const CONSISTENT: f64 = 3.0;
/// Maximum ratio of the new standard deviation to the old one to replace the scale of the local frame: every change
/// moves all positions of the local frame.
const BETTER: f64 = 0.5;
/// Name of the source of scale.
const MAP_POINTS: &str = "map points";

/// A camera center in the frame of the maps.
struct Visited {
    time_s: f64,
    center: Point3<f64>,
    /// Variance of the logarithm of lengths by the alignments of maps up to it.
    drift: f64,
}

/// Georeference of the frame of the maps on the ellipsoid.
pub(super) struct Georeference {
    /// Meters east, north, up from the frame of the maps.
    frame: MetricFrame,
    map: LocalFrame,
    /// UTC at the beginning of the video, seconds after 1970; `None` where the log has none.
    utc_start_s: Option<f64>,
    alignment: Alignment,
    /// Variance of the logarithm of lengths by the alignments of maps up to it.
    drift: f64,
}

/// Aligns the path of the camera to the fixes, map by map.
pub(super) struct Georeferencer {
    feed: Arc<TelemetryFeed>,
    path: BTreeMap<FrameId, Visited>,
    found: Option<Arc<Georeference>>,
    /// Meters per unit of the local frame, and the drift up to them.
    held: Option<(Source, f64)>,
    problem: Option<String>,
}

/// Data of a new map for georeferencing.
pub(super) struct Update<'a> {
    pub(super) model: &'a Reconstruction,
    /// The frames of its images.
    pub(super) frames: &'a [Frame],
    pub(super) gravity: Option<Gravity>,
    /// Variance of the logarithm of lengths by the alignments of maps so far.
    pub(super) drift: f64,
    /// Other sources of scale.
    pub(super) sources: &'a [Source],
    pub(super) options: &'a MetricOptions,
    /// Height of a camera that does not translate above the ground, units; its frame has its origin there.
    pub(super) hovering: Option<Measured>,
}

impl Georeferencer {
    pub(super) fn new(feed: Arc<TelemetryFeed>) -> Self {
        Self { feed, path: BTreeMap::new(), found: None, held: None, problem: None }
    }

    /// Resets the state: the maps have a new frame.
    pub(super) fn restart(&mut self) {
        *self = Self::new(self.feed.clone());
    }

    /// Takes a new map; aligns the path to the fixes.
    pub(super) fn update(&mut self, update: &Update) {
        let Update { model, frames, drift, .. } = *update;
        let visited = frames.iter().filter_map(|frame| {
            let center = model.images.get(&frame.id.into())?.cam_from_world.center();
            Some((frame.id, Visited { time_s: frame.time_s, center, drift }))
        });
        self.path.extend(visited);
        let Some(last) = self.path.values().next_back() else { return };
        let (begin_s, here) = (last.time_s - PATH_S, last.center);
        self.path.retain(|_, visited| visited.time_s >= begin_s);
        match self.align(update) {
            Err(problem) => self.problem = Some(problem),
            Ok((new, scale)) => {
                self.problem = None;
                self.hold(scale, drift);
                let error = |found: &Georeference| found.camera_std(here, drift);
                let is_better = self.found.as_ref().is_none_or(|found| error(&new) <= error(found));
                if is_better {
                    self.found = Some(Arc::new(new));
                }
            }
        }
    }

    /// The best alignment so far.
    pub(super) fn found(&self) -> Option<Arc<Georeference>> {
        self.found.clone()
    }

    /// Reason why the last map could not be aligned.
    pub(super) fn problem(&self) -> Option<String> {
        self.problem.clone()
    }

    /// Meters per unit of the local frame.
    ///
    /// * `drift` – variance of the logarithm of lengths by the alignments of maps so far.
    pub(super) fn scale(&self, drift: f64) -> Option<Source> {
        let (source, before) = self.held.as_ref()?;
        Some(Source { std: source.std.hypot((drift - before).max(0.0).sqrt()), ..source.clone() })
    }

    fn hold(&mut self, new: Option<Source>, drift: f64) {
        let Some(new) = new else { return };
        if self.scale(drift).is_none_or(|held| new.std < BETTER * held.std) {
            self.held = Some((new, drift));
        }
    }

    /// Position and attitude of a camera that does not translate.
    ///
    /// # Errors
    /// Reason why they are unknown.
    pub(super) fn station(
        &self,
        model: &Reconstruction,
        frames: &[Frame],
        options: &MetricOptions,
    ) -> Result<Station, String> {
        let (current, local) = self.fixes()?;
        let offset = offset(&current, &local, options);
        Station::new(local, offset, frames, model, &current.log.fixes)
    }

    /// UTC at the beginning of the video, seconds after 1970; `None` where the log has none.
    pub(super) fn utc_start_s(&self, station: &Station, options: &MetricOptions) -> Option<f64> {
        utc_start_s(&self.feed.current().ok()?.log, station.clock_offset_s(), options)
    }

    /// Current log, and its fixes.
    fn fixes(&self) -> Result<(Current, LocalFixes), String> {
        let current = self.feed.current().map_err(|error| error.to_string())?;
        let local = current.log.local_fixes().ok_or("no position with a time")?;
        Ok((current, local))
    }

    /// Georeference of the map, and meters per unit by it.
    fn align(&self, update: &Update) -> Result<(Georeference, Option<Source>), String> {
        let Update { model, frames, gravity, drift, sources, options, hovering } = *update;
        let (alignment, scale, map, clock_offset_s, log) = if let Some(height) = hovering {
            let log = self.feed.current().map_err(|error| error.to_string())?.log;
            let station = self.station(model, frames, options)?;
            let alignment = station.alignment().ok_or("no gimbal angles, and the camera does not translate")?;
            let of_height = station.source_of_height(&height);
            let clock_offset_s = station.clock_offset_s();
            (alignment, of_height, station.map, clock_offset_s, log)
        } else {
            let (current, local) = self.fixes()?;
            let path = self.camera_path()?;
            let offset = offset(&current, &local, options);
            let orientation = match offset {
                Offset::Known { mean_s, .. } => {
                    gimbal_orientation(model, frames, &current.log.fixes, local.epoch_s + mean_s)
                }
                Offset::Unknown => None,
            };
            let support = Support { offset, gravity: gravity.filter(|_| orientation.is_none()), orientation };
            let alignment = align_to_fixes(&path, &local.fixes, &support).map_err(|refusal| refusal.to_string())?;
            let of_path = alignment.source("telemetry", Kind::Telemetry);
            let clock_offset_s = local.epoch_s + alignment.offset_s;
            (alignment, Some(of_path), local.frame, clock_offset_s, current.log)
        };
        let all: Vec<Source> = sources.iter().cloned().chain(scale.clone()).collect();
        let fused = fuse(&all).ok_or("no scale")?;
        let frame = frame_on_map(&fused, &alignment, map.origin);
        let utc_start_s = utc_start_s(&log, clock_offset_s, options);
        Ok((Georeference { frame, map, utc_start_s, alignment, drift }, scale))
    }

    fn camera_path(&self) -> Result<CameraPath, String> {
        let centers = self.path.values().map(|visited| (visited.time_s, visited.center)).collect();
        let drifts = || self.path.values().map(|visited| visited.drift);
        let drift = drifts().next_back().unwrap_or(0.0) - drifts().next().unwrap_or(0.0);
        CameraPath::with_drift(centers, DRIFT.max(drift.max(0.0).sqrt()))
            .ok_or_else(|| "fewer than two frames registered".to_owned())
    }
}

/// Prior on the offset between the clocks.
fn offset(current: &Current, local: &LocalFixes, options: &MetricOptions) -> Offset {
    let LocalFixes { times, epoch_s, .. } = *local;
    if let Some(given) = options.time_offset {
        return Offset::Known { mean_s: given.mean_s, std_s: given.std_s };
    }
    let is_of_camera = times == TimeBase::Video && current.log.is_of_camera();
    match current.by_arrival {
        Some((mean_s, std_s)) if !is_of_camera || mean_s.abs() > CONSISTENT * std_s => {
            Offset::Known { mean_s: mean_s - epoch_s, std_s }
        }
        _ if is_of_camera => Offset::SAME_FILE,
        _ if times == TimeBase::Video => Offset::TWO_BUTTONS,
        _ => Offset::Unknown,
    }
}

fn utc_start_s(log: &Log, log_from_video_s: f64, options: &MetricOptions) -> Option<f64> {
    let dates = dates_of_log(log, Some(log_from_video_s), options)?;
    dates.start_s.filter(|_| dates.zone == ClockZone::Utc)
}

impl Georeference {
    /// A camera that does not translate, by points of a map.
    ///
    /// * `utc_start_s` – UTC at the beginning of the video, seconds after 1970.
    pub(super) fn on_map(found: OnMap, utc_start_s: Option<f64>) -> Self {
        let OnMap { alignment, map, .. } = found;
        let scale = alignment.source(MAP_POINTS, Kind::Surveyed);
        let fused = Fused::of_scale(scale.log_scale.exp(), scale.std);
        let frame = frame_on_map(&fused, &alignment, map.origin);
        Self { frame, map, utc_start_s, alignment, drift: 0.0 }
    }

    /// Meters per unit by the points of a map.
    pub(super) fn of_map_points(&self) -> Source {
        self.alignment.source(MAP_POINTS, Kind::Surveyed)
    }

    /// A position of the maps on the ellipsoid.
    ///
    /// * `drift` – variance of the logarithm of lengths by the alignments of maps so far.
    pub(super) fn position(&self, observed: &ObservedPoint, drift: f64) -> GeoPosition {
        let found = self.map.to_geodetic(self.frame.metric_from_world() * observed.point);
        let [east, north, up] = self.std_m(observed, drift);
        let knows_height = self.map.origin.knows_height;
        GeoPosition {
            latitude: found.latitude_deg,
            longitude: found.longitude_deg,
            height: knows_height.then_some(rounded(found.height_m)),
            horizontal_std: rounded(east.hypot(north)),
            vertical_std: knows_height.then_some(rounded(up)),
            distance: rounded((observed.point - observed.center).norm() * self.frame.scale),
            velocity: None,
            speed_std: None,
            course_deg: None,
            course_std_deg: None,
        }
    }

    /// The same with the velocity.
    ///
    /// * `local` – frame of the velocity.
    /// * `velocity` – along its axes, per second.
    /// * `heading_std_deg` – `None` for a vehicle at rest.
    pub(super) fn moving(
        &self,
        position: GeoPosition,
        local: &MetricFrame,
        velocity: [f64; 3],
        speed_std: f64,
        heading_std_deg: Option<f64>,
    ) -> GeoPosition {
        let (map, local) = (self.frame.metric_from_world(), local.metric_from_world());
        let factor = map.scale / local.scale;
        let velocity = map.rotation * (local.rotation.inverse() * Vector3::from(velocity)) * factor;
        let course = velocity.x.atan2(velocity.y).to_degrees().rem_euclid(360.0);
        let north_std = self.frame.std.heading_deg.unwrap_or(0.0);
        GeoPosition {
            velocity: Some([velocity.x, velocity.y, velocity.z].map(rounded)),
            speed_std: Some(rounded(speed_std * factor)),
            course_deg: heading_std_deg.map(|_| rounded(course)),
            course_std_deg: heading_std_deg.map(|std| rounded(std.hypot(north_std))),
            ..position
        }
    }

    /// UTC of a time of the video, ISO 8601.
    pub(super) fn utc(&self, time_s: f64) -> Option<String> {
        date(self.utc_start_s? + time_s, true)
    }

    fn std_m(&self, observed: &ObservedPoint, drift: f64) -> [f64; 3] {
        let arm = (observed.point - Point3::from(self.frame.anchor)).norm() * self.frame.scale;
        let drift = arm * (drift - self.drift).max(0.0).sqrt();
        place_std_m(&self.frame, observed).map(|std| std.hypot(drift))
    }

    /// Standard deviation of the camera's position, meters.
    fn camera_std(&self, center: Point3<f64>, drift: f64) -> f64 {
        let [east, north, _] = self.std_m(&camera(center), drift);
        east.hypot(north)
    }
}

/// A camera center, without an error of its own.
pub(super) fn camera(center: Point3<f64>) -> ObservedPoint {
    let pose_covariance = Matrix3::zeros();
    ObservedPoint { point: center, center, log_ratio_std: 0.0, direction_std: 0.0, pose_covariance }
}

/// Rounds to four decimals: a tenth of a millimeter.
pub(super) fn rounded(value: f64) -> f64 {
    (1e4 * value).round() / 1e4
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::{UnitQuaternion, point, vector};
    use rand::Rng as _;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::math::{Sim3, seeded_rng};
    use crate::metric::Kind;
    use crate::scene::{CameraId, Image};
    use crate::synthetic::scene::{self, CameraMotion, static_scene};
    use crate::telemetry::Geodetic;

    const STEP_S: f64 = 0.5;

    /// A flight of 300 m at 10 m/s, its log, and the true similarity.
    struct Flight {
        model: Reconstruction,
        frames: Vec<Frame>,
        feed: Arc<TelemetryFeed>,
        enu_from_world: Sim3,
        map: LocalFrame,
    }

    /// * `std_m` – standard deviation of the positions of the log.
    fn flight(std_m: f64) -> Flight {
        let options = scene::Options { num_images: 60, path: CameraMotion::Flight, ..scene::Options::default() };
        let model = static_scene(&options);
        let frames: Vec<Frame> = model
            .images
            .iter()
            .map(|(id, image)| Frame {
                id: id.frame(),
                name: image.name.clone(),
                time_s: STEP_S * f64::from(id.frame().0),
            })
            .collect();
        let rotation = UnitQuaternion::from_euler_angles(0.3, -0.2, 1.1);
        let enu_from_world = Sim3::new(10.0, rotation, vector![40.0, -20.0, 55.0]);
        let map = LocalFrame::at(Geodetic { longitude_deg: 8.5, latitude_deg: 47.3, height_m: 400.0 });
        let feed = Arc::new(TelemetryFeed::new(Path::new("recording.csv")));
        feed.push(b"time_s,latitude,longitude,altitude,utc\n", false);
        let mut rng = seeded_rng(3, 0);
        for frame in frames.iter().step_by(2) {
            let center = enu_from_world * model.images[&frame.id.into()].cam_from_world.center();
            let noise = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal) * std_m);
            let at = map.to_geodetic(center + noise);
            let row = format!(
                "{:.3},{:.9},{:.9},{:.4},2024-06-01T12:00:{:06.3}Z\n",
                frame.time_s, at.latitude_deg, at.longitude_deg, at.height_m, frame.time_s
            );
            feed.push(row.as_bytes(), false);
        }
        Flight { model, frames, feed, enu_from_world, map }
    }

    impl Flight {
        fn update<'a>(&'a self, drift: f64, options: &'a MetricOptions) -> Update<'a> {
            let up_in_world = self.enu_from_world.rotation.inverse() * Vector3::z();
            let gravity = Some(Gravity { up_in_world, std: 0.02 });
            Update { model: &self.model, frames: &self.frames, gravity, drift, sources: &[], options, hovering: None }
        }
    }

    #[test]
    fn a_point_gets_its_position_within_the_standard_deviation() {
        let flight = flight(1.0);
        let options = MetricOptions::default();
        let mut georeferencer = Georeferencer::new(flight.feed.clone());
        georeferencer.update(&flight.update(0.0, &options));
        assert_eq!(georeferencer.problem(), None);
        let found = georeferencer.found().unwrap();
        let center = flight.model.images[&flight.frames[30].id.into()].cam_from_world.center();
        let observed = ObservedPoint { point: center + vector![0.0, 0.0, 5.0], ..camera(center) };
        let truth = flight.map.to_geodetic(flight.enu_from_world * observed.point);
        let position = found.position(&observed, 0.0);
        let frame = LocalFrame::at(truth);
        let error = frame.from_geodetic(Geodetic {
            latitude_deg: position.latitude,
            longitude_deg: position.longitude,
            height_m: position.height.unwrap(),
        });
        let (horizontal, vertical) = (position.horizontal_std, position.vertical_std.unwrap());
        assert!(error.xy().coords.norm() < 2.5 * horizontal && error.z.abs() < 2.5 * vertical, "{error} {position:?}");
        assert!((1.0..8.0).contains(&horizontal) && (position.distance - 50.0).abs() < 5.0, "{position:?}");
        // The offset between the clocks is estimated to some tenths of a second.
        let utc = found.utc(12.5).unwrap();
        assert!(utc.starts_with("2024-06-01T12:00:12."), "{utc}");
        // The path continues, and the maps drift.
        assert!(found.position(&observed, 0.01).horizontal_std > horizontal);
        let scale = georeferencer.scale(0.0).unwrap();
        assert!((scale.log_scale - 10f64.ln()).abs() < 3.0 * scale.std && scale.std < 0.05, "{scale:?}");
        assert_eq!((scale.kind, georeferencer.scale(0.01).unwrap().std > 0.1), (Kind::Telemetry, true));
    }

    #[test]
    fn a_camera_that_hovers_has_the_map_of_its_gimbal() {
        // 50 m above take-off, to the east, 40° down.
        let feed = Arc::new(TelemetryFeed::new(Path::new("recording.SRT")));
        let mut model = Reconstruction::default();
        let mut frames = Vec::new();
        for frame in 0..20u32 {
            let (from, to) = (f64::from(frame) / 10.0, f64::from(frame + 1) / 10.0);
            let times = format!("00:00:{from:06.3} --> 00:00:{to:06.3}").replace('.', ",");
            let place = "[latitude: 47.300000] [longitude: 8.500000] [rel_alt: 50.000 abs_alt: 450.000]";
            let gimbal = "[gb_yaw: 90.0 gb_pitch: -40.0 gb_roll: 0.0]";
            let text =
                format!("{}\n{times}\nFrameCnt: {}, DiffTime: 100ms\n{place} {gimbal}\n\n", frame + 1, frame + 1);
            feed.push(text.as_bytes(), false);
            let name = format!("{frame}.jpg");
            let cam_from_world = crate::math::Rigid3::identity();
            let image = Image { name: name.clone(), camera: CameraId(1), cam_from_world, observations: Vec::new() };
            model.images.insert(FrameId(frame).into(), image);
            frames.push(Frame { id: FrameId(frame), name, time_s: from });
        }
        let (options, hovering) = (MetricOptions::default(), Measured::new(1.0, 0.01));
        let mut georeferencer = Georeferencer::new(feed);
        let (model, frames, sources, options) = (&model, &frames[..], &[][..], &options);
        georeferencer.update(&Update { model, frames, gravity: None, drift: 0.0, sources, options, hovering });
        assert_eq!(georeferencer.problem(), None);
        let pitch = 40f64.to_radians();
        let observed = ObservedPoint { point: point![0.0, 0.0, 1.0 / pitch.sin()], ..camera(Point3::origin()) };
        let position = georeferencer.found().unwrap().position(&observed, 0.0);
        let map = LocalFrame::at(Geodetic { longitude_deg: 8.5, latitude_deg: 47.3, height_m: 0.0 });
        let (longitude_deg, latitude_deg) = (position.longitude, position.latitude);
        let found = map.from_geodetic(Geodetic { longitude_deg, latitude_deg, height_m: 0.0 });
        assert!((found.x - 50.0 / pitch.tan()).abs() < 0.1 && found.y.abs() < 0.1, "{found}");
        let scale = georeferencer.scale(0.0).unwrap();
        assert!((scale.log_scale - 50f64.ln()).abs() < 1e-6 && (0.03..0.1).contains(&scale.std), "{scale:?}");
    }

    #[test]
    fn velocities_turn_to_the_east_and_north() {
        let flight = flight(0.01);
        let options = MetricOptions::default();
        let mut georeferencer = Georeferencer::new(flight.feed.clone());
        georeferencer.update(&flight.update(0.0, &options));
        let found = georeferencer.found().unwrap();
        // A local frame equal to that of the maps.
        let local = MetricFrame {
            scale: 1.0,
            rotation_wxyz: [1.0, 0.0, 0.0, 0.0],
            translation: [0.0; 3],
            ..found.frame.clone()
        };
        let velocity = flight.enu_from_world.rotation.inverse() * vector![0.0, 0.7, 0.0];
        let still = found.position(&camera(point![0.0, 0.0, 0.0]), 0.0);
        let moving = found.moving(still.clone(), &local, velocity.into(), 0.05, Some(1.0));
        let [east, north, up] = moving.velocity.unwrap();
        assert!(east.abs() < 0.1 && (north - 7.0).abs() < 0.1 && up.abs() < 0.1, "{moving:?}");
        let course = moving.course_deg.unwrap();
        assert!(course.min(360.0 - course) < 1.0 && moving.course_std_deg.unwrap() > 1.0, "{moving:?}");
        assert_eq!(found.moving(still, &local, [0.0; 3], 0.05, None).course_deg, None);
    }

    #[test]
    fn a_new_frame_has_no_georeference_until_it_is_aligned() {
        let flight = flight(1.0);
        let options = MetricOptions::default();
        let mut georeferencer = Georeferencer::new(flight.feed.clone());
        georeferencer.update(&flight.update(0.0, &options));
        georeferencer.restart();
        assert!(georeferencer.found().is_none() && georeferencer.scale(0.0).is_none());
        let short = Update { frames: &flight.frames[..4], ..flight.update(0.0, &options) };
        georeferencer.update(&short);
        assert!(georeferencer.found().is_none() && georeferencer.problem().unwrap().contains("positions"));
    }
}
