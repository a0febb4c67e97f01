//! Statistics of the evidence for a track.

use super::BoxSource;
use super::box_groups::FrameDetection;
use super::choice::NewMask;
use crate::scene::{DetectionCounts, Outline};

/// Counts and sums over the life of a track.
#[derive(Clone, Debug, Default)]
pub(super) struct TrackStatistics {
    pub(super) found: DetectionCounts,
    pub(super) outline: Outline,
    /// Number of frames until the last reliable mask, and since.
    frames: [usize; 2],
    /// The same of the frames in which the detector ran.
    detector_frames: [usize; 2],
    /// Frames without a box since then, with a new mask and with a propagated one.
    unboxed_since: [usize; 2],
    sum_class_confidence: f64,
    sum_quality: f64,
    sum_area: f64,
    /// Number of new masks.
    pub(super) num_masks: usize,
}

impl TrackStatistics {
    pub(super) fn count_frame(&mut self, by: BoxSource) {
        self.frames[1] += 1;
        self.detector_frames[1] += usize::from(by == BoxSource::Detector);
    }

    /// Counts a detection of the object in one frame.
    pub(super) fn count_detection(&mut self, detection: &FrameDetection) {
        let count = match (detection.detector, detection.motion) {
            (Some(_), Some(_)) => &mut self.found.both,
            (Some(_), None) => &mut self.found.detector,
            (None, _) => &mut self.found.motion,
        };
        *count += 1;
        self.sum_class_confidence += detection.detector.unwrap_or(0.0);
    }

    /// Counts a frame without a box, in which the mask is new or propagated.
    pub(super) fn count_unboxed(&mut self, is_new: bool) {
        self.unboxed_since[usize::from(!is_new)] += 1;
    }

    pub(super) fn add_mask(&mut self, new_mask: &NewMask, outline: Outline) {
        self.sum_quality += new_mask.quality;
        self.sum_area += new_mask.region.area() as f64;
        self.num_masks += 1;
        self.outline = self.outline.max(outline);
    }

    /// Moves the counts since the last reliable mask into the totals.
    pub(super) fn accept(&mut self) {
        for counts in [&mut self.frames, &mut self.detector_frames] {
            *counts = [counts[0] + counts[1], 0];
        }
        let [prompted, propagated] = std::mem::take(&mut self.unboxed_since);
        self.found.prompted += prompted;
        self.found.carried += propagated;
    }

    pub(super) fn num_frames(&self) -> usize {
        self.frames[0]
    }

    pub(super) fn num_detector_frames(&self) -> usize {
        self.detector_frames[0]
    }

    /// Mean confidence of the detector's boxes; 0 without any.
    pub(super) fn class_confidence(&self) -> f64 {
        self.sum_class_confidence / self.found.by_detector().max(1) as f64
    }

    /// Mean quality of the new masks.
    pub(super) fn mask_quality(&self) -> Option<f64> {
        (self.num_masks > 0).then(|| self.sum_quality / self.num_masks as f64)
    }

    /// Mean number of pixels of the new masks; 0 without any.
    pub(super) fn mean_area(&self) -> f64 {
        self.sum_area / self.num_masks.max(1) as f64
    }
}
