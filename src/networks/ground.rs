//! Ground segmentation of a frame by a semantic network.
//!
//! A network gives one score per class and cell; the ground is where the best ground class exceeds the best other one,
//! after linear interpolation of their difference at the frame's pixels. Networks trained from a car's point of view
//! are right on dashcams and low drones and wrong from high altitude: there the geometric fallback of the ground stage
//! is better.

use std::path::Path;

use ::image::RgbImage;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::description::{ModelDescription, Preprocessing, description_of};
use super::tensor::{Plane, input_size, size_in_steps, tensor_from_image};
use super::{INPUT_SIZES, PerceptionError};
use crate::checks::{Checked, some_of, within};
use crate::ffi::onnx::{Model, Resources, Tensor};
use crate::image::resize_rgb;
use crate::scene::Mask;

/// Options of ground segmentation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GroundOptions {
    /// Classes that count as ground.
    pub classes: Vec<String>,
    /// Longer side of the network's input, for networks with a free input size.
    #[schemars(extend("unit" = "pixels"))]
    pub input_size: u32,
}

impl Default for GroundOptions {
    fn default() -> Self {
        let classes =
            ["road", "sidewalk", "parking", "terrain", "ground", "street", "drivable", "lane", "grass", "pavement"];
        Self { classes: classes.map(str::to_owned).to_vec(), input_size: 1024 }
    }
}

impl GroundOptions {
    /// Rejects invalid values.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        some_of("classes", &self.classes)?;
        within("input_size", self.input_size, INPUT_SIZES)
    }
}

/// Loads a semantic network; its preprocessing comes from the description next to it, else from the descriptions
/// shipped with the program. `resources` is its resource limit, or a number of threads; 0 is one per core.
///
/// # Errors
/// [`PerceptionError::Option`] for invalid options; [`PerceptionError::UnknownLayout`] for a network without
/// description; [`PerceptionError::NoWantedClass`] if it has no ground class.
pub fn load_ground_segmenter(
    path: &Path,
    options: &GroundOptions,
    resources: impl Into<Resources>,
) -> Result<GroundSegmenter, PerceptionError> {
    options.check()?;
    let model = Model::load(path, resources)?;
    let description = description_of(&model, "ground")?;
    let image_in = model.inputs().len() == 1 && model.inputs()[0].shape.len() == 4;
    match description {
        Some(description) if image_in => GroundSegmenter::new(model, description, options),
        _ => Err(PerceptionError::unknown_layout(
            &model,
            "ground segmentation",
            "semantic networks with one image [1, 3, h, w] in and [1, classes, h, w] or class numbers [1, \
                 h, w] out: ESPNet (Cityscapes), TwinLiteNet, SegFormer (Cityscapes), or any other with a description \
                 (preprocessing, classes) in a .toml file of the same name next to it; see docs/perception.md",
        )),
    }
}

/// A semantic network for ground segmentation, with its preprocessing.
pub struct GroundSegmenter {
    model: Model,
    preprocessing: Preprocessing,
    /// Index of the output with the classes.
    output_idx: usize,
    /// Flags of the ground classes.
    is_ground: Vec<bool>,
    input_size: u32,
}

impl GroundSegmenter {
    fn new(model: Model, description: ModelDescription, options: &GroundOptions) -> Result<Self, PerceptionError> {
        let wanted = description.outputs.first().map(|pattern| pattern.name.as_str());
        let position = |name: &str| model.outputs().iter().position(|output| output.name == name);
        let output_idx = wanted.and_then(position).unwrap_or(0);
        let is_ground: Vec<bool> = description.classes.iter().map(|name| options.classes.contains(name)).collect();
        if !is_ground.contains(&true) {
            return Err(PerceptionError::NoWantedClass {
                path: model.path().to_path_buf(),
                wanted: options.classes.clone(),
                found: description.classes,
            });
        }
        let preprocessing = description.preprocessing.unwrap_or_default();
        Ok(Self { model, preprocessing, output_idx, is_ground, input_size: options.input_size })
    }

