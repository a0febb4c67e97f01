//! Properties of a network that its inputs and outputs do not define: its preprocessing and its classes.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::PerceptionError;
use crate::ffi::onnx::{Model, TensorInfo};
use crate::files;

/// The order of an input's three channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ChannelOrder {
    /// Red, green, blue.
    #[default]
    Rgb,
    /// Blue, green, red.
    Bgr,
}

/// Conversion of 8-bit pixels v to a network's input: `(v - mean) / std * scale`, channel by channel in the given
/// order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Preprocessing {
    /// Order of the channels, also of `mean` and `std`.
    pub order: ChannelOrder,
    /// Subtracted first.
    pub mean: [f32; 3],
    /// Divided by next.
    pub std: [f32; 3],
    /// Multiplied last.
    pub scale: f32,
}

impl Default for Preprocessing {
    /// RGB between 0 and 1.
    fn default() -> Self {
        Self { order: ChannelOrder::Rgb, mean: [0.0; 3], std: [1.0; 3], scale: 1.0 / 255.0 }
    }
}

/// One input or output in a description; sides that may differ are 0.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TensorPattern {
    /// The tensor's name.
    pub name: String,
    /// Its sides; 0 represents any.
    pub shape: Vec<usize>,
}

impl TensorPattern {
    fn fits(&self, tensor: &TensorInfo) -> bool {
        let side_fits = |(&wanted, found): (&usize, &Option<usize>)| wanted == 0 || found.is_none_or(|f| f == wanted);
        self.name == tensor.name
            && self.shape.len() == tensor.shape.len()
            && self.shape.iter().zip(&tensor.shape).all(side_fits)
    }
}

/// Description of a network in `models/models.toml`. A file next to a network may have any of the fields; its values
/// take precedence over the network's own metadata.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelDescription {
    /// Display name.
    pub name: String,
    /// Task: `instances`, `boxes`, `box-masks`, `ground` or `flow`.
    pub task: String,
    /// Its file in the folder `models`, if it comes with the program.
    pub file: String,
    /// Its origin.
    pub origin: String,
    /// Its licence.
    pub licence: String,
    /// SHA-256 of the described file; of the program's own file if it comes with it.
    pub sha256: String,
    /// Changes between the original and the file that comes with the program.
    pub changes: String,
    /// Note for users.
    pub note: String,
    /// Its inputs, for recognition.
    pub inputs: Vec<TensorPattern>,
    /// The outputs that are used, for recognition; a network may have others.
    pub outputs: Vec<TensorPattern>,
    /// Conversion of pixels to its input.
    pub preprocessing: Option<Preprocessing>,
    /// Class names by class number.
    pub classes: Vec<String>,
}

impl ModelDescription {
    /// Returns true if a network has the inputs and outputs described here.
    fn fits(&self, model: &Model) -> bool {
        let all = |patterns: &[TensorPattern], tensors: &[TensorInfo]| {
            patterns.iter().all(|p| tensors.iter().any(|t| p.fits(t)))
        };
        !self.inputs.is_empty()
            && self.inputs.len() == model.inputs().len()
            && all(&self.inputs, model.inputs())
            && all(&self.outputs, model.outputs())
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    model: Vec<ModelDescription>,
}

/// The descriptions compiled in.
pub(super) fn known() -> Result<Vec<ModelDescription>, PerceptionError> {
    let table: Table = toml::from_str(include_str!("../../models/models.toml")).map_err(|e| {
        PerceptionError::Description { path: PathBuf::from("models/models.toml"), reason: e.to_string() }
    })?;
    Ok(table.model)
}

/// The description next to a network, else the one compiled in whose task, inputs and outputs are those of the network.
pub(super) fn description_of(model: &Model, task: &str) -> Result<Option<ModelDescription>, PerceptionError> {
    match read_sidecar(model.path())? {
        Some(description) => Ok(Some(description)),
        None => Ok(known()?.into_iter().find(|d| d.task == task && d.fits(model))),
    }
}

/// File path of the description next to a network.
pub(super) fn sidecar_path(model: &Path) -> PathBuf {
    model.with_extension("toml")
}

/// The description next to a network, if there is one.
///
/// # Errors
/// [`PerceptionError::Description`] if it cannot be read or is invalid.
pub(super) fn read_sidecar(model: &Path) -> Result<Option<ModelDescription>, PerceptionError> {
    let path = sidecar_path(model);
    if !path.is_file() {
        return Ok(None);
    }
    let failed = |reason: String| PerceptionError::Description { path: path.clone(), reason };
    let text = files::read_text(&path).map_err(|e| failed(e.to_string()))?;
    toml::from_slice(&text).map(Some).map_err(|e| failed(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_table_is_valid_and_complete() {
        let all = known().unwrap();
        assert!(!all.is_empty());
        for model in all {
            assert!(
                ["instances", "boxes", "box-masks", "ground", "flow"].contains(&model.task.as_str()),
                "{}",
                model.name
            );
            assert!(!model.licence.is_empty() && !model.origin.is_empty(), "{}", model.name);
            assert!(model.sha256.is_empty() || model.sha256.len() == 64, "{}", model.name);
            assert!(model.task != "ground" || (model.preprocessing.is_some() && !model.classes.is_empty()));
        }
    }

    #[test]
    fn open_sides_fit_any_length() {
        let pattern = TensorPattern { name: "x".into(), shape: vec![1, 3, 0, 0] };
        let tensor =
            |name: &str, shape: Vec<Option<usize>>| TensorInfo { name: name.into(), shape, element: "f32".into() };
        assert!(pattern.fits(&tensor("x", vec![None, Some(3), Some(9), None])));
        assert!(!pattern.fits(&tensor("x", vec![None, Some(4), Some(9), None])));
        assert!(!pattern.fits(&tensor("y", vec![None, Some(3), Some(9), None])));
        assert!(!pattern.fits(&tensor("x", vec![None, Some(3), Some(9)])));
    }

    #[test]
    fn a_wrong_sidecar_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("net.onnx");
        assert_eq!(read_sidecar(&model).unwrap(), None);
        std::fs::write(folder.path().join("net.toml"), "classes = ['car']").unwrap();
        assert_eq!(read_sidecar(&model).unwrap().unwrap().classes, ["car"]);
        std::fs::write(folder.path().join("net.toml"), "clases = ['car']").unwrap();
        let error = read_sidecar(&model).unwrap_err().to_string();
        assert!(error.contains("net.toml") && error.contains("clases"), "{error}");
    }
}
