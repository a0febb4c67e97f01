//! Geometry of few views: relative pose, resection and triangulation, with their minimal solvers.

pub mod resection;
pub mod solvers;
pub mod triangulation;
pub mod two_view;
