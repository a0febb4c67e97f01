//! Yuan and Medioni: translation parallel to the ground.
//!
//! C. Yuan, G. Medioni, *3D Reconstruction of Background and Objects Moving on Ground Plane Viewed from a Moving
//! Camera*, CVPR 2006: the scale, approximately known from the contact with the ground, follows from the constraint
//! that the instantaneous translation is parallel to the ground plane. With one normal n for the clip, the mean of the
//! local ones,
//!
//! ```text
//! n · (Δc_i + r Δv_i) = 0,    r = −Σ (n · Δc)(n · Δv) / Σ (n · Δv)².
//! ```
//!
//! It is constant distance to the ground with residuals that add up from frame to frame, instead of independent ones.
//!
//! **Assumption**: a plane ground. **Blind** where the camera keeps its height over it.

use nalgebra::Vector3;

use super::motion::Motion;
use super::{Estimate, Estimator, EstimatorInput};
use crate::scene::ScaleMethod;
use crate::trajectory::{Options, ScaleError};

/// Row of the registry.
pub(super) struct Yuan;

impl Estimator for Yuan {
    fn method(&self) -> ScaleMethod {
        ScaleMethod::Yuan
    }

    fn estimate(&self, input: &EstimatorInput, _options: &Options) -> Result<Estimate, ScaleError> {
        Motion::new(input.views)?.jackknifed(ratio)
    }
}

/// r of translations parallel to the mean plane.
pub(super) fn ratio(motion: &Motion) -> Result<f64, ScaleError> {
    let normal = motion.normals.iter().sum::<Vector3<f64>>().try_normalize(0.0);
    let normal = normal.ok_or(ScaleError::NoMeanNormal { num_views: motion.len() })?;
    let term = |(a, b): (usize, usize)| [&motion.centers, &motion.offsets].map(|x| [normal.dot(&(x[b] - x[a]))]);
    motion.least_squares(&motion.pairs(1).map(term).collect::<Vec<_>>())
}
