//! Counts of the evidence for a track.

use super::BoxSource;
use super::box_groups::Finding;
use super::choice::Fresh;
use crate::scene::{DetectionCounts, Outline};

/// Counts and sums over the life of a track.
#[derive(Clone, Debug, Default)]
pub(super) struct Ledger {
    pub(super) found: DetectionCounts,
    pub(super) outline: Outline,
    /// Looks until the last mask that can be trusted, and those since.
    looks: [usize; 2],
    /// The same of the detector's looks.
    detector_looks: [usize; 2],
    /// Frames without a box since then, with a new mask and with a carried one.
    unboxed_since: [usize; 2],
    sum_class_confidence: f64,
    sum_quality: f64,
    sum_area: f64,
    /// Masks that were asked for.
    pub(super) num_masks: usize,
}

impl Ledger {
    pub(super) fn look(&mut self, by: BoxSource) {
        self.looks[1] += 1;
        self.detector_looks[1] += usize::from(by == BoxSource::Detector);
    }

    /// Counts what found the object in one frame.
    pub(super) fn note(&mut self, finding: &Finding) {
        let count = match (finding.detector, finding.motion) {
            (Some(_), Some(_)) => &mut self.found.both,
            (Some(_), None) => &mut self.found.detector,
            (None, _) => &mut self.found.motion,
        };
        *count += 1;
        self.sum_class_confidence += finding.detector.unwrap_or(0.0);
    }

    /// Counts a frame without a box, in which the mask is new or carried.
    pub(super) fn count_unboxed(&mut self, is_new: bool) {
        self.unboxed_since[usize::from(!is_new)] += 1;
    }

    pub(super) fn add_mask(&mut self, fresh: &Fresh, outline: Outline) {
        self.sum_quality += fresh.quality;
        self.sum_area += fresh.region.area() as f64;
        self.num_masks += 1;
        self.outline = self.outline.max(outline);
    }

    /// Moves the counts since the last reliable mask into the object's own.
    pub(super) fn trust(&mut self) {
        for looks in [&mut self.looks, &mut self.detector_looks] {
            *looks = [looks[0] + looks[1], 0];
        }
        let [prompted, carried] = std::mem::take(&mut self.unboxed_since);
        self.found.prompted += prompted;
        self.found.carried += carried;
    }

    pub(super) fn num_looks(&self) -> usize {
        self.looks[0]
    }

    pub(super) fn num_detector_looks(&self) -> usize {
        self.detector_looks[0]
    }

    /// Mean confidence of the detector's boxes; 0 without any.
    pub(super) fn class_confidence(&self) -> f64 {
        self.sum_class_confidence / self.found.by_detector().max(1) as f64
    }

    /// Mean quality of the masks that were asked for.
    pub(super) fn mask_quality(&self) -> Option<f64> {
        (self.num_masks > 0).then(|| self.sum_quality / self.num_masks as f64)
    }

    /// Mean number of pixels of the masks that were asked for; 0 without any.
    pub(super) fn mean_area(&self) -> f64 {
        self.sum_area / self.num_masks.max(1) as f64
    }
}
