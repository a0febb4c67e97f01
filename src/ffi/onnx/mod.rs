//! Networks in ONNX format, run by ONNX Runtime (feature `onnxruntime`, crate `ort`) or in Rust (feature
//! `networks-rust`, crate `rten`): see [`Provider`].
//!
//! ONNX Runtime is a shared library that is searched for when the first model is loaded: everything else works without
//! it. [`probe`] reports its location, or how to install it. [`Model`] is one network; its inputs and outputs are
//! [`Tensor`]s, row-major `f32`, whatever the number type of the network.
//!
//! Nothing here panics when the library is missing, too old or not ONNX Runtime at all.

#[cfg(feature = "onnxruntime")]
mod library;
mod model;
mod provider;
#[cfg(feature = "networks-rust")]
mod rust;
#[cfg(feature = "onnxruntime")]
mod session;

use std::path::PathBuf;

use serde::Serialize;

use crate::memory::{MemoryLimit, TooMuch};

pub use self::model::{Model, Tensor, TensorInfo};
pub use self::provider::Provider;

/// Inference library.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RuntimeInfo {
    /// The shared library; a bare file name if the system's loader found it. `None` if it is part of the program.
    pub library: Option<PathBuf>,
    /// Version, such as `1.31.1`; `None` if unknown.
    pub version: Option<String>,
}

/// Finds and loads the library of a provider, as loading a model would do.
///
/// # Errors
/// [`OnnxError::RuntimeNotFound`], [`OnnxError::NamedRuntime`], [`OnnxError::Runtime`], [`OnnxError::Provider`]; each
/// explains how to install it.
pub fn probe(provider: Provider) -> Result<RuntimeInfo, OnnxError> {
    match provider {
        #[cfg(feature = "networks-rust")]
        Provider::Rust => Ok(RuntimeInfo { library: None, version: None }),
        #[cfg(feature = "onnxruntime")]
        _ if provider != Provider::Rust => library::probe(provider),
        _ => Err(provider.not_built()),
    }
}

/// Returns true if a provider's library exists at a searched path, without loading it.
///
/// Libraries that only the system's loader would find do not count.
pub fn is_in_place(provider: Provider) -> bool {
    match provider {
        Provider::Rust => cfg!(feature = "networks-rust"),
        #[cfg(feature = "onnxruntime")]
        _ => library::is_in_place(),
        #[cfg(not(feature = "onnxruntime"))]
        _ => false,
    }
}

/// Resources of the machine for a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resources {
    /// Number of threads per operation; 0 for one per core.
    pub num_threads: usize,
    /// Memory limit for its file, its inputs and its outputs.
    pub memory: MemoryLimit,
    /// Implementation and device that run it.
    pub provider: Provider,
}

impl From<usize> for Resources {
    /// Resources with this number of threads, the default memory limit, and the default provider.
    fn from(num_threads: usize) -> Self {
        Self { num_threads, memory: MemoryLimit::of_machine(), provider: Provider::default() }
    }
}

/// Ways to get the runtime, for messages.
const CURE: &str = "install it with `scripts/fetch-onnxruntime`, set the environment variable TRACTRIX_ONNXRUNTIME to \
                    its path, or give --provider rust";

/// Minimum minor version of ONNX Runtime 1.x: that of the `api-*` feature of `ort` that this crate enables.
pub const MINIMUM_VERSION: u32 = 24;

/// Errors of networks.
#[derive(Debug, thiserror::Error)]
pub enum OnnxError {
    /// No ONNX Runtime library could be loaded.
    #[error(
        "ONNX Runtime (libonnxruntime.so, 1.{MINIMUM_VERSION} or later): not found; {CURE}\n  tried: {}",
        tried.join("\n  tried: ")
    )]
    RuntimeNotFound {
        /// Each path that was tried, with the reason of its rejection.
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
    /// This build, or this ONNX Runtime library, does not have the provider.
    #[error("provider {}: {reason}", provider.name())]
    Provider {
        /// Requested provider.
        provider: Provider,
        /// Problem and remedy.
        reason: String,
    },
    /// The model file does not exist.
    #[error("{}: model file not found", path.display())]
    NoModel {
        /// The file.
        path: PathBuf,
    },
    /// The file is not a network that this runtime can load.
    #[error("{}: this network cannot be loaded: {reason}", path.display())]
    Load {
        /// The file.
        path: PathBuf,
        /// The runtime's message.
        reason: String,
    },
    /// The network exceeds the memory limit.
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
