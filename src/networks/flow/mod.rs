//! Dense optical flow between two frames, with a forward-backward check.
//!
//! Both estimators compute the flow from the first frame to the second and from the second to the first. A pixel is
//! consistent if forward and backward flow cancel: |f + b|² ≤ α (|f|² + |b|²) + β (Sundaram, Brox and Keutzer, *Dense
//! point trajectories by GPU-accelerated large displacement optical flow*, 2010). Pixels that become occluded, leave
//! the frame or are matched wrongly fail this check.

mod dis;
mod network;
mod parts;

use std::path::Path;

use ::image::RgbImage;

pub use self::dis::DisFlow;
pub use self::network::OnnxFlow;
use self::parts::{Part, PartFlow, nothing};
use super::PerceptionError;
use super::tensor::Between;
use crate::ffi::onnx::Resources;
use crate::scene::{BoundingBox, Flow, Rect};

/// Estimator of the displacement of pixels between two frames.
pub trait FlowEstimator {
    /// Computes the flow from one frame to another of the same size in and near some boxes of the first, at frame size.
    /// Elsewhere it may be skipped: no pixel is consistent there.
    ///
    /// # Errors
    /// [`PerceptionError::SizeMismatch`] if the frames differ in size; errors of the estimator.
    fn flow(&mut self, from: &RgbImage, to: &RgbImage, boxes: &[Rect]) -> Result<Flow, PerceptionError>;
}

/// Maximum longer side of a flow network's input, pixels; larger frames are shrunk. The flow has the frame's size.
const MAX_DIMENSION: u32 = 960;
/// Relative tolerance α of the forward-backward check, as a share of the squared lengths of both flows.
const CONSISTENCY_RELATIVE: f32 = 0.01;
/// Absolute tolerance β of the forward-backward check, squared pixels at the size of the estimate.
const CONSISTENCY_ABSOLUTE_PX2: f32 = 0.5;

/// Loads the flow estimator: a network if one is given, otherwise OpenCV's DIS. `resources` is the resource limit of a
/// network, or a number of threads; 0 is one per core.
///
/// # Errors
/// [`PerceptionError::UnknownLayout`] if the network does not have two input images and an output flow field.
pub fn load_flow(
    network: Option<&Path>,
    resources: impl Into<Resources>,
) -> Result<Box<dyn FlowEstimator>, PerceptionError> {
    match network {
        Some(path) => Ok(Box::new(OnnxFlow::load(path, resources)?)),
        None => Ok(Box::new(DisFlow::new()?)),
    }
}

/// Rejects frames of different sizes.
fn check_sizes(from: &RgbImage, to: &RgbImage) -> Result<(), PerceptionError> {
    if from.dimensions() == to.dimensions() {
        return Ok(());
    }
    let what = "the second frame of a flow".to_owned();
    Err(PerceptionError::SizeMismatch { what, expected: from.dimensions(), found: to.dimensions() })
}

/// A flow field at the size of the estimate: displacements in x and in y, row-major, in its own pixels.
struct Field {
    width: usize,
    height: usize,
    dx: Vec<f32>,
    dy: Vec<f32>,
}

impl Field {
    fn from_pairs(width: usize, height: usize, pairs: impl Iterator<Item = [f32; 2]>) -> Self {
        let (dx, dy) = pairs.map(|[x, y]| (x, y)).unzip();
        Self { width, height, dx, dy }
    }

    /// Displacement at a position in pixels, first centre at (0.5, 0.5).
    fn sample(&self, x: f32, y: f32) -> [f32; 2] {
        let between = Between::new(x, y, self.width, self.height);
        [between.value(&self.dx), between.value(&self.dy)]
    }
}

/// Pixels that pass the forward-backward check.
fn consistent(forward: &Field, backward: &Field) -> Vec<bool> {
    let mut out = Vec::with_capacity(forward.dx.len());
    for y in 0..forward.height {
        for x in 0..forward.width {
            let i = y * forward.width + x;
            let (fx, fy) = (forward.dx[i], forward.dy[i]);
            let (u, v) = (x as f32 + 0.5 + fx, y as f32 + 0.5 + fy);
            let inside = u >= 0.0 && v >= 0.0 && u <= forward.width as f32 && v <= forward.height as f32;
            out.push(
                inside && {
                    let [bx, by] = backward.sample(u, v);
                    let miss = (fx + bx).powi(2) + (fy + by).powi(2);
                    let lengths = fx * fx + fy * fy + bx * bx + by * by;
                    miss <= CONSISTENCY_RELATIVE * lengths + CONSISTENCY_ABSOLUTE_PX2
                },
            );
        }
    }
    out
}

/// Resizes an estimated flow to the frame's size.
fn at_frame_size(forward: Field, consistent: Vec<bool>, size @ (width, height): (u32, u32)) -> Flow {
    let bounds = BoundingBox { x0: 0, y0: 0, x1: width, y1: height };
    let mut flow = nothing(size);
    PartFlow { part: Part { bounds, shift: [0, 0] }, forward, consistent }.put(&mut flow, &bounds);
    flow
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uniform(width: usize, height: usize, d: [f32; 2]) -> Field {
        Field::from_pairs(width, height, std::iter::repeat_n(d, width * height))
    }

    #[test]
    fn pixels_in_both_frames_are_consistent_and_leaving_ones_are_not() {
        let ok = consistent(&uniform(8, 4, [2.0, 0.0]), &uniform(8, 4, [-2.0, 0.0]));
        assert_eq!(ok[..8], [true, true, true, true, true, true, false, false]);
        let bad = consistent(&uniform(8, 4, [2.0, 0.0]), &uniform(8, 4, [0.0, 0.0]));
        assert!(!bad.contains(&true));
    }

    #[test]
    fn a_flow_grows_with_its_frame() {
        let flow = at_frame_size(uniform(4, 3, [1.0, -0.5]), vec![true; 12], (8, 6));
        assert_eq!((flow.at(7, 5), flow.is_consistent(7, 5)), ([2.0, -1.0], true));
        assert_eq!(flow.displacement.len(), 48);
    }
}
