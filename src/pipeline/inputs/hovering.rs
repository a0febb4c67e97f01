//! Evidence on a camera that does not translate: options, a log, and ground control points.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::Path;

use nalgebra::{Matrix3, Point2, Point3, Vector3};
use serde::Deserialize;
use serde_json::{Value, json};

use super::telemetry::{Origin, Telemetry};
use super::{alignment, attitude, clock_offsets, telemetry};
use crate::camera::{Camera, GUESSED_FOCAL_STD, SLOPE_STD};
use crate::features::TrackTable;
use crate::ground::{TiltEstimate, TiltKind};
use crate::io;
use crate::mapper::{LineNormal, rotating_camera};
use crate::math::Sim3;
use crate::metric::{
    Alignment, Kind, MapPoint, Measured, Offset, Orientation, PositionFix, Source, align, camera_over_map,
    focal_over_map,
};
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::stages::background::focal_deviation;
use crate::pipeline::{MetricOptions, PipelineError, Result};
use crate::scene::{Frame, FrameId, MapOrigin, Reconstruction};
use crate::telemetry::{Fix, Geodetic, Heights, LocalFixes, LocalFrame};

/// Minimum standard deviation of a given pitch, radians: half a degree, the accuracy of gimbals and of visual
/// estimates.
const MIN_PITCH_STD: f64 = 0.009;
/// Standard deviation of a pixel that a user picks in an image, pixels.
const PICKED_STD_PX: f64 = 1.5;
/// Standard deviation of a position that a user picks on an aerial image or a map, metres: the accuracy that providers
/// of orthophotos state (0.2 to 0.5 m), and a pixel of it.
const MAP_STD_M: f64 = 0.3;
/// Standard deviation of the ground's height below a scene relative to the take-off point, meters: one per cent of
/// slope over the 200 m to the pilot.
const TAKEOFF_STD_M: f64 = 2.0;

/// Inputs for the ground below a camera that does not translate.
pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let options = &run.options.metric;
    let logs = telemetry::fingerprints(run);
    let points = options.map_points.as_deref().map(fingerprint::of_content).transpose()?;
    Ok(json!({
        "pitch": options.camera_pitch,
        "logs": logs,
        "time_offset": options.time_offset,
        "utc_offset": options.utc_offset,
        "map_points": points,
    }))
}

/// Tilts of the ground relative to the camera of the first image, by all sources but vehicles.
///
/// # Errors
/// Map points from which no camera pose follows.
pub(in crate::pipeline) fn tilts(
    run: &Run,
    background: &Reconstruction,
    by_lines: Option<&LineNormal>,
) -> Result<Vec<TiltEstimate>> {
    let vertical = telemetry::find(run, &mut Outcome::default()).and_then(|log| {
        let of_gimbal = || station(run, background, &log).ok()?.vertical();
        let frames = alignment::registered(background, run.frames().ok()?);
        attitude::vertical(run, &frames, &log, &mut Outcome::default()).or_else(of_gimbal)
    });
    let metric = &run.options.metric;
    let on_map = on_map_points(metric, background, focal_deviation(run)?.unwrap_or(0.0))?;
    Ok(stated_tilts(background, metric, by_lines, vertical, on_map.as_ref()))
}

