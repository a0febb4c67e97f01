//! Crossings of user-defined lines and visits of zones: counts, speeds and headways with their uncertainty.
//!
//! Paths are the smoothed positions of all trajectories that are not rejected. A crossing has the time and speed
//! interpolated between two frames. Its σ follows from that of the position along the path: σ_t = σ_s / v.

use nalgebra::{Matrix2, Point2, Vector2};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use super::results::motions;
use super::{ExportError, Results};
use crate::scene::{Estimate, Motion, ObjectId, ObjectTrajectory};
use crate::telemetry::{Geodetic, LocalFrame};

/// A line or a zone, in meters of the metric frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Gate {
    /// Name: the property `name` of its feature, else its number.
    pub name: String,
    /// Geometry.
    pub shape: Shape,
}

/// Geometry of a gate.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A line of two or more points.
    Line(Vec<Point2<f64>>),
    /// A polygon without holes; the last point is the first.
    Zone(Vec<Point2<f64>>),
}

/// Direction of a crossing relative to the line from its first to its last point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// From the left to the right.
    ToRight,
    /// From the right to the left.
    ToLeft,
}

/// Crossing of a line by a vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Crossing {
    /// Name of the line.
    pub gate: String,
    /// The vehicle.
    pub vehicle: ObjectId,
    /// Its class.
    pub class: String,
    /// Its verdict.
    pub verdict: &'static str,
    /// Direction.
    pub direction: Direction,
    /// Time of the video, seconds.
    pub time_s: Estimate,
    /// Speed at the crossing.
    pub speed_m_s: Estimate,
    /// Seconds since the previous crossing of the same line in the same direction.
    pub headway_s: Option<Estimate>,
    /// Distance from the nearer end of the line, meters; a crossing within its σ may have missed the line.
    pub from_end_m: Estimate,
}

/// Visit of a zone by a vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Visit {
    /// Name of the zone.
    pub gate: String,
    /// The vehicle.
    pub vehicle: ObjectId,
    /// Its class.
    pub class: String,
    /// Its verdict.
    pub verdict: &'static str,
    /// Time of its entry, seconds; `None` if its path begins inside.
    pub entry_s: Option<f64>,
    /// Time of its exit; `None` if its path ends inside.
    pub exit_s: Option<f64>,
    /// Observed seconds inside.
    pub duration_s: f64,
    /// Mean speed inside.
    pub mean_speed_m_s: f64,
}

/// Result of an analysis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Analysis {
    /// Crossings of lines, by gate and time.
    pub crossings: Vec<Crossing>,
    /// Visits of zones, by gate and time.
    pub visits: Vec<Visit>,
    /// Rejected trajectories, which are not counted.
    pub num_rejected: usize,
}

/// A position at a time.
#[derive(Clone, Copy, Debug)]
struct Sample {
    time_s: f64,
    at: Point2<f64>,
    std: Vector2<f64>,
    speed: Estimate,
}

/// Reads lines and polygons of a GeoJSON file. Coordinates are longitude and latitude where the results are
/// georeferenced, else x and y of the metric frame.
///
/// # Errors
/// Description of the feature that is neither a line nor a polygon.
pub fn gates(document: &Value, results: &Results) -> Result<Vec<Gate>, String> {
    let features = document["features"].as_array().ok_or("not a GeoJSON FeatureCollection")?;
    let found: Result<Vec<Gate>, String> =
        features.iter().enumerate().map(|(k, feature)| gate(k + 1, feature, results)).collect();
    found.and_then(|gates| if gates.is_empty() { Err("no features".to_owned()) } else { Ok(gates) })
}

fn gate(number: usize, feature: &Value, results: &Results) -> Result<Gate, String> {
    let named = feature["properties"]["name"].as_str().map(str::to_owned);
    let name = named.unwrap_or_else(|| number.to_string());
    let wrong = |problem: &str| format!("feature {number}: {problem}");
    let geometry = &feature["geometry"];
    let points = |list: &Value| -> Result<Vec<Point2<f64>>, String> {
        let points = list.as_array().ok_or_else(|| wrong("has no coordinates"))?;
        points
            .iter()
            .map(|point| position(point, results).ok_or_else(|| wrong("a coordinate is not two numbers")))
            .collect()
    };
    let shape = match geometry["type"].as_str() {
        Some("LineString") => Shape::Line(points(&geometry["coordinates"])?),
        Some("Polygon") => Shape::Zone(points(&geometry["coordinates"][0])?),
        other => return Err(wrong(&format!("{}, expected LineString or Polygon", other.unwrap_or("no geometry")))),
    };
    match &shape {
        Shape::Line(points) if points.len() < 2 => Err(wrong("a line needs two points")),
        Shape::Zone(points) if points.len() < 4 => Err(wrong("a polygon needs three corners")),
        _ => Ok(Gate { name, shape }),
    }
}

