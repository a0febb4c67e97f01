//! Grouping of the boxes of one frame that show one object.

use super::{DetectedBox, TrackerOptions};
use crate::scene::{BoxDetection, DetectionSource, Rect};

/// Overlap (intersection over union) above which two detector boxes show one object.
const SAME_OBJECT: f64 = 0.55;
/// Overlap above which a motion box and a detector box show one object: motion detection finds the textured part of a
/// vehicle, or the vehicle with its shadow.
const SAME_MOVER: f64 = 0.35;
/// Share of its area from which a box or a mask counts as inside another.
pub(super) const INSIDE: f64 = 0.7;
/// Maximum number of frames for which a box is pending.
const MAX_PENDING_FRAMES: usize = 40;

/// Detection of an object in one frame by the detector, by motion, or by both.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FrameDetection {
    /// Class of the detector; `vehicle` where only motion detection found the object.
    pub(super) class: String,
    /// Confidence of the detector, if it found the object.
    pub(super) detector: Option<f64>,
    /// Confidence of motion detection, if it found the object.
    pub(super) motion: Option<f64>,
    /// True if the points in the box show that it is stationary.
    pub(super) is_stationary: bool,
}

impl FrameDetection {
    fn of(DetectedBox { found, is_stationary }: DetectedBox) -> Self {
        let (detector, motion) = match found.finder {
            DetectionSource::Detector => (Some(found.confidence), None),
            DetectionSource::Motion => (None, Some(found.confidence)),
        };
        Self { class: found.class, detector, motion, is_stationary }
    }

    /// Maximum of both confidences.
    pub(super) fn confidence(&self) -> f64 {
        self.detector.unwrap_or(0.0).max(self.motion.unwrap_or(0.0))
    }

    fn add_motion(&mut self, confidence: f64) {
        self.motion = Some(self.motion.unwrap_or(0.0).max(confidence));
    }
}

/// Boxes that show one object.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BoxGroup {
    pub(super) rect: Rect,
    /// Detection in this frame; `None` if the group is pending since an earlier one.
    pub(super) current: Option<FrameDetection>,
    /// Detections in earlier frames without segmentation.
    pub(super) earlier: Vec<FrameDetection>,
    /// Number of frames for which it has been pending.
    age: usize,
}

impl BoxGroup {
    fn new(rect: Rect, detection: FrameDetection) -> Self {
        Self { rect, current: Some(detection), earlier: Vec::new(), age: 0 }
    }

    /// The same group at another position.
    pub(super) fn at(&self, rect: Rect) -> Self {
        Self { rect, ..self.clone() }
    }

    /// Maximum confidence of its detections.
    pub(super) fn confidence(&self) -> f64 {
        self.detections().map(FrameDetection::confidence).fold(0.0, f64::max)
    }

    /// Its detections, the latest first.
    pub(super) fn detections(&self) -> impl Iterator<Item = &FrameDetection> {
        self.current.iter().chain(&self.earlier)
    }

    /// Returns true if points in any of its boxes show that it is stationary, and motion detection never found it.
    pub(super) fn is_stationary(&self) -> bool {
        self.detections().any(|detection| detection.is_stationary)
            && self.detections().all(|detection| detection.motion.is_none())
    }

    /// Class of its most confident detector box; `None` where only motion detection found it.
    pub(super) fn class(&self) -> Option<&str> {
        let named = self.detections().filter_map(|f| Some((f.detector?, f.class.as_str())));
        named.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, class)| class)
    }
}

