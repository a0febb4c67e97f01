//! Trajectories of the vehicles in a video whose masks are given: one 8-bit PNG per frame, k where object k is.
//!
//! ```text
//! cargo run --release --example trajectories -- dataset/demo/video.mp4 dataset/demo/masks out/example
//! ```
//!
//! Without ground masks the ground is found by geometry alone, without intrinsics the focal length by the motion.

use std::error::Error;
use std::path::Path;

use tractrix::io::RunFolder;
use tractrix::pipeline::{self, Instances, Job, Options, Overwrite, Silent, Stage};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [video, masks, output] = arguments.as_slice() else {
        return Err("usage: trajectories VIDEO MASKS OUTPUT".into());
    };
    let (video, output) = (Path::new(video), Path::new(output));

    let options = Options { instances: Instances::Masks(masks.into()), ..Options::default() };
    let goal = Stage::Report;
    let (also_read, overwrite, arguments) = (Vec::new(), Overwrite::default(), arguments.as_slice());
    let job = Job { input: video, output, options: &options, goal, also_read, overwrite, arguments };
    let summary = pipeline::run(&job, &Silent)?;
    if let Some(failure) = summary.failure() {
        return Err(failure.into());
    }

    for object in RunFolder::at(output).read_trajectories()?.objects {
        println!("{} {}: {} poses, scale ratio {:.4}", object.id, object.class, object.poses.len(), object.scale.ratio);
        for pose in object.poses.iter().step_by(10) {
            let [x, y, z] = pose.position;
            println!("  {:6.2} s  {x:9.3} {y:9.3} {z:9.3}", pose.time_s);
        }
    }
    println!("units are those of the background; everything else: {}", output.display());
    Ok(())
}
