//! Three-dimensional trajectories of the vehicles in one monocular video from a moving camera.
//!
//! The method is that of Bullinger et al., *3D Trajectory Reconstruction of Dynamic Objects Using Planarity
//! Constraints*; equation labels in the documentation (`eq. determine_s3`) are the paper's.
//!
//! Data goes one way: [`video`] → [`networks`], [`tracking`] → [`features`] → [`mapper`] → [`ground`] → [`trajectory`]
//! → outputs. The stage rooms never call one another; [`pipeline`] passes the nouns of [`scene`] along.
//! `docs/architecture.md` is the map, and `tests/layers.rs` holds the code against it.
//!
//! Conventions, everywhere: transforms are named `target_from_source`; camera axes are x right, y down, z forward; the
//! centre of the upper left pixel is (0.5, 0.5); angles are radians.

//!
//! The whole way in one call, for a video whose masks are given; `examples/` holds more, and shorter ways:
//!
//! ```no_run
//! use std::path::Path;
//! use tractrix::pipeline::{self, Instances, Job, Options, Overwrite, Silent, Stage};
//!
//! let options = Options { instances: Instances::Masks("masks".into()), ..Options::default() };
//! let summary = pipeline::run(
//!     &Job {
//!         input: Path::new("video.mp4"),
//!         output: Path::new("out"),
//!         options: &options,
//!         goal: Stage::Report,
//!         also_read: Vec::new(),
//!         overwrite: Overwrite::default(),
//!         arguments: &[],
//!     },
//!     &Silent,
//! )?;
//! println!("{} frames, {} warnings", summary.num_frames, summary.warnings.len());
//! # Ok::<(), pipeline::PipelineError>(())
//! ```
//!
//! `examples/read_results.rs` reads an output folder without any feature.
//!
//! Rooms can be used one by one; which feature brings which, and what it needs, is in `docs/architecture.md`.

/// Gives an enum a list of its values and a name for each: the word in files, on the command line and in messages.
macro_rules! with_names {
    ($kind:ident { $($value:ident = $name:literal),* $(,)? }) => {
        impl $kind {
            /// Every value, in order.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$value),*];

            /// The name in files, on the command line and in messages.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $name,)*
                }
            }
        }
    };
}

pub mod bundle;
pub mod camera;
pub mod checks;
#[cfg(feature = "cli")]
pub mod cli;
#[cfg(feature = "eval")]
pub mod eval;
#[cfg(feature = "export")]
pub mod export;
#[cfg(feature = "sfm")]
pub mod features;
#[cfg(any(feature = "video", feature = "perception"))]
pub mod ffi;
pub mod files;
#[cfg(feature = "sfm")]
pub mod geometry;
pub mod ground;
#[cfg(feature = "opencv")]
pub mod image;
pub mod io;
#[cfg(feature = "pipeline")]
pub mod live;
#[cfg(feature = "sfm")]
pub mod mapper;
pub mod math;
pub mod memory;
pub mod metric;
#[cfg(feature = "perception")]
pub mod motion;
#[cfg(feature = "perception")]
pub mod networks;
#[cfg(feature = "pipeline")]
pub mod pipeline;
#[cfg(feature = "report")]
pub mod report;
pub mod robust;
pub mod scene;
#[cfg(feature = "sfm")]
pub mod sfm;
pub mod synthetic;
#[cfg(feature = "telemetry")]
pub mod telemetry;
#[cfg(feature = "perception")]
pub mod tracking;
pub mod trajectory;
#[cfg(feature = "video")]
pub mod video;

/// Version of this build: that of the package, and, unless it is a tagged release, `+` and a hash of its sources.
pub const VERSION: &str = env!("TRACTRIX_VERSION");
