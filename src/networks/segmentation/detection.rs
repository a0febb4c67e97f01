//! Loading what finds objects as boxes.

use std::path::Path;

use super::DetectorOptions;
use super::yolox::{self, Yolox};
use crate::ffi::onnx::{Model, Resources};
use crate::networks::PerceptionError;

/// Loads a network that finds boxes; its family is recognised from its inputs and outputs. `resources` is what it may
/// take, or a number of threads; 0 is one per core.
///
/// # Errors
/// [`PerceptionError::Option`] for options that make no sense; [`PerceptionError::UnknownLayout`] lists what was found
/// and what is supported; [`PerceptionError::NoClassNames`] and [`PerceptionError::NoWantedClass`] say what is wrong
/// with its classes; errors of the runtime say how to get it.
pub fn load_detector(
    path: &Path,
    options: &DetectorOptions,
    resources: impl Into<Resources>,
) -> Result<Yolox, PerceptionError> {
    options.check()?;
    let model = Model::load(path, resources)?;
    if yolox::recognise(&model) {
        return Yolox::new(model, options);
    }
    Err(PerceptionError::unknown_layout(
        &model,
        "detection",
        "the YOLOX family: one image [1, 3, h, w] in; [1, n, 5 + classes] out, one row per cell of the \
                    strides 8, 16 and 32, not decoded",
    ))
}
