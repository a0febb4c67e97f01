//! The stages of a run: one module each, with the name of the stage.

pub(in crate::pipeline) mod background;
pub(in crate::pipeline) mod features;
pub(in crate::pipeline) mod follow;
pub(in crate::pipeline) mod frames;
pub(in crate::pipeline) mod ground;
pub(in crate::pipeline) mod metric;
pub(in crate::pipeline) mod motion;
pub(in crate::pipeline) mod objects;
pub(in crate::pipeline) mod report;
pub(in crate::pipeline) mod scale;
pub(in crate::pipeline) mod segment;
pub(in crate::pipeline) mod track;