/// Groups the boxes of a frame by object.
///
/// * `tracked` – boxes of tracked objects. A motion box that covers several of them, or several detector boxes, counts
///   for each and forms no group of its own.
pub(super) fn merge(
    found: Vec<DetectedBox>,
    tracked: &[Rect],
    options: &TrackerOptions,
    size: (u32, u32),
) -> Vec<BoxGroup> {
    let usable = |DetectedBox { found, is_stationary }: DetectedBox| {
        let Rect { x0, y0, x1, y1 } = found.rect;
        let is_number = [x0, y0, x1, y1, found.confidence].iter().all(|v| v.is_finite());
        let rect = found.rect.clipped(size.0, size.1);
        let counts = found.finder == DetectionSource::Motion || options.track_classes.contains(&found.class);
        let found = BoxDetection { rect, ..found };
        (counts && is_number && rect.area_px2() >= 1.0).then_some(DetectedBox { found, is_stationary })
    };
    let mut found: Vec<DetectedBox> = found.into_iter().filter_map(usable).collect();
    found.sort_by(|DetectedBox { found: a, .. }, DetectedBox { found: b, .. }| {
        a.finder.cmp(&b.finder).then(b.confidence.total_cmp(&a.confidence))
    });
    let mut groups: Vec<BoxGroup> = Vec::new();
    for found in found {
        match found.found.finder {
            DetectionSource::Detector => add_detected(&mut groups, found),
            DetectionSource::Motion => add_moving(&mut groups, found, tracked),
        }
    }
    groups
}

fn add_detected(groups: &mut Vec<BoxGroup>, found: DetectedBox) {
    let rect = found.found.rect;
    if groups.iter().all(|group| group.rect.iou(&rect) <= SAME_OBJECT) {
        groups.push(BoxGroup::new(rect, FrameDetection::of(found)));
    }
}

fn add_moving(groups: &mut Vec<BoxGroup>, found: DetectedBox, tracked: &[Rect]) {
    let (rect, confidence) = (found.found.rect, found.found.confidence);
    let overlap = |group: &BoxGroup| group.rect.iou(&rect).max(inside(&rect, &group.rect) - INSIDE);
    let best = (0..groups.len()).max_by(|&a, &b| overlap(&groups[a]).total_cmp(&overlap(&groups[b])).then(b.cmp(&a)));
    let is_covered = |other: &Rect| inside(other, &rect) > INSIDE && other.iou(&rect) < SAME_OBJECT;
    let group_rects: Vec<Rect> = groups.iter().map(|group| group.rect).collect();
    let is_ungrouped = |rect: &&Rect| group_rects.iter().all(|s| s.iou(rect) < SAME_MOVER && inside(s, rect) < INSIDE);
    let ungrouped: Vec<Rect> = tracked.iter().filter(is_ungrouped).copied().filter(is_covered).collect();
    let covered: Vec<usize> = (0..groups.len()).filter(|&s| is_covered(&group_rects[s])).collect();
    if covered.len() + ungrouped.len() > 1 {
        for group in covered {
            if let Some(detection) = &mut groups[group].current {
                detection.add_motion(confidence);
            }
        }
        groups.extend(ungrouped.into_iter().map(|rect| BoxGroup::new(rect, FrameDetection::of(found.clone()))));
        return;
    }
    let same = |s: &usize| groups[*s].rect.iou(&rect) > SAME_MOVER || inside(&rect, &group_rects[*s]) > INSIDE;
    match best.filter(same).and_then(|s| groups[s].current.as_mut()) {
        Some(detection) => detection.add_motion(confidence),
        None => groups.push(BoxGroup::new(rect, FrameDetection::of(found))),
    }
}

/// Share of a box that is inside another.
pub(super) fn inside(inner: &Rect, outer: &Rect) -> f64 {
    inner.intersection(outer).area_px2() / inner.area_px2().max(f64::MIN_POSITIVE)
}

/// Keeps unassociated boxes pending until the next frame with segmentation.
///
/// * `pending` – groups of earlier frames, propagated to this one.
/// * `unassociated` – groups of this frame.
pub(super) fn postpone(pending: Vec<BoxGroup>, unassociated: Vec<BoxGroup>) -> Vec<BoxGroup> {
    let mut all = merge_pending(pending, unassociated);
    for group in &mut all {
        if let Some(detection) = group.current.take() {
            group.earlier.insert(0, detection);
        }
        group.earlier.truncate(MAX_PENDING_FRAMES);
        group.age += 1;
    }
    all.retain(|group| group.age <= MAX_PENDING_FRAMES);
    all
}

