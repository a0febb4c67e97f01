//! Optical flow networks with two input images and one flow field, such as RAFT.

use std::path::Path;

use ::image::RgbImage;

use super::parts::nothing;
use super::{Field, FlowEstimator, MAX_DIMENSION, at_frame_size, check_sizes, consistent};
use crate::ffi::onnx::{Model, Resources, Tensor, TensorInfo};
use crate::image::resize_rgb;
use crate::networks::PerceptionError;
use crate::networks::description::{Preprocessing, description_of};
use crate::networks::tensor::{input_size, size_in_steps, tensor_from_image};
use crate::scene::{Flow, Rect};

/// Minimum side of the input, pixels: below it the top of RAFT's four-level correlation pyramid is empty.
const MIN_SIDE: u32 = 128;

/// A loaded flow network.
pub struct OnnxFlow {
    model: Model,
    preprocessing: Preprocessing,
    /// Index of the flow output: the last of matching shape, which is RAFT's final iteration.
    output_idx: usize,
}

fn is_image(tensor: &TensorInfo) -> bool {
    tensor.shape.len() == 4 && tensor.shape[1].is_none_or(|channels| channels == 3)
}

fn is_flow(tensor: &TensorInfo) -> bool {
    tensor.shape.len() == 4 && tensor.shape[1].is_none_or(|channels| channels == 2)
}

impl OnnxFlow {
    /// Loads a network with two inputs [1, 3, h, w] and an output [1, 2, h, w] of displacements in x and y, in pixels
    /// of the input. Pixels become RGB between -1 and 1 (torchvision's RAFT) unless a description next to it overrides
    /// this. `resources` is its resource limit, or a number of threads; 0 is one per core.
    ///
    /// # Errors
    /// [`PerceptionError::UnknownLayout`] if inputs and outputs differ from these.
    pub fn load(path: &Path, resources: impl Into<Resources>) -> Result<Self, PerceptionError> {
        let model = Model::load(path, resources)?;
        let output_idx = model.outputs().iter().rposition(is_flow);
        let (2, true, Some(output_idx)) = (model.inputs().len(), model.inputs().iter().all(is_image), output_idx)
        else {
            return Err(PerceptionError::unknown_layout(
                &model,
                "optical flow",
                "RAFT-like networks: two images [1, 3, h, w] in, displacements [1, 2, h, w] out",
            ));
        };
        let raft = Preprocessing { mean: [127.5; 3], std: [127.5; 3], scale: 1.0, ..Preprocessing::default() };
        let preprocessing = description_of(&model, "flow")?.and_then(|d| d.preprocessing).unwrap_or(raft);
        Ok(Self { model, preprocessing, output_idx })
    }

    fn estimate(&mut self, from: &Tensor, to: &Tensor) -> Result<Field, PerceptionError> {
        let mut outputs = self.model.run(&[from.clone(), to.clone()])?;
        let output = outputs.swap_remove(self.output_idx);
        let (height, width) = (from.shape[2], from.shape[3]);
        if output.shape != [1, 2, height, width] {
            let expected = format!("[1, 2, {height}, {width}], as large as the input");
            return Err(PerceptionError::output(&self.model, Some(output.shape), expected));
        }
        let (dx, dy) = output.values.split_at(height * width);
        Ok(Field { width, height, dx: dx.to_vec(), dy: dy.to_vec() })
    }
}

impl FlowEstimator for OnnxFlow {
    fn flow(&mut self, from: &RgbImage, to: &RgbImage, boxes: &[Rect]) -> Result<Flow, PerceptionError> {
        check_sizes(from, to)?;
        let (width, height) = from.dimensions();
        if boxes.is_empty() || from.is_empty() {
            return Ok(nothing((width, height)));
        }
        // RAFT works at an eighth of the input.
        let open = size_in_steps((width, height), MAX_DIMENSION, 8);
        let (w, h) = input_size(&self.model, (open.0.max(MIN_SIDE), open.1.max(MIN_SIDE)));
        let from = tensor_from_image(&resize_rgb(from, w, h)?, &self.preprocessing);
        let to = tensor_from_image(&resize_rgb(to, w, h)?, &self.preprocessing);
        let forward = self.estimate(&from, &to)?;
        let backward = self.estimate(&to, &from)?;
        let ok = consistent(&forward, &backward);
        Ok(at_frame_size(forward, ok, (width, height)))
    }
}
