//! Seeded worlds with known truth, for tests and benches.

pub mod drive;
mod noisy;
mod vehicle;
