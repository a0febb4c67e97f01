//! Evidence on a camera that does not translate: options, a log, and points of a map.

use std::path::Path;

use nalgebra::{Matrix3, Point2, Point3, Vector3};
use serde::Deserialize;
use serde_json::{Value, json};

use super::telemetry::{Origin, Telemetry};
use super::{alignment, attitude, clock_offsets, telemetry};
use crate::ground::{SLOPE_STD, StatedTilt, TiltKind};
use crate::io;
use crate::mapper::SwayGround;
use crate::metric::{Alignment, MapPoint, Offset, Orientation, PositionFix, camera_over_map};
use crate::pipeline::PipelineError;
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::scene::{FrameId, Reconstruction};
use crate::telemetry::{Geodetic, Heights, LocalFixes, LocalFrame};

/// Standard deviation of a stated pitch at least, radians: half a degree, which gimbals and eyes leave.
const LEAST_PITCH_STD: f64 = 0.009;
/// Standard deviation of a pixel that a person picks in an image, pixels.
const PICKED_STD_PX: f64 = 1.5;
/// Standard deviation of a position that a person picks on an aerial image or a map, metres: what providers of
/// orthophotos state (0.2 to 0.5 m), and a pixel of it.
const MAP_STD_M: f64 = 0.3;

/// Inputs of the ground below a camera that does not translate.
pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value, PipelineError> {
    let options = &run.options.metric;
    let logs: Vec<Option<String>> =
        telemetry::files(run).iter().map(|file| fingerprint::of_content(file).ok()).collect();
    let points = options.map_points.as_deref().map(fingerprint::of_content).transpose()?;
    Ok(json!({
        "pitch": options.camera_pitch,
        "logs": logs,
        "time_offset": options.time_offset,
        "utc_offset": options.utc_offset,
        "map_points": points,
    }))
}

/// Tilts of the ground against the camera of the first image, by all sources but vehicles.
///
/// # Errors
/// Points of a map that place no camera.
pub(in crate::pipeline) fn tilts(
    run: &Run,
    background: &Reconstruction,
    sway: Option<&SwayGround>,
) -> Result<Vec<StatedTilt>, PipelineError> {
    let Some(first) = background.images.values().next() else { return Ok(Vec::new()) };
    let of_up = |source: &str, up_in_world: Vector3<f64>, covariance: Matrix3<f64>| {
        let cam_from_world = first.cam_from_world.rotation.to_rotation_matrix();
        let covariance = cam_from_world * covariance * cam_from_world.transpose();
        StatedTilt::of_up(source, &(cam_from_world * up_in_world), &covariance)
    };
    let in_all_directions = |std: f64| Matrix3::identity() * std.powi(2);
    let mut found: Vec<StatedTilt> =
        sway.iter().map(|sway| of_up("sway of the camera", sway.normal, sway.covariance)).collect();
    if let Some(pitch) = run.options.metric.camera_pitch {
        let std = pitch.std.to_radians().max(LEAST_PITCH_STD);
        let angles = [pitch.value.to_radians(), 0.0];
        found.push(StatedTilt {
            source: "--camera-pitch".to_owned(),
            angles,
            std: [Some(std), None],
            kind: TiltKind::Ground,
        });
    }
    if let Some(log) = telemetry::find(run, &mut Outcome::default()) {
        let of_gimbal = || {
            let station = station(run, background, &log).ok()?;
            let Orientation { metric_from_world, tilt_std, .. } = station.orientation?;
            Some((metric_from_world.inverse() * Vector3::z(), tilt_std))
        };
        let frames = alignment::registered(background, run.frames()?);
        let vertical = attitude::vertical(run, &frames, &log, &mut Outcome::default()).or_else(of_gimbal);
        // The ground is not level.
        found.extend(vertical.map(|(up, std)| {
            let tilt = of_up("attitude of the camera in telemetry", up, in_all_directions(std.hypot(SLOPE_STD)));
            StatedTilt { kind: TiltKind::Vertical, ..tilt }
        }));
    }
    if let Some(map) = on_map_points(run, background)? {
        let up = map.alignment.metric_from_world.rotation.inverse() * Vector3::z();
        let tilt = of_up("--map-points", up, in_all_directions(map.alignment.tilt_std()));
        found.push(StatedTilt { kind: TiltKind::Map, ..tilt });
    }
    Ok(found)
}

