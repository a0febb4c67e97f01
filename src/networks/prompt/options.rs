//! Limits on the mask of a box, and on its cost.

use std::ops::RangeInclusive;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{Checked, OptionError, within};

/// Sides of the encoder's input are multiples of this: its cells.
pub(super) const CELL: u32 = 16;

/// A mask reaches beyond its box by at most this much of the box's longer side.
pub(super) const MASK_MARGIN: f64 = 0.15;
/// Overlap of two answers that mean the same object.
pub(super) const CONFIRMED_OVERLAP: f64 = 0.8;
/// Share of its box that a mask covers, margin included: what fills it altogether is a piece of road or wall.
pub(super) const FILL: RangeInclusive<f64> = 0.2..=1.2;

/// Options of masks of boxes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PromptOptions {
    /// Longer side of the encoder's input, a multiple of 16. The cost grows with its square. What counts is how
    /// large the box is in it: below 170 pixels (`input_size` through `window`) the masks get worse quickly.
    #[schemars(extend("unit" = "pixels"))]
    pub input_size: u32,
    /// Side of the window that is encoded for a box prompt, as a multiple of the box's longer side. A larger one leaves
    /// less of the input to the object.
    #[schemars(extend("unit" = "longer sides of the box"))]
    pub window: f64,
    /// No part of the frame that is encoded is smaller than this: what is enlarged further does not get clearer.
    #[schemars(extend("unit" = "pixels"))]
    pub min_window: u32,
    /// Boxes may share a part of the frame if their longer side is at least this much of its side. 0.4 is about the
    /// size that a box has in a part of its own; less saves runs of the encoder and costs exactness.
    #[schemars(extend("unit" = "share"))]
    pub min_shared: f64,
    /// Masks of a lower quality are none: the network expects too little of them, their border is unsure, or they do
    /// not fit their box.
    #[schemars(extend("unit" = "expected overlap, 0 to 1"))]
    pub min_quality: f64,
}

impl Default for PromptOptions {
    fn default() -> Self {
        Self { input_size: 336, window: 1.84, min_window: 56, min_shared: 0.25, min_quality: 0.75 }
    }
}

impl PromptOptions {
    /// Refuses values that make no sense.
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
