//! Limits on the mask of a box, and on its cost.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{Checked, OptionError, ordered, within};

/// Sides of the encoder's input are multiples of this: its cells.
pub(super) const CELL: u32 = 16;

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
    /// A mask reaches beyond its box by at most this much of the box's longer side.
    #[schemars(extend("unit" = "share"))]
    pub margin: f64,
    /// Masks of a lower quality are none: the network expects too little of them, their border is unsure, or they do
    /// not fit their box.
    #[schemars(extend("unit" = "expected overlap, 0 to 1"))]
    pub min_quality: f64,
    /// A mask covers at least this much of its box.
    #[schemars(extend("unit" = "share"))]
    pub min_fill: f64,
    /// A mask covers at most this much of its box, margin included: what fills it altogether is a piece of road or
    /// wall.
    #[schemars(extend("unit" = "share"))]
    pub max_fill: f64,
    /// Of what the network marks round the box, at least this much lies within its margin.
    #[schemars(extend("unit" = "share"))]
    pub min_inside: f64,
}

impl Default for PromptOptions {
    fn default() -> Self {
        Self {
            input_size: 336,
            window: 1.84,
            min_window: 56,
            min_shared: 0.25,
            margin: 0.15,
            min_quality: 0.75,
            min_fill: 0.2,
            max_fill: 1.2,
            min_inside: 0.8,
        }
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
        within("margin", self.margin, 0.0..=1.0)?;
        within("min_quality", self.min_quality, 0.0..=1.0)?;
        within("min_fill", self.min_fill, 0.0..=1.0)?;
        within("max_fill", self.max_fill, 0.1..=10.0)?;
        ordered(("min_fill", self.min_fill), ("max_fill", self.max_fill))?;
        within("min_inside", self.min_inside, 0.0..=1.0)
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
        assert_eq!(bad(PromptOptions { window: f64::NAN, ..usual.clone() }), "window");
        assert_eq!(bad(PromptOptions { min_fill: 0.9, max_fill: 0.5, ..usual }), "min_fill");
    }
}
