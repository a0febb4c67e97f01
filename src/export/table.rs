//! Tables: comma-separated values with one header line of column names, whose endings are the units.
//!
//! `_units` is the unit of length of the background's reconstruction, `_m` meters, `_s` seconds, `_deg` degrees. An
//! unknown value is an empty cell. Meters have four decimals, longitude and latitude nine: a tenth of a millimeter.

use std::ops::Range;
use std::path::Path;

use nalgebra::Point3;

use super::facts::raw_speed;
use super::{Clock, ExportError, Facts, RegisteredFrame, Results, Units};
use crate::io::{IoError, atomic};
use crate::scene::{Estimate, FrameId, GroundTrack, MapPlace, MetricPose, ObjectTrajectory, Position, TimeBase};

/// Name of a column, and its cell in the row of a vehicle.
type Fact = (&'static str, fn(&Facts) -> String);

/// Name of a column, and its number in a frame with metric values.
type MetricColumn = (&'static str, fn(&MetricPose) -> Option<f64>);

/// Columns of the properties of a vehicle as a whole.
const FACTS: [Fact; 27] = [
    ("vehicle", |facts| facts.vehicle.to_string()),
    ("class", |facts| facts.class.clone()),
    ("confidence", |facts| facts.confidence.to_string()),
    ("verdict", |facts| facts.verdict.unwrap_or_default().to_owned()),
    ("doubt", |facts| facts.doubt.clone().unwrap_or_default()),
    ("frames", |facts| facts.num_frames.to_string()),
    ("first_frame", |facts| frame(facts.first_frame)),
    ("last_frame", |facts| frame(facts.last_frame)),
    ("first_time_s", |facts| exact(facts.first_time_s)),
    ("last_time_s", |facts| exact(facts.last_time_s)),
    ("duration_s", |facts| exact(facts.duration_s)),
    ("path_units", |facts| exact(facts.path_units)),
    ("path_std_units", |facts| exact(facts.path_std_units)),
    ("path_m", |facts| value(facts.path_m)),
    ("path_std_m", |facts| std(facts.path_m)),
    ("displacement_m", |facts| value(facts.displacement_m)),
    ("displacement_std_m", |facts| std(facts.displacement_m)),
    ("mean_speed_m_s", |facts| value(facts.mean_speed_m_s)),
    ("mean_speed_std_m_s", |facts| std(facts.mean_speed_m_s)),
    ("max_speed_m_s", |facts| value(facts.max_speed_m_s)),
    ("max_speed_std_m_s", |facts| std(facts.max_speed_m_s)),
    ("length_m", |facts| value(facts.dimensions.length_m)),
    ("length_std_m", |facts| std(facts.dimensions.length_m)),
    ("width_m", |facts| value(facts.dimensions.width_m)),
    ("width_std_m", |facts| std(facts.dimensions.width_m)),
    ("height_m", |facts| value(facts.dimensions.height_m)),
    ("height_std_m", |facts| std(facts.dimensions.height_m)),
];

/// Columns of the frames, the travel and the size, which ground tracks also have.
const OF_GROUND_TRACKS: [Range<usize>; 2] = [5..8, 10..27];

/// Columns of metric values.
const METRIC: [MetricColumn; 23] = [
    ("x_m", |pose| Some(pose.position_m[0])),
    ("y_m", |pose| Some(pose.position_m[1])),
    ("z_m", |pose| Some(pose.position_m[2])),
    ("x_std_m", |pose| Some(pose.position_std_m[0])),
    ("y_std_m", |pose| Some(pose.position_std_m[1])),
    ("z_std_m", |pose| Some(pose.position_std_m[2])),
    ("x_smoothed_m", |pose| Some(pose.motion?.smoothed_position_m[0])),
    ("y_smoothed_m", |pose| Some(pose.motion?.smoothed_position_m[1])),
    ("z_smoothed_m", |pose| Some(pose.motion?.smoothed_position_m[2])),
    ("x_smoothed_std_m", |pose| Some(pose.motion?.smoothed_position_std_m[0])),
    ("y_smoothed_std_m", |pose| Some(pose.motion?.smoothed_position_std_m[1])),
    ("z_smoothed_std_m", |pose| Some(pose.motion?.smoothed_position_std_m[2])),
    ("speed_m_s", |pose| Some(pose.motion?.speed_m_s)),
    ("speed_std_m_s", |pose| Some(pose.motion?.speed_std_m_s)),
    ("raw_speed_m_s", |pose| Some(pose.motion?.raw_speed_m_s)),
    ("acceleration_m_s2", |pose| Some(pose.motion?.acceleration_m_s2)),
    ("acceleration_std_m_s2", |pose| Some(pose.motion?.acceleration_std_m_s2)),
    ("heading_deg", |pose| pose.motion?.heading_deg),
    ("heading_std_deg", |pose| pose.motion?.heading_std_deg),
    ("yaw_rate_deg_s", |pose| pose.motion?.yaw_rate_deg_s),
    ("yaw_rate_std_deg_s", |pose| pose.motion?.yaw_rate_std_deg_s),
    ("distance_to_camera_m", |pose| Some(pose.distance_to_camera_m)),
    ("distance_to_camera_std_m", |pose| Some(pose.distance_to_camera_std_m)),
];

/// Columns of a time, of a position in the background's frame, and of a georeferenced position.
const MOMENT: [&str; 4] = ["frame", "image", "time_s", "date"];
const POSITION: [&str; 3] = ["x_units", "y_units", "z_units"];
const PLACE: [&str; 4] = ["longitude", "latitude", "height_m", "place_std_m"];

/// One row per vehicle.
pub(super) fn vehicles(path: &Path, results: &Results) -> Result<(), ExportError> {
    let metric = results.trajectories.metric.as_ref();
    let frame = results.metric_frame();
    let of_scale = ["scale_ratio", "scale_ratio_std", "metres_verdict", "metres_per_unit", "metres_per_unit_std"];
    let columns = [&fact_columns()[..], &of_scale].concat();
    let row = |object: &ObjectTrajectory| {
        let scale = [
            object.scale.ratio.to_string(),
            exact(object.scale.std),
            metric.map(|metric| metric.verdict.name().to_owned()).unwrap_or_default(),
            exact(frame.map(|frame| frame.scale)),
            exact(frame.map(|frame| frame.std.scale)),
        ];
        [fact_cells(&Facts::of(object, results.time_base)), scale.to_vec()].concat()
    };
    write_in(path, results.units, &columns, results.trajectories.objects.iter().map(row))
}

/// Names of the columns of [`fact_cells`].
pub(super) fn fact_columns() -> [&'static str; FACTS.len()] {
    FACTS.map(|(name, _)| name)
}

/// Properties of a vehicle as a whole.
pub(super) fn fact_cells(facts: &Facts) -> Vec<String> {
    FACTS.iter().map(|(_, cell)| cell(facts)).collect()
}

/// The columns that ground tracks also have.
fn shared_facts() -> impl Iterator<Item = Fact> {
    OF_GROUND_TRACKS.into_iter().flatten().map(|k| FACTS[k])
}

/// One row per vehicle and frame.
pub(super) fn trajectories(path: &Path, results: &Results) -> Result<(), ExportError> {
    let clock = results.clock();
    let rows = results.trajectories.objects.iter().flat_map(|object| {
        let headings = object.unwrapped_headings_deg().into_iter().map(metres);
        let cells = |(index, heading)| [pose_cells(results, &clock, object, index), vec![heading]].concat();
        headings.enumerate().map(cells).collect::<Vec<_>>()
    });
    let (head, speed, heading) = (["vehicle", "class"], ["speed_units_s"], ["heading_unwrapped_deg"]);
    let columns = [&head[..], &MOMENT, &POSITION, &speed, &metric_columns(), &PLACE, &heading].concat();
    write_in(path, results.units, &columns, rows)
}

fn pose_cells(results: &Results, clock: &Clock, object: &ObjectTrajectory, index: usize) -> Vec<String> {
    let pose = Position::from(&object.poses[index]);
    let speed = raw_speed(&object.poses, index).filter(|_| results.time_base == TimeBase::Seconds);
    let who = vec![object.id.to_string(), object.class.clone()];
    [who, position_cells(clock, &pose), vec![exact(speed)], metric_cells(results, &pose)].concat()
}

/// One row per ground track.
pub(super) fn ground_tracks(path: &Path, results: &Results) -> Result<(), ExportError> {
    let own = ["vehicle", "class", "confidence", "method", "verdict", "remark", "reason", "distance_std", "omitted"];
    let axis = ["axis_deg", "axis_std_deg"];
    let columns: Vec<&str> = own.into_iter().chain(shared_facts().map(|(name, _)| name)).chain(axis).collect();
    let row = |track: &GroundTrack| {
        let facts = Facts::of_ground_track(track, results.time_base);
        let own = [
            facts.vehicle.to_string(),
            facts.class.clone(),
            facts.confidence.to_string(),
            track.method.name().to_owned(),
            facts.verdict.unwrap_or_default().to_owned(),
            facts.doubt.clone().unwrap_or_default(),
            track.reason.clone(),
            exact(track.verdict.as_ref().map(|verdict| verdict.distance_std)),
            track.omissions().unwrap_or_default(),
        ];
        let axis = [value(track.axis_deg), std(track.axis_deg)];
        own.into_iter().chain(shared_facts().map(|(_, cell)| cell(&facts))).chain(axis).collect()
    };
    write_in(path, results.units, &columns, results.trajectories.ground_tracks.iter().map(row))
}

/// One row per ground track and frame: the columns of `trajectories.csv`, with the method.
pub(super) fn ground_positions(path: &Path, results: &Results) -> Result<(), ExportError> {
    let clock = results.clock();
    let head = ["vehicle", "class", "method"];
    let columns = [&head[..], &MOMENT, &POSITION, &metric_columns(), &PLACE].concat();
    let rows = results.trajectories.ground_tracks.iter().flat_map(|track| {
        let clock = &clock;
        track.positions.iter().map(move |contact| contact_cells(results, clock, track, contact.into()))
    });
    write_in(path, results.units, &columns, rows)
}

fn contact_cells(results: &Results, clock: &Clock, track: &GroundTrack, contact: Position) -> Vec<String> {
    let who = vec![track.id.to_string(), track.class.clone(), track.method.name().to_owned()];
    [who, position_cells(clock, &contact), metric_cells(results, &contact)].concat()
}

/// Cells of [`MOMENT`] and [`POSITION`]; the time is empty where the rate is unknown.
fn position_cells(clock: &Clock, at: &Position) -> Vec<String> {
    let time = if clock.has_seconds() { at.time_s.to_string() } else { String::new() };
    let date = clock.date(at.name, at.time_s).unwrap_or_default();
    let [x, y, z] = [at.in_world.x, at.in_world.y, at.in_world.z].map(|value| value.to_string());
    vec![at.frame.0.to_string(), at.name.to_owned(), time, date, x, y, z]
}

fn metric_columns() -> [&'static str; METRIC.len()] {
    METRIC.map(|(name, _)| name)
}

/// Cells of [`METRIC`] and [`PLACE`].
fn metric_cells(results: &Results, at: &Position) -> Vec<String> {
    let metric = METRIC.iter().map(|(_, value)| metres(at.metric.and_then(value)));
    metric.chain(place_cells(results.place_of(*at))).collect()
}

/// One row per frame of the camera.
pub(super) fn camera(path: &Path, results: &Results) -> Result<(), ExportError> {
    let clock = results.clock();
    let (pose, metric) = (["qw", "qx", "qy", "qz", "focal_x_px", "focal_y_px"], ["x_m", "y_m", "z_m"]);
    let columns = [&MOMENT[..], &POSITION, &pose, &metric, &PLACE, &["place_std_up_m"]].concat();
    write_in(path, results.units, &columns, results.views.iter().map(|view| view_cells(results, &clock, view)))
}

fn view_cells(results: &Results, clock: &Clock, view: &RegisteredFrame) -> Vec<String> {
    let center = view.cam_from_world.center();
    let turn = view.cam_from_world.rotation.inverse();
    let mut cells = position_cells(clock, &view.into());
    cells.extend([turn.w, turn.i, turn.j, turn.k].map(|value| value.to_string()));
    cells.extend(view.camera.focal.map(|focal| focal.to_string()));
    let in_metres = results.metric_frame().map(|frame| frame.metric_from_world() * center);
    cells.extend([0, 1, 2].map(|axis| metres(in_metres.map(|point: Point3<f64>| point[axis]))));
    let place = results.place(center);
    cells.extend(place_cells(place));
    cells.push(metres(place.map(|place| place.place_std_m[2])));
    cells
}

fn place_cells(place: Option<MapPlace>) -> [String; 4] {
    let degrees = |value: Option<f64>| value.map(|value| format!("{value:.9}")).unwrap_or_default();
    [
        degrees(place.map(|place| place.longitude)),
        degrees(place.map(|place| place.latitude)),
        metres(place.map(|place| place.height_m)),
        metres(place.map(|place| place.horizontal_std_m())),
    ]
}

fn value(estimate: Option<Estimate>) -> String {
    metres(estimate.map(|estimate| estimate.value))
}

fn std(estimate: Option<Estimate>) -> String {
    metres(estimate.map(|estimate| estimate.std))
}

fn frame(frame: Option<FrameId>) -> String {
    frame.map(|frame| frame.0.to_string()).unwrap_or_default()
}

/// Four decimals.
fn metres(value: Option<f64>) -> String {
    value.map(|value| format!("{value:.4}")).unwrap_or_default()
}

/// Shortest representation that identifies the number.
fn exact(value: Option<f64>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// As [`write()`], in units.
fn write_in(
    path: &Path,
    units: Units,
    columns: &[&str],
    rows: impl Iterator<Item = Vec<String>>,
) -> Result<(), ExportError> {
    let (names, factors): (Vec<String>, Vec<f64>) = columns.iter().map(|name| units.column(name)).unzip();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let convert = |row: Vec<String>| row.into_iter().zip(&factors).map(|(cell, f)| Units::cell(*f, cell)).collect();
    write(path, &names, rows.map(convert))
}

/// Writes a table; every row has one cell per column.
pub(super) fn write(path: &Path, columns: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Result<(), ExportError> {
    let text = text(columns, rows).map_err(|error| IoError::content(path, error.to_string()))?;
    Ok(atomic::write(path, &text)?)
}

/// A table as text. Texts that a spreadsheet would parse as a formula get a leading apostrophe.
pub(super) fn text(columns: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Result<Vec<u8>, csv::Error> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(columns)?;
    for row in rows {
        writer.write_record(row.into_iter().map(without_formula))?;
    }
    writer.into_inner().map_err(|error| error.into_error().into())
}

/// A cell that no spreadsheet evaluates. Numbers stay unchanged.
fn without_formula(cell: String) -> String {
    let is_formula = cell.starts_with(['=', '+', '-', '@', '\t', '\r', '\n']) && cell.parse::<f64>().is_err();
    if is_formula { format!("'{cell}") } else { cell }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{results, with_metres};

    fn read(write: fn(&Path, &Results) -> Result<(), ExportError>, results: &Results) -> Vec<Vec<(String, String)>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        write(&path, results).unwrap();
        let mut reader = csv::Reader::from_path(&path).unwrap();
        let columns = reader.headers().unwrap().clone();
        let named = |row: csv::StringRecord| {
            columns.iter().zip(row.iter()).map(|(name, cell)| (name.to_owned(), cell.to_owned())).collect()
        };
        reader.records().map(|row| named(row.unwrap())).collect()
    }

    fn cell<'a>(row: &'a [(String, String)], column: &str) -> &'a str {
        &row.iter().find(|(name, _)| name == column).unwrap_or_else(|| panic!("no column {column}")).1
    }

    #[test]
    fn every_frame_has_a_row_that_reads_back() {
        let results = with_metres(results());
        let rows = read(trajectories, &results);
        let poses: usize = results.trajectories.objects.iter().map(|object| object.poses.len()).sum();
        assert_eq!(rows.len(), poses);
        let (row, pose) = (&rows[0], &results.trajectories.objects[0].poses[0]);
        assert_eq!((cell(row, "vehicle"), cell(row, "class"), cell(row, "image")), ("1", "car", pose.name.as_str()));
        assert_eq!(cell(row, "x_units").parse(), Ok(pose.position[0]));
        let metric = pose.metric.unwrap();
        assert_eq!(cell(row, "y_m"), format!("{:.4}", metric.position_m[1]));
        assert_eq!(cell(row, "speed_m_s"), format!("{:.4}", metric.motion.unwrap().speed_m_s));
        assert_eq!(cell(row, "latitude"), format!("{:.9}", metric.place.unwrap().latitude));
        assert_eq!(cell(row, "date"), "2024-06-01T12:00:00Z");
    }

    #[test]
    fn vehicles_and_camera_have_their_figures() {
        let results = with_metres(results());
        let rows = read(vehicles, &results);
        assert_eq!(rows.len(), 2);
        assert!((cell(&rows[0], "mean_speed_m_s").parse::<f64>().unwrap() - 8.0).abs() < 1e-3);
        assert_eq!((cell(&rows[0], "length_m"), cell(&rows[0], "width_m")), ("4.3000", ""));
        assert_eq!((cell(&rows[0], "metres_verdict"), cell(&rows[0], "metres_per_unit_std")), ("telemetry", "0.04"));
        let rows = read(camera, &results);
        assert_eq!(rows.len(), results.views.len());
        assert!(cell(&rows[0], "place_std_m").parse::<f64>().unwrap() > 0.0);
    }

    #[test]
    fn tables_have_the_units_that_were_asked_for() {
        let results = Results { units: "mph,ft".parse().unwrap(), ..with_metres(results()) };
        let row = &read(trajectories, &results)[0];
        assert_eq!((cell(row, "speed_mph"), cell(row, "speed_std_mph")), ("17.8955", "0.8948"));
        let metric = results.trajectories.objects[0].poses[0].metric.unwrap();
        let x_ft: f64 = cell(row, "x_ft").parse().unwrap();
        assert!((0.3048 * x_ft - metric.position_m[0]).abs() < 1e-4 && !row.iter().any(|(name, _)| name == "x_m"));
        assert_eq!(cell(&read(vehicles, &results)[0], "length_ft"), "14.1076");
    }

    #[test]
    fn without_metres_their_cells_are_empty() {
        let results = results();
        let rows = read(trajectories, &results);
        for column in ["x_m", "speed_m_s", "longitude", "date", "place_std_m"] {
            assert_eq!(cell(&rows[0], column), "", "{column}");
        }
        assert!(cell(&rows[0], "speed_units_s").parse::<f64>().unwrap() > 0.0);
        assert_eq!(cell(&read(camera, &results)[0], "x_m"), "");
        assert_eq!(cell(&read(vehicles, &results)[0], "metres_verdict"), "");
    }

    #[test]
    fn texts_are_no_formulas_and_numbers_stay() {
        let cells =
            ["=1+1", "+cmd|' /C calc'!A0", "-2+3.jpg", "@SUM(1)", "\t=1", "-2.5", "-1e-7", "+4", "", "a=b", "'"];
        let row = || cells.map(str::to_owned).to_vec();
        let written = text(&cells, std::iter::once(row())).unwrap();
        let read: Vec<String> = ::csv::Reader::from_reader(&written[..])
            .records()
            .flat_map(|record| record.unwrap().iter().map(str::to_owned).collect::<Vec<_>>())
            .collect();
        let quoted = ["'=1+1", "'+cmd|' /C calc'!A0", "'-2+3.jpg", "'@SUM(1)", "'\t=1"];
        assert_eq!(read[..5], quoted);
        assert_eq!(read[5..], cells[5..]);
    }
}
