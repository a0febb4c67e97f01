//! Which of the tracked objects moved: the points of the stage `motion` that lie on their masks say it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::perception::motion::{Judgement, MovementReason, TrackLabel, judge};
use crate::pipeline::PipelineError;
use crate::pipeline::motion::{self, Points};
use crate::pipeline::run::Run;
use crate::scene::{FoundIn, Frame, FrameId, Movement, MovementFinding, ObjectId, TrackedObject};

/// What is said where nothing was looked at.
pub(super) fn unknown() -> MovementFinding {
    MovementFinding {
        state: Movement::Undetermined,
        reason: "pictures that do not follow one another in time show no motion".to_owned(),
    }
}

/// Says of every object whether it moved; its masks lie in `folder`, which is still in the making. Gives the objects
/// that are a patch of the ground.
pub(super) fn find(
    run: &Run,
    folder: &Path,
    objects: &mut [TrackedObject],
) -> Result<BTreeSet<ObjectId>, PipelineError> {
    let points = motion::points(run)?;
    let mut flat = BTreeSet::new();
    if points.frames.is_empty() {
        return Ok(flat);
    }
    let size = (run.info().width, run.info().height);
    let on = on_objects(run, folder, objects, &points)?;
    let none = OnObject::default();
    for object in objects {
        let on_it = on.get(&object.id).unwrap_or(&none);
        let tracks: Vec<_> = on_it
            .counts
            .iter()
            .map(|(&track, &count)| {
                let (track, label) = (&points.tracks[track], &points.labels[track]);
                (track, label, count as f64 / track.pixels.len().max(1) as f64)
            })
            .collect();
        object.movement = finding(object, &judge(&tracks));
        let labels: Vec<&TrackLabel> = on_it.counts.keys().map(|&track| &points.labels[track]).collect();
        if object.movement.state != Movement::Moving && lies_flat(&labels, on_it.mean_share(size)) {
            flat.insert(object.id);
        }
    }
    Ok(flat)
}

/// Whether an object is a piece of the ground: its points stand, none of them rises over the ground, and it is too
/// large in the picture for a vehicle so far away that it looks flat.
///
/// * `share` – of the picture, that its masks cover.
fn lies_flat(labels: &[&TrackLabel], share: f64) -> bool {
    const LEAST_SHARE: f64 = 0.03;
    const LEAST_POINTS: usize = 8;
    const MOST_HEIGHT: f64 = 0.03;
    const LEAST_FLAT: f64 = 0.8;
    let heights: Vec<f64> = labels.iter().filter_map(|label| label.relative_height).collect();
    let low = heights.iter().filter(|height| height.abs() <= MOST_HEIGHT).count();
    share >= LEAST_SHARE && heights.len() >= LEAST_POINTS && low as f64 >= LEAST_FLAT * heights.len() as f64
}

/// What lies on an object's masks.
#[derive(Default)]
struct OnObject {
    /// Per track of a point the number of frames in which it does.
    counts: BTreeMap<usize, usize>,
    /// Pixels of all masks, and their number.
    area: usize,
    num_masks: usize,
}

impl OnObject {
    /// Mean share of the picture that the masks cover.
    fn mean_share(&self, (width, height): (u32, u32)) -> f64 {
        let all = f64::from(width) * f64::from(height) * self.num_masks.max(1) as f64;
        self.area as f64 / all.max(1.0)
    }
}

/// That its foot would float says of a vehicle that it comes nearer; of anything else, that it is a tree, a sign or a
/// balcony.
fn finding(object: &TrackedObject, judged: &Judgement) -> MovementFinding {
    let FoundIn { given, .. } = object.found_in;
    let is_vehicle = given > 0 || object.found_in.by_detector() > object.found_in.motion;
    if judged.reason == MovementReason::FootFloats && !is_vehicle {
        let reason =
            "its lowest points would float over the ground if it stood: it comes nearer, or it is something tall";
        return MovementFinding { state: Movement::Undetermined, reason: reason.to_owned() };
    }
    MovementFinding { state: judged.movement, reason: judged.to_string() }
}

/// What lies on the masks of each object.
fn on_objects(
    run: &Run,
    folder: &Path,
    objects: &[TrackedObject],
    points: &Points,
) -> Result<BTreeMap<ObjectId, OnObject>, PipelineError> {
    let names: BTreeMap<FrameId, &Frame> = run.frames()?.iter().map(|frame| (frame.id, frame)).collect();
    let mut starting: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (k, track) in points.tracks.iter().enumerate() {
        starting.entry(track.first).or_default().push(k);
    }
    let mut live: Vec<usize> = Vec::new();
    let mut found: BTreeMap<ObjectId, OnObject> = BTreeMap::new();
    for (index, id) in (0u32..).zip(&points.frames) {
        live.extend(starting.remove(&index).into_iter().flatten());
        live.retain(|&k| points.tracks[k].end() > index);
        let Some(frame) = names.get(id) else { continue };
        for (object, mask) in super::masks_in(run, folder, objects, frame)? {
            let on_it = found.entry(object).or_default();
            on_it.area += mask.area_px2();
            on_it.num_masks += 1;
            for &k in &live {
                if points.tracks[k].at(index).is_some_and(|[x, y]| mask.contains(x, y)) {
                    *on_it.counts.entry(k).or_default() += 1;
                }
            }
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::motion::Verdict;

    fn label(relative_height: Option<f64>) -> TrackLabel {
        TrackLabel { verdict: Verdict::Standing, strength: 0.0, deviation_px: 0.0, relative_height }
    }

    fn lie_flat(heights: &[f64], share: f64) -> bool {
        let labels: Vec<TrackLabel> = heights.iter().map(|height| label(Some(*height))).collect();
        lies_flat(&labels.iter().collect::<Vec<_>>(), share)
    }

    #[test]
    fn a_patch_of_road_lies_flat_and_a_parked_car_does_not() {
        assert!(lie_flat(&[0.0, 0.01, -0.02, 0.0, 0.01, 0.02, 0.0, 0.01, 0.2], 0.3));
        assert!(!lie_flat(&[0.0, 0.1, 0.15, 0.12, 0.01, 0.2, 0.18, 0.01, 0.2], 0.3));
        // Far away everything is flat, and small.
        assert!(!lie_flat(&[0.01; 9], 0.005));
        assert!(!lie_flat(&[0.0; 5], 0.3));
        assert!(!lies_flat(&[&label(None)], 0.3));
    }
}
