//! One network.

use std::fmt;
use std::path::{Path, PathBuf};

use super::{OnnxError, Provider, Resources};

/// Name and shape of an input or output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorInfo {
    /// The tensor's name in the network.
    pub name: String,
    /// Dimensions; `None` for an open dimension. Empty if it is not a tensor.
    pub shape: Vec<Option<usize>>,
    /// Number type, such as `f32`.
    pub element: String,
}

impl TensorInfo {
    /// Size as 32-bit numbers, bytes; open dimensions count as one.
    fn num_bytes(&self) -> u128 {
        let sides = self.shape.iter().map(|side| side.unwrap_or(1) as u128);
        sides.fold(size_of::<f32>() as u128, u128::saturating_mul)
    }
}

impl fmt::Display for TensorInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} [", self.name, self.element)?;
        for (i, side) in self.shape.iter().enumerate() {
            let comma = if i > 0 { ", " } else { "" };
            match side {
                Some(side) => write!(f, "{comma}{side}")?,
                None => write!(f, "{comma}?")?,
            }
        }
        write!(f, "]")
    }
}

/// Row-major tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Dimensions.
    pub shape: Vec<usize>,
    /// Values; their number is the product of the dimensions.
    pub values: Vec<f32>,
}

impl Tensor {
    /// Creates a tensor of zeros.
    pub fn zeros(shape: &[usize]) -> Self {
        Self { shape: shape.to_vec(), values: vec![0.0; shape.iter().product()] }
    }
}

/// Network loaded by an implementation, whose own messages are the reasons of errors.
pub(super) trait Engine: Send {
    /// Inputs.
    fn inputs(&self) -> Vec<TensorInfo>;
    /// Outputs.
    fn outputs(&self) -> Vec<TensorInfo>;
    /// Metadata entry that the exporter stored in the file.
    fn metadata(&self, key: &str) -> Option<String>;
    /// Runs the network; one tensor per input, one per output. The caller checks the number of inputs.
    fn run(&mut self, inputs: &[Tensor]) -> Result<Vec<Tensor>, String>;
}

/// Loaded network.
pub struct Model {
    path: PathBuf,
    engine: Box<dyn Engine>,
    inputs: Vec<TensorInfo>,
    outputs: Vec<TensorInfo>,
}

impl fmt::Debug for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Model")
            .field("path", &self.path)
            .field("inputs", &self.inputs)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}

impl Model {
    /// Loads a network from a file.
    ///
    /// # Errors
    /// [`OnnxError::NoModel`], [`OnnxError::Load`], [`OnnxError::Memory`] for a file, or inputs and outputs, that
    /// exceed the memory limit; or one of the runtime's own errors if its library or the provider is missing.
    pub fn load(path: &Path, resources: impl Into<Resources>) -> Result<Self, OnnxError> {
        let Resources { num_threads, memory, provider } = resources.into();
        let found = std::fs::metadata(path).ok().filter(|found| found.is_file());
        let size = found.ok_or_else(|| OnnxError::NoModel { path: path.to_path_buf() })?.len();
        memory.check(|| format!("{}: the network", path.display()), u128::from(size))?;
        let engine = open(path, num_threads, provider)?;
        let (inputs, outputs) = (engine.inputs(), engine.outputs());
        for tensor in inputs.iter().chain(&outputs) {
            let what = || format!("{}: {tensor}, declared by the network,", path.display());
            memory.check(what, tensor.num_bytes())?;
        }
        Ok(Self { path: path.to_path_buf(), engine, inputs, outputs })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Inputs.
    pub fn inputs(&self) -> &[TensorInfo] {
        &self.inputs
    }

    /// Outputs.
    pub fn outputs(&self) -> &[TensorInfo] {
        &self.outputs
    }

    /// Metadata entry that the exporter stored in the file.
    pub fn metadata(&self, key: &str) -> Option<String> {
        self.engine.metadata(key)
    }

    /// Runs the network on one tensor per input, in the order of [`Self::inputs`].
    ///
    /// Returns one tensor per output, in the order of [`Self::outputs`]; integers become `f32`, exact up to 2^24.
    ///
    /// # Errors
    /// [`OnnxError::Run`], for instance when a shape does not fit.
    pub fn run(&mut self, inputs: &[Tensor]) -> Result<Vec<Tensor>, OnnxError> {
        let failed = |reason: String| OnnxError::Run { path: self.path.clone(), reason };
        if inputs.len() != self.inputs.len() {
            return Err(failed(format!("{} inputs given, the network has {}", inputs.len(), self.inputs.len())));
        }
        self.engine.run(inputs).map_err(failed)
    }
}

fn open(path: &Path, num_threads: usize, provider: Provider) -> Result<Box<dyn Engine>, OnnxError> {
    match provider {
        #[cfg(feature = "networks-rust")]
        Provider::Rust => Ok(Box::new(super::rust::RustEngine::load(path, num_threads)?)),
        #[cfg(feature = "onnxruntime")]
        _ if provider != Provider::Rust => {
            Ok(Box::new(super::session::OnnxRuntime::load(path, num_threads, provider)?))
        }
        _ => Err(provider.not_built()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_is_reported_before_the_runtime_is_searched() {
        let error = Model::load(Path::new("/nowhere/net.onnx"), 1).unwrap_err();
        assert!(matches!(error, OnnxError::NoModel { .. }), "{error}");
        assert!(error.to_string().contains("/nowhere/net.onnx"));
    }

    #[test]
    fn open_sides_are_shown_as_a_question_mark() {
        let info = TensorInfo { name: "x".into(), shape: vec![None, Some(3)], element: "f32".into() };
        assert_eq!(info.to_string(), "x f32 [?, 3]");
        assert_eq!(info.num_bytes(), 12);
        let shape = vec![Some(1), Some(3), Some(usize::MAX), Some(usize::MAX)];
        assert!(TensorInfo { shape, ..info }.num_bytes() > 1 << 100);
    }
}
