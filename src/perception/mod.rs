//! Segmentation, optical flow and mask tracking.
