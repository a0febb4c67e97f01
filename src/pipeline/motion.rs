//! Stage `motion`: what moves against the background.

use serde_json::{Value, json};

use super::PipelineError;
use super::run::{Outcome, Run};

pub(super) fn depends_on(_run: &Run) -> Result<Value, PipelineError> {
    Ok(json!("none"))
}

pub(super) fn work(_run: &Run, _fingerprint: &str) -> Result<Outcome, PipelineError> {
    Ok(Outcome::default())
}
