//! Networks in `rten`, written in Rust: for builds and machines without ONNX Runtime.

use std::path::Path;
use std::sync::Arc;

use rten::{Dimension, NodeId, RunOptions, ThreadPool, Value, ValueOrView, ValueType, ValueView};
use rten_tensor::Layout as _;

use super::model::Engine;
use super::{OnnxError, Tensor, TensorInfo};

pub(super) struct RustEngine {
    model: rten::Model,
    options: RunOptions,
}

impl RustEngine {
    /// * `num_threads` – 0 for one per core.
    pub(super) fn load(path: &Path, num_threads: usize) -> Result<Self, OnnxError> {
        let failed = |reason: String| OnnxError::Load { path: path.to_path_buf(), reason };
        let model = rten::Model::load_file(path).map_err(|e| failed(e.to_string()))?;
        let mut options = RunOptions::default();
        options.thread_pool = Some(Arc::new(ThreadPool::with_num_threads(num_threads)));
        Ok(Self { model, options })
    }

    fn describe(&self, id: NodeId) -> TensorInfo {
        let node = self.model.node_info(id);
        let side = |side: &Dimension| match side {
            Dimension::Fixed(side) => Some(*side),
            Dimension::Symbolic(_) => None,
        };
        let element = match node.as_ref().and_then(rten::NodeInfo::dtype) {
            Some(ValueType::Tensor(element)) => element.to_string(),
            _ => "of open type".to_owned(),
        };
        TensorInfo {
            name: node.as_ref().and_then(rten::NodeInfo::name).unwrap_or_default().to_owned(),
            shape: node.and_then(|node| node.shape()).unwrap_or_default().iter().map(side).collect(),
            element,
        }
    }
}

impl Engine for RustEngine {
    fn inputs(&self) -> Vec<TensorInfo> {
        self.model.input_ids().iter().map(|id| self.describe(*id)).collect()
    }

    fn outputs(&self) -> Vec<TensorInfo> {
        self.model.output_ids().iter().map(|id| self.describe(*id)).collect()
    }

    fn metadata(&self, key: &str) -> Option<String> {
        self.model.metadata().get(key).map(str::to_owned)
    }

    fn run(&mut self, inputs: &[Tensor]) -> Result<Vec<Tensor>, String> {
        let mut values = Vec::with_capacity(inputs.len());
        for (id, tensor) in self.model.input_ids().iter().zip(inputs) {
            let view = ValueView::from_shape(&tensor.shape, &tensor.values).map_err(|e| e.to_string())?;
            values.push((*id, ValueOrView::from(view)));
        }
        let outputs = self.model.run(values, self.model.output_ids(), Some(self.options.clone()));
        outputs.map_err(|e| e.to_string())?.into_iter().map(extract).collect()
    }
}

/// Converts a value to a tensor; `rten` has no 64-bit numbers.
fn extract(value: Value) -> Result<Tensor, String> {
    let shape = value.shape().to_vec();
    let values = match value {
        Value::FloatTensor(tensor) => tensor.into_data(),
        Value::Int32Tensor(tensor) => tensor.into_data().into_iter().map(|v| v as f32).collect(),
        Value::Int8Tensor(tensor) => tensor.into_data().into_iter().map(f32::from).collect(),
        Value::UInt8Tensor(tensor) => tensor.into_data().into_iter().map(f32::from).collect(),
        _ => return Err("an output is not a tensor".to_owned()),
    };
    Ok(Tensor { shape, values })
}

#[cfg(all(test, feature = "onnxruntime"))]
mod tests {
    use super::*;
    use crate::ffi::onnx::{Model, Provider, Resources, probe};

    /// Largest difference between outputs of two implementations, as a share of the largest value.
    ///
    /// Sums in another order differ by 1e-5; where a value is at the border between two 8-bit levels, a layer differs
    /// by 1 %.
    const TOLERANCE: f32 = 0.05;

    fn waves(shape: &[usize]) -> Tensor {
        let mut tensor = Tensor::zeros(shape);
        for (k, value) in tensor.values.iter_mut().enumerate() {
            *value = 60.0 * (0.11 * k as f32).sin() + 30.0 * (0.0013 * k as f32).cos();
        }
        tensor
    }

    #[test]
    fn both_implementations_agree_on_the_networks_that_come_with_the_program() {
        if let Err(error) = probe(Provider::Cpu) {
            println!("skipped: {error}");
            return;
        }
        let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
        let files = ["yolox_nano.onnx", "mobile_sam_encoder.onnx", "mobile_sam_decoder.onnx", "box_masks.onnx"];
        let inputs: [&[Tensor]; 4] = [
            &[waves(&[1, 3, 96, 128])],
            &[waves(&[1, 3, 96, 128])],
            &[
                waves(&[1, 256, 6, 8]),
                Tensor { shape: vec![1, 2, 2], values: vec![20.0, 10.0, 90.0, 70.0] },
                Tensor { shape: vec![1, 2], values: vec![2.0, 3.0] },
            ],
            &[waves(&[1, 4, 128, 128])],
        ];
        for (file, inputs) in files.map(|name| models.join(name)).iter().zip(inputs) {
            let load = |provider| Model::load(file, Resources { provider, ..Resources::from(1) }).unwrap();
            let [mut theirs, mut ours] = [Provider::Cpu, Provider::Rust].map(load);
            let names = |model: &Model| model.outputs().iter().map(|output| output.name.clone()).collect::<Vec<_>>();
            assert_eq!(names(&theirs), names(&ours), "{}", file.display());
            for (a, b) in theirs.run(inputs).unwrap().iter().zip(&ours.run(inputs).unwrap()) {
                assert_eq!(a.shape, b.shape, "{}", file.display());
                let largest = a.values.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
                let mean =
                    a.values.iter().zip(&b.values).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.values.len() as f32;
                assert!(mean <= TOLERANCE * largest, "{}: {mean} of {largest}", file.display());
            }
        }
    }
}
