//! Joint adjustment of an object's reconstruction with the ground under it.
//!
//! Structure from motion determines an object's depth and inclination by a chain of weak links: over sixty frames of
//! plain, glossy paint its size drifts by a few percent, which its own images do not contradict. The ground does. The
//! object is on it in every frame, so that its frame can be chosen with the ground at z = 0 and in the background's
//! unit of length. The only unknowns are then poses and points: in the frame of camera i the plane n_i · x + h_i = 0
//! passes through the point below the vehicle's center, is level there, and the vehicle's outline touches it
//! ([`contact`]). All of these terms and the image positions enter one bundle adjustment, and the scale ratio is the
//! resulting size of the object.
//!
//! Derivation, weights and figures: docs/maths/scale.md.

mod adjustment;
mod precision;
mod spread;
mod sub_maps;
mod surface;
#[cfg(test)]
mod tests;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::adjustment::Adjustment;
use self::precision::{median_error_px, point_covariances, uncertain_points};
use self::surface::move_onto_surface;
use super::{Contact, ContactOptions, Evidence, Options, ScaleError, Views, object_center};
use crate::checks::{Checked, OptionError, under, within};
use crate::math::median;
use crate::scene::{Reconstruction, ScaleShares};

/// Maximum number of rounds of adjustment and contact estimation; they end earlier when the contact has converged.
const MAX_ROUNDS: usize = 5;
/// Maximum growth of the image positions' median error, as a factor: beyond it ground and images contradict each other.
const MAX_ERROR_GROWTH: f64 = 3.0;
/// Standard deviation of a point's position, as a share of the object's radius (the median distance of its points from
/// the center), beyond which it is removed: few frames observe it, and no neighbors define a surface for it.
const MAX_DEVIATION: f64 = 0.05;
/// Minimum share of the points that is kept: those with the smallest standard deviation.
const LEAST_SHARE: f64 = 0.5;

/// Weights of the terms of the joint adjustment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct JointOptions {
    /// Bounds of the standard deviation of a local plane's distance to the vehicle, as a share of the camera's height
    /// over it. Within these bounds it is the spread of the distance before the adjustment: the smaller the spread, the
    /// better are planes and reconstruction.
    #[schemars(extend("unit" = "shares of the camera's height: least, most"))]
    pub sigma_distance: [f64; 2],
    /// Effective number of independent points per frame at the maximum drift of the distance. Errors on glossy paint
    /// and of drifting tracks are common to many points and many frames; taken as independent they would outweigh the
    /// ground.
    #[schemars(extend("unit" = "points"))]
    pub independent_points: f64,
    /// True if points are moved onto the surface of their neighbors.
    pub smooth_surface: bool,
    /// True if sub-maps of a vehicle are adjusted separately and aligned by its body.
    pub align_sub_maps: bool,
    /// Contact of the vehicle with the ground.
    pub contact: ContactOptions,
}

impl Default for JointOptions {
    fn default() -> Self {
        Self {
            sigma_distance: [0.003, 0.008],
            independent_points: 1.25,
            smooth_surface: true,
            align_sub_maps: true,
            contact: ContactOptions::default(),
        }
    }
}

impl JointOptions {
    /// Largest assumed drift of the object's height over its planes, as a share of [`View::lever`](super::View::lever).
    pub fn max_drift(&self) -> f64 {
        self.sigma_distance[1]
    }

    /// Rejects unusable values.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        let [least, most] = self.sigma_distance;
        if !(least > 0.0 && least <= most && most <= 1.0) {
            let reason = format!("[{least:?}, {most:?}] are not two ascending shares between 0 and 1");
            return Err(OptionError::new("sigma_distance", reason));
        }
        within("independent_points", self.independent_points, 0.01..=1e6)?;
        under("contact", self.contact.check())
    }
}

/// Reconstruction of an object, adjusted with the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// The reconstruction, in the frame and unit of the original one.
    pub object: Reconstruction,
    /// r, for this reconstruction.
    pub ratio: f64,
    /// Contributions to its standard deviation by the adjustment itself: without focal length and other methods.
    pub shares: ScaleShares,
    /// Height of the ground by the outlines, relative to the adjusted ground, in units of the background: the remaining
    /// difference between outlines and planes.
    pub contact: Contact,
    /// Median reprojection error before and after, pixels.
    pub error_px: [f64; 2],
    /// Points that were removed because their position is too uncertain.
    pub num_uncertain: usize,
}

