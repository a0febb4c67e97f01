//! One run, and its figures in every outlet: terminal, page, `run --json`, `trajectories.json`, tables and `summary`.

mod common;

use std::fmt::Write as _;
use std::fs;

use common::{Place, drive, json, outcome, tractrix};
use serde_json::Value;
use tractrix::math::rounding::with_std;

const NUM_FRAMES: u32 = 24;

/// Runs the drive at 12 frames per second; gives what went to stdout.
fn run(place: &Place, more: &[&str]) -> String {
    let path = |name: &str| place.path(name).display().to_string();
    let mut command = tractrix();
    command.args(["run", &path("images"), "--output", &path("out"), "--masks", &path("masks")]);
    command.args(["--ground-masks", &path("ground"), "--intrinsics", &drive::intrinsics()]);
    command.args(["--fps", "12", "--threads", "1"]).args(more);
    let (code, stdout, stderr) = outcome(&mut command);
    assert_eq!(code, 0, "{stderr}");
    stdout
}

/// First row of a table, by column.
fn first_row(text: &str) -> impl Fn(&str) -> String + use<> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let columns = reader.headers().unwrap().clone();
    let row = reader.records().next().unwrap().unwrap();
    move |column: &str| row[columns.iter().position(|name| name == column).unwrap_or_else(|| panic!("{column}"))].into()
}

fn export(place: &Place, formats: &str) {
    let out = place.path("out").display().to_string();
    let (code, _, stderr) = outcome(tractrix().args(["export", &out, "--format", formats]));
    assert_eq!(code, 0, "{stderr}");
}

#[test]
fn every_outlet_has_the_same_figures() {
    let place = Place::new(NUM_FRAMES);
    let height = ["--camera-height", "5.5±0.05"];
    let with_json = [&height[..], &["--json"][..]].concat();
    let by_json: Value = serde_json::from_str(&run(&place, &with_json)).unwrap();
    let terminal = run(&place, &height);
    let file = json(&place.path("out/trajectories.json"));
    // The templates escape slashes.
    let page = fs::read_to_string(place.path("out/report.html")).unwrap().replace("&#x2f;", "/");
    export(&place, "csv,trajectories-v2");
    let table = first_row(&fs::read_to_string(place.path("out/export/vehicles.csv")).unwrap());
    let (code, text, _) = outcome(tractrix().args(["summary", &place.path("out").display().to_string()]));
    assert_eq!(code, 0);
    let summary = first_row(&text);

    let (vehicle, object) = (&file["objects"][0], &by_json["objects"][0]);
    for (key, column, unit, factor) in [
        ("path_m", "path", "m", 1.0),
        ("displacement_m", "displacement", "m", 1.0),
        ("mean_speed_m_s", "mean_speed", "km/h", 3.6),
        ("max_speed_m_s", "max_speed", "km/h", 3.6),
    ] {
        let of = |value: &Value| (value["value"].as_f64().unwrap(), value["std"].as_f64().unwrap());
        let (value, std) = of(&vehicle["travel"][key]);
        assert!(std > 0.0 && std.is_finite(), "{key}");
        assert_eq!(of(&object[key]), (value, std), "run --json {key}");
        let ending = key.strip_prefix(column).unwrap();
        for (row, whose) in [(&table as &dyn Fn(&str) -> String, "vehicles.csv"), (&summary, "summary")] {
            assert_eq!(row(key), format!("{value:.4}"), "{whose} {key}");
            assert_eq!(row(&format!("{column}_std{ending}")), format!("{std:.4}"), "{whose} {key}");
        }
        let said = format!("{} {unit}", with_std(factor * value, factor * std));
        assert!(terminal.contains(&said), "{key}: {said} in\n{terminal}");
        assert!(page.contains(&said), "{key}: {said} on the page");
    }
    for key in ["length_m", "width_m", "height_m"] {
        assert_eq!(object[key], vehicle["dimensions"][key], "{key}");
    }
    let state = vehicle["verdict"]["state"].as_str().unwrap();
    assert!(["good", "fair", "doubtful", "rejected"].contains(&state), "{state}");
    assert_eq!((object["verdict"].as_str(), table("verdict").as_str()), (Some(state), state));
    assert!(terminal.contains(&format!("     {state}. ")), "{terminal}");
    assert!(page.contains(&format!("Explanation\">{state}</a>")), "the badge");
    assert!(vehicle["frames"][0].get("speed").is_none() && vehicle["frames"][0]["speed_m_s"].is_number());
    let old = json(&place.path("out/export/trajectories-v2.json"));
    check_rate_and_units(&place, &vehicle["frames"]);
    assert!(old["version"] == 2 && old["objects"][0]["frames"][0].as_object().unwrap()["speed"].is_null());
}

