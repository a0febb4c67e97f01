//! Boxes of one frame that mean one object.

use super::{DetectedBox, TrackerOptions};
use crate::scene::{BoxDetection, DetectionSource, Rect};

/// Two boxes of a detector that overlap by more than this (intersection over union) mean one object.
const SAME_OBJECT: f64 = 0.55;
/// A box of motion and a box of a detector that overlap by more than this mean one object: motion finds the part of a
/// vehicle that has texture, or the vehicle with its shadow.
const SAME_MOVER: f64 = 0.35;
/// A box or a mask lies in another from this share of its area on.
pub(super) const INSIDE: f64 = 0.7;
/// A box waits for a mask for at most so many frames.
const MAX_WAITING_FRAMES: usize = 40;

/// Source of an object's detection in one frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Finding {
    /// The detector's class; `vehicle` where motion alone found it.
    pub(super) class: String,
    /// The detector's confidence, if it found it.
    pub(super) detector: Option<f64>,
    /// Motion's confidence, if it found it.
    pub(super) motion: Option<f64>,
    /// True if the points in the box show that it is stationary.
    pub(super) stands: bool,
}

impl Finding {
    fn of(DetectedBox { found, stands }: DetectedBox) -> Self {
        let (detector, motion) = match found.finder {
            DetectionSource::Detector => (Some(found.confidence), None),
            DetectionSource::Motion => (None, Some(found.confidence)),
        };
        Self { class: found.class, detector, motion, stands }
    }

    /// The confidence of whatever is surer.
    pub(super) fn confidence(&self) -> f64 {
        self.detector.unwrap_or(0.0).max(self.motion.unwrap_or(0.0))
    }

    fn add_motion(&mut self, confidence: f64) {
        self.motion = Some(self.motion.unwrap_or(0.0).max(confidence));
    }
}

/// One object that boxes show.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BoxGroup {
    pub(super) rect: Rect,
    /// Source of its detection in this frame; `None` if it waits since an earlier one.
    pub(super) now: Option<Finding>,
    /// Sources of its detections in earlier frames without segmentation.
    pub(super) earlier: Vec<Finding>,
    /// Frames for which it waits.
    age: usize,
}

impl BoxGroup {
    fn new(rect: Rect, finding: Finding) -> Self {
        Self { rect, now: Some(finding), earlier: Vec::new(), age: 0 }
    }

    /// The same object at another place.
    pub(super) fn at(&self, rect: Rect) -> Self {
        Self { rect, ..self.clone() }
    }

    /// The highest confidence of all that found it.
    pub(super) fn confidence(&self) -> f64 {
        self.findings().map(Finding::confidence).fold(0.0, f64::max)
    }

    /// All that found it, the latest first.
    pub(super) fn findings(&self) -> impl Iterator<Item = &Finding> {
        self.now.iter().chain(&self.earlier)
    }

    /// Returns true if the points in any of its boxes show that it is stationary; a detection by motion is not.
    pub(super) fn stands(&self) -> bool {
        self.findings().any(|finding| finding.stands) && self.findings().all(|finding| finding.motion.is_none())
    }

    /// The class of the surest finding of a detector; `None` where only motion found it.
    pub(super) fn class(&self) -> Option<&str> {
        let named = self.findings().filter_map(|f| Some((f.detector?, f.class.as_str())));
        named.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, class)| class)
    }
}

/// The objects that the boxes of a frame show, each once.
///
/// * `followed` – boxes of objects that are followed: a box of motion that covers several of them, or several boxes of
///   the detector, speaks for each, and is none of its own.
pub(super) fn merge(
    found: Vec<DetectedBox>,
    followed: &[Rect],
    options: &TrackerOptions,
    size: (u32, u32),
) -> Vec<BoxGroup> {
    let usable = |DetectedBox { found, stands }: DetectedBox| {
        let Rect { x0, y0, x1, y1 } = found.rect;
        let is_number = [x0, y0, x1, y1, found.confidence].iter().all(|v| v.is_finite());
        let rect = found.rect.clipped(size.0, size.1);
        let counts = found.finder == DetectionSource::Motion || options.track_classes.contains(&found.class);
        let found = BoxDetection { rect, ..found };
        (counts && is_number && rect.area_px2() >= 1.0).then_some(DetectedBox { found, stands })
    };
    let mut found: Vec<DetectedBox> = found.into_iter().filter_map(usable).collect();
    found.sort_by(|DetectedBox { found: a, .. }, DetectedBox { found: b, .. }| {
        a.finder.cmp(&b.finder).then(b.confidence.total_cmp(&a.confidence))
    });
    let mut sights: Vec<BoxGroup> = Vec::new();
    for found in found {
        match found.found.finder {
            DetectionSource::Detector => add_detected(&mut sights, found),
            DetectionSource::Motion => add_moving(&mut sights, found, followed),
        }
    }
    sights
}

fn add_detected(sights: &mut Vec<BoxGroup>, found: DetectedBox) {
    let rect = found.found.rect;
    if sights.iter().all(|sight| sight.rect.iou(&rect) <= SAME_OBJECT) {
        sights.push(BoxGroup::new(rect, Finding::of(found)));
    }
}

