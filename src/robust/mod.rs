//! One RANSAC loop, its samplers and its scoring.
