//! Standard deviation of the scale ratio, with its sources.
//!
//! Errors on a vehicle are common to all sightings of a track and to neighbouring frames, so that the covariance of the
//! adjustment, which takes them for independent, does not know the half of it. Here groups of tracks, and stretches of
//! frames, are left out in turn, and the object is adjusted again: with K groups and θ_k the logarithm of the ratio
//! without group k,
//!
//! ```text
//! σ² = (K − 1) / K · Σ (θ_k − θ̄)²
//! ```
//!
//! (delete-a-group jackknife; J. Shao and C. F. J. Wu, *A general theory for jackknife variance estimation*, Annals of
//! Statistics 1989). Derivation and calibration: docs/maths/scale.md.

use std::collections::BTreeSet;

use super::adjustment::Adjustment;
use crate::scene::{ImageId, Point3dId, Reconstruction};
use crate::trajectory::Contact;

/// Groups of tracks, and stretches of frames, of which each is left out once.
const GROUPS: usize = 5;

/// Standard deviation of the ratio, as a share of it, from leaving out every `GROUPS`-th track.
pub(super) fn over_tracks(adjustment: &Adjustment) -> Option<f64> {
    let ids: Vec<Point3dId> = adjustment.object.points.keys().copied().collect();
    let without = |group: usize| {
        let mut object = adjustment.object.clone();
        object.remove_points(&ids.iter().copied().skip(group).step_by(GROUPS).collect::<Vec<_>>());
        object
    };
    jackknife((0..GROUPS).filter_map(|group| log_size(adjustment, without(group))))
}

/// Standard deviation of the ratio, as a share of it, from leaving out stretches of frames.
pub(super) fn over_frames(adjustment: &Adjustment) -> Option<f64> {
    let ids: Vec<ImageId> = adjustment.object.images.keys().copied().collect();
    let without = |group: usize| {
        let gone = &ids[group * ids.len() / GROUPS..(group + 1) * ids.len() / GROUPS];
        without_images(&adjustment.object, &gone.iter().copied().collect())
    };
    jackknife((0..GROUPS).filter_map(|group| log_size(adjustment, without(group))))
}

/// Two standard deviations by which the same evidence was left out in two ways, so that their squares add up to that of
/// the larger: an error that is common to neither groups of tracks nor stretches of frames is in both.
pub(super) fn counted_once(stds: [f64; 2]) -> [f64; 2] {
    let [first, second] = stds;
    let both = first.hypot(second);
    if both > 0.0 && both.is_finite() { stds.map(|std| std * (first.max(second) / both)) } else { stds }
}

/// The logarithm of the size with which an object comes out that has fewer frames or points.
fn log_size(adjustment: &Adjustment, object: Reconstruction) -> Option<f64> {
    let mut part = adjustment.of_part(object);
    let contact: Contact = part.contact().ok()?;
    part.round(&contact).ok()?;
    let found = part.back_to(&adjustment.object)?;
    Some(-found.scale.ln()).filter(|log| log.is_finite())
}

/// `None` for fewer than three values.
fn jackknife(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() >= 3).then(|| ((count - 1.0) / count * squares).sqrt())
}

/// The object without some images; points that fewer than three are left of go, too.
fn without_images(object: &Reconstruction, gone: &BTreeSet<ImageId>) -> Reconstruction {
    let mut out = object.clone();
    out.images.retain(|id, _| !gone.contains(id));
    let mut lost = Vec::new();
    for (id, point) in &mut out.points {
        point.track.retain(|element| !gone.contains(&element.image));
        if point.track.len() < 3 {
            lost.push(*id);
        }
    }
    out.remove_points(&lost);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Options, drive};

    #[test]
    fn what_was_left_out_in_two_ways_counts_once() {
        let [tracks, frames] = counted_once([0.3, 0.4]);
        assert!((tracks.hypot(frames) - 0.4).abs() < 1e-12 && (tracks / frames - 0.75).abs() < 1e-12);
        assert_eq!(counted_once([0.0, 0.2]), [0.0, 0.2]);
        assert_eq!(counted_once([0.0, 0.0]), [0.0, 0.0]);
        assert!(counted_once([f64::INFINITY, 0.1]).iter().any(|std| std.is_infinite()));
    }

    #[test]
    fn the_jackknife_of_a_mean_is_its_standard_error() {
        // Five groups of one number each: leaving one out in turn gives s² / n exactly.
        let numbers = [0.3, -1.2, 0.7, 2.0, -0.4];
        let mean = numbers.iter().sum::<f64>() / 5.0;
        let of_mean = (numbers.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 4.0 / 5.0).sqrt();
        let found = jackknife(numbers.iter().map(|x| (5.0 * mean - x) / 4.0));
        assert!((found.unwrap() - of_mean).abs() < 1e-12);
        assert_eq!(jackknife([0.1, 0.2].into_iter()), None);
    }

    #[test]
    fn images_that_go_take_their_observations_along() {
        let object = drive(&Options { num_frames: 8, ..Options::default() }, 1).object;
        let gone: BTreeSet<ImageId> = object.images.keys().copied().take(3).collect();
        let left = without_images(&object, &gone);
        assert_eq!(left.images.len(), object.images.len() - 3);
        assert!(!left.points.is_empty());
        let is_there = |id: &ImageId| left.images.contains_key(id);
        assert!(left.points.values().all(|p| p.track.len() >= 3 && p.track.iter().all(|e| is_there(&e.image))));
        let seen = left.images.values().flat_map(|image| &image.observations).filter_map(|o| o.point);
        assert!(seen.into_iter().all(|id| left.points.contains_key(&id)));
    }
}