/// Tilts of the ground relative to the camera of the first image.
///
/// * `vertical` – unit vector up in the background's frame by a sensor, and its standard deviation, radians.
pub fn stated_tilts(
    background: &Reconstruction,
    options: &MetricOptions,
    by_lines: Option<&LineNormal>,
    vertical: Option<(Vector3<f64>, f64)>,
    on_map: Option<&OnMap>,
) -> Vec<TiltEstimate> {
    let Some(first) = background.images.values().next() else { return Vec::new() };
    let of_up = |kind: TiltKind, source: &str, up_in_world: Vector3<f64>, covariance: Matrix3<f64>| {
        let cam_from_world = first.cam_from_world.rotation.to_rotation_matrix();
        let covariance = cam_from_world * covariance * cam_from_world.transpose();
        TiltEstimate { kind, ..TiltEstimate::of_up(source, &(cam_from_world * up_in_world), &covariance) }
    };
    let in_all_directions = |std: f64| Matrix3::identity() * std.powi(2);
    // Vertical edges of buildings.
    let of_lines =
        |lines: &LineNormal| of_up(TiltKind::Vertical, "straight lines", lines.normal_in_world, lines.covariance);
    let mut found: Vec<TiltEstimate> = by_lines.map(of_lines).into_iter().collect();
    found.extend(options.camera_pitch.map(|pitch| TiltEstimate {
        source: "--camera-pitch".to_owned(),
        angles: [pitch.value.to_radians(), 0.0],
        std: [Some(pitch.std.to_radians().max(MIN_PITCH_STD)), None],
        kind: TiltKind::Ground,
    }));
    // The ground need not be level.
    found.extend(vertical.map(|(up, std)| {
        let covariance = in_all_directions(std.hypot(SLOPE_STD));
        of_up(TiltKind::Vertical, "attitude of the camera in telemetry", up, covariance)
    }));
    found.extend(on_map.map(|OnMap { alignment, relief_in_world, .. }| {
        let up = alignment.metric_from_world.rotation.inverse() * Vector3::z();
        let kind = TiltKind::Map { relief_in_world: relief_in_world.clone() };
        of_up(kind, "--map-points", up, in_all_directions(alignment.tilt_std()))
    }));
    found
}

/// Position and attitude of a camera that does not translate, by a log.
pub struct Station {
    /// The map's frame.
    pub map: LocalFrame,
    /// Metres east, north, up.
    position_m: Point3<f64>,
    std_m: Vector3<f64>,
    /// Height above the take-off point, metres.
    height_m: Option<f64>,
    orientation: Option<Orientation>,
    epoch_s: f64,
    /// The log's clock minus the video's time, relative to the epoch, seconds.
    offset_s: f64,
    offset_std_s: f64,
    num_fixes: usize,
}

/// The mean of the fixes during the video.
///
/// # Errors
/// The reason for a missing mean.
pub(in crate::pipeline) fn station(run: &Run, background: &Reconstruction, log: &Telemetry) -> Result<Station, String> {
    let frames = run.frames().map_err(|error| error.to_string())?;
    let local = alignment::local_fixes(log, frames)?;
    let log_s = local.fixes.iter().map(|fix| fix.time_s).fold(0.0, f64::max);
    let offsets = clock_offsets::candidates(run, log, local.times, local.epoch_s, log_s);
    let offset = offsets.first().and_then(|offsets| if let [offset] = offsets[..] { Some(offset) } else { None });
    let of_camera = if matches!(log.origin, Origin::Photographs | Origin::ByName) { &[][..] } else { &log.log.fixes };
    Station::new(local, offset.unwrap_or(Offset::Unknown), frames, background, of_camera)
}

