//! Standard deviation of the scale ratio by a jackknife over frames.
//!
//! Errors on a vehicle are common to neighboring frames, so that the covariance of the adjustment, which assumes
//! independent errors, is too small. Here the object is adjusted without each jackknife group of consecutive frames in
//! turn: σ is that of a jackknife of the logarithm of the ratio ([`jackknife_std`]). Derivation and calibration:
//! docs/maths/scale.md.

use std::ops::Range;

use super::adjustment::Adjustment;
use crate::math::{jackknife_groups, jackknife_std};
use crate::scene::{ImageId, Reconstruction};
use crate::trajectory::Contact;

/// Observations per frame in the adjustment without a jackknife group.
///
/// In an adjustment those of a frame count as one or two independent ones
/// ([`JointOptions::independent_points`](super::JointOptions)), so that a hundred evenly chosen tracks do not change
/// the result and take a fifth of the time for large vehicles.
const OBSERVATIONS_PER_FRAME: usize = 100;

/// Relative standard deviation of the ratio, by a jackknife over groups of frames.
pub(super) fn over_frames(adjustment: &Adjustment) -> Option<f64> {
    let whole = thinned(&adjustment.object);
    let ids: Vec<ImageId> = whole.images.keys().copied().collect();
    let without = |group: Range<usize>| without_images(&whole, &ids[group]);
    let logs: Vec<f64> = jackknife_groups(ids.len()).filter_map(|group| log_size(adjustment, without(group))).collect();
    jackknife_std(&logs)
}

/// Object with every n-th of its tracks: about [`OBSERVATIONS_PER_FRAME`] observations per frame.
fn thinned(object: &Reconstruction) -> Reconstruction {
    let num_seen: usize = object.points.values().map(|point| point.track.len()).sum();
    let every = num_seen.div_ceil(OBSERVATIONS_PER_FRAME * object.images.len().max(1)).max(1);
    let mut object = object.clone();
    let is_kept = |k: usize| k.is_multiple_of(every);
    let gone = object.points.keys().enumerate().filter(|(k, _)| !is_kept(*k)).map(|(_, id)| *id);
    object.remove_points(&gone.collect::<Vec<_>>());
    object
}

/// Logarithm of the adjusted size of an object with fewer frames or points.
fn log_size(adjustment: &Adjustment, object: Reconstruction) -> Option<f64> {
    let mut part = adjustment.of_part(object);
    let contact: Contact = part.contact().ok()?;
    part.round(&contact).ok()?;
    let found = part.similarity_to(&adjustment.object)?;
    Some(-found.scale.ln()).filter(|log| log.is_finite())
}

/// Object without some images, and without the points that fewer than three of the others observe.
pub(super) fn without_images(object: &Reconstruction, gone: &[ImageId]) -> Reconstruction {
    let mut out = object.clone();
    out.remove_images(gone);
    let lost = out.points.iter().filter(|(_, point)| point.track.len() < 3).map(|(id, _)| *id);
    out.remove_points(&lost.collect::<Vec<_>>());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Options, drive};

    #[test]
    fn thinned_objects_keep_all_frames_and_fewer_tracks() {
        let object = drive(&Options { num_frames: 8, ..Options::default() }, 1).object;
        let thinned = thinned(&object);
        let num_seen: usize = thinned.points.values().map(|point| point.track.len()).sum();
        assert!(thinned.images.len() == object.images.len() && thinned.points.len() < object.points.len());
        assert!(num_seen <= 8 * OBSERVATIONS_PER_FRAME && num_seen > 4 * OBSERVATIONS_PER_FRAME, "{num_seen}");
    }

    #[test]
    fn removing_images_removes_their_observations() {
        let object = drive(&Options { num_frames: 8, ..Options::default() }, 1).object;
        let gone: Vec<ImageId> = object.images.keys().copied().take(3).collect();
        let left = without_images(&object, &gone);
        assert_eq!(left.images.len(), object.images.len() - 3);
        assert!(!left.points.is_empty());
        let is_there = |id: &ImageId| left.images.contains_key(id);
        assert!(left.points.values().all(|p| p.track.len() >= 3 && p.track.iter().all(|e| is_there(&e.image))));
        let seen = left.images.values().flat_map(|image| &image.observations).filter_map(|o| o.point);
        assert!(seen.into_iter().all(|id| left.points.contains_key(&id)));
    }
}
