//! A network in ONNX Runtime.

use std::path::Path;

use ort::session::{Session, SessionInputValue};
use ort::value::{DynValue, Outlet, TensorElementType, TensorRef};

use super::library::{execution_provider, runtime};
use super::model::Engine;
use super::{OnnxError, Provider, Tensor, TensorInfo};

pub(super) struct OnnxRuntime {
    session: Session,
    /// Names of the inputs.
    names: Vec<String>,
}

impl OnnxRuntime {
    pub(super) fn load(path: &Path, num_threads: usize, provider: Provider) -> Result<Self, OnnxError> {
        let failed = |reason: String| OnnxError::Load { path: path.to_path_buf(), reason };
        let builder = Session::builder(&runtime()?.environment).map_err(|e| failed(e.to_string()))?;
        let builder = builder.with_intra_threads(num_threads).map_err(|e| failed(e.to_string()))?;
        // Threads that spin between frames would take processor time from the other stages.
        let builder = builder.with_intra_op_spinning(false).map_err(|e| failed(e.to_string()))?;
        let refused = |e: String| OnnxError::Provider { provider, reason: format!("{e}; give --provider cpu") };
        let provider = execution_provider(provider)?;
        let mut builder = builder.with_execution_providers(provider.as_slice()).map_err(|e| refused(e.to_string()))?;
        let session = builder.commit_from_file(path).map_err(|e| failed(e.to_string()))?;
        let names = session.inputs().iter().map(|outlet| outlet.name().to_owned()).collect();
        Ok(Self { session, names })
    }
}

impl Engine for OnnxRuntime {
    fn inputs(&self) -> Vec<TensorInfo> {
        self.session.inputs().iter().map(describe).collect()
    }

    fn outputs(&self) -> Vec<TensorInfo> {
        self.session.outputs().iter().map(describe).collect()
    }

    fn metadata(&self, key: &str) -> Option<String> {
        self.session.metadata().ok()?.custom(key)
    }

    fn run(&mut self, inputs: &[Tensor]) -> Result<Vec<Tensor>, String> {
        let mut values: Vec<(&str, SessionInputValue<'_>)> = Vec::with_capacity(inputs.len());
        for (name, tensor) in self.names.iter().zip(inputs) {
            let view = TensorRef::from_array_view((tensor.shape.clone(), tensor.values.as_slice()))
                .map_err(|e| format!("input {name}: {e}"))?;
            values.push((name, view.into()));
        }
        let outputs = self.session.run(values).map_err(|e| e.to_string())?;
        outputs.iter().map(|(name, value)| extract(&value).map_err(|e| format!("output {name}: {e}"))).collect()
    }
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