fn position(point: &Value, results: &Results) -> Option<Point2<f64>> {
    let [x, y] = [point[0].as_f64()?, point[1].as_f64()?];
    let Some((_, origin)) = results.map() else { return Some(Point2::new(x, y)) };
    if !(x.abs() <= 180.0 && y.abs() <= 90.0) {
        return None;
    }
    let place = Geodetic { longitude_deg: x, latitude_deg: y, height_m: origin.height_m };
    let local = LocalFrame { origin }.from_geodetic(place);
    Some(Point2::new(local.x, local.y))
}

/// Finds all crossings and visits.
///
/// # Errors
/// [`ExportError::NoMeters`] where speeds in meters per second are not known.
pub fn analyse(results: &Results, gates: &[Gate]) -> Result<Analysis, ExportError> {
    if results.metric_frame().is_none() || !results.clock().has_seconds() {
        return Err(ExportError::NoMeters { wanted: "analyse".to_owned() });
    }
    let mut found = Analysis::default();
    let (rejected, trusted): (Vec<_>, Vec<_>) =
        results.trajectories.objects.iter().partition(|object| object.is_ruled_out());
    found.num_rejected = rejected.len();
    for gate in gates {
        let mut crossings = Vec::new();
        for object in &trusted {
            let samples = samples(object);
            match &gate.shape {
                Shape::Line(line) => crossings.extend(crossings_of(gate, line, object, &samples)),
                Shape::Zone(zone) => found.visits.extend(visits(gate, zone, object, &samples)),
            }
        }
        crossings.sort_by(|a, b| a.time_s.value.total_cmp(&b.time_s.value));
        add_headways(&mut crossings);
        found.crossings.extend(crossings);
    }
    Ok(found)
}

fn samples(object: &ObjectTrajectory) -> Vec<Sample> {
    let sample = |(time_s, motion): (f64, Motion)| {
        let [x, y, _] = motion.smoothed_position_m;
        let [std_x, std_y, _] = motion.smoothed_position_std_m;
        let speed = Estimate { value: motion.speed_m_s.abs(), std: motion.speed_std_m_s };
        Sample { time_s, at: Point2::new(x, y), std: Vector2::new(std_x, std_y), speed }
    };
    motions(object).map(sample).collect()
}

/// Intersection of the step from `from` to `to` with the line from `a` to `b`, as shares of both.
fn meeting(from: Point2<f64>, to: Point2<f64>, a: Point2<f64>, b: Point2<f64>) -> Option<(f64, f64)> {
    let (way, line) = (to - from, b - a);
    let shares = Matrix2::from_columns(&[way, -line]).lu().solve(&(a - from))?;
    let (t, u) = (shares.x, shares.y);
    // A step that ends on the line has not crossed it yet; the next step has.
    ((0.0..1.0).contains(&t) && (0.0..=1.0).contains(&u)).then_some((t, u))
}

fn crossings_of(gate: &Gate, line: &[Point2<f64>], object: &ObjectTrajectory, samples: &[Sample]) -> Vec<Crossing> {
    let mut found = Vec::new();
    for pair in samples.windows(2) {
        let [before, after] = [pair[0], pair[1]];
        for ends in line.windows(2) {
            let Some((t, _)) = meeting(before.at, after.at, ends[0], ends[1]) else { continue };
            let way = after.at - before.at;
            let along = way.normalize();
            let mix = |a: f64, b: f64| a + t * (b - a);
            let std = before.std + t * (after.std - before.std);
            let along_std = along.component_mul(&std).norm();
            let speed = Estimate {
                value: mix(before.speed.value, after.speed.value),
                std: mix(before.speed.std, after.speed.std),
            };
            let step_s = after.time_s - before.time_s;
            let pace = speed.value.max(way.norm() / step_s);
            let at = before.at + t * way;
            let across = (ends[1] - ends[0]).normalize();
            let [first, last] = [line[0], line[line.len() - 1]].map(|end| (at - end).norm());
            found.push(Crossing {
                gate: gate.name.clone(),
                vehicle: object.id,
                class: object.class.clone(),
                verdict: verdict(object),
                direction: if across.perp(&along) < 0.0 { Direction::ToRight } else { Direction::ToLeft },
                time_s: Estimate { value: mix(before.time_s, after.time_s), std: along_std / pace },
                speed_m_s: speed,
                headway_s: None,
                from_end_m: Estimate { value: first.min(last), std: across.component_mul(&std).norm() },
            });
        }
    }
    found
}

