//! Coverage of the standard deviations that follow from a model's own observations.
//!
//! The covariance of a bundle adjustment is relative to what holds its gauge: the first image, and one coordinate of
//! the image farthest from it. So the reference is moved to where it agrees with the model in exactly these, and every
//! other centre is compared there. The reference is taken to be exact.

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::Both;
use crate::bundle::{self, CenterDeviations};
use crate::math::{Rigid3, median};
use crate::scene::ImageId;

/// Images whose deviations are computed, at most.
const MOST_IMAGES: usize = 200;
/// Fewer say nothing.
const FEWEST_IMAGES: usize = 5;

/// Numbers of camera centers within the standard deviations that their model's observations give.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Images that were looked at: evenly spread, 200 at most.
    pub num_images: usize,
    /// Shares of them within one, two and three deviations (√ of the trace of the centre's covariance).
    pub within: [f64; 3],
    /// Median distance, in deviations.
    pub median_in_deviations: f64,
}

/// Of the other reconstruction against the reference.
///
/// # Errors
/// Says what is missing.
pub(super) fn coverage(both: &Both<'_>) -> Result<Coverage, String> {
    let found = bundle::center_deviations(both.other, MOST_IMAGES, &BTreeMap::new()).map_err(|e| e.to_string())?;
    let found = found.ok_or("too few observations to estimate the uncertainty of its cameras")?;
    let references: BTreeMap<ImageId, Rigid3> =
        both.common.iter().map(|(a, b)| (*b, both.reference.images[a].cam_from_world)).collect();
    let moved = in_gauge(both, &references, &found)
        .ok_or("the images that fix the gauge (the first one and the farthest from it) are not in the reference")?;
    let ratio = |(id, deviation): (&ImageId, &f64)| {
        let distance =
            (both.other.images.get(id)?.cam_from_world.center() - moved(references.get(id)?.center())).norm();
        (*deviation > 0.0).then_some(distance / deviation)
    };
    let ratios: Vec<f64> = found.centers.iter().filter_map(ratio).collect();
    if ratios.len() < FEWEST_IMAGES {
        return Err(format!("{} of its images are usable, at least {FEWEST_IMAGES} needed", ratios.len()));
    }
    let share = |limit: f64| ratios.iter().filter(|r| **r <= limit).count() as f64 / ratios.len() as f64;
    Ok(Coverage {
        num_images: ratios.len(),
        within: [1.0, 2.0, 3.0].map(share),
        median_in_deviations: median(ratios).unwrap_or(0.0),
    })
}

/// Positions of the reference, in the frame of the model and in the gauge of its covariance.
fn in_gauge(
    both: &Both<'_>,
    references: &BTreeMap<ImageId, Rigid3>,
    found: &CenterDeviations,
) -> Option<impl Fn(Point3<f64>) -> Point3<f64>> {
    let camera = |id: &ImageId| both.other.images.get(id).map(|image| image.cam_from_world);
    let (first, farthest) = (camera(&found.held)?, camera(&found.farthest)?);
    let (true_first, true_farthest) = (*references.get(&found.held)?, *references.get(&found.farthest)?);
    let (origin, true_origin) = (first.center(), true_first.center());
    let seen = farthest * origin;
    let axis = seen.coords.iamax();
    let scale = seen[axis] / (true_farthest * true_origin)[axis];
    let rotation = first.rotation.inverse() * true_first.rotation;
    (scale.is_finite() && scale > 0.0).then_some(move |p: Point3<f64>| origin + rotation * (p - true_origin) * scale)
}
