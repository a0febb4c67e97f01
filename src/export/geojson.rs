//! GeoJSON (RFC 7946): longitude, latitude and, where heights are absolute, height, on WGS 84.
//!
//! The format has no field for times. `coordTimes`, one per coordinate next to the geometry, is the convention of
//! converters from GPX and KML.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::results::Fix;
use super::{Clock, ExportError, Facts, Results};
use crate::io::atomic;
use crate::scene::{GroundTrack, MapPlace, MetricPose, Position};

/// Kinds of the features of ground tracks: trajectories, positions, and footprints of stationary vehicles.
const GROUND_TRACK: &str = "ground-track";
const FOOTPRINT: &str = "footprint";

/// Writes the trajectories: one feature per vehicle, the footprint of each stationary one, and one of the camera.
pub(super) fn write_trajectories(path: &Path, results: &Results) -> Result<(), ExportError> {
    let clock = results.clock();
    let vehicles = results.trajectories.objects.iter().map(|object| {
        let facts = Facts::of(object, results.time_base);
        line_feature(&results.fixes(&object.poses), results, &clock, vehicle_properties(&facts))
    });
    let ground_tracks = results.trajectories.ground_tracks.iter().map(|track| {
        let properties = ground_track_properties(results, track);
        line_feature(&results.fixes(&track.positions), results, &clock, properties)
    });
    let footprints = results.trajectories.ground_tracks.iter().filter_map(|track| footprint(results, track));
    let camera = line_feature(&results.fixes(&results.views), results, &clock, properties(json!({ "kind": "camera" })));
    Ok(atomic::write_json(
        path,
        &collection(results, vehicles.chain(ground_tracks).chain(footprints).chain([camera]).collect()),
    )?)
}

/// Writes the positions: one feature per vehicle and frame, and per frame of the camera.
pub(super) fn write_positions(path: &Path, results: &Results) -> Result<(), ExportError> {
    let clock = results.clock();
    let mut features = Vec::new();
    for object in &results.trajectories.objects {
        let who = json!({ "kind": "vehicle", "vehicle": object.id, "class": object.class });
        features.extend(results.fixes(&object.poses).iter().map(|fix| vehicle_at(results, &clock, &who, fix)));
    }
    for track in &results.trajectories.ground_tracks {
        let who = json!({
            "kind": GROUND_TRACK, "vehicle": track.id, "class": track.class, "method": track.method.name()
        });
        features.extend(results.fixes(&track.positions).iter().map(|fix| vehicle_at(results, &clock, &who, fix)));
    }
    features.extend(results.fixes(&results.views).iter().map(|fix| {
        let more = [timed(&clock, &fix.at), deviations(&fix.place)];
        point(results, &fix.place, joined(json!({ "kind": "camera" }), more))
    }));
    Ok(atomic::write_json(path, &collection(results, features))?)
}

fn vehicle_at(results: &Results, clock: &Clock, who: &Value, fix: &Fix) -> Value {
    let more = [timed(clock, &fix.at), motion(fix.at.metric), deviations(&fix.place)];
    point(results, &fix.place, joined(who.clone(), more))
}

/// The footprint of a stationary vehicle; `None` where it has none, or crosses the 180th meridian.
fn footprint(results: &Results, track: &GroundTrack) -> Option<Value> {
    let corners = track.footprint(results.trajectories.metric.as_ref()?.frame.as_ref()?)?;
    let places: Vec<MapPlace> = corners.into_iter().filter_map(|corner| results.place(corner)).collect();
    let first = places.first().filter(|_| places.len() == corners.len())?;
    let is_whole = places.iter().all(|place| (place.longitude - first.longitude).abs() < 180.0);
    let ring: Vec<_> = places.iter().chain([first]).map(|place| coordinates(results, place)).collect();
    let mut properties = ground_track_properties(results, track);
    properties.insert("kind".into(), FOOTPRINT.into());
    let geometry = json!({ "type": "Polygon", "coordinates": [ring] });
    is_whole
        .then(|| json!({ "type": "Feature", "geometry": geometry, "properties": results.units.properties(properties) }))
}

fn collection(results: &Results, features: Vec<Value>) -> Value {
    json!({ "type": "FeatureCollection", "name": results.title, "features": features })
}

fn point(results: &Results, place: &MapPlace, properties: Map<String, Value>) -> Value {
    let geometry = json!({ "type": "Point", "coordinates": coordinates(results, place) });
    json!({ "type": "Feature", "geometry": geometry, "properties": results.units.properties(properties) })
}

