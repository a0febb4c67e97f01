//! `run.json`: input, options, results and cost of a run.

use std::collections::BTreeMap;

use schemars::{JsonSchema, Schema};
use serde::Serialize;
use serde_json::{Map, Value};

use super::cost::Cost;
use super::run::Run;
use crate::io::{atomic, json};
use crate::pipeline::{Method, Result};
use crate::scene::TimeBase;
use crate::video::Info;

/// A run: its input, options, cost and warnings (docs/formats.md).
#[derive(Serialize, JsonSchema)]
struct Document<'a> {
    /// Version of the program.
    version: &'a str,
    /// The command line, word by word.
    arguments: &'a [String],
    /// The input.
    input: Input<'a>,
    /// `default`, `paper` or `paper-baseline`.
    method: &'a str,
    /// The complete tree of options, as `tractrix options --json` prints it.
    options: Value,
    /// Finished stages by name, in order.
    #[schemars(with = "BTreeMap<String, StageOfRun>")]
    stages: Map<String, Value>,
    /// Warnings in order, each with its section of docs/troubleshooting.md.
    warnings: Vec<String>,
    /// Reason of a premature end.
    error: Option<&'a str>,
}

/// The input of a run.
#[derive(Serialize, JsonSchema)]
struct Input<'a> {
    /// As named on the command line.
    path: String,
    /// SHA-256 of a video's content; of a folder, that of the names and contents of its files.
    sha256: &'a str,
    /// Properties.
    info: &'a Info,
    /// Meaning of `time_s` in all files.
    times: TimeBase,
}

/// A finished stage.
#[derive(Serialize, JsonSchema)]
struct StageOfRun<'a> {
    #[serde(flatten)]
    cost: Cost,
    /// True if cost and figures are those of an earlier run.
    reused: bool,
    /// Figures of the stage.
    figures: &'a BTreeMap<String, Value>,
}

/// The JSON schema of the file.
pub fn run_json_schema() -> Schema {
    json::schema_of::<Document>()
}

/// Rewrites `run.json` from the records of the stages. `error` is the reason for a premature end.
pub(in crate::pipeline) fn write(run: &Run, error: Option<&str>) -> Result<()> {
    let mut stages = Map::new();
    for record in &run.records {
        let marker = &record.marker;
        let stage = StageOfRun { cost: marker.cost, reused: record.reused, figures: &marker.figures };
        stages.insert(record.stage.name().to_owned(), serde_json::json!(stage));
    }
    let document = Document {
        version: crate::VERSION,
        arguments: run.arguments,
        input: Input {
            path: run.input().display().to_string(),
            sha256: &run.content,
            info: run.info(),
            times: run.info().time_base(),
        },
        method: Method::of(run.options).name(),
        options: run.options.to_json(),
        stages,
        warnings: run.warnings(),
        error,
    };
    run.workspace.put_file(&run.workspace.run_json(), |fresh| atomic::write_json(fresh, &document))
}
