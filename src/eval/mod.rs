//! Comparison with ground truth.