fn add_moving(sights: &mut Vec<BoxGroup>, found: DetectedBox, followed: &[Rect]) {
    let (rect, confidence) = (found.found.rect, found.found.confidence);
    let overlap = |sight: &BoxGroup| sight.rect.iou(&rect).max(inside(&rect, &sight.rect) - INSIDE);
    let best = (0..sights.len()).max_by(|&a, &b| overlap(&sights[a]).total_cmp(&overlap(&sights[b])).then(b.cmp(&a)));
    let is_covered = |other: &Rect| inside(other, &rect) > INSIDE && other.iou(&rect) < SAME_OBJECT;
    let seen: Vec<Rect> = sights.iter().map(|sight| sight.rect).collect();
    let unseen = |rect: &&Rect| seen.iter().all(|s| s.iou(rect) < SAME_MOVER && inside(s, rect) < INSIDE);
    let alone: Vec<Rect> = followed.iter().filter(unseen).copied().filter(is_covered).collect();
    let covered: Vec<usize> = (0..sights.len()).filter(|&s| is_covered(&seen[s])).collect();
    if covered.len() + alone.len() > 1 {
        for sight in covered {
            if let Some(finding) = &mut sights[sight].now {
                finding.add_motion(confidence);
            }
        }
        sights.extend(alone.into_iter().map(|rect| BoxGroup::new(rect, Finding::of(found.clone()))));
        return;
    }
    let same = |s: &usize| sights[*s].rect.iou(&rect) > SAME_MOVER || inside(&rect, &seen[*s]) > INSIDE;
    match best.filter(same).and_then(|s| sights[s].now.as_mut()) {
        Some(finding) => finding.add_motion(confidence),
        None => sights.push(BoxGroup::new(rect, Finding::of(found))),
    }
}

/// Share of a box that lies in another.
pub(super) fn inside(inner: &Rect, outer: &Rect) -> f64 {
    inner.intersection(outer).area_px2() / inner.area_px2().max(f64::MIN_POSITIVE)
}

/// Lets boxes wait that no followed object explains, until a frame in which masks are asked for.
///
/// * `waiting` – those of earlier frames, at their places in this one.
/// * `left` – those of this frame.
pub(super) fn wait(waiting: Vec<BoxGroup>, left: Vec<BoxGroup>) -> Vec<BoxGroup> {
    let mut all = join(waiting, left);
    for sight in &mut all {
        if let Some(finding) = sight.now.take() {
            sight.earlier.insert(0, finding);
        }
        sight.earlier.truncate(MAX_WAITING_FRAMES);
        sight.age += 1;
    }
    all.retain(|sight| sight.age <= MAX_WAITING_FRAMES);
    all
}

/// The boxes of a frame with those that wait; what is found again has waited no longer.
pub(super) fn join(waiting: Vec<BoxGroup>, mut found: Vec<BoxGroup>) -> Vec<BoxGroup> {
    for old in waiting {
        match found.iter_mut().find(|sight| sight.rect.iou(&old.rect) > SAME_MOVER) {
            Some(sight) => sight.earlier.extend(old.earlier),
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

    fn merged(found: Vec<BoxDetection>, followed: &[Rect]) -> Vec<BoxGroup> {
        merge(found.into_iter().map(DetectedBox::from).collect(), followed, &TrackerOptions::default(), SIZE)
    }

    #[test]
    fn detector_and_motion_that_overlap_are_one() {
        let car = rect(20.0, 20.0, 40.0, 20.0);
        let sights = merged(
            vec![
                found(DetectionSource::Motion, rect(25.0, 22.0, 30.0, 16.0), 0.7),
                found(DetectionSource::Detector, car, 0.5),
            ],
            &[],
        );
        let [sight] = &sights[..] else { panic!("one object: {sights:?}") };
        assert_eq!((sight.rect, sight.class(), sight.confidence()), (car, Some("car"), 0.7));
        assert_eq!(sight.now.as_ref().map(|f| (f.detector, f.motion)), Some((Some(0.5), Some(0.7))));
    }

    #[test]
    fn motion_over_two_cars_speaks_for_both() {
        let (a, b) = (rect(20.0, 20.0, 30.0, 20.0), rect(60.0, 20.0, 30.0, 20.0));
        let both = found(DetectionSource::Motion, rect(18.0, 18.0, 74.0, 24.0), 0.8);
        let sights = merged(
            vec![found(DetectionSource::Detector, a, 0.5), found(DetectionSource::Detector, b, 0.6), both.clone()],
            &[],
        );
        assert_eq!(sights.len(), 2);
        assert!(sights.iter().all(|s| s.now.as_ref().is_some_and(|f| f.motion == Some(0.8))));
        // The same where the detector is blind, but the cars are followed.
        let sights = merged(vec![both], &[a, b]);
        assert_eq!(sights.iter().map(|s| s.rect).collect::<Vec<_>>(), [a, b]);
    }

    #[test]
    fn a_detected_object_is_reported_once_and_others_not_at_all() {
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
        let sights = merged(vec![found(DetectionSource::Detector, car, 0.5), truck, person, broken, outside], &[]);
        assert_eq!(sights.iter().map(BoxGroup::class).collect::<Vec<_>>(), [Some("truck")]);
    }

    #[test]
    fn a_box_waits_for_a_while_and_remembers_what_found_it() {
        let car = rect(20.0, 20.0, 40.0, 20.0);
        let sights = |confidence| merged(vec![found(DetectionSource::Detector, car, confidence)], &[]);
        let waiting = wait(wait(Vec::new(), sights(0.4)), sights(0.6));
        assert_eq!((waiting.len(), waiting[0].earlier.len(), waiting[0].confidence()), (1, 2, 0.6));
        let forgotten = (0..=MAX_WAITING_FRAMES).fold(waiting, |waiting, _| wait(waiting, Vec::new()));
        assert_eq!(forgotten, []);
    }
}
