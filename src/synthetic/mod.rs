//! Seeded worlds with known truth, for tests and benches.

mod clip;
pub mod drive;
mod noisy;
pub mod scene;
pub mod showcase;
#[cfg(feature = "sfm")]
mod track_table;
mod vehicle;

pub use clip::write_clip;
#[cfg(feature = "sfm")]
pub use track_table::{empty_table, observe};