/// Splits a line at the 180th meridian (RFC 7946, section 3.1.9); a line needs two positions.
fn line_feature(fixes: &[Fix], results: &Results, clock: &Clock, mut properties: Map<String, Value>) -> Value {
    let stays = |a: &Fix, b: &Fix| (a.place.longitude - b.place.longitude).abs() < 180.0;
    let pieces: Vec<&[Fix]> = fixes.chunk_by(stays).filter(|piece| piece.len() > 1).collect();
    let line = |piece: &[Fix]| piece.iter().map(|fix| coordinates(results, &fix.place)).collect::<Vec<_>>();
    let times = |piece: &[Fix]| piece.iter().map(|fix| time(clock, &fix.at)).collect::<Vec<_>>();
    let (geometry, times) = match (pieces.as_slice(), fixes.first()) {
        ([], None) => (Value::Null, json!([])),
        ([], Some(fix)) => {
            (json!({ "type": "Point", "coordinates": coordinates(results, &fix.place) }), json!([time(clock, &fix.at)]))
        }
        ([piece], _) => (json!({ "type": "LineString", "coordinates": line(piece) }), json!(times(piece))),
        (pieces, _) => {
            let lines: Vec<_> = pieces.iter().map(|piece| line(piece)).collect();
            let times: Vec<_> = pieces.iter().map(|piece| times(piece)).collect();
            (json!({ "type": "MultiLineString", "coordinates": lines }), json!(times))
        }
    };
    properties = results.units.properties(properties);
    properties.insert("coordTimes".into(), times);
    json!({ "type": "Feature", "geometry": geometry, "properties": properties })
}

fn coordinates(results: &Results, place: &MapPlace) -> Vec<f64> {
    // Nine decimals of a degree are a tenth of a millimeter.
    let mut numbers = vec![rounded(place.longitude, 1e9), rounded(place.latitude, 1e9)];
    if results.knows_height() {
        numbers.push(rounded(place.height_m, 1e4));
    }
    numbers
}

fn rounded(value: f64, steps: f64) -> f64 {
    (value * steps).round() / steps
}

/// A date where one is known, else seconds after the video's start.
fn time(clock: &Clock, at: &Position) -> Value {
    clock.date(at.name, at.time_s).map_or_else(|| json!(at.time_s), Value::from)
}

fn timed(clock: &Clock, at: &Position) -> Value {
    let seconds = clock.has_seconds().then_some(at.time_s);
    json!({ "frame": at.frame, "time_s": seconds, "date": clock.date(at.name, at.time_s) })
}

fn motion(metric: Option<&MetricPose>) -> Value {
    let motion = metric.and_then(|metric| metric.motion);
    json!({
        "speed_m_s": motion.map(|motion| motion.speed_m_s),
        "speed_std_m_s": motion.map(|motion| motion.speed_std_m_s),
        "heading_deg": motion.and_then(|motion| motion.heading_deg),
    })
}

fn deviations(place: &MapPlace) -> Value {
    let [east, north, up] = place.place_std_m;
    json!({ "east_std_m": east, "north_std_m": north, "up_std_m": up, "height_m": place.height_m })
}

/// Properties of a vehicle as a whole, under the names of the tables' columns.
pub(super) fn vehicle_properties(facts: &Facts) -> Map<String, Value> {
    let value = |estimate: Option<crate::scene::Estimate>| estimate.map(|estimate| estimate.value);
    let std = |estimate: Option<crate::scene::Estimate>| estimate.map(|estimate| estimate.std);
    properties(json!({
        "kind": "vehicle",
        "vehicle": facts.vehicle,
        "class": facts.class,
        "confidence": facts.confidence,
        "verdict": facts.verdict,
        "doubt": facts.doubt,
        "frames": facts.num_frames,
        "first_time_s": facts.first_time_s,
        "last_time_s": facts.last_time_s,
        "path_m": value(facts.path_m),
        "path_std_m": std(facts.path_m),
        "displacement_m": value(facts.displacement_m),
        "displacement_std_m": std(facts.displacement_m),
        "mean_speed_m_s": value(facts.mean_speed_m_s),
        "mean_speed_std_m_s": std(facts.mean_speed_m_s),
        "max_speed_m_s": value(facts.max_speed_m_s),
        "max_speed_std_m_s": std(facts.max_speed_m_s),
        "length_m": value(facts.dimensions.length_m),
        "width_m": value(facts.dimensions.width_m),
        "height_m": value(facts.dimensions.height_m),
    }))
}

/// Properties of a ground track: the vehicle's properties that it has, and its method.
fn ground_track_properties(results: &Results, track: &GroundTrack) -> Map<String, Value> {
    let mut all = vehicle_properties(&Facts::of_ground_track(track, results.time_base));
    all.remove("doubt");
    all.extend(properties(json!({
        "kind": GROUND_TRACK,
        "method": track.method.name(),
        "remark": track.verdict.as_ref().map(|verdict| &verdict.says),
        "reason": track.reason,
        "axis_deg": track.axis_deg.map(|axis| axis.value),
    })));
    all
}

fn properties(value: Value) -> Map<String, Value> {
    if let Value::Object(map) = value { map } else { Map::new() }
}