/// Position and attitude of a camera that does not translate, by a log.
pub(in crate::pipeline) struct Station {
    pub(in crate::pipeline) map: LocalFrame,
    pub(in crate::pipeline) knows_height: bool,
    /// Metres east, north, up.
    pub(in crate::pipeline) position_m: Point3<f64>,
    pub(in crate::pipeline) std_m: Vector3<f64>,
    /// Height above the place of take-off, metres.
    pub(in crate::pipeline) height_m: Option<f64>,
    pub(in crate::pipeline) orientation: Option<Orientation>,
    pub(in crate::pipeline) epoch_s: f64,
    pub(in crate::pipeline) offset_s: f64,
    pub(in crate::pipeline) offset_std_s: f64,
    pub(in crate::pipeline) num_fixes: usize,
}

/// The mean of the fixes in the time of the video.
///
/// # Errors
/// Why there is none.
pub(in crate::pipeline) fn station(run: &Run, background: &Reconstruction, log: &Telemetry) -> Result<Station, String> {
    /// A log of one fix per second has one within this time of any frame, seconds.
    const MARGIN_S: f64 = 1.0;
    let frames = run.frames().map_err(|error| error.to_string())?;
    let (LocalFixes { frame: map, knows_height, fixes, heights, times }, epoch_s) =
        alignment::local_fixes(log, frames)?;
    let log_s = fixes.iter().map(|fix| fix.time_s - epoch_s).fold(0.0, f64::max);
    let offsets = clock_offsets::candidates(run, log, times, epoch_s, log_s);
    let Some([Offset::Known { mean_s: offset_s, std_s: offset_std_s }]) = offsets.first().map(Vec::as_slice) else {
        return Err("clock offset unknown, and a camera that does not move shows none; give --time-offset".to_owned());
    };
    let (first_s, last_s) = frames.first().zip(frames.last()).map_or((0.0, 0.0), |(a, b)| (a.time_s, b.time_s));
    let in_time = |fix: &&PositionFix| {
        let video_s = fix.time_s - epoch_s - offset_s;
        (first_s - MARGIN_S..=last_s + MARGIN_S).contains(&video_s)
    };
    let used: Vec<&PositionFix> = fixes.iter().filter(in_time).collect();
    let Some(one) = used.first() else {
        return Err("no position within the time of the video; check --time-offset".to_owned());
    };
    let mean = |value: &dyn Fn(&PositionFix) -> Option<f64>| {
        let values: Vec<f64> = used.iter().filter_map(|fix| value(fix)).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let up_m = mean(&|fix| fix.up_m);
    let [east, north] = [0, 1].map(|k| mean(&|fix| Some(fix.east_north_m[k])).unwrap_or(0.0));
    let of_images = matches!(log.origin, Origin::Photographs | Origin::ByName);
    Ok(Station {
        map,
        knows_height,
        position_m: Point3::new(east, north, up_m.unwrap_or(0.0)),
        // The bias of a receiver lasts longer than a clip.
        std_m: Vector3::new(one.horizontal_std_m, one.horizontal_std_m, one.vertical_std_m),
        height_m: up_m.filter(|height| heights == Heights::Relative && *height > 0.0),
        orientation: if of_images {
            None
        } else {
            attitude::orientation(background, frames, &log.log.fixes, epoch_s + offset_s)
        },
        epoch_s,
        offset_s: *offset_s,
        offset_std_s: *offset_std_s,
        num_fixes: used.len(),
    })
}

/// A camera over points of a map.
pub(in crate::pipeline) struct OnMap {
    pub(in crate::pipeline) alignment: Alignment,
    pub(in crate::pipeline) map: LocalFrame,
    pub(in crate::pipeline) knows_height: bool,
}

/// Points of a map as GeoJSON has them.
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
    frame: Option<u32>,
}

