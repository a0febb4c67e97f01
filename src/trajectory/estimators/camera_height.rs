//! Known camera height: contact with ground planes that count by their covariance.
//!
//! S. Song, M. Chandraker, *Robust Scale Estimation in Real-Time Monocular SFM for Autonomous Driving*, CVPR 2014
//! (PAMI 2015); B. Lee et al., IV 2015; F. Chhaya et al., ICRA 2016. The known height fixes meters
//! (`--camera-height`), not the ratio, which follows from the vehicle's contact. What these add to the contact of the
//! paper's baseline is a variance of the camera's height in every frame, so that a bad plane counts less. With a_i the
//! smallest n · v of a frame, the object's lowest point, and w_i = 1 / σ_i²,
//!
//! ```text
//! r = Σ w_i h_i / −Σ w_i a_i.
//! ```
//!
//! **Assumption**: the lowest reconstructed point touches the ground; a floating one makes r too large by clearance
//! over height in all frames. No spread over frames shows that, so there is no standard deviation. **Blind** to nothing
//! of the camera's motion.

use super::motion::{Motion, positive};
use super::{Estimate, Estimator, EstimatorInput};
use crate::scene::ScaleMethod;
use crate::trajectory::{Options, ScaleError};

/// Row of the registry.
pub(super) struct CameraHeight;

impl Estimator for CameraHeight {
    fn method(&self) -> ScaleMethod {
        ScaleMethod::CameraHeight
    }

    fn estimate(&self, input: &EstimatorInput, options: &Options) -> Result<Estimate, ScaleError> {
        // No plane is better than the best that `joint` reckons with.
        let [least, _] = options.joint.sigma_distance;
        Ok(Estimate::new(ratio(&Motion::new(input.views)?, least)?, None))
    }
}

/// r of contact, with σ_i no less than a share of the camera's height.
fn ratio(motion: &Motion, least: f64) -> Result<f64, ScaleError> {
    let frames = motion.heights.iter().zip(&motion.lowest).zip(&motion.height_stds);
    let (mut heights, mut offsets) = (0.0, 0.0);
    for ((height, lowest), std) in frames {
        let std = std.max(least * height.abs());
        // Planes above the camera and points above it are no contact.
        if *height > 0.0 && *lowest < 0.0 && std.is_finite() {
            heights += height / (std * std);
            offsets += lowest / (std * std);
        }
    }
    positive(-heights / offsets)
}
