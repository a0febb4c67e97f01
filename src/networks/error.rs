//! Errors of perception.

use std::path::PathBuf;

use crate::ffi::onnx::{Model, OnnxError, TensorInfo};
use crate::image::ImageError;
use crate::scene::FrameId;

/// Errors of perception; each message names the file or value at fault and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum PerceptionError {
    /// The network or its runtime could not be used.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    /// An image operation failed.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// OpenCV failed.
    #[error("OpenCV: {0}")]
    OpenCv(#[from] opencv::Error),
    /// The network belongs to no supported family.
    #[error(
        "{}: unknown {task} network, by its inputs and outputs.\n  inputs: {}\n  outputs: {}\nSupported: {supported}",
        path.display(), list(inputs), list(outputs)
    )]
    UnknownLayout {
        /// The model file.
        path: PathBuf,
        /// Task of the network.
        task: &'static str,
        /// Its inputs.
        inputs: Vec<TensorInfo>,
        /// Its outputs.
        outputs: Vec<TensorInfo>,
        /// Supported families.
        supported: &'static str,
    },
    /// The names of a network's classes are unknown.
    #[error(
        "{}: {num_classes} classes without names (no `names` in the metadata); put a list `classes = [...]` into {}",
        path.display(), sidecar.display()
    )]
    NoClassNames {
        /// The model file.
        path: PathBuf,
        /// Number of its classes.
        num_classes: usize,
        /// File path at which the names can be given.
        sidecar: PathBuf,
    },
    /// None of the network's classes is wanted.
    #[error("{}: none of the requested classes ({}) found; the network has {}",
        path.display(), wanted.join(", "), found.join(", "))]
    NoWantedClass {
        /// The model file.
        path: PathBuf,
        /// Requested classes.
        wanted: Vec<String>,
        /// The classes that the network has.
        found: Vec<String>,
    },
    /// An output of a network has another shape than its family defines.
    #[error(
        "{}: output of unexpected shape {found:?}; expected {expected}",
        path.display()
    )]
    Output {
        /// The model file.
        path: PathBuf,
        /// The shape that was found.
        found: Vec<usize>,
        /// The shape that was expected, in words.
        expected: String,
    },
    /// The networks that come with the program were not found.
    #[error(
        "bundled networks not found; put the program's folder `models` next to the executable, or set the environment \
         variable TRACTRIX_MODELS to its path\n\
           tried: {}",
        tried.join("\n  tried: ")
    )]
    NoModels {
        /// Searched folders, each with the missing file.
        tried: Vec<String>,
    },
    /// The folder that TRACTRIX_MODELS names does not hold the networks that come with the program.
    #[error("TRACTRIX_MODELS: the networks it names cannot be used: {reason}; correct the variable, or unset it")]
    NamedModels {
        /// Missing part, with the path.
        reason: String,
    },
    /// A model description cannot be read.
    #[error("{}: invalid model description: {reason}", path.display())]
    Description {
        /// The description file.
        path: PathBuf,
        /// Problem, with the line.
        reason: String,
    },
    /// An option is invalid or contradicts another.
    #[error(transparent)]
    Option(#[from] crate::checks::OptionError),
    /// Data of one frame differ in size.
    #[error("{what}: size {found:?} differs from that of the frame, {expected:?}")]
    SizeMismatch {
        /// Subject with the wrong size.
        what: String,
        /// Width and height of the frame.
        expected: (u32, u32),
        /// Width and height that were found.
        found: (u32, u32),
    },
    /// The tracker was given a frame that is not later than the one before.
    #[error("tracker: frame {found:?} after frame {previous:?}; frames must be in order")]
    FrameOrder {
        /// The frame before.
        previous: FrameId,
        /// The frame at fault.
        found: FrameId,
    },
}

impl PerceptionError {
    /// [`PerceptionError::UnknownLayout`] of a network.
    pub(super) fn unknown_layout(model: &Model, task: &'static str, supported: &'static str) -> Self {
        let (inputs, outputs) = (model.inputs().to_vec(), model.outputs().to_vec());
        Self::UnknownLayout { path: model.path().to_owned(), task, inputs, outputs, supported }
    }

    /// [`PerceptionError::Output`] of a network; a missing output has no shape.
    pub(super) fn output(model: &Model, found: Option<Vec<usize>>, expected: impl Into<String>) -> Self {
        let (found, expected) = (found.unwrap_or_default(), expected.into());
        Self::Output { path: model.path().to_owned(), found, expected }
    }

    /// Returns true if the unusable input was given by an environment variable or an option.
    pub fn is_of_choice(&self) -> bool {
        matches!(
            self,
            Self::NamedModels { .. } | Self::Onnx(OnnxError::NamedRuntime { .. } | OnnxError::Provider { .. })
        )
    }
}

fn list(tensors: &[TensorInfo]) -> String {
    let all: Vec<String> = tensors.iter().map(ToString::to_string).collect();
    if all.is_empty() { "none".to_owned() } else { all.join("; ") }
}
