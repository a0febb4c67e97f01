//! Inputs of a run: images and cameras, given masks and models, networks, telemetry, and checks before the first long
//! stage.

pub(in crate::pipeline) mod alignment;
pub(in crate::pipeline) mod attitude;
pub(in crate::pipeline) mod cameras;
mod clock_offsets;
pub(in crate::pipeline) mod given_masks;
pub(in crate::pipeline) mod given_models;
pub(in crate::pipeline) mod hovering;
pub(in crate::pipeline) mod images;
pub(in crate::pipeline) mod networks;
pub(in crate::pipeline) mod order;
pub(in crate::pipeline) mod preflight;
pub(in crate::pipeline) mod telemetry;