    /// Mask of the pixels of `image` that show ground, at its size.
    ///
    /// # Errors
    /// The network cannot be run or its output has a shape that its description does not allow.
    pub fn ground_mask(&mut self, image: &RgbImage) -> Result<Mask, PerceptionError> {
        let frame = image.dimensions();
        if image.is_empty() {
            return Ok(Mask::empty(frame.0, frame.1));
        }
        // 32 is the coarsest stride of common encoders.
        let (width, height) = input_size(&self.model, size_in_steps(frame, self.input_size, 32));
        let input = tensor_from_image(&resize_rgb(image, width, height)?, &self.preprocessing);
        let mut outputs = self.model.run(&[input])?;
        let output = outputs.swap_remove(self.output_idx);
        let margin = ground_margin(&output, &self.is_ground).ok_or_else(|| {
            let expected = format!("[1, {} classes, h, w] or class numbers [1, h, w]", self.is_ground.len());
            PerceptionError::output(&self.model, Some(output.shape.clone()), expected)
        })?;
        Ok(margin.mask(frame))
    }
}

/// Margin of the best ground class over the best other one, cell by cell.
struct Margin {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Margin {
    fn mask(&self, frame: (u32, u32)) -> Mask {
        let plane = Plane { width: self.width, height: self.height, values: &self.values };
        let (per_x, per_y) = (self.width as f32 / frame.0 as f32, self.height as f32 / frame.1 as f32);
        Mask::from_fn(frame.0, frame.1, |x, y| plane.sample((x as f32 + 0.5) * per_x, (y as f32 + 0.5) * per_y) > 0.0)
    }
}

/// The margin of the ground, from scores [1, C, h, w] or class numbers [1, h, w] or [1, 1, h, w]; `None` for any other
/// shape.
fn ground_margin(output: &Tensor, is_ground: &[bool]) -> Option<Margin> {
    let (channels, height, width) = match output.shape[..] {
        [1, channels, height, width] => (channels, height, width),
        [1, height, width] => (1, height, width),
        _ => return None,
    };
    let plane = height * width;
    if plane == 0 || (channels != 1 && channels != is_ground.len()) {
        return None;
    }
    if channels == 1 {
        let ground = |&label: &f32| is_ground.get(label as usize).copied().unwrap_or(false);
        let values = output.values.iter().map(|label| if ground(label) { 1.0 } else { -1.0 }).collect();
        return Some(Margin { width, height, values });
    }
    let mut best = [vec![f32::NEG_INFINITY; plane], vec![f32::NEG_INFINITY; plane]];
    for (scores, &ground) in output.values.chunks_exact(plane).zip(is_ground) {
        for (best, &score) in best[usize::from(ground)].iter_mut().zip(scores) {
            *best = best.max(score);
        }
    }
    let [other, ground] = best;
    // Bounded, so that a network without any other class still gives finite margins to interpolate.
    let values = ground.iter().zip(&other).map(|(g, o)| (g - o).clamp(-1e6, 1e6)).collect();
    Some(Margin { width, height, values })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_better_class_wins_and_the_border_lies_between_the_cells() {
        let scores = Tensor { shape: vec![1, 3, 1, 2], values: vec![0.0, 3.0, 1.0, 0.0, 2.0, 1.0] };
        // Ground is class 1 or 2: margins +2 and -2, so the border is in the middle.
        let margin = ground_margin(&scores, &[false, true, true]).unwrap();
        assert_eq!(margin.values, [2.0, -2.0]);
        let mask = margin.mask((8, 2));
        assert_eq!(mask, crate::scene::Mask::from_fn(8, 2, |x, _| x < 4));
    }

    #[test]
    fn class_numbers_serve_as_well_and_other_shapes_do_not() {
        let numbers = Tensor { shape: vec![1, 1, 2], values: vec![1.0, 0.0] };
        assert_eq!(ground_margin(&numbers, &[false, true]).unwrap().values, [1.0, -1.0]);
        assert!(ground_margin(&Tensor::zeros(&[1, 5, 2, 2]), &[true, false]).is_none());
        assert!(ground_margin(&Tensor::zeros(&[2, 2]), &[true, false]).is_none());
        assert!(ground_margin(&Tensor::zeros(&[1, 2, 0, 2]), &[true, false]).is_none());
    }
}