/// Tables at another rate and in other units have the figures of the frames.
fn check_rate_and_units(place: &Place, frames: &Value) {
    let out = place.path("out").display().to_string();
    let export = |more: &[&str]| outcome(tractrix().args(["export", &out, "--format", "csv"]).args(more));
    let (code, _, stderr) = export(&["--rate", "48", "--units", "mph,ft"]);
    assert_eq!(code, 0, "{stderr}");
    let mut reader = csv::Reader::from_path(place.path("out/export/trajectories.csv")).unwrap();
    let columns = reader.headers().unwrap().clone();
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let number = |row: &csv::StringRecord, name: &str| -> f64 {
        row[columns.iter().position(|column| column == name).unwrap()].parse().unwrap()
    };
    let frames = frames.as_array().unwrap();
    assert_eq!(rows.len(), 4 * (frames.len() - 1) + 1);
    for (row, frame) in rows.iter().step_by(4).zip(frames) {
        assert!((number(row, "time_s") - frame["time_s"].as_f64().unwrap()).abs() < 1e-6);
        assert!((number(row, "speed_mph") * 0.44704 - frame["speed_m_s"].as_f64().unwrap()).abs() < 1e-3);
        assert!((number(row, "x_ft") * 0.3048 - frame["position_m"][0].as_f64().unwrap()).abs() < 1e-3);
    }
    for (arguments, said) in
        [(["--rate", "0"], "samples per second"), (["--units", "knots"], "expected m/s, km/h or mph")]
    {
        let (code, _, stderr) = export(&arguments);
        assert!(code == 2 && stderr.contains(said), "{stderr}");
    }
    let (code, _, stderr) = outcome(tractrix().args(["export", &out, "--format", "gltf", "--rate", "10"]));
    assert!(code == 1 && stderr.contains("--rate: gltf has the frames of the input"), "{stderr}");
    let (code, _, stderr) = outcome(tractrix().args(["export", &out, "--format", "cot"]));
    assert!(code == 1 && stderr.contains("--telemetry"), "{stderr}");
}

#[test]
fn models_alone_have_a_page_and_can_be_exported() {
    let place = Place::new(NUM_FRAMES);
    let path = |name: &str| place.path(name).display().to_string();
    let mut command = tractrix();
    command.args(["sfm", &path("images"), "--output", &path("out"), "--intrinsics", &drive::intrinsics(), "--json"]);
    command.args(["--masks", &path("masks"), "--fps", "12"]);
    let (code, stdout, stderr) = outcome(&mut command);
    assert_eq!(code, 0, "{stderr}");
    let output: Value = serde_json::from_str(&stdout).unwrap();
    assert!(output["report"].as_str().unwrap().ends_with("report.html"));
    let page = fs::read_to_string(place.path("out/report.html")).unwrap();
    assert!(page.contains("images registered") && page.contains("Models and residuals"));
    assert!(page.contains("each in its own unit: 1 of 1.") && page.contains("as-reconstructed&#x2f;1&#x2f;"));
    assert!(place.path("out/ply/background.ply").is_file());
    export(&place, "colmap,tum,gltf");
    assert!(place.path("out/export/colmap/sparse/0/points3D.bin").is_file());
    let (code, _, stderr) = outcome(tractrix().args(["export", &path("out"), "--format", "csv"]));
    assert!(code == 1 && stderr.contains("no trajectories"), "{stderr}");
}

#[test]
fn every_schema_is_printed() {
    let (code, list, _) = outcome(tractrix().args(["schema", "--json"]));
    let list: Value = serde_json::from_str(&list).unwrap();
    let names: Vec<&str> = list["schemas"].as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert!(code == 0 && names.len() >= 9, "{names:?}");
    for name in names {
        let (code, text, stderr) = outcome(tractrix().args(["schema", name]));
        let schema: Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(code == 0 && schema["type"] == "object", "{name}: {stderr}");
    }
}

#[test]
fn dates_of_a_log_without_a_zone_are_local_until_it_is_given() {
    let place = Place::new(NUM_FRAMES);
    let mut text = String::new();
    for i in 0..20u32 {
        let (start, end) = (100 * i, 100 * i + 100);
        let [from, to] = [start, end].map(|ms| format!("00:00:{:02},{:03}", ms / 1000, ms % 1000));
        let clock = format!("2024-05-14 10:12:{:02}.{:03}", 30 + start / 1000, start % 1000);
        let place = format!("[latitude: 47.30{i:04}] [longitude: 8.500000] [rel_alt: 3.5 abs_alt: 402.1]");
        writeln!(text, "{}\n{from} --> {to}\n{clock}\n{place}\n", i + 1).unwrap();
    }
    let log = place.path("log.srt");
    fs::write(&log, text).unwrap();
    let log = log.display().to_string();
    let first_date = || {
        export(&place, "csv");
        first_row(&fs::read_to_string(place.path("out/export/trajectories.csv")).unwrap())("date")
    };
    run(&place, &["--telemetry", &log]);
    assert_eq!(first_date(), "2024-05-14T10:12:30");
    run(&place, &["--telemetry", &log, "--utc-offset", "+02:00"]);
    assert_eq!(first_date(), "2024-05-14T08:12:30Z");
}
