//! Seeded worlds with known truth, for tests and benches.

pub mod drive;
mod noisy;
pub mod scene;
pub mod showcase;
mod vehicle;