/// Merges pending groups into those of a frame; a group that is detected again is no longer pending.
pub(super) fn merge_pending(pending: Vec<BoxGroup>, mut found: Vec<BoxGroup>) -> Vec<BoxGroup> {
    for old in pending {
        match found.iter_mut().find(|group| group.rect.iou(&old.rect) > SAME_MOVER) {
            Some(group) => group.earlier.extend(old.earlier),
            None => found.push(old),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (u32, u32) = (200, 100);

    fn rect(x0: f64, y0: f64, width: f64, height: f64) -> Rect {
        Rect { x0, y0, x1: x0 + width, y1: y0 + height }
    }

    fn found(finder: DetectionSource, rect: Rect, confidence: f64) -> BoxDetection {
        let class = if finder == DetectionSource::Motion { "vehicle" } else { "car" };
        BoxDetection { class: class.into(), confidence, rect, finder }
    }

    fn merged(found: Vec<BoxDetection>, tracked: &[Rect]) -> Vec<BoxGroup> {
        merge(found.into_iter().map(DetectedBox::from).collect(), tracked, &TrackerOptions::default(), SIZE)
    }

    #[test]
    fn detector_and_motion_that_overlap_are_one() {
        let car = rect(20.0, 20.0, 40.0, 20.0);
        let groups = merged(
            vec![
                found(DetectionSource::Motion, rect(25.0, 22.0, 30.0, 16.0), 0.7),
                found(DetectionSource::Detector, car, 0.5),
            ],
            &[],
        );
        let [group] = &groups[..] else { panic!("one object: {groups:?}") };
        assert_eq!((group.rect, group.class(), group.confidence()), (car, Some("car"), 0.7));
        assert_eq!(group.current.as_ref().map(|f| (f.detector, f.motion)), Some((Some(0.5), Some(0.7))));
    }

    #[test]
    fn motion_box_over_two_cars_counts_for_both() {
        let (a, b) = (rect(20.0, 20.0, 30.0, 20.0), rect(60.0, 20.0, 30.0, 20.0));
        let both = found(DetectionSource::Motion, rect(18.0, 18.0, 74.0, 24.0), 0.8);
        let groups = merged(
            vec![found(DetectionSource::Detector, a, 0.5), found(DetectionSource::Detector, b, 0.6), both.clone()],
            &[],
        );
        assert_eq!(groups.len(), 2);
        assert!(groups.iter().all(|s| s.current.as_ref().is_some_and(|f| f.motion == Some(0.8))));
        // The same without a detection, if the cars are tracked.
        let groups = merged(vec![both], &[a, b]);
        assert_eq!(groups.iter().map(|s| s.rect).collect::<Vec<_>>(), [a, b]);
    }

    #[test]
    fn duplicate_and_invalid_boxes_are_dropped() {
        let car = rect(20.0, 20.0, 40.0, 20.0);
        let truck = BoxDetection {
            class: "truck".into(),
            ..found(DetectionSource::Detector, rect(21.0, 20.0, 40.0, 21.0), 0.9)
        };
        let person = BoxDetection {
            class: "person".into(),
            ..found(DetectionSource::Detector, rect(90.0, 10.0, 9.0, 20.0), 0.9)
        };
        let broken = found(DetectionSource::Detector, Rect { x0: f64::NAN, ..car }, 0.9);
        let outside = found(DetectionSource::Motion, rect(300.0, 20.0, 40.0, 20.0), 0.9);
        let groups = merged(vec![found(DetectionSource::Detector, car, 0.5), truck, person, broken, outside], &[]);
        assert_eq!(groups.iter().map(BoxGroup::class).collect::<Vec<_>>(), [Some("truck")]);
    }

    #[test]
    fn pending_box_keeps_its_detections_and_expires() {
        let car = rect(20.0, 20.0, 40.0, 20.0);
        let groups = |confidence| merged(vec![found(DetectionSource::Detector, car, confidence)], &[]);
        let pending = postpone(postpone(Vec::new(), groups(0.4)), groups(0.6));
        assert_eq!((pending.len(), pending[0].earlier.len(), pending[0].confidence()), (1, 2, 0.6));
        let expired = (0..=MAX_PENDING_FRAMES).fold(pending, |pending, _| postpone(pending, Vec::new()));
        assert_eq!(expired, []);
    }
}
