//! Structure from motion.

pub mod bundle;
pub mod resection;
pub mod solvers;
pub mod triangulation;
pub mod two_view;
