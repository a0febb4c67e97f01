//! Execution of stages: markers and cache keys, the output folder, intermediate files, progress and cost.

pub(in crate::pipeline) mod completion;
pub(in crate::pipeline) mod cost;
pub(in crate::pipeline) mod fingerprint;
pub(in crate::pipeline) mod intermediate;
pub(in crate::pipeline) mod progress;
pub(in crate::pipeline) mod reopen;
pub(in crate::pipeline) mod run;
pub(in crate::pipeline) mod run_json;
pub(in crate::pipeline) mod stage;
pub(in crate::pipeline) mod threads;
pub(in crate::pipeline) mod workspace;