fn verdict(object: &ObjectTrajectory) -> &'static str {
    object.verdict.as_ref().map_or("", |verdict| verdict.state.name())
}

/// Crossings of one line, ascending in time.
fn add_headways(crossings: &mut [Crossing]) {
    for k in 0..crossings.len() {
        let now = &crossings[k];
        let earlier = crossings[..k].iter().rev();
        let before = earlier.clone().find(|other| other.direction == now.direction && other.vehicle != now.vehicle);
        let headway = before.map(|before| Estimate {
            value: now.time_s.value - before.time_s.value,
            std: now.time_s.std.hypot(before.time_s.std),
        });
        crossings[k].headway_s = headway;
    }
}

/// Returns true if a point lies inside a polygon: an odd number of its sides is to the right.
fn is_inside(zone: &[Point2<f64>], at: Point2<f64>) -> bool {
    let is_right = |ends: &&[Point2<f64>]| {
        let (a, b) = (ends[0], ends[1]);
        (a.y > at.y) != (b.y > at.y) && at.x < (b.x - a.x) * (at.y - a.y) / (b.y - a.y) + a.x
    };
    zone.windows(2).filter(is_right).count() % 2 == 1
}

fn visits(gate: &Gate, zone: &[Point2<f64>], object: &ObjectTrajectory, samples: &[Sample]) -> Vec<Visit> {
    let runs = samples.chunk_by(|a, b| is_inside(zone, a.at) == is_inside(zone, b.at));
    let mut found = Vec::new();
    let mut start = 0;
    for run in runs {
        let end = start + run.len();
        if is_inside(zone, run[0].at) {
            let border = |inside: Sample, outside: Option<&Sample>| {
                let outside = outside?;
                let share = zone.windows(2).filter_map(|ends| meeting(inside.at, outside.at, ends[0], ends[1])).next();
                Some(inside.time_s + share.map_or(0.0, |(t, _)| t) * (outside.time_s - inside.time_s))
            };
            let (first, last) = (run[0], run[run.len() - 1]);
            let entry_s = border(first, start.checked_sub(1).and_then(|k| samples.get(k)));
            let exit_s = border(last, samples.get(end));
            let speeds = run.iter().map(|sample| sample.speed.value);
            found.push(Visit {
                gate: gate.name.clone(),
                vehicle: object.id,
                class: object.class.clone(),
                verdict: verdict(object),
                entry_s,
                exit_s,
                duration_s: exit_s.unwrap_or(last.time_s) - entry_s.unwrap_or(first.time_s),
                mean_speed_m_s: speeds.sum::<f64>() / run.len() as f64,
            });
        }
        start = end;
    }
    found
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::export::testing::{results, with_metres};
    use crate::scene::MetricAxes;

    /// The showcase in meters without a map; its first vehicle moves straight along x at 8 m/s.
    fn straight() -> Results {
        let mut results = with_metres(results());
        let frame = results.trajectories.metric.as_mut().and_then(|metric| metric.frame.as_mut()).unwrap();
        (frame.axes, frame.origin) = (MetricAxes::Up, None);
        let object = &mut results.trajectories.objects[0];
        for (k, pose) in object.poses.iter_mut().enumerate() {
            pose.time_s = k as f64 * 0.5;
            let motion = pose.metric.as_mut().and_then(|metric| metric.motion.as_mut()).unwrap();
            motion.smoothed_position_m = [4.0 * k as f64, 1.0, 0.0];
        }
        results.trajectories.objects.truncate(1);
        results
    }

    fn collection(geometry: &Value) -> Value {
        json!({ "type": "FeatureCollection", "features": [
            { "type": "Feature", "properties": { "name": "west" }, "geometry": geometry }
        ] })
    }

    #[test]
    fn a_line_is_crossed_at_its_time_with_its_uncertainty() {
        let results = straight();
        let line = json!({ "type": "LineString", "coordinates": [[10.0, 3.0], [10.0, -1.0]] });
        let gates = gates(&collection(&line), &results).unwrap();
        let found = analyse(&results, &gates).unwrap();
        let [crossing] = &found.crossings[..] else { panic!("{found:?}") };
        assert_eq!((crossing.gate.as_str(), crossing.direction), ("west", Direction::ToLeft));
        assert!((crossing.time_s.value - 1.25).abs() < 1e-12, "{crossing:?}");
        assert!((crossing.time_s.std - 0.1 / 8.0).abs() < 1e-12, "0.1 m at 8 m/s");
        assert!((crossing.speed_m_s.value - 8.0).abs() < 1e-12 && (crossing.from_end_m.value - 2.0).abs() < 1e-12);
        let reversed = json!({ "type": "LineString", "coordinates": [[10.0, -1.0], [10.0, 3.0]] });
        let found = analyse(&results, &super::gates(&collection(&reversed), &results).unwrap()).unwrap();
        assert_eq!(found.crossings[0].direction, Direction::ToRight);
    }

    #[test]
    fn headways_are_those_of_other_vehicles_in_the_same_direction() {
        let mut results = straight();
        let mut second = results.trajectories.objects[0].clone();
        second.id = ObjectId(7);
        second.poses.iter_mut().for_each(|pose| pose.time_s += 3.0);
        results.trajectories.objects.push(second);
        let line = json!({ "type": "LineString", "coordinates": [[10.0, 3.0], [10.0, -1.0]] });
        let found = analyse(&results, &gates(&collection(&line), &results).unwrap()).unwrap();
        assert_eq!(found.crossings[0].headway_s, None);
        let headway = found.crossings[1].headway_s.unwrap();
        assert!((headway.value - 3.0).abs() < 1e-12 && (headway.std - 0.0125 * 2f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_zone_is_entered_and_left() {
        let results = straight();
        let square = [[6.0, 0.0], [14.0, 0.0], [14.0, 4.0], [6.0, 4.0], [6.0, 0.0]];
        let zone = json!({ "type": "Polygon", "coordinates": [square] });
        let found = analyse(&results, &gates(&collection(&zone), &results).unwrap()).unwrap();
        let [visit] = &found.visits[..] else { panic!("{found:?}") };
        assert!((visit.entry_s.unwrap() - 0.75).abs() < 1e-12 && (visit.exit_s.unwrap() - 1.75).abs() < 1e-12);
        assert!((visit.duration_s - 1.0).abs() < 1e-12 && (visit.mean_speed_m_s - 8.0).abs() < 1e-12);
    }

    #[test]
    fn coordinates_on_the_map_are_longitude_and_latitude() {
        let results = with_metres(results());
        let (_, origin) = results.map().unwrap();
        let north = origin.latitude + 1e-4;
        let ends = [[origin.longitude, origin.latitude], [origin.longitude, north]];
        let line = json!({ "type": "LineString", "coordinates": ends });
        let gates = gates(&collection(&line), &results).unwrap();
        let Shape::Line(points) = &gates[0].shape else { panic!("{gates:?}") };
        assert!(points[0].coords.norm() < 1e-6 && (points[1].y - 11.1).abs() < 0.1, "{points:?}");
    }

    #[test]
    fn invalid_gate_is_refused_by_its_number() {
        let results = straight();
        let refusal = |geometry: Value| gates(&collection(&geometry), &results).unwrap_err();
        assert!(refusal(json!({ "type": "Point", "coordinates": [1, 2] })).starts_with("feature 1: Point"));
        assert!(refusal(json!({ "type": "LineString", "coordinates": [[1, 2]] })).contains("two points"));
        assert!(refusal(json!({ "type": "LineString", "coordinates": [[1], [2, 3]] })).contains("two numbers"));
        assert!(refusal(json!({ "type": "Polygon" })).contains("coordinates"));
        assert!(gates(&json!([]), &results).is_err());
    }
}
