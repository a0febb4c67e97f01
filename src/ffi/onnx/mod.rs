//! Networks in ONNX format, run by ONNX Runtime through the `ort` crate.
//!
//! The runtime is a shared library that is looked for when the first model is loaded, so that the program starts and
//! does all other work without it: [`probe`] says where it is or how to get it. [`Model`] is one network; tensors go in
//! and come out as [`Tensor`], row-major `f32`, whatever number type the network gives.
//!
//! Nothing here panics when the library is missing, too old or not ONNX Runtime at all.

mod library;
mod model;

use std::path::PathBuf;

use crate::memory::{MemoryLimit, TooMuch};

pub use self::library::{MINIMUM_VERSION, RuntimeInfo, is_in_place, probe};
pub use self::model::{Model, Tensor, TensorInfo};

/// Resources of the machine for a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resources {
    /// Threads that work on one operation; 0 lets the runtime take one per core.
    pub num_threads: usize,
    /// Memory limit for its file, its inputs and its outputs.
    pub memory: MemoryLimit,
}

impl From<usize> for Resources {
    /// So many threads, and the usual share of the machine's memory.
    fn from(num_threads: usize) -> Self {
        Self { num_threads, memory: MemoryLimit::of_machine() }
    }
}

/// Ways to get the runtime, for messages.
const CURE: &str =
    "install it with `scripts/fetch-onnxruntime`, or set the environment variable TRACTRIX_ONNXRUNTIME to its path";

/// Errors of networks.
#[derive(Debug, thiserror::Error)]
pub enum OnnxError {
    /// No ONNX Runtime library could be loaded.
    #[error(
        "ONNX Runtime (libonnxruntime.so, 1.{MINIMUM_VERSION} or later): not found; {CURE}\n  tried: {}",
        tried.join("\n  tried: ")
    )]
    RuntimeNotFound {
        /// Each place that was tried, with the reason for which it did not serve.
        tried: Vec<String>,
    },
    /// The library that an environment variable names cannot be used.
    #[error(
        "{variable}: the ONNX Runtime library it names cannot be used: {reason}; correct the variable, or unset it and \
         {CURE}"
    )]
    NamedRuntime {
        /// The environment variable.
        variable: &'static str,
        /// The loader's reason, with the path.
        reason: String,
    },
    /// The library was loaded but does not work.
    #[error("ONNX Runtime at {}: failed to start: {reason}; {CURE}", library.display())]
    Runtime {
        /// The library.
        library: PathBuf,
        /// The runtime's message.
        reason: String,
    },
    /// There is no such model file.
    #[error("{}: model file not found", path.display())]
    NoModel {
        /// The file.
        path: PathBuf,
    },
    /// The file is not a network that this runtime can load.
    #[error("{}: ONNX Runtime cannot load this network: {reason}", path.display())]
    Load {
        /// The file.
        path: PathBuf,
        /// The runtime's message.
        reason: String,
    },
    /// The network promises more than memory holds.
    #[error(transparent)]
    Memory(#[from] TooMuch),
    /// Running the network failed.
    #[error("{}: network failed: {reason}", path.display())]
    Run {
        /// The file.
        path: PathBuf,
        /// The runtime's message.
        reason: String,
    },
}
