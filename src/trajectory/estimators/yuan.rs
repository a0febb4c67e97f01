//! Yuan and Medioni: translation parallel to the ground.
//!
//! C. Yuan, G. Medioni, *3D Reconstruction of Background and Objects Moving on Ground Plane Viewed from a Moving
//! Camera*, CVPR 2006: the scale, approximately known from the contact with the ground, follows from the constraint
//! that the instantaneous translation is parallel to the ground plane,
//!
//! ```text
//! n · (Δc_i + r Δv_i) = 0,    r = −Σ (n · Δc)(n · Δv) / Σ (n · Δv)².
//! ```
//!
//! `yuan` has one normal n for the clip as in the source, the mean of the local ones; `yuan-local`, a variant of ours
//! for ground that is not planar, the mean of both frames' local normals. It is constant distance to the ground with
//! residuals that accumulate from frame to frame, instead of independent ones.
//!
//! **Assumption**: a ground that is planar, or locally so. **Blind** where the camera keeps its height over it.

use nalgebra::Vector3;

use super::motion::Motion;
use crate::trajectory::ScaleError;

/// r of translations parallel to the mean plane.
pub(super) fn ratio(motion: &Motion) -> Result<f64, ScaleError> {
    let normal = motion.normals.iter().sum::<Vector3<f64>>().try_normalize(0.0);
    let normal = normal.ok_or(ScaleError::NoMeanNormal { num_views: motion.len() })?;
    parallel(motion, |_, _| normal)
}

/// r of translations parallel to the local planes.
pub(super) fn local_ratio(motion: &Motion) -> Result<f64, ScaleError> {
    // Opposite normals have no mean: such a pair has no weight.
    parallel(motion, |a, b| (motion.normals[a] + motion.normals[b]).try_normalize(0.0).unwrap_or_default())
}

fn parallel(motion: &Motion, normal: impl Fn(usize, usize) -> Vector3<f64>) -> Result<f64, ScaleError> {
    let term = |(a, b): (usize, usize)| {
        let normal = normal(a, b);
        [&motion.centers, &motion.offsets].map(|x| [normal.dot(&(x[b] - x[a]))])
    };
    motion.least_squares(&motion.pairs(1).map(term).collect::<Vec<_>>())
}
