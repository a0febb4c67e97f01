//! Bindings to foreign libraries behind safe types; the only module that may contain `unsafe`.

#[cfg(feature = "cli")]
pub mod child;
pub mod environment;
#[cfg(feature = "video")]
pub mod ffmpeg;
#[cfg(feature = "pipeline")]
pub mod memory;
#[cfg(feature = "perception")]
pub mod onnx;
#[cfg(feature = "pipeline")]
pub mod priority;
