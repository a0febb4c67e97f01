//! Fit of a body of a given shape to outlines: Gauss–Newton with Cauchy weights, which suppress outliers.

use nalgebra::{Point3, SMatrix, SVector, Vector3};

use super::outline::{OutlineView, projected, support};
use super::template::Template;

/// Number of unknowns: logarithms of length, width and height; the center, forward and to the left; the yaw; the
/// ground's height.
pub(super) const NUM: usize = 7;
/// One value for every unknown.
pub(super) type Unknowns = SVector<f64, NUM>;

/// Initial values and prior standard deviations of the unknowns.
#[derive(Clone, Debug)]
pub(super) struct Expected {
    pub(super) value: Unknowns,
    pub(super) std: Unknowns,
    /// Extents of points forward, backward, to the left and to the right; empty without points.
    pub(super) reaches: Vec<Reach>,
    /// Typical proportions, for vehicles of unknown size.
    pub(super) proportions: Vec<Proportion>,
}

impl Expected {
    /// Residuals of extents and proportions, with their gradients.
    fn rows(&self, value: &Unknowns) -> impl Iterator<Item = (f64, Unknowns)> {
        let reaches = self.reaches.iter().map(|reach| reach.residual(value));
        reaches.chain(self.proportions.iter().map(|proportion| proportion.residual(value)))
    }
}

/// Logarithm of one dimension over another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Proportion {
    /// Numerator and denominator: length (0), width (1) or height (2).
    pub(super) of: [usize; 2],
    pub(super) log: f64,
    /// Its standard deviation.
    pub(super) std: f64,
}

impl Proportion {
    fn residual(&self, value: &Unknowns) -> (f64, Unknowns) {
        let [of, over] = self.of;
        let mut gradient = Unknowns::zeros();
        (gradient[of], gradient[over]) = (self.std.recip(), -self.std.recip());
        ((value[of] - value[over] - self.log) / self.std, gradient)
    }
}

/// Extent of points in a horizontal direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reach {
    /// Length (0) or width (1).
    pub(super) axis: usize,
    /// 1.0 forward or to the left, −1.0 in the opposite direction.
    pub(super) side: f64,
    /// Distance along that direction, slightly enlarged: the end of the body if that end was visible.
    pub(super) at: f64,
    /// Its standard deviation.
    pub(super) std: f64,
    /// True if that end was visible; otherwise the body may extend farther.
    pub(super) is_visible: bool,
}

impl Reach {
    /// Residual of the body's end in standard deviations, with its gradient.
    fn residual(&self, value: &Unknowns) -> (f64, Unknowns) {
        let half = 0.5 * value[self.axis].exp();
        let beyond = self.side * value[3 + self.axis] + half - self.at;
        let mut gradient = Unknowns::zeros();
        if beyond > 0.0 && !self.is_visible {
            return (0.0, gradient);
        }
        gradient[self.axis] = half / self.std;
        gradient[3 + self.axis] = self.side / self.std;
        (beyond / self.std, gradient)
    }
}

/// Best fit of a body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// The shape.
    pub(super) template: &'static Template,
    /// The unknowns.
    pub(super) value: Unknowns,
    /// Their covariance.
    pub(super) covariance: SMatrix<f64, NUM, NUM>,
    /// Robust mean of the squared residuals, in units of their variance.
    pub(super) misfit: f64,
    /// Cost of all residuals, including those of the priors.
    pub(super) cost: f64,
}

/// Standard deviations beyond which a residual loses weight.
const CAUCHY: f64 = 2.0;

/// The body's corners in the vehicle's frame.
fn placed(corners: &[Vector3<f64>], value: &Unknowns) -> Vec<Point3<f64>> {
    let [length, width, height] = [0, 1, 2].map(|k| value[k].exp());
    let (sin, cos) = value[5].sin_cos();
    let place = |c: &Vector3<f64>| {
        let (x, y) = (length * c.x, width * c.y);
        Point3::new(value[3] + cos * x - sin * y, value[4] + sin * x + cos * y, value[6] + height * c.z)
    };
    corners.iter().map(place).collect()
}

