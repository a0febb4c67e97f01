//! Depth of a vehicle's footprint from the extents of its mask.
//!
//! A box of length L, width W and height H, with its long side at the angle φ to the image plane and the line of sight
//! at the angle ε below the horizon, has the extents
//!
//! ```text
//! a = L cos φ + W sin φ,    e = d sin ε + H cos ε,    d = L sin φ + W cos φ                                        (1)
//! ```
//!
//! along the edge on the ground and across it. H is a share of W and W one of L, each known to some percent for all
//! vehicles from small cars to lorries. Then e / a constrains φ: the depth d is the mean over all φ and W / L by their
//! likelihood, and its standard deviation that of the same distribution.

use std::f64::consts::FRAC_PI_2;

use crate::trajectory::body::{HEIGHT_PER_WIDTH, WIDTH_PER_LENGTH, WIDTH_STD};

/// Standard deviation of the logarithm of an extent: by the spread of heights (0.12), by masks, and by the shape of
/// vehicles, which do not fill the box at their hoods and corners.
const EXTENT_STD: f64 = 0.15;
/// Number of steps of φ: more change the depth by less than a percent.
const NUM_ANGLES: i32 = 36;
/// Number of steps of W / L to either side: more change the depth by less than a percent.
const NUM_WIDTHS: i32 = 6;
/// Range of W / L to either side, standard deviations.
const REACH: f64 = 3.0;

/// Depth of the footprint along the horizontal line of sight, and its standard deviation, in the unit of the extents.
///
/// `None` where the extents are not positive and finite.
///
/// * `extents` – of the mask at the distance of the vehicle: along the edge on the ground, and across it.
/// * `dip_sine` – sine of the angle of the line of sight below the horizon.
pub(super) fn depth([along, across]: [f64; 2], dip_sine: f64) -> Option<(f64, f64)> {
    let dip_cosine = (1.0 - dip_sine * dip_sine).max(0.0).sqrt();
    let [mut total, mut sum, mut squares] = [0.0; 3];
    for angle in (0..=NUM_ANGLES).map(|k| FRAC_PI_2 * f64::from(k) / f64::from(NUM_ANGLES)) {
        let (sine, cosine) = angle.sin_cos();
        for k in -NUM_WIDTHS..=NUM_WIDTHS {
            let off = REACH * f64::from(k) / f64::from(NUM_WIDTHS);
            let width_per_length = WIDTH_PER_LENGTH * (WIDTH_STD * off).exp();
            let width = along / (cosine / width_per_length + sine);
            let depth = width * (sine / width_per_length + cosine);
            let expected = depth * dip_sine + HEIGHT_PER_WIDTH * width * dip_cosine;
            let residual = (across / expected).ln() / EXTENT_STD;
            let weight = (-0.5 * (off * off + residual * residual)).exp();
            total += weight;
            sum += weight * depth;
            squares += weight * depth * depth;
        }
    }
    let mean = sum / total;
    let variance = squares / total - mean * mean;
    (mean.is_finite() && variance.is_finite()).then(|| (mean, variance.max(0.0).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Length, width and height, meters.
    const CAR: [f64; 3] = [4.4, 1.8, 1.5];
    const SMALL_CAR: [f64; 3] = [2.7, 1.66, 1.55];
    const VAN: [f64; 3] = [5.0, 1.9, 1.9];
    const LORRY: [f64; 3] = [8.0, 2.5, 3.3];

    #[test]
    fn extents_of_a_mask_determine_the_depth_of_a_vehicle() {
        let (mut inside, mut all) = ([0, 0], 0);
        let [mut by_mean, mut by_edge] = [0.0; 2];
        for [length, width, height] in [CAR, SMALL_CAR, VAN, LORRY] {
            for dip in [0.1f64, 0.3, 0.6, 1.0, 1.5] {
                for turn in (0..=9).map(|k| f64::from(k) * 0.17) {
                    let (sine, cosine) = f64::sin_cos(turn);
                    let truth = length * sine + width * cosine;
                    let across = truth * dip.sin() + height * dip.cos();
                    let (found, std) = depth([length * cosine + width * sine, across], dip.sin()).unwrap();
                    inside[0] += i32::from((found - truth).abs() <= std);
                    inside[1] += i32::from((found - truth).abs() <= 2.0 * std);
                    all += 1;
                    by_mean += (found - truth).abs();
                    by_edge += truth;
                }
            }
        }
        let [one, two] = inside.map(|inside| f64::from(inside) / f64::from(all));
        assert!(one > 0.6 && two > 0.95, "{one} {two}");
        assert!(by_mean < 0.2 * by_edge, "{by_mean} {by_edge}");
    }

    #[test]
    fn lengths_of_any_unit_are_accepted_and_nan_has_no_depth() {
        let (one, thousandth) = (depth([3.0, 2.0], 0.5).unwrap(), depth([0.003, 0.002], 0.5).unwrap());
        assert!((one.0 / thousandth.0 - 1000.0).abs() < 1e-6 && (one.1 / thousandth.1 - 1000.0).abs() < 1e-6);
        assert_eq!(depth([f64::NAN, 1.0], 0.5), None);
        assert_eq!(depth([1.0, 0.0], 0.5), None);
    }
}