/// Reads points of a map.
///
/// # Errors
/// [`PipelineError::Options`] says what is wrong with which point.
pub(in crate::pipeline) fn read_map_points(path: &Path) -> Result<Vec<Picked>, PipelineError> {
    let wrong = |problem: String| PipelineError::Options(format!("--map-points: {}: {problem}", path.display()));
    let collection: Collection = io::json::read_model(path, "a GeoJSON collection of points with properties x and y")?;
    let point = |(number, Feature { geometry, properties }): (usize, Feature)| {
        let [longitude_deg, latitude_deg] = match geometry.coordinates[..] {
            [longitude, latitude, ..] if geometry.r#type == "Point" => [longitude, latitude],
            _ => return Err(wrong(format!("point {number} is no Point with longitude and latitude"))),
        };
        if !(-180.0..=180.0).contains(&longitude_deg) || !(-90.0..=90.0).contains(&latitude_deg) {
            return Err(wrong(format!(
                "point {number}: expected degrees, longitude first; export as WGS 84 (EPSG:4326)"
            )));
        }
        let height_m = geometry.coordinates.get(2).copied();
        let Properties { x, y, frame } = properties;
        Ok(Picked { pixel: Point2::new(x, y), frame: frame.map(FrameId), longitude_deg, latitude_deg, height_m })
    };
    let points: Vec<Picked> = (1..).zip(collection.features).map(point).collect::<Result<_, _>>()?;
    match points.len() {
        0..FEWEST_POINTS => Err(wrong(format!("{} points; at least {FEWEST_POINTS} needed", points.len()))),
        _ => Ok(points),
    }
}

/// Fewest points of a map: a homography has eight numbers.
const FEWEST_POINTS: usize = 4;

/// A point of the ground that a person picked in an image and on a map.
pub(in crate::pipeline) struct Picked {
    pixel: Point2<f64>,
    /// `None` is the first one.
    frame: Option<FrameId>,
    longitude_deg: f64,
    latitude_deg: f64,
    height_m: Option<f64>,
}

/// The camera over the points of a map that are given; `None` without any.
///
/// # Errors
/// [`PipelineError::Options`] where they place no camera.
pub(in crate::pipeline) fn on_map_points(
    run: &Run,
    background: &Reconstruction,
) -> Result<Option<OnMap>, PipelineError> {
    let Some(path) = &run.options.metric.map_points else { return Ok(None) };
    let wrong = |problem: String| PipelineError::Options(format!("--map-points: {}: {problem}", path.display()));
    let picked = read_map_points(path)?;
    let mean = |value: &dyn Fn(&Picked) -> f64| picked.iter().map(value).sum::<f64>() / picked.len() as f64;
    let knows_height = picked.iter().all(|point| point.height_m.is_some());
    let origin = Geodetic {
        longitude_deg: mean(&|point| point.longitude_deg),
        latitude_deg: mean(&|point| point.latitude_deg),
        height_m: if knows_height { mean(&|point| point.height_m.unwrap_or(0.0)) } else { 0.0 },
    };
    let map = LocalFrame::at(origin);
    let point = |(number, picked): (usize, &Picked)| {
        let found = match picked.frame {
            None => background.images.iter().next(),
            Some(frame) => background.images.iter().find(|(id, _)| id.frame() == frame),
        };
        let Some((_, image)) = found else {
            return Err(wrong(format!(
                "point {number}: frame {} is not registered",
                picked.frame.map_or(0, |id| id.0)
            )));
        };
        let camera = background.camera_of(image);
        if !camera.contains(picked.pixel) {
            let [x, y] = [picked.pixel.x, picked.pixel.y];
            return Err(wrong(format!(
                "point {number}: pixel ({x}, {y}) is outside {}x{}",
                camera.width, camera.height
            )));
        }
        let Picked { longitude_deg, latitude_deg, .. } = *picked;
        let place = map.from_geodetic(Geodetic { longitude_deg, latitude_deg, height_m: origin.height_m });
        Ok(MapPoint {
            ray_in_world: image.cam_from_world.rotation.inverse() * camera.ray_from_pixel(picked.pixel),
            ray_std: PICKED_STD_PX / camera.mean_focal(),
            east_north_m: place.coords.xy(),
            std_m: MAP_STD_M,
        })
    };
    let points: Vec<MapPoint> = (1..).zip(&picked).map(point).collect::<Result<_, _>>()?;
    let alignment = camera_over_map(&points).map_err(|error| wrong(error.to_string()))?;
    Ok(Some(OnMap { alignment, map, knows_height }))
}