fn joined<const N: usize>(first: Value, more: [Value; N]) -> Map<String, Value> {
    let mut all = properties(first);
    more.into_iter().for_each(|value| all.extend(properties(value)));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{results, with_metres};
    use crate::io::json;
    use crate::scene::{ContactError, Dimensions, Estimate, GroundPosition, ObjectId};

    fn read(write: fn(&Path, &Results) -> Result<(), ExportError>, results: &Results) -> Vec<Value> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.geojson");
        write(&path, results).unwrap();
        let value: Value = json::read(&path).unwrap();
        assert_eq!(value["type"], "FeatureCollection");
        value["features"].as_array().unwrap().clone()
    }

    #[test]
    fn trajectories_are_lines_with_times_and_positions_are_points() {
        let results = with_metres(results());
        let features = read(write_trajectories, &results);
        assert_eq!(features.len(), 3);
        let poses = &results.trajectories.objects[0].poses;
        let (geometry, properties) = (&features[0]["geometry"], &features[0]["properties"]);
        assert_eq!((&geometry["type"], &properties["class"]), (&"LineString".into(), &"car".into()));
        assert_eq!(geometry["coordinates"].as_array().unwrap().len(), poses.len());
        assert_eq!(properties["coordTimes"][0], "2024-06-01T12:00:00Z");
        let place = poses[0].metric.unwrap().place.unwrap();
        assert!((geometry["coordinates"][0][0].as_f64().unwrap() - place.longitude).abs() < 1e-9);
        assert!((geometry["coordinates"][0][2].as_f64().unwrap() - place.height_m).abs() < 1e-4);
        let points = read(write_positions, &results);
        let count: usize = results.trajectories.objects.iter().map(|object| object.poses.len()).sum();
        assert_eq!(points.len(), count + results.views.len());
        assert_eq!(points[0]["properties"]["speed_m_s"], 8.0);
        assert_eq!(points.last().unwrap()["properties"]["kind"], "camera");
    }

    #[test]
    fn stationary_vehicles_have_footprints() {
        let mut results = with_metres(results());
        let pose = &results.trajectories.objects[0].poses[0];
        let position = GroundPosition {
            frame: pose.frame,
            name: pose.name.clone(),
            time_s: pose.time_s,
            position: pose.position,
            error: ContactError::default(),
            metric: None,
        };
        let [length_m, width_m] = [4.0, 2.0].map(|value| Some(Estimate { value, std: 0.1 }));
        let track = GroundTrack {
            dimensions: Some(Dimensions { length_m, width_m, height_m: None }),
            axis_deg: Some(Estimate { value: 90.0, std: 3.0 }),
            positions: vec![position],
            ..GroundTrack::new(ObjectId(7), "car", 0.9)
        };
        let moving = GroundTrack { axis_deg: None, ..track.clone() };
        results.trajectories.ground_tracks = vec![track, moving];
        let features = read(write_trajectories, &results);
        let shapes: Vec<&Value> = features.iter().filter(|found| found["properties"]["kind"] == FOOTPRINT).collect();
        let [shape] = shapes[..] else { panic!("{shapes:?}") };
        assert_eq!((&shape["geometry"]["type"], &shape["properties"]["vehicle"]), (&"Polygon".into(), &7.into()));
        let ring: Vec<[f64; 2]> = shape["geometry"]["coordinates"][0]
            .as_array()
            .unwrap()
            .iter()
            .map(|place| [0, 1].map(|k| place[k].as_f64().unwrap()))
            .collect();
        // It points east: twice as long along the parallel, in meters.
        let east_m =
            111_320.0 * results.trajectories.metric.unwrap().frame.unwrap().origin.unwrap().latitude.to_radians().cos();
        let span = |k: usize, unit: f64| {
            let all = || ring.iter().map(|place| place[k]);
            (all().fold(f64::MIN, f64::max) - all().fold(f64::MAX, f64::min)) * unit
        };
        assert!((span(0, east_m) - 4.0).abs() < 0.05 && (span(1, 111_320.0) - 2.0).abs() < 0.05, "{ring:?}");
        assert_eq!((ring.len(), ring[0]), (5, ring[4]), "a closed ring");
        let area: f64 = ring.windows(2).map(|edge| edge[0][0] * edge[1][1] - edge[1][0] * edge[0][1]).sum();
        assert!(area > 0.0, "counterclockwise");
    }

    #[test]
    fn lines_are_split_at_the_180th_meridian_and_a_single_position_is_a_point() {
        let results = with_metres(results());
        let fix = |longitude: f64| Fix {
            at: Position { time_s: longitude, ..Position::from(&results.views[0]) },
            place: MapPlace { longitude, latitude: -17.0, height_m: 3.0, place_std_m: [1.0; 3] },
        };
        let geometry = |fixes: &[Fix]| {
            line_feature(fixes, &results, &Clock::of(None, crate::scene::TimeBase::Seconds), Map::new())
        };
        let cut = geometry(&[fix(179.8), fix(179.9), fix(-179.9), fix(-179.8)]);
        assert_eq!(cut["geometry"]["type"], "MultiLineString");
        assert_eq!(cut["properties"]["coordTimes"], json!([[179.8, 179.9], [-179.9, -179.8]]));
        assert_eq!(geometry(&[fix(1.0)])["geometry"]["type"], "Point");
        assert_eq!(geometry(&[])["geometry"], Value::Null);
    }
}
