//! Seeded worlds with known truth, for tests and benches.

mod clip;
pub mod drive;
mod noisy;
pub mod scene;
pub mod showcase;
mod vehicle;

pub use clip::write_clip;
