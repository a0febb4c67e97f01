//! Summary table of many runs: a row per vehicle of every run, and a row for each run or vehicle without a result, with
//! the reason.
//!
//! A folder that is not an output folder is searched for such folders, in the order of their names; links and hidden
//! folders are skipped. An error in one run does not affect the others.

use std::fs;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::geojson::vehicle_properties;
use super::table::{fact_cells, fact_columns, text};
use super::{ExportError, Facts, Results};
use crate::checks::text::with_causes;
use crate::io::{RunFolder, json as json_file};
use crate::scene::{GroundTrack, MapPlace, ObjectId, ObjectTrajectory, warning_text};

/// Columns before and after those of a vehicle's figures.
const BEFORE: [&str; 2] = ["run", "input"];
const AFTER: [&str; 7] = ["metres", "metres_reason", "date", "longitude", "latitude", "place_std_m", "missing"];

/// One row of the table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Row {
    /// The output folder.
    pub run: PathBuf,
    /// Input, where it is readable.
    pub input: Option<PathBuf>,
    /// The vehicle's figures; `None` in a row of a run without a result or of a vehicle without a trajectory.
    pub facts: Option<Facts>,
    /// Id and class of a vehicle without a trajectory.
    pub unplaced: Option<(ObjectId, String)>,
    /// Source of the metric scale; `None` in results without that information.
    pub metres: Option<&'static str>,
    /// Remark on meters.
    pub metres_reason: Option<String>,
    /// Date of the vehicle's first observation, where dates are known.
    pub date: Option<String>,
    /// Its georeferenced position at that time; `None` where the map is unknown.
    pub place: Option<MapPlace>,
    /// Missing part, with the reason.
    pub missing: Option<String>,
}

/// All rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Summary {
    /// Rows in the order of the given folders, and by name below them.
    pub rows: Vec<Row>,
    /// Output folders that were read.
    pub num_runs: usize,
    /// Folders that could not be read.
    pub unreadable: Vec<PathBuf>,
}

/// Parts of `run.json` on the progress of a run.
#[derive(Deserialize)]
struct RunJson {
    input: InputJson,
    #[serde(default)]
    warnings: Vec<String>,
    #[serde(default)]
    error: Option<String>,
}

#[derive(Deserialize)]
struct InputJson {
    path: PathBuf,
}

impl Summary {
    /// Reads output folders, and folders that contain them.
    pub fn of(folders: &[PathBuf]) -> Self {
        let mut summary = Self::default();
        for folder in folders {
            let runs = runs_below(folder, 0);
            if runs.is_empty() {
                summary.refuse(folder, nothing_in(folder));
            }
            runs.iter().for_each(|run| summary.add(run));
        }
        summary
    }

    /// As comma-separated values.
    ///
    /// # Errors
    /// Only those of writing to memory.
    pub fn to_csv(&self) -> Result<Vec<u8>, csv::Error> {
        let columns = [&BEFORE[..], &fact_columns(), &AFTER].concat();
        text(&columns, self.rows.iter().map(Row::cells))
    }

    /// As GeoJSON: a point per row at the vehicle's first observation; no geometry where that is unknown.
    pub fn to_geojson(&self) -> Value {
        let features: Vec<Value> = self.rows.iter().map(Row::feature).collect();
        json!({ "type": "FeatureCollection", "features": features })
    }

    fn refuse(&mut self, folder: &Path, reason: String) {
        self.unreadable.push(folder.to_owned());
        self.rows.push(Row { missing: Some(reason), ..Row::new(folder, None) });
    }

    fn add(&mut self, run: &Path) {
        let folder = RunFolder::at(run);
        let info: RunJson = match json_file::read(&folder.run_json()) {
            Ok(info) => info,
            Err(error) => return self.refuse(run, with_causes(&error)),
        };
        match Results::read_trajectories(&folder) {
            Ok(results) => self.add_results(&folder, &info, &results),
            Err(ExportError::NoResult { .. }) => {
                self.num_runs += 1;
                let reason = info.error.unwrap_or_else(|| "run incomplete: no trajectories yet".to_owned());
                self.rows.push(Row { missing: Some(reason), ..Row::new(run, Some(info.input.path)) });
            }
            Err(error) => self.refuse(run, with_causes(&error)),
        }
    }

