//! Structure from motion: cameras and points from a folder of photographs, or from a video, as a COLMAP model.
//!
//! ```text
//! cargo run --release --example structure_from_motion -- PHOTOS OUTPUT
//! ```

use std::error::Error;

use tractrix::camera::Camera;
use tractrix::io::interchange::colmap;
use tractrix::mapper::Intrinsics;
use tractrix::sfm;
use tractrix::video::{self, Source};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [photos, output] = arguments.as_slice() else {
        return Err("usage: structure_from_motion PHOTOS OUTPUT".into());
    };

    let source = Source::open(photos.as_ref(), &video::Options::default())?;
    // Nothing is known of the camera: a guess from the size, refined with everything else.
    let camera = Camera::prior_of_photograph(source.info().width, source.info().height);
    let options = sfm::Options::unordered(); // For a video: sfm::Options::background().
    // No mask: the whole picture is used. A frame that cannot be decoded is no reason to stop.
    let pictures = source.frames()?.filter_map(Result::ok).map(|(frame, picture)| (frame, picture, None));
    let (model, report) = sfm::reconstruct_pictures(pictures, camera, Intrinsics::GUESSED, &options, 0)?;

    colmap::write_text(output.as_ref(), &model)?;
    println!("{} of {} pictures, {} points", report.num_registered(), report.views.len(), report.num_points);
    report.remarks.iter().for_each(|remark| println!("{remark}"));
    Ok(())
}
