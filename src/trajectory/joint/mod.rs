//! One adjustment of an object's reconstruction with the ground under it.
//!
//! Structure from motion leaves an object's depth and inclination to a chain of weak links: along sixty frames of
//! plain, glossy paint its size wanders by a few percent, which nothing in its own pictures contradicts. The ground
//! does. The object stands on it in every frame, so that its frame can be chosen with the ground at z = 0 and in the
//! background's unit of length. Then no unknown is left besides poses and points: in the frame of camera i the plane
//! n_i · x + h_i = 0 passes through the point below the vehicle's middle, is level there, and the vehicle's outline
//! touches it ([`contact`]). All of that goes into one bundle adjustment with the image positions, and the scale ratio
//! is the size with which the object comes out.
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
use self::surface::draw_onto_surface;
use super::{Contact, ContactOptions, Evidence, Options, ScaleError, Views, object_center};
use crate::checks::{Checked, OptionError, under, within};
use crate::math::median;
use crate::scene::{Reconstruction, ScaleShares};

/// Most rounds of adjustment and new contact; it stops earlier when the contact stays.
const MAX_ROUNDS: usize = 5;
/// Maximum growth of the image positions' median error, as a factor: beyond it ground and images contradict each other.
const MAX_ERROR_GROWTH: f64 = 3.0;
/// Standard deviation of a point's position, as a share of the object's radius (the median distance of its points from
/// the middle), beyond which it is removed: few frames observe it, and no neighbors define a surface for it.
const MAX_DEVIATION: f64 = 0.05;
/// Share of the points, those with the smallest standard deviation, that stays in any case.
const LEAST_SHARE: f64 = 0.5;

/// Weights of the terms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct JointOptions {
    /// Standard deviation of a local plane's distance to the vehicle, as a share of the camera's height over it: what
    /// the distance wanders by before the adjustment, but no less than the first of these and no more than the second.
    /// The less it wanders, the better are planes and reconstruction.
    #[schemars(extend("unit" = "shares of the camera's height: least, most"))]
    pub sigma_distance: [f64; 2],
    /// Points as many as which those of one frame count, where the distance wanders by the most. Errors on glossy paint
    /// and of tracks that wander are common to many points and many frames; taken for independent they would leave
    /// nothing to the ground.
    #[schemars(extend("unit" = "points"))]
    pub independent_points: f64,
    /// True if points are drawn onto the surface of their neighbors.
    pub smooth_surface: bool,
    /// True if sub-maps of a vehicle are adjusted by themselves and aligned by its body.
    pub align_sub_maps: bool,
    /// Where the vehicle touches the ground.
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

    /// Rejects what cannot be worked with.
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

/// An object's reconstruction that stands on the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// The reconstruction, in the frame and unit of the one that it was made from.
    pub object: Reconstruction,
    /// r, for this reconstruction.
    pub ratio: f64,
    /// Sources of its standard deviation that the adjustment itself knows: without focal length and other methods.
    pub shares: ScaleShares,
    /// Where the vehicle touches the ground, relative to it and in units of the background: what is left of the
    /// outlines' contradiction to the planes.
    pub contact: Contact,
    /// Median error of the image positions before and after, pixels.
    pub error_px: [f64; 2],
    /// Points that were left out because their place is too uncertain.
    pub num_uncertain: usize,
}

/// Adjusts an object's reconstruction together with the ground.
///
/// * `views` – of `evidence.object`.
/// * `options` – besides those of `joint` itself those of `least_squares`, from which the adjustment starts.
///
/// # Errors
/// [`ScaleError`] where there are fewer than three frames with a plane, no points, nothing to begin with, or where
/// image positions and ground contradict one another.
pub fn joint(evidence: &Evidence, views: &Views, options: &Options) -> Result<Joint, ScaleError> {
    views.require(3)?;
    let mut adjustment = Adjustment::new(evidence, views, options)?;
    let before_px = median_error_px(&adjustment.object).unwrap_or(0.0);
    if options.joint.align_sub_maps {
        settle_sub_maps(&mut adjustment, options);
    }
    let options = &options.joint;
    let contact = settle(&mut adjustment)?;
    let after_px = median_error_px(&adjustment.object).filter(|px| px.is_finite()).ok_or(ScaleError::NoObservations)?;
    if !(after_px <= MAX_ERROR_GROWTH * before_px.max(1e-3)) {
        return Err(ScaleError::GroundContradicts { before_px, after_px });
    }
    let shares = shares(&adjustment, &contact)?;
    let object_from_ground = adjustment.back_to(evidence.object).ok_or(ScaleError::NoSimilarity)?;
    let mut object = adjustment.object;
    object.transform(&object_from_ground);
    let radius = object_radius(&object);
    let covariances = point_covariances(&object);
    let deviations = draw_onto_surface(&mut object, &covariances, radius, options.smooth_surface);
    let uncertain = uncertain_points(&deviations, MAX_DEVIATION * radius, LEAST_SHARE);
    object.remove_points(&uncertain);
    object.renew_errors();
    let ratio = 1.0 / object_from_ground.scale;
    let (error_px, num_uncertain) = ([before_px, after_px], uncertain.len());
    Ok(Joint { object, ratio, shares, contact, error_px, num_uncertain })
}

/// Adjusts every sub-map by itself, where there are several, and joins them.
fn settle_sub_maps(adjustment: &mut Adjustment, options: &Options) {
    let mut sub_maps = sub_maps::split(&adjustment.object);
    if sub_maps.len() > 1 {
        for sub_map in &mut sub_maps {
            let mut part = adjustment.with_object(sub_map.clone());
            match settle(&mut part) {
                Ok(_) => *sub_map = part.object,
                Err(error) => tracing::debug!("sub-map of {} images: {error}", sub_map.images.len()),
            }
        }
        adjustment.object = sub_maps::join(sub_maps, adjustment.evidence, options);
    }
}

/// Adjusts in turns with the contact until that stays.
fn settle(adjustment: &mut Adjustment) -> Result<Contact, ScaleError> {
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

/// Where the standard deviation of the ratio comes from, as far as the adjustment itself knows.
///
/// The part of the contact is what is left of the adjustment's own variance when the contact is known. For the rest
/// that variance is too small, since it takes errors for independent; only where stretches cannot be left out it stands
/// in.
fn shares(adjustment: &Adjustment, contact: &Contact) -> Result<ScaleShares, ScaleError> {
    let doubted = adjustment.in_doubt();
    let all = doubted.relative_std(contact)?;
    let of_contact_known = doubted.relative_std(&contact.known())?;
    Ok(ScaleShares {
        frames: spread::over_frames(adjustment).unwrap_or(of_contact_known),
        plane: adjustment.common_height_std(),
        contact: (all * all - of_contact_known * of_contact_known).max(0.0).sqrt(),
        ..ScaleShares::default()
    })
}

/// The median distance of an object's points from their middle.
fn object_radius(object: &Reconstruction) -> f64 {
    let center = object_center(object);
    median(object.points.values().map(|point| (point.position - center).norm()).collect()).unwrap_or(0.0)
}
