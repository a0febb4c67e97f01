//! Options and limits of masks from box prompts.

use std::ops::RangeInclusive;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{Checked, OptionError, within};

/// Side of a cell of the encoder, of which the sides of its input are multiples, pixels.
pub(super) const CELL: u32 = 16;

/// Maximum extent of a mask beyond its box, as a share of the box's longer side.
pub(super) const MASK_MARGIN: f64 = 0.15;
/// Minimum IoU of two masks of the same object.
pub(super) const CONFIRMED_OVERLAP: f64 = 0.8;
/// Range of the area of a mask, margin included, relative to its box: a mask that fills it is a piece of road or wall.
pub(super) const FILL: RangeInclusive<f64> = 0.2..=1.2;

/// Options of masks of boxes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PromptOptions {
    /// Longer side of the encoder's input, a multiple of 16. The cost increases with its square. The quality depends on
    /// the size of the box in it (`input_size` over `window`): below 170 pixels the masks degrade quickly.
    #[schemars(extend("unit" = "pixels"))]
    pub input_size: u32,
    /// Side of the window that is encoded for a box prompt, as a multiple of the box's longer side. In a larger window
    /// the object has fewer pixels of the input.
    #[schemars(extend("unit" = "longer sides of the box"))]
    pub window: f64,
    /// Minimum side of the window that is encoded: further enlargement adds no detail.
    #[schemars(extend("unit" = "pixels"))]
    pub min_window: u32,
    /// Minimum longer side of a box that shares the window of another box, relative to the window's side. A box in a
    /// window of its own has about 0.4; lower values save runs of the encoder and reduce accuracy.
    #[schemars(extend("unit" = "share"))]
    pub min_shared: f64,
    /// Minimum quality of a mask. Masks below it have a low expected overlap, an unstable border, or do not fit their
    /// box.
    #[schemars(extend("unit" = "expected overlap, 0 to 1"))]
    pub min_quality: f64,
}

impl Default for PromptOptions {
    fn default() -> Self {
        Self { input_size: 336, window: 1.84, min_window: 56, min_shared: 0.25, min_quality: 0.75 }
    }
}

impl PromptOptions {
    /// Rejects values out of range.
    ///
    /// # Errors
    /// [`OptionError`] names the option.
    pub fn check(&self) -> Checked {
        within("input_size", self.input_size, 64..=2048)?;
        if !self.input_size.is_multiple_of(CELL) {
            return Err(OptionError::new("input_size", format!("{}: expected a multiple of {CELL}", self.input_size)));
        }
        within("window", self.window, 1.0..=100.0)?;
        within("min_window", self.min_window, 16..=8192)?;
        within("min_shared", self.min_shared, 0.01..=1.0)?;
        within("min_quality", self.min_quality, 0.0..=1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_out_of_range_are_refused_by_name() {
        let usual = PromptOptions::default();
        assert_eq!(usual.check(), Ok(()));
        let bad = |options: PromptOptions| options.check().unwrap_err().key;
        assert_eq!(bad(PromptOptions { input_size: 450, ..usual.clone() }), "input_size");
        assert_eq!(bad(PromptOptions { window: f64::NAN, ..usual }), "window");
    }
}
