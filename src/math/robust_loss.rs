//! Robust losses ρ(s) on squared residuals s = ‖e‖²; a cost is ½ Σ ρ(s), as in Ceres.

use serde::{Deserialize, Serialize};

/// A loss function. Scales are in the unit of the residual (pixels in bundle adjustment).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum RobustLoss {
    /// ρ(s) = s.
    Squared,
    /// Quadratic up to `scale`, then linear (Huber, 1964).
    Huber {
        /// Residual at which the loss becomes linear.
        scale: f64,
    },
    /// ρ(s) = c² log(1 + s / c²).
    Cauchy {
        /// c.
        scale: f64,
    },
    /// ρ(s) = 2 c² (√(1 + s / c²) − 1).
    SoftL1 {
        /// c.
        scale: f64,
    },
}

impl RobustLoss {
    /// `[ρ(s), ρ'(s), ρ''(s)]` for a squared residual norm `s ≥ 0`.
    pub fn evaluate(&self, s: f64) -> [f64; 3] {
        match *self {
            Self::Squared => [s, 1.0, 0.0],
            Self::Huber { scale } => {
                let b = scale * scale;
                if s <= b {
                    [s, 1.0, 0.0]
                } else {
                    let r = s.sqrt();
                    let slope = scale / r;
                    [2.0 * scale * r - b, slope, -slope / (2.0 * s)]
                }
            }
            Self::Cauchy { scale } => {
                let b = scale * scale;
                let inverse = 1.0 / (1.0 + s / b);
                [b * (s / b).ln_1p(), inverse, -inverse * inverse / b]
            }
            Self::SoftL1 { scale } => {
                let b = scale * scale;
                let root = (1.0 + s / b).sqrt();
                [2.0 * b * (root - 1.0), 1.0 / root, -0.5 / (b * root * root * root)]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_match_finite_differences() {
        let losses = [
            RobustLoss::Squared,
            RobustLoss::Huber { scale: 1.5 },
            RobustLoss::Cauchy { scale: 0.7 },
            RobustLoss::SoftL1 { scale: 2.0 },
        ];
        for loss in losses {
            assert_eq!(loss.evaluate(0.0)[0], 0.0);
            for s in [0.01, 0.5, 2.0, 30.0, 1e4] {
                let h = 1e-5 * s;
                let [_, first, second] = loss.evaluate(s);
                let numeric = (loss.evaluate(s + h)[0] - loss.evaluate(s - h)[0]) / (2.0 * h);
                let numeric2 = (loss.evaluate(s + h)[1] - loss.evaluate(s - h)[1]) / (2.0 * h);
                assert!((first - numeric).abs() < 1e-6 * (1.0 + first.abs()), "{loss:?} at {s}");
                assert!((second - numeric2).abs() < 1e-6 * (1.0 + second.abs()), "{loss:?} at {s}");
            }
        }
    }
}
