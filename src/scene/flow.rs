//! Dense optical flow.

/// Displacement of each pixel from a source frame to a target frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Flow {
    /// Width of the frame, pixels.
    pub width: u32,
    /// Height of the frame, pixels.
    pub height: u32,
    /// Row-major displacement (dx, dy), pixels: pixel (x, y) of the source is at (x + dx, y + dy) in the target.
    pub displacement: Vec<[f32; 2]>,
    /// Row-major; true if the backward flow returns to the source pixel (forward-backward check).
    pub consistent: Vec<bool>,
}

impl Flow {
    /// Displacement at an integer pixel.
    pub fn at(&self, x: u32, y: u32) -> [f32; 2] {
        self.displacement[(y * self.width + x) as usize]
    }

    /// Returns true if the displacement at an integer pixel passed the forward-backward check.
    pub fn is_consistent(&self, x: u32, y: u32) -> bool {
        self.consistent[(y * self.width + x) as usize]
    }
}