impl Station {
    /// The mean of the fixes during the frames.
    ///
    /// * `angles` – fixes with the gimbal's angles.
    ///
    /// # Errors
    /// The reason for a missing mean.
    pub fn new(
        local: LocalFixes,
        offset: Offset,
        frames: &[Frame],
        background: &Reconstruction,
        angles: &[Fix],
    ) -> Result<Self, String> {
        /// Margin before the first and after the last frame, seconds: a log of one fix per second has a fix within it.
        const MARGIN_S: f64 = 1.0;
        let Offset::Known { mean_s: offset_s, std_s: offset_std_s } = offset else {
            return Err(
                "clock offset unknown, and a camera that does not move shows none; give --time-offset".to_owned()
            );
        };
        let mut registered = frames.iter().filter(|frame| background.images.contains_key(&frame.id.into()));
        let (first, last) = (registered.next(), registered.next_back());
        let (first_s, last_s) = first.map_or((0.0, 0.0), |first| (first.time_s, last.unwrap_or(first).time_s));
        let in_time = |fix: &&PositionFix| (first_s - MARGIN_S..=last_s + MARGIN_S).contains(&(fix.time_s - offset_s));
        let used: Vec<&PositionFix> = local.fixes.iter().filter(in_time).collect();
        let Some(one) = used.first() else {
            return Err("no position within the time of the video; check --time-offset".to_owned());
        };
        let mean = |value: &dyn Fn(&PositionFix) -> Option<f64>| {
            let values: Vec<f64> = used.iter().filter_map(|fix| value(fix)).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        let up_m = mean(&|fix| fix.up_m);
        let [east, north] = [0, 1].map(|k| mean(&|fix| Some(fix.east_north_m[k])).unwrap_or(0.0));
        Ok(Self {
            position_m: Point3::new(east, north, up_m.unwrap_or(0.0)),
            // The bias of a receiver persists longer than a clip.
            std_m: Vector3::new(one.horizontal_std_m, one.horizontal_std_m, one.vertical_std_m),
            height_m: up_m.filter(|height| local.heights == Heights::Relative && *height > 0.0),
            orientation: attitude::orientation(background, frames, angles, local.epoch_s + offset_s),
            epoch_s: local.epoch_s,
            offset_s,
            offset_std_s,
            num_fixes: used.len(),
            map: local.frame,
        })
    }

    /// The log's clock minus the video's time, seconds.
    pub fn clock_offset_s(&self) -> f64 {
        self.epoch_s + self.offset_s
    }

    /// Up in the background's frame by the gimbal's angles, and its standard deviation, radians.
    pub fn vertical(&self) -> Option<(Vector3<f64>, f64)> {
        let Orientation { metric_from_world, tilt_std, .. } = self.orientation.as_ref()?;
        Some((metric_from_world.inverse() * Vector3::z(), *tilt_std))
    }

    /// Uses the height above take-off as that above the ground, metres.
    pub fn height(&self) -> Option<Measured> {
        Measured::new(self.height_m?, self.std_m.z.hypot(TAKEOFF_STD_M))
    }

    /// Meters per unit by the height.
    ///
    /// * `height` – height above the ground, units.
    pub fn source_of_height(&self, height: &Measured) -> Option<Source> {
        let (log_scale, std) = self.height()?.log_ratio(height);
        Some(Source { name: "height above take-off".to_owned(), kind: Kind::Telemetry, log_scale, std })
    }

    /// The map frame around the camera, if the log has its attitude.
    pub fn alignment(&self) -> Option<Alignment> {
        let Orientation { metric_from_world, tilt_std, heading_std } = self.orientation?;
        // An arbitrary scale: that of all sources replaces it, and nothing else depends on it.
        let (scale, log_std) = self.height().map_or((1.0, 1.0), |height| (height.value, height.std / height.value));
        let std = [log_std, tilt_std, tilt_std, heading_std, self.std_m.x, self.std_m.y, self.std_m.z];
        Some(Alignment {
            metric_from_world: Sim3::new(scale, metric_from_world, self.position_m.coords),
            anchor_in_world: Point3::origin(),
            covariance: align::Covariance::from_diagonal(&std.map(|std| std * std).into()),
            offset_s: self.offset_s,
            offset_std_s: self.offset_std_s,
            num_fixes: self.num_fixes,
            rejected_share: 0.0,
            noise_factor: 1.0,
        })
    }
}

/// A camera pose by map points.
pub struct OnMap {
    /// The map from the background.
    pub alignment: Alignment,
    /// The map's frame; heights are known if the points have them.
    pub map: LocalFrame,
    /// The points with heights, in the background's frame; empty if heights are unknown.
    pub relief_in_world: Vec<Point3<f64>>,
}

/// GeoJSON content of map points.
#[derive(Deserialize)]
struct Collection {
    features: Vec<Feature>,
}

#[derive(Deserialize)]
struct Feature {
    geometry: Geometry,
    properties: Properties,
}

#[derive(Deserialize)]
struct Geometry {
    r#type: String,
    coordinates: Vec<f64>,
}

#[derive(Deserialize)]
struct Properties {
    x: f64,
    y: f64,
    frame: Option<FrameId>,
}

/// Error of a file of points.
fn wrong(path: &Path, problem: impl Display) -> PipelineError {
    PipelineError::Options(format!("--map-points: {}: {problem}", path.display()))
}

/// Reads the given map points, to report errors early.
///
/// # Errors
/// [`PipelineError::Options`] names the invalid point and its problem.
pub fn check_map_points(options: &MetricOptions) -> Result<()> {
    options.map_points.as_deref().map_or(Ok(()), |path| Survey::read(path).map(drop))
}

/// Checks that the map points are inside the frames of a run; `frames` must be done.
///
/// # Errors
/// [`PipelineError::Options`] names the point outside.
pub(in crate::pipeline) fn check_map_points_in_frames(run: &Run) -> Result<()> {
    let Some(path) = &run.options.metric.map_points else { return Ok(()) };
    let frames = run.frames()?;
    let (width, height) = run.size();
    for (number, Picked { pixel, frame, .. }) in (1..).zip(Survey::read(path)?.picked) {
        if let Some(FrameId(frame)) = frame.filter(|frame| !frames.iter().any(|known| known.id == *frame)) {
            return Err(wrong(path, format!("point {number}: there is no frame {frame}")));
        }
        if !is_in_frame(pixel, (width, height)) {
            let [x, y] = [pixel.x, pixel.y];
            return Err(wrong(path, format!("point {number}: pixel ({x}, {y}) is outside {width}x{height}")));
        }
    }
    Ok(())
}

/// Returns true if a position is inside a frame, including its border: a corner of the frame is valid.
fn is_in_frame(pixel: Point2<f64>, (width, height): (u32, u32)) -> bool {
    (0.0..=f64::from(width)).contains(&pixel.x) && (0.0..=f64::from(height)).contains(&pixel.y)
}

/// Heights on Earth, meters.
const HEIGHTS_M: RangeInclusive<f64> = -1000.0..=9000.0;
/// Minimum number of map points: a homography has eight parameters.
const MIN_POINTS: usize = 4;

/// A ground point picked in an image and on a map.
struct Picked {
    pixel: Point2<f64>,
    /// `None` is the first frame.
    frame: Option<FrameId>,
    longitude_deg: f64,
    latitude_deg: f64,
    height_m: Option<f64>,
}

/// The picked points, and their map frame.
struct Survey {
    picked: Vec<Picked>,
    map: LocalFrame,
}

impl Survey {
    /// Reads map points.
    ///
    /// # Errors
    /// [`PipelineError::Options`] names the invalid point and its problem.
    fn read(path: &Path) -> Result<Self> {
        let collection: Collection =
            io::json::read_model(path, "a GeoJSON collection of points with properties x and y")?;
        let point = |(number, Feature { geometry, properties }): (usize, Feature)| {
            let [longitude_deg, latitude_deg] = match geometry.coordinates[..] {
                [longitude, latitude, ..] if geometry.r#type == "Point" => [longitude, latitude],
                _ => return Err(wrong(path, format!("point {number} is no Point with longitude and latitude"))),
            };
            if !(-180.0..=180.0).contains(&longitude_deg) || !(-90.0..=90.0).contains(&latitude_deg) {
                let cure = "expected degrees, longitude first; export as WGS 84 (EPSG:4326)";
                return Err(wrong(path, format!("point {number}: {cure}")));
            }
            let height_m = geometry.coordinates.get(2).copied();
            if height_m.is_some_and(|height_m| !HEIGHTS_M.contains(&height_m)) {
                return Err(wrong(path, format!("point {number}: the height must be meters, from -1000 to 9000")));
            }
            let Properties { x, y, frame } = properties;
            Ok(Picked { pixel: Point2::new(x, y), frame, longitude_deg, latitude_deg, height_m })
        };
        let picked: Vec<Picked> = (1..).zip(collection.features).map(point).collect::<Result<_, _>>()?;
        if picked.len() < MIN_POINTS {
            return Err(wrong(path, format!("{} points; at least {MIN_POINTS} needed", picked.len())));
        }
        let mean = |value: &dyn Fn(&Picked) -> f64| picked.iter().map(value).sum::<f64>() / picked.len() as f64;
        let knows_height = picked.iter().all(|point| point.height_m.is_some());
        let origin = MapOrigin {
            longitude: mean(&|point| point.longitude_deg),
            latitude: mean(&|point| point.latitude_deg),
            height_m: if knows_height { mean(&|point| point.height_m.unwrap_or(0.0)) } else { 0.0 },
            knows_height,
        };
        Ok(Self { map: LocalFrame { origin }, picked })
    }

