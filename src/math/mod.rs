//! Arithmetic that every room shares: rigid and similarity transforms, robust losses, seeded random numbers, rounding.

mod align;
mod decomposition;
mod direct_linear;
mod neighbors;
mod parallax;
mod points;
pub mod polynomial;
mod random;
mod rigid3;
mod robust_loss;
pub mod rounding;
mod sim3;
mod statistics;
mod wxyz;

pub use align::umeyama;
pub use decomposition::{svd3, symmetric_eigen};
#[cfg(feature = "sfm")]
pub(crate) use direct_linear::{epipolar_row, null_matrices};
pub use direct_linear::{fundamental_from_points, homography_from_points};
pub(crate) use neighbors::Neighbors;
pub use parallax::widest_angle;
pub use points::{across, any_across, centroid, is_finite};
pub use random::{Rng, seeded_rng};
pub use rigid3::Rigid3;
pub use robust_loss::RobustLoss;
pub use sim3::Sim3;
pub use statistics::{
    JACKKNIFE_GROUPS, RAYLEIGH_MEDIAN, STD_PER_MAD, bin, jackknife_groups, jackknife_std, lower_quantile, median,
    quantile, quantile_range, student_4, upper_median,
};
pub(crate) use wxyz::MAX_UNIT_ERROR;
