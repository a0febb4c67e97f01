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

/// A document with a schema.
struct Document {
    name: &'static str,
    /// The file or output that it describes.
    of: &'static str,
    schema: fn() -> Schema,
}

const DOCUMENTS: [Document; 10] = [
    Document { name: "trajectories", of: "trajectories.json, version 3", schema: trajectories::schema },
    Document { name: "tracks", of: "tracks.json", schema: tracks::schema },
    Document { name: "ground", of: "ground.json", schema: ground::schema },
    Document { name: "run", of: "run.json", schema: pipeline::run_json_schema },
    Document { name: "evaluation", of: "evaluation.json", schema: json_file::schema_of::<Evaluation> },
    Document { name: "benchmark", of: "benchmark.json without `summary`", schema: json_file::schema_of::<Benchmark> },
    Document { name: "run-output", of: "output of `run --json`", schema: json_file::schema_of::<RunOutput> },
    Document { name: "live", of: "a line of live.jsonl", schema: json_file::schema_of::<Line> },
    Document { name: "analyse", of: "output of `analyse --json`", schema: json_file::schema_of::<Analysis> },
    Document { name: "summary", of: "output of `summary --json`", schema: json_file::schema_of::<Summary> },
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
    let document = DOCUMENTS.iter().find(|document| document.name == name.trim_end_matches(".json"));
    let document = document.ok_or_else(|| {
        let names = DOCUMENTS.map(|document| document.name).join(", ");
        Failure::Usage(format!("'{name}': no such schema; expected {names}"))
    })?;
    print_json(&titled(document))
}

/// The schema with the name of its document.
fn titled(document: &Document) -> Schema {
    let mut schema = (document.schema)();
    schema.insert("title".into(), document.of.into());
    schema
}

fn list() -> Value {
    json!({ "schemas": DOCUMENTS.map(|document| json!({ "name": document.name, "of": document.of })) })
}

fn as_text() -> String {
    let line = |document: &Document| format!("{:<14}{}\n", document.name, document.of);
    DOCUMENTS.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_schema_describes_every_key() {
        for document in &DOCUMENTS {
            let schema = titled(document).to_value();
            assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema", "{}", document.name);
            let definitions = schema["$defs"].as_object().unwrap();
            for (name, of) in definitions.iter().chain([(&document.name.to_owned(), &schema)]) {
                for (key, property) in of["properties"].as_object().into_iter().flatten() {
                    let said = property["description"].as_str().unwrap_or_default();
                    let refers = property.get("const").is_some();
                    assert!(said.len() > 3 || refers, "{} {name}.{key}: {property}", document.name);
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
