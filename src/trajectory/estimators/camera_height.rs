//! Known camera height: contact with ground planes weighted by their covariance.
//!
//! S. Song, M. Chandraker, *Robust Scale Estimation in Real-Time Monocular SFM for Autonomous Driving*, CVPR 2014 (PAMI
//! 2015); B. Lee et al., IV 2015; F. Chhaya et al., ICRA 2016. The known height fixes meters (`--camera-height`), not
//! the ratio, which follows from the vehicle's contact. In addition to the contact of the paper's baseline these
//! methods have a variance of the camera's height in every frame, which reduces the weight of bad planes. With a_i the
//! smallest n · v of a frame, the object's lowest point, and w_i = 1 / σ_i²,
//!
//! ```text
//! r = Σ w_i h_i / −Σ w_i a_i.
//! ```
//!
//! **Assumption**: the lowest reconstructed point touches the ground. A clearance e makes r too large by e over h in
//! all frames, which does not appear in the spread over the frames. Its root mean square, a share of the vehicle's
//! height (`scale.joint.contact.lowest`), is therefore a term of the standard deviation in addition to the jackknife's.
//! **Blind** to no motion of the camera, but uncertain for low cameras.

use super::Estimate;
use super::motion::{Motion, positive};
use crate::math::median;
use crate::trajectory::{Options, ScaleError, Views};

/// Ratio by contact, with the clearance of the lowest point in its standard deviation.
pub(super) fn estimate(views: &Views, options: &Options) -> Result<Estimate, ScaleError> {
    // The minimum standard deviation of a plane is that of `joint`.
    let [least, _] = options.joint.sigma_distance;
    let motion = Motion::new(views)?;
    let found = motion.jackknifed(|motion| ratio(motion, least))?;
    let [mean, spread] = options.joint.contact.lowest;
    let height = median(motion.heights.clone()).unwrap_or(0.0);
    let clearance = mean.hypot(spread) * motion.object_height * found.ratio;
    let std = found.std.map(|std| std.hypot(clearance / height * found.ratio));
    Ok(Estimate::new(found.ratio, std))
}

/// r of contact, with σ_i at least a share of the camera's height.
fn ratio(motion: &Motion, least: f64) -> Result<f64, ScaleError> {
    let frames = motion.heights.iter().zip(&motion.lowest).zip(&motion.height_stds);
    let (mut heights, mut offsets) = (0.0, 0.0);
    for ((height, lowest), std) in frames {
        let std = std.max(least * height.abs());
        // Planes above the camera and points above it have no contact.
        if *height > 0.0 && *lowest < 0.0 && std.is_finite() {
            heights += height / (std * std);
            offsets += lowest / (std * std);
        }
    }
    positive(-heights / offsets)
}