/// Distances of the body beyond every line, in standard deviations; `None` where it is not in front of a camera.
fn residuals(corners: &[Vector3<f64>], views: &[OutlineView], value: &Unknowns) -> Option<Vec<f64>> {
    let body = placed(corners, value);
    let mut all = Vec::new();
    for view in views {
        let outline: Option<Vec<_>> = body.iter().map(|p| projected(&view.cam_from_vehicle, p)).collect();
        let outline = outline?;
        all.extend(view.tangents.iter().map(|t| (support(&outline, &t.normal) - t.support) / view.std));
    }
    all.iter().all(|r| r.is_finite()).then_some(all)
}

fn cauchy(residual: f64) -> f64 {
    (1.0 + (residual / CAUCHY).powi(2)).recip()
}

fn cost(residuals: &[f64], value: &Unknowns, expected: &Expected, weight: f64) -> f64 {
    let lines: f64 = residuals.iter().map(|r| CAUCHY * CAUCHY * (r / CAUCHY).powi(2).ln_1p()).sum();
    let others: f64 = expected.rows(value).map(|(residual, _)| residual.powi(2)).sum();
    weight * lines + others + (value - expected.value).component_div(&expected.std).norm_squared()
}

/// Fits a body to outlines.
///
/// * `weight` – weight of a line, as a share of an independent observation.
///
/// `None` where the body is not in front of all cameras, or the fit is singular.
pub(super) fn fit(template: &'static Template, views: &[OutlineView], expected: &Expected, weight: f64) -> Option<Fit> {
    let corners = template.corners();
    let mut value = expected.value;
    let mut residual = residuals(&corners, views, &value)?;
    let mut now = cost(&residual, &value, expected, weight);
    let mut damping = 1e-3;
    let mut normal = SMatrix::<f64, NUM, NUM>::zeros();
    // Limit on the iterations for degenerate outlines.
    for _ in 0..30 {
        let (matrix, gradient) = linearized(&corners, views, expected, &value, &residual, weight)?;
        normal = matrix;
        let mut damped = matrix;
        for k in 0..NUM {
            damped[(k, k)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&gradient);
        let next = value - step;
        let found = residuals(&corners, views, &next).map(|r| (cost(&r, &next, expected, weight), r));
        match found.filter(|(cost, _)| *cost < now) {
            Some((better, r)) => {
                let is_done = now - better < 1e-6 * now;
                (value, residual, now, damping) = (next, r, better, damping * 0.3);
                if is_done {
                    break;
                }
            }
            None if damping > 1e6 => break,
            None => damping *= 10.0,
        }
    }
    let misfit = residual.iter().map(|r| cauchy(*r) * r * r).sum::<f64>() / residual.len().max(1) as f64;
    Some(Fit { template, value, covariance: normal.try_inverse()?, misfit, cost: now })
}

type Linear = (SMatrix<f64, NUM, NUM>, Unknowns);

/// Normal matrix and gradient, by finite differences.
fn linearized(
    corners: &[Vector3<f64>],
    views: &[OutlineView],
    expected: &Expected,
    value: &Unknowns,
    residual: &[f64],
    line_weight: f64,
) -> Option<Linear> {
    let mut columns: Vec<Vec<f64>> = Vec::with_capacity(NUM);
    for k in 0..NUM {
        // Step of the differences, in units of the prior standard deviations.
        let step = 1e-5 * expected.std[k];
        let mut moved = *value;
        moved[k] += step;
        let other = residuals(corners, views, &moved)?;
        columns.push(other.iter().zip(residual).map(|(a, b)| (a - b) / step).collect());
    }
    let prior = expected.std.map(|std| (std * std).recip());
    let mut matrix = SMatrix::<f64, NUM, NUM>::from_diagonal(&prior);
    let mut gradient = (value - expected.value).component_mul(&prior);
    for (r, jacobian) in expected.rows(value) {
        matrix += jacobian * jacobian.transpose();
        gradient += jacobian * r;
    }
    for (row, r) in residual.iter().enumerate() {
        let jacobian = Unknowns::from_fn(|k, _| columns[k][row]);
        let weight = line_weight * cauchy(*r);
        matrix += jacobian * jacobian.transpose() * weight;
        gradient += jacobian * (weight * r);
    }
    Some((matrix, gradient))
}
