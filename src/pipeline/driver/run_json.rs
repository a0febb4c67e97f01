//! `run.json`: what was run on what, with what result and at what cost.

use serde_json::{Map, Value, json};

use super::run::Run;
use crate::io::atomic;
use crate::pipeline::{Method, PipelineError};

/// Writes `run.json` again from what the stages left behind. `error` says why the run ended before its end.
pub(in crate::pipeline) fn write(run: &Run, error: Option<&str>) -> Result<(), PipelineError> {
    let mut stages = Map::new();
    for record in &run.records {
        let marker = &record.marker;
        let mut stage = json!({
            "wall_s": marker.cost.wall_s,
            "cpu_s": marker.cost.cpu_s,
            "peak_rss_mib": marker.cost.peak_rss_mib,
            "reused": record.reused,
        });
        stage["figures"] = json!(marker.figures);
        stages.insert(record.stage.name().to_owned(), stage);
    }
    let document = json!({
        "version": crate::VERSION,
        "arguments": run.arguments,
        "input": { "path": run.input().display().to_string(), "info": run.info(), "times": run.info().time_base() },
        "method": Method::of(run.options).name(),
        "options": run.options.to_json(),
        "stages": Value::Object(stages),
        "warnings": run.warnings(),
        "error": error,
    });
    run.workspace.put_file(&run.workspace.run_json(), |fresh| atomic::write_json(fresh, &document))
}
