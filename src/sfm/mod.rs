//! Structure from motion.

pub mod bundle;
pub mod solvers;