    /// The points with their viewing rays.
    ///
    /// * `log_focal` – logarithm of a factor of the focal length.
    ///
    /// # Errors
    /// The number of a point without a camera, and the reason.
    fn points(&self, background: &Reconstruction, log_focal: f64) -> Result<Vec<MapPoint>, String> {
        let point = |(number, picked): (usize, &Picked)| {
            let found = match picked.frame {
                None => background.images.iter().next(),
                Some(frame) => background.images.iter().find(|(id, _)| id.frame() == frame),
            };
            let Some((_, image)) = found else {
                return Err(format!("point {number}: frame {} is not registered", picked.frame.map_or(0, |id| id.0)));
            };
            let camera = background.camera_of(image).zoomed(log_focal.exp());
            if !is_in_frame(picked.pixel, (camera.width, camera.height)) {
                return Err(format!("point {number} is outside of its frame"));
            }
            let Picked { longitude_deg, latitude_deg, height_m, .. } = *picked;
            let origin = &self.map.origin;
            let height_m = height_m.filter(|_| origin.knows_height).unwrap_or(origin.height_m);
            let place = Geodetic { longitude_deg, latitude_deg, height_m };
            Ok(MapPoint {
                ray_in_world: image.cam_from_world.rotation.inverse() * camera.ray_from_pixel(picked.pixel),
                ray_std: PICKED_STD_PX / camera.mean_focal(),
                position_m: self.map.from_geodetic(place),
                std_m: MAP_STD_M,
            })
        };
        (1..).zip(&self.picked).map(point).collect()
    }
}

/// The camera pose by the given map points; `None` without any.
///
/// * `focal_std` – relative standard deviation of the focal length.
///
/// # Errors
/// [`PipelineError::Options`] if no camera pose follows from them.
pub fn on_map_points(options: &MetricOptions, background: &Reconstruction, focal_std: f64) -> Result<Option<OnMap>> {
    let Some(path) = &options.map_points else { return Ok(None) };
    let survey = Survey::read(path)?;
    survey.points(background, 0.0).map_err(|problem| wrong(path, problem))?;
    let points_at = |log_focal| survey.points(background, log_focal).unwrap_or_default();
    let prior_std = if focal_std > 0.0 { GUESSED_FOCAL_STD } else { 0.0 };
    let alignment = camera_over_map(points_at, focal_std, prior_std).map_err(|error| wrong(path, error))?;
    let world_from_metric = alignment.metric_from_world.inverse();
    let points = points_at(0.0).into_iter().filter(|_| survey.map.origin.knows_height);
    let relief_in_world = points.map(|point| world_from_metric * point.position_m).collect();
    Ok(Some(OnMap { alignment, map: survey.map, relief_in_world }))
}

/// A camera that does not translate with the focal length estimated from the map points, and its relative standard
/// deviation; both unchanged if no points are given, or if the points do not determine it.
///
/// * `focal_std` – prior relative standard deviation.
pub fn camera_by_map_points(
    options: &MetricOptions,
    table: &TrackTable,
    camera: &Camera,
    focal_std: f64,
) -> (Camera, f64) {
    let found = || {
        let survey = Survey::read(options.map_points.as_deref()?).ok().filter(|_| focal_std > 0.0)?;
        let poses = rotating_camera(table, camera)?.model(table, camera);
        survey.points(&poses, 0.0).ok()?;
        focal_over_map(|log_focal| survey.points(&poses, log_focal).unwrap_or_default(), focal_std)
    };
    found().map_or((*camera, focal_std), |(log_focal, std)| (camera.zoomed(log_focal.exp()), std))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn map_points_may_be_on_the_border_of_a_frame() {
        let inside = |x, y| is_in_frame(Point2::new(x, y), (1920, 1080));
        assert!(inside(0.0, 0.0) && inside(1920.0, 1080.0) && inside(5.0, 5.0));
        assert!(!inside(1920.5, 4.0) && !inside(f64::NAN, 4.0));
    }
}
