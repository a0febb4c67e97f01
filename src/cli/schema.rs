//! `tractrix schema [NAME]`: JSON schemas of the files of a run and of what commands print with `--json`.

use schemars::Schema;
use serde_json::{Value, json};

use super::output::{Failure, Form, print, print_json};
use super::run_output::RunOutput;
use crate::eval::Evaluation;
use crate::eval::benchmark::Benchmark;
use crate::export::crossings::Analysis;
use crate::export::summary::Summary;
use crate::io::{ground, json as json_file, tracks, trajectories};
use crate::live::Line;
use crate::pipeline;

/// Print the JSON Schema of a result file, or of what a command prints with --json
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// Name of a schema; without it, the list of names
    #[arg(value_name = "NAME")]
    name: Option<String>,
}

/// Name of a document, the file or output that it describes, and its schema.
type Document = (&'static str, &'static str, fn() -> Schema);

const DOCUMENTS: [Document; 10] = [
    ("trajectories", "trajectories.json, version 3", trajectories::schema),
    ("tracks", "tracks.json", tracks::schema),
    ("ground", "ground.json", ground::schema),
    ("run", "run.json", pipeline::run_json_schema),
    ("evaluation", "evaluation.json", json_file::schema_of::<Evaluation>),
    ("benchmark", "benchmark.json without `summary`", json_file::schema_of::<Benchmark>),
    ("run-output", "output of `run --json`", json_file::schema_of::<RunOutput>),
    ("live", "a line of live.jsonl", json_file::schema_of::<Line>),
    ("analyse", "output of `analyse --json`", json_file::schema_of::<Analysis>),
    ("summary", "output of `summary --json`", json_file::schema_of::<Summary>),
];

/// Prints a schema, or the list of them.
///
/// # Errors
/// An unknown name, with the list.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let Some(name) = &args.name else {
        return match form {
            Form::Json => print_json(&list()),
            Form::Text | Form::Nothing => print(&as_text()),
        };
    };
    let document = DOCUMENTS.iter().find(|(other, ..)| *other == name.trim_end_matches(".json"));
    let document = document.ok_or_else(|| {
        let names = DOCUMENTS.map(|(name, ..)| name).join(", ");
        Failure::Usage(format!("'{name}': no such schema; expected {names}"))
    })?;
    print_json(&titled(document))
}

/// The schema with the name of its document.
fn titled((_, of, schema): &Document) -> Schema {
    let mut schema = schema();
    schema.insert("title".into(), (*of).into());
    schema
}

fn list() -> Value {
    json!({ "schemas": DOCUMENTS.map(|(name, of, _)| json!({ "name": name, "of": of })) })
}

fn as_text() -> String {
    DOCUMENTS.iter().map(|(name, of, _)| format!("{name:<14}{of}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_schema_describes_every_key() {
        for document in &DOCUMENTS {
            let (schema, document) = (titled(document).to_value(), document.0);
            assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema", "{document}");
            let definitions = schema["$defs"].as_object().unwrap();
            for (name, of) in definitions.iter().chain([(&document.to_owned(), &schema)]) {
                for (key, property) in of["properties"].as_object().into_iter().flatten() {
                    let said = property["description"].as_str().unwrap_or_default();
                    let refers = property.get("const").is_some();
                    assert!(said.len() > 3 || refers, "{document} {name}.{key}: {property}");
                    assert!(!said.contains("`None`") && !said.contains("[`"), "{name}.{key}: {said}");
                }
            }
        }
    }

    #[test]
    fn unknown_names_are_refused_with_the_list() {
        let asked = |name: &str| run(&Args { name: Some(name.to_owned()) }, Form::Nothing);
        let refused = asked("tables").unwrap_err();
        assert!(refused.code() == 2 && refused.to_string().contains("expected trajectories, tracks"), "{refused}");
    }
}