    fn add_results(&mut self, folder: &RunFolder, info: &RunJson, results: &Results) {
        self.num_runs += 1;
        let before = self.rows.len();
        let blank = Row { input: Some(info.input.path.clone()), ..Row::of_metres(folder.root(), results) };
        let on_ground = |id: ObjectId| results.trajectories.ground_track(id).map(ground_track_in_words);
        let placed = results.trajectories.objects.iter().map(|object| {
            let missing = on_ground(object.id);
            Row { missing, ..blank.of_vehicle(results, object) }
        });
        self.rows.extend(placed);
        let tracked = folder.read_tracked().unwrap_or_default();
        let has_way = |id: ObjectId| results.trajectories.objects.iter().any(|object| object.id == id);
        for object in tracked.iter().filter(|object| !has_way(object.id)) {
            let unplaced = Some((object.id, object.class.clone()));
            let reason = reason_without_trajectory(object.id, info);
            let missing = Some(on_ground(object.id).map_or(reason.clone(), |track| format!("{reason}; {track}")));
            self.rows.push(Row { unplaced, missing, ..blank.clone() });
        }
        if self.rows.len() == before {
            let reason = info.error.clone().unwrap_or_else(|| "no vehicle found".to_owned());
            self.rows.push(Row { missing: Some(reason), ..blank });
        }
    }
}

impl Row {
    fn new(run: &Path, input: Option<PathBuf>) -> Self {
        Self { run: run.to_owned(), input, ..Self::default() }
    }

    fn of_metres(run: &Path, results: &Results) -> Self {
        let metric = results.trajectories.metric.as_ref();
        Self {
            metres: metric.map(|metric| metric.verdict.name()),
            metres_reason: metric.and_then(|metric| metric.reason.clone()),
            ..Self::new(run, None)
        }
    }

    fn of_vehicle(&self, results: &Results, object: &ObjectTrajectory) -> Self {
        let first = object.poses.first();
        Self {
            facts: Some(Facts::of(object, results.time_base)),
            date: first.and_then(|pose| results.clock().date(&pose.name, pose.time_s)),
            place: first.and_then(|pose| results.place_of(pose)),
            ..self.clone()
        }
    }

    fn cells(&self) -> Vec<String> {
        let path = |path: Option<&PathBuf>| path.map(|path| path.display().to_string()).unwrap_or_default();
        let mut cells = vec![path(Some(&self.run)), path(self.input.as_ref())];
        match (&self.facts, &self.unplaced) {
            (Some(facts), _) => cells.extend(fact_cells(facts)),
            (None, unplaced) => {
                let mut empty = vec![String::new(); fact_columns().len()];
                if let Some((id, class)) = unplaced {
                    (empty[0], empty[1]) = (id.to_string(), class.clone());
                }
                cells.extend(empty);
            }
        }
        let degrees = |value: fn(&MapPlace) -> f64| {
            self.place.as_ref().map(|place| format!("{:.9}", value(place))).unwrap_or_default()
        };
        cells.extend([
            self.metres.unwrap_or_default().to_owned(),
            self.metres_reason.clone().unwrap_or_default(),
            self.date.clone().unwrap_or_default(),
            degrees(|place| place.longitude),
            degrees(|place| place.latitude),
            self.place.map(|place| format!("{:.4}", place.horizontal_std_m())).unwrap_or_default(),
            self.missing.clone().unwrap_or_default(),
        ]);
        cells
    }

    fn feature(&self) -> Value {
        let geometry =
            self.place.map(|place| json!({ "type": "Point", "coordinates": [place.longitude, place.latitude] }));
        let mut properties = json!({
            // Paths need not be UTF-8.
            "run": self.run.to_string_lossy(),
            "input": self.input.as_ref().map(|input| input.to_string_lossy()),
            "metres": self.metres,
            "metres_reason": self.metres_reason,
            "date": self.date,
            "place_std_m": self.place.map(|place| place.horizontal_std_m()),
            "missing": self.missing,
        });
        if let Some(all) = properties.as_object_mut() {
            if let Some((id, class)) = &self.unplaced {
                all.insert("vehicle".into(), json!(id));
                all.insert("class".into(), json!(class));
            }
            all.extend(self.facts.iter().flat_map(vehicle_properties));
        }
        json!({ "type": "Feature", "geometry": geometry, "properties": properties })
    }
}

/// Output folders at and below a path, by name.
fn runs_below(folder: &Path, depth: usize) -> Vec<PathBuf> {
    let run = RunFolder::at(folder);
    if run.run_json().is_file() || run.trajectories().is_file() {
        return vec![folder.to_owned()];
    }
    // Maximum depth of the folder search.
    if depth == 6 {
        return Vec::new();
    }
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let is_folder = |entry: &fs::DirEntry| {
        // A link may form a cycle.
        entry.file_type().is_ok_and(|kind| kind.is_dir()) && !entry.file_name().as_encoded_bytes().starts_with(b".")
    };
    let mut below: Vec<PathBuf> = entries.filter(is_folder).map(|entry| entry.path()).collect();
    below.sort();
    below.iter().flat_map(|folder| runs_below(folder, depth + 1)).collect()
}

