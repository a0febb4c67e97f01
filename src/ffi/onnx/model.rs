//! One network.

use std::fmt;
use std::path::{Path, PathBuf};

use ort::session::{Session, SessionInputValue};
use ort::value::{DynValue, Outlet, TensorElementType, TensorRef};

use super::library::runtime;
use super::{OnnxError, Resources};

/// Name and shape of an input or output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorInfo {
    /// The tensor's name in the network.
    pub name: String,
    /// Its sides; `None` where the network leaves a side open. Empty for what is not a tensor.
    pub shape: Vec<Option<usize>>,
    /// Its number type, such as `f32`.
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

/// Row-major numbers with a shape.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Length of each side.
    pub shape: Vec<usize>,
    /// The values; as many as the product of the sides.
    pub values: Vec<f32>,
}

impl Tensor {
    /// All zeros.
    pub fn zeros(shape: &[usize]) -> Self {
        Self { shape: shape.to_vec(), values: vec![0.0; shape.iter().product()] }
    }
}

/// A network, loaded.
pub struct Model {
    path: PathBuf,
    session: Session,
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
    /// [`OnnxError::NoModel`], [`OnnxError::Load`], [`OnnxError::Memory`] for a file, or numbers that go in and come
    /// out, which are more than memory holds; or one of the runtime's own errors when its library is missing.
    pub fn load(path: &Path, resources: impl Into<Resources>) -> Result<Self, OnnxError> {
        let Resources { num_threads, memory } = resources.into();
        let found = std::fs::metadata(path).ok().filter(|found| found.is_file());
        let size = found.ok_or_else(|| OnnxError::NoModel { path: path.to_path_buf() })?.len();
        memory.check(|| format!("{}: the network", path.display()), u128::from(size))?;
        let session = open(path, num_threads)?;
        let inputs: Vec<_> = session.inputs().iter().map(describe).collect();
        let outputs: Vec<_> = session.outputs().iter().map(describe).collect();
        for tensor in inputs.iter().chain(&outputs) {
            let what = || format!("{}: {tensor}, declared by the network,", path.display());
            memory.check(what, tensor.num_bytes())?;
        }
        Ok(Self { path: path.to_path_buf(), session, inputs, outputs })
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

    /// An entry of the metadata that the exporter left in the file.
    pub fn metadata(&self, key: &str) -> Option<String> {
        self.session.metadata().ok()?.custom(key)
    }

    /// Runs the network on one tensor per input, in the order of [`Self::inputs`].
    ///
    /// Returns one tensor per output, in the order of [`Self::outputs`]; integers become `f32`, exact up to 2^24.
    ///
    /// # Errors
    /// [`OnnxError::Run`], for instance when a shape does not fit.
    pub fn run(&mut self, inputs: &[Tensor]) -> Result<Vec<Tensor>, OnnxError> {
        let Self { path, session, inputs: infos, .. } = self;
        let failed = |reason: String| OnnxError::Run { path: path.clone(), reason };
        if inputs.len() != infos.len() {
            return Err(failed(format!("{} inputs given, the network has {}", inputs.len(), infos.len())));
        }
        let mut values: Vec<(String, SessionInputValue<'_>)> = Vec::with_capacity(inputs.len());
        for (info, tensor) in infos.iter().zip(inputs) {
            let view = TensorRef::from_array_view((tensor.shape.clone(), tensor.values.as_slice()))
                .map_err(|e| failed(format!("input {}: {e}", info.name)))?;
            values.push((info.name.clone(), view.into()));
        }
        let outputs = session.run(values).map_err(|e| failed(e.to_string()))?;
        outputs.iter().map(|(name, value)| extract(&value).map_err(|e| failed(format!("output {name}: {e}")))).collect()
    }
}

fn open(path: &Path, num_threads: usize) -> Result<Session, OnnxError> {
    let failed = |reason: String| OnnxError::Load { path: path.to_path_buf(), reason };
    let builder = Session::builder(&runtime()?.environment).map_err(|e| failed(e.to_string()))?;
    let builder = builder.with_intra_threads(num_threads).map_err(|e| failed(e.to_string()))?;
    // Threads that spin between frames would take the processor from the other stages.
    let mut builder = builder.with_intra_op_spinning(false).map_err(|e| failed(e.to_string()))?;
    builder.commit_from_file(path).map_err(|e| failed(e.to_string()))
}

fn describe(outlet: &Outlet) -> TensorInfo {
    let shape = outlet.dtype().tensor_shape();
    let element = outlet.dtype().tensor_type().map_or_else(|| "not a tensor".to_owned(), |t| t.to_string());
    TensorInfo {
        name: outlet.name().to_owned(),
        shape: shape.map_or_else(Vec::new, |s| s.iter().map(|&side| usize::try_from(side).ok()).collect()),
        element,
    }
}

/// Copies a tensor out of the runtime.
fn extract(value: &DynValue) -> Result<Tensor, String> {
    macro_rules! copy {
        ($number:ty) => {{
            let (shape, values) = value.try_extract_tensor::<$number>().map_err(|e| e.to_string())?;
            (shape.iter().map(|&s| s as usize).collect(), values.iter().map(|&v| v as f32).collect())
        }};
    }
    let (shape, values): (Vec<usize>, Vec<f32>) = match value.dtype().tensor_type() {
        Some(TensorElementType::Float32) => copy!(f32),
        Some(TensorElementType::Float64) => copy!(f64),
        Some(TensorElementType::Int64) => copy!(i64),
        Some(TensorElementType::Int32) => copy!(i32),
        Some(TensorElementType::Uint8) => copy!(u8),
        Some(other) => return Err(format!("number type {other} is not supported; export the network in float32")),
        None => return Err("not a tensor".to_owned()),
    };
    Ok(Tensor { shape, values })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_is_named_before_the_runtime_is_looked_for() {
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
