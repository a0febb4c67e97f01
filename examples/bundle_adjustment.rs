//! The bundle adjuster alone: a COLMAP model, text or binary, adjusted and written as text. Needs no feature of the
//! library.
//!
//! ```text
//! cargo run --release --no-default-features --example bundle_adjustment -- tests/golden/models/colmap_text OUTPUT
//! ```

use std::error::Error;

use tractrix::bundle::{CameraBlock, Options, Problem, adjust};
use tractrix::io::interchange::colmap;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, output] = arguments.as_slice() else { return Err("usage: bundle_adjustment MODEL OUTPUT".into()) };

    let mut model = colmap::read(input.as_ref())?;
    // What varies besides poses and points: nothing of the camera. See also CameraBlock::free_focal_and_radial.
    let mut problem = Problem::from_reconstruction(&model, |_, camera| CameraBlock::fixed(*camera));
    let summary = adjust(&mut problem, &Options::default())?;
    problem.store(&mut model);

    colmap::write_text(output.as_ref(), &model)?;
    let (before, after) = (summary.initial_cost, summary.final_cost);
    println!("cost {before:.6} before, {after:.6} after {} iterations: {:?}", summary.iterations, summary.termination);
    Ok(())
}