fn nothing_in(folder: &Path) -> String {
    match fs::read_dir(folder) {
        Err(error) => format!("cannot be read: {error}; check the path"),
        Ok(_) => "no output folder of `tractrix run` in it".to_owned(),
    }
}

/// Reason why a tracked vehicle has no trajectory: the run's warning, else what is known.
fn reason_without_trajectory(id: ObjectId, info: &RunJson) -> String {
    let begins = ["not reconstructed", "skipped", "no trajectory"].map(|what| format!("object {id}: {what}: "));
    let reason = |warning: &String| {
        begins.iter().find_map(|begin| warning_text(warning).strip_prefix(begin.as_str()).map(str::to_owned))
    };
    info.warnings.iter().find_map(reason).unwrap_or_else(|| "tracked, but without a trajectory".to_owned())
}

/// `ground track of 90 frames (usable: ...)`.
fn ground_track_in_words(track: &GroundTrack) -> String {
    let verdict = track.verdict.as_ref();
    let said = verdict.map(|verdict| format!(" ({}: {})", verdict.state.name(), verdict.says)).unwrap_or_default();
    format!("ground track of {} frames{said}, see trajectories.json", track.positions.len())
}

#[cfg(test)]
mod tests {
    use std::os::unix::ffi::OsStringExt;

    use super::*;
    use crate::export::testing::{results, with_metres, write_run};

    fn records(summary: &Summary) -> Vec<csv::StringRecord> {
        let text = summary.to_csv().unwrap();
        let mut reader = csv::Reader::from_reader(text.as_slice());
        assert_eq!(reader.headers().unwrap().len(), BEFORE.len() + fact_columns().len() + AFTER.len());
        reader.records().map(Result::unwrap).collect()
    }

    #[test]
    fn table_has_good_and_broken_runs() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        write_run(&at("runs/b"), &with_metres(results()));
        write_run(&at("runs/deep/a"), &results());
        write_run(&at("runs/c"), &results());
        fs::write(at("runs/c/trajectories.json"), "{\"version\": 1").unwrap();
        write_run(&at("runs/d"), &results());
        fs::remove_file(at("runs/d/trajectories.json")).unwrap();
        let summary = Summary::of(&[at("runs"), at("gone")]);
        let rows = records(&summary);
        let names: Vec<_> = summary.rows.iter().map(|row| row.run.strip_prefix(folder.path()).unwrap()).collect();
        let names: Vec<_> = names.iter().map(|name| name.to_str().unwrap()).collect();
        assert_eq!(names, ["runs/b", "runs/b", "runs/c", "runs/d", "runs/deep/a", "runs/deep/a", "gone"]);
        assert_eq!((summary.num_runs, summary.unreadable.len()), (3, 2));
        let missing = |row: usize| rows[row].iter().next_back().unwrap().to_owned();
        assert!(missing(2).contains("trajectories.json") && missing(3).contains("run incomplete"));
        assert!(missing(0).is_empty() && missing(6).contains("cannot be read"));
        let features = summary.to_geojson();
        assert_eq!(features["features"][0]["geometry"]["type"], "Point");
        assert_eq!(features["features"][0]["properties"]["mean_speed_m_s"], 8.0);
        assert_eq!(features["features"][4]["geometry"], Value::Null);
        assert_eq!(Summary::of(&[at("runs"), at("gone")]), summary);
    }

    #[test]
    fn names_of_folders_need_not_be_utf_8() {
        let folder = PathBuf::from(std::ffi::OsString::from_vec(b"gone-\xff".to_vec()));
        assert_eq!(Summary::of(&[folder]).to_geojson()["features"][0]["properties"]["run"], "gone-\u{fffd}");
    }

    #[test]
    fn vehicle_without_trajectory_has_the_reason_of_the_run() {
        let warnings = vec![
            "object 12: skipped: far".to_owned(),
            "object 1: not reconstructed: dark [troubleshooting: vehicle-not-reconstructed]".to_owned(),
        ];
        let info = RunJson { input: InputJson { path: "a.mp4".into() }, warnings, error: None };
        assert_eq!(reason_without_trajectory(ObjectId(1), &info), "dark");
        assert_eq!(reason_without_trajectory(ObjectId(12), &info), "far");
        assert_eq!(reason_without_trajectory(ObjectId(2), &info), "tracked, but without a trajectory");
    }
}
