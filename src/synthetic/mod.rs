//! Seeded worlds with known truth, for tests and benches.