/// Adjusts an object's reconstruction together with the ground.
///
/// * `views` – of `evidence.object`.
/// * `options` – those of `joint`, and those of `least_squares` for the initial ratio.
///
/// # Errors
/// [`ScaleError`] for fewer than three frames with a plane, no points, no initial ratio, or if image positions and
/// ground contradict each other.
pub fn joint(evidence: &Evidence, views: &Views, options: &Options) -> Result<Joint, ScaleError> {
    views.require(3)?;
    let mut adjustment = Adjustment::new(evidence, views, options)?;
    let before_px = median_error_px(&adjustment.object).unwrap_or(0.0);
    if options.joint.align_sub_maps {
        adjust_sub_maps(&mut adjustment, options);
    }
    let options = &options.joint;
    let contact = converge(&mut adjustment)?;
    let after_px = median_error_px(&adjustment.object).filter(|px| px.is_finite()).ok_or(ScaleError::NoObservations)?;
    if !(after_px <= MAX_ERROR_GROWTH * before_px.max(1e-3)) {
        return Err(ScaleError::GroundContradicts { before_px, after_px });
    }
    let shares = shares(&adjustment, &contact)?;
    let object_from_ground = adjustment.similarity_to(evidence.object).ok_or(ScaleError::NoSimilarity)?;
    let mut object = adjustment.object;
    object.transform(&object_from_ground);
    let radius = object_radius(&object);
    let covariances = point_covariances(&object);
    let stds = move_onto_surface(&mut object, &covariances, radius, options.smooth_surface);
    let uncertain = uncertain_points(&stds, MAX_DEVIATION * radius, LEAST_SHARE);
    object.remove_points(&uncertain);
    object.renew_errors();
    let ratio = 1.0 / object_from_ground.scale;
    let (error_px, num_uncertain) = ([before_px, after_px], uncertain.len());
    Ok(Joint { object, ratio, shares, contact, error_px, num_uncertain })
}

/// Adjusts every sub-map separately, if there are several, and joins them.
fn adjust_sub_maps(adjustment: &mut Adjustment, options: &Options) {
    let mut sub_maps = sub_maps::split(&adjustment.object);
    if sub_maps.len() > 1 {
        for sub_map in &mut sub_maps {
            let mut part = adjustment.with_object(sub_map.clone());
            match converge(&mut part) {
                Ok(_) => *sub_map = part.object,
                Err(error) => tracing::debug!("sub-map of {} images: {error}", sub_map.images.len()),
            }
        }
        adjustment.object = sub_maps::join(sub_maps, adjustment.evidence, options);
    }
}

/// Alternates adjustment and contact estimation until the contact has converged.
fn converge(adjustment: &mut Adjustment) -> Result<Contact, ScaleError> {
    let mut contact = adjustment.contact()?;
    for _ in 0..MAX_ROUNDS {
        adjustment.round(&contact)?;
        let last = std::mem::replace(&mut contact, adjustment.contact()?);
        if (contact.z - last.z).abs() < 0.05 * contact.std {
            break;
        }
    }
    Ok(contact)
}

/// Contributions to the standard deviation of the ratio by the adjustment itself.
///
/// The variance by the contact is the adjustment's own variance minus that with a known contact. The latter is too
/// small for the rest, since it assumes independent errors; it is used only if no jackknife is possible.
fn shares(adjustment: &Adjustment, contact: &Contact) -> Result<ScaleShares, ScaleError> {
    let conservative = adjustment.with_max_drift();
    let all = conservative.relative_std(contact)?;
    let of_contact_known = conservative.relative_std(&contact.known())?;
    Ok(ScaleShares {
        frames: spread::over_frames(adjustment).unwrap_or(of_contact_known),
        plane: adjustment.common_height_std(),
        contact: (all * all - of_contact_known * of_contact_known).max(0.0).sqrt(),
        ..ScaleShares::default()
    })
}

/// Median distance of an object's points from their center.
fn object_radius(object: &Reconstruction) -> f64 {
    let center = object_center(object);
    median(object.points.values().map(|point| (point.position - center).norm()).collect()).unwrap_or(0.0)
}
