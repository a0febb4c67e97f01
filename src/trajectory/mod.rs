//! The scale ratio and the trajectories that follow from it.
