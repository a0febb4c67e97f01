//! Least squares over similarity and time offset, with correlated errors, outlier rejection and estimated noise.

use nalgebra::{DMatrix, DVector, Matrix3, Point3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::covariance::Errors;
use super::search::Start;
use super::{Alignment, MIN_FIXES, NUM_PARAMETERS, Offset, Support};
use crate::math::Sim3;
use crate::metric::CameraPath;
use crate::metric::fix::{Group, PositionFix, groups};

type Normal = SMatrix<f64, NUM_PARAMETERS, NUM_PARAMETERS>;
type Step = SVector<f64, NUM_PARAMETERS>;

/// Current parameters.
#[derive(Clone, Copy, Debug)]
struct State {
    log_scale: f64,
    rotation: UnitQuaternion<f64>,
    /// Position of the path's mean, metres.
    place: Point3<f64>,
    offset_s: f64,
}

impl State {
    fn moved(&self, step: &Step) -> Self {
        Self {
            log_scale: self.log_scale + step[0],
            rotation: UnitQuaternion::from_scaled_axis(Vector3::new(step[1], step[2], step[3])) * self.rotation,
            place: self.place + Vector3::new(step[4], step[5], step[6]),
            offset_s: self.offset_s + step[7],
        }
    }
}

/// A fit.
pub(super) struct Refined {
    pub(super) alignment: Alignment,
    /// Sum of the squared whitened residuals.
    chi2: f64,
    num_groups: usize,
    /// Diagonal of the box round the positions used, metres.
    pub(super) extent_m: f64,
}

impl Refined {
    /// Cost by which fits are compared: the residuals per group, those of outliers set to the limit.
    pub(super) fn badness(&self) -> f64 {
        let rejected = self.alignment.rejected_share * REJECTED * REJECTED;
        (self.chi2 / self.num_groups as f64 + rejected) * self.alignment.noise_factor.max(1.0).powi(2)
    }

    /// Random difference between fits of this many groups: three standard deviations of χ² over its degrees of
    /// freedom.
    pub(super) fn badness_by_chance(&self) -> f64 {
        3.0 * (2.0 / (3.0 * self.num_groups as f64)).sqrt()
    }
}

/// Standard deviations beyond which a fix is downweighted: by chance one in three hundred, in two dimensions.
const SUSPECT: f64 = 3.4;
/// Standard deviations beyond which a fix counts as a jump.
const REJECTED: f64 = 6.0;
/// Weight of a fix that jumps.
const NO_WEIGHT: f64 = 1e-6;
/// Relative change of scale and noise below which they have converged.
const SETTLED: f64 = 1e-3;
/// Weight of the stated noise, as a number of fixes.
const NOISE_PRIOR: f64 = 6.0;

struct Fit<'a> {
    path: &'a CameraPath,
    support: &'a Support,
    groups: Vec<Group>,
    times_s: Vec<f64>,
    anchor_in_world: Point3<f64>,
    state: State,
    /// Weight of the noise of each group: horizontal, vertical.
    weights: [Vec<f64>; 2],
    /// Variance of the noise over what was stated: horizontal, vertical.
    noise: [f64; 2],
}

/// Weighted residuals of the priors.
struct PriorResiduals {
    gravity: Option<(Vector3<f64>, f64)>,
    attitude: Option<(Vector3<f64>, Matrix3<f64>)>,
    /// Seconds; its weight is [`Fit::offset_weight`].
    offset_s: f64,
}

/// Groups that take part on each axis, and the covariance of their errors in the plane and upwards.
struct AxisErrors {
    members: [Vec<usize>; 3],
    horizontal: Errors,
    vertical: Option<Errors>,
}

impl AxisErrors {
    /// Axes with errors: index, members, errors.
    fn axes(&self) -> impl Iterator<Item = (usize, &[usize], &Errors)> {
        let errors = [Some(&self.horizontal), Some(&self.horizontal), self.vertical.as_ref()];
        let members = self.members.iter().zip(errors).enumerate();
        members.filter_map(|(axis, (members, errors))| Some((axis, members.as_slice(), errors?)))
    }
}

/// One axis.
struct Axis {
    jacobian: DMatrix<f64>,
    residual: DVector<f64>,
}

/// Fits the path to the fixes near a start; `None` if too few are in its time.
pub(super) fn refine(path: &CameraPath, fixes: &[PositionFix], support: &Support, start: &Start) -> Option<Refined> {
    let used: Vec<PositionFix> = fixes.iter().filter(|fix| path.covers(fix.time_s - start.offset_s)).copied().collect();
    if used.len() < MIN_FIXES {
        return None;
    }
    let groups = groups(&used);
    let mut fit = Fit::new(path, support, groups, start);
    fit.weigh_by_start();
    // Maximum number of updates of weights and noise.
    for _ in 0..12 {
        let before = (fit.state.log_scale, fit.noise[0]);
        fit.settle()?;
        fit.reweigh()?;
        if (fit.state.log_scale - before.0).abs() < SETTLED && (fit.noise[0] / before.1 - 1.0).abs() < SETTLED {
            break;
        }
    }
    fit.settle()?;
    fit.finish(used.len())
}

impl<'a> Fit<'a> {
    fn new(path: &'a CameraPath, support: &'a Support, groups: Vec<Group>, start: &Start) -> Self {
        let times_s: Vec<f64> = groups.iter().map(Group::time_s).collect();
        let sum: Vector3<f64> = groups.iter().map(|group| path.at(group.time_s() - start.offset_s).0.coords).sum();
        let anchor_in_world = Point3::from(sum / groups.len() as f64);
        let Sim3 { scale, rotation, .. } = start.metric_from_world;
        let place = start.metric_from_world * anchor_in_world;
        let state = State { log_scale: scale.ln(), rotation, place, offset_s: start.offset_s };
        let weights = [vec![1.0; groups.len()], vec![1.0; groups.len()]];
        Self { path, support, groups, times_s, anchor_in_world, state, weights, noise: [1.0; 2] }
    }

    /// Centre (from the mean) and velocity of the camera for a group, turned and scaled into metres.
    fn moved(&self, state: &State, group: &Group) -> (Vector3<f64>, Vector3<f64>) {
        let (mut arm, mut velocity) = (Vector3::zeros(), Vector3::zeros());
        for time_s in &group.times_s {
            let (center, rate) = self.path.at(time_s - state.offset_s);
            arm += center - self.anchor_in_world;
            velocity += rate;
        }
        let factor = state.log_scale.exp() / group.times_s.len() as f64;
        (state.rotation * arm * factor, state.rotation * velocity * factor)
    }

    /// Residual of a group: its position minus the path's, metres.
    fn residuals(&self, state: &State) -> Vec<Vector3<f64>> {
        let residual = |group: &Group| group.position_m - (state.place + self.moved(state, group).0);
        self.groups.iter().map(residual).collect()
    }

    /// Initial weights; fixes far from the robust initial alignment have none.
    fn weigh_by_start(&mut self) {
        let residuals = self.residuals(&self.state);
        for (j, (group, residual)) in self.groups.iter().zip(&residuals).enumerate() {
            let std_m = group.wander_m[0].hypot(group.noise_m2[0].sqrt());
            if residual.xy().norm() > REJECTED * std_m {
                self.weights[0][j] = NO_WEIGHT;
                self.weights[1][j] = NO_WEIGHT;
            }
        }
    }

    /// Groups used on an axis: all of them horizontally, those with a height vertically.
    fn members(&self, axis: usize) -> Vec<usize> {
        (0..self.groups.len()).filter(|&j| axis < 2 || self.groups[j].has_up).collect()
    }

    fn errors(&self, axis: usize, members: &[usize]) -> Option<Errors> {
        let kind = usize::from(axis == 2);
        let path_m2 = (self.path.center_std * self.state.log_scale.exp()).powi(2);
        let noise = members.iter().map(|&j| {
            let group = &self.groups[j];
            (group.noise_m2[kind] * self.noise[kind] + path_m2 / group.times_s.len() as f64) / self.weights[kind][j]
        });
        let noise = DVector::from_iterator(members.len(), noise.map(|variance| variance.max(1e-8)));
        let times_s: Vec<f64> = members.iter().map(|&j| self.times_s[j]).collect();
        let wander_m: Vec<f64> = members.iter().map(|&j| self.groups[j].wander_m[kind]).collect();
        Errors::new(&times_s, &wander_m, noise)
    }

    /// Derivatives of the predicted positions along an axis, and the residuals.
    fn axis(&self, state: &State, axis: usize, members: &[usize]) -> Axis {
        let mut jacobian = DMatrix::zeros(members.len(), NUM_PARAMETERS);
        let mut residual = DVector::zeros(members.len());
        for (row, &j) in members.iter().enumerate() {
            let (arm, velocity) = self.moved(state, &self.groups[j]);
            let turn = -arm.cross_matrix();
            jacobian[(row, 0)] = arm[axis];
            for i in 0..3 {
                jacobian[(row, 1 + i)] = turn[(axis, i)];
            }
            jacobian[(row, 4 + axis)] = 1.0;
            jacobian[(row, 7)] = -velocity[axis];
            residual[row] = (self.groups[j].position_m - (state.place + arm))[axis];
        }
        Axis { jacobian, residual }
    }

    fn axis_errors(&self) -> Option<AxisErrors> {
        let members = [0, 1, 2].map(|axis| self.members(axis));
        let horizontal = self.errors(0, &members[0])?;
        let vertical = if members[2].is_empty() { None } else { Some(self.errors(2, &members[2])?) };
        Some(AxisErrors { members, horizontal, vertical })
    }

    /// Gauss–Newton at fixed weights; steps that increase the cost are halved.
    fn settle(&mut self) -> Option<()> {
        let errors = self.axis_errors()?;
        for _ in 0..6 {
            let (damped, gradient) = self.normal(&errors);
            let mut step = limited(damped.cholesky()?.solve(&gradient));
            let before = self.cost(&self.state, &errors);
            let mut tries = 0;
            while !(self.cost(&self.state.moved(&step), &errors) <= before) && tries < 12 {
                step *= 0.5;
                tries += 1;
            }
            if tries == 12 {
                break;
            }
            self.state = self.state.moved(&step);
            if step.norm() < 1e-9 {
                break;
            }
        }
        Some(())
    }

    /// Normal equations, with uninformative priors on scale, rotation and position.
    fn normal(&self, errors: &AxisErrors) -> (Normal, Step) {
        let (mut normal, mut gradient) = self.priors(&self.state);
        for (axis, members, errors) in errors.axes() {
            let Axis { jacobian, residual } = self.axis(&self.state, axis, members);
            let weighted = errors.solve(&jacobian);
            normal += Normal::from_iterator((weighted.transpose() * &jacobian).iter().copied());
            gradient += Step::from_iterator((weighted.transpose() * residual).iter().copied());
        }
        let free = [5.0, 1.8, 1.8, 1.8, 1e5, 1e5, 1e5, 60.0].map(|std: f64| 1.0 / (std * std));
        (normal + Normal::from_diagonal(&SVector::from(free)), gradient)
    }

    /// Twice the negative logarithm of the likelihood, up to a constant.
    fn cost(&self, state: &State, errors: &AxisErrors) -> f64 {
        let residuals = self.residuals(state);
        let of_axis = |(axis, members, errors): (usize, &[usize], &Errors)| {
            let residual = DMatrix::from_iterator(members.len(), 1, members.iter().map(|&j| residuals[j][axis]));
            residual.dot(&errors.solve(&residual))
        };
        errors.axes().map(of_axis).sum::<f64>() + self.prior_cost(state)
    }

    /// Residuals and weights of the priors on rotation and offset.
    fn prior_residuals(&self, state: &State) -> PriorResiduals {
        let gravity = self
            .support
            .gravity
            .map(|gravity| (Vector3::z() - state.rotation * gravity.up_in_world, 1.0 / (gravity.std * gravity.std)));
        let attitude = self.support.orientation.map(|known| {
            let turn = (known.metric_from_world * state.rotation.inverse()).scaled_axis();
            let (tilt, heading) = (known.tilt_std.powi(-2), known.heading_std.powi(-2));
            (turn, Matrix3::from_diagonal(&Vector3::new(tilt, tilt, heading)))
        });
        let offset_s = match self.support.offset {
            Offset::Known { mean_s, .. } => mean_s - state.offset_s,
            Offset::Unknown => 0.0,
        };
        PriorResiduals { gravity, attitude, offset_s }
    }

    fn offset_weight(&self) -> f64 {
        match self.support.offset {
            Offset::Known { std_s, .. } => std_s.max(1e-6).powi(-2),
            Offset::Unknown => 0.0,
        }
    }

    fn prior_cost(&self, state: &State) -> f64 {
        let PriorResiduals { gravity, attitude, offset_s } = self.prior_residuals(state);
        gravity.map_or(0.0, |(residual, weight)| weight * residual.norm_squared())
            + attitude.map_or(0.0, |(residual, weight)| residual.dot(&(weight * residual)))
            + self.offset_weight() * offset_s * offset_s
    }

    fn priors(&self, state: &State) -> (Normal, Step) {
        let (mut normal, mut gradient) = (Normal::zeros(), Step::zeros());
        let PriorResiduals { gravity, attitude, offset_s } = self.prior_residuals(state);
        let mut add = |jacobian: Matrix3<f64>, weight: Matrix3<f64>, residual: Vector3<f64>| {
            let weighted = jacobian.transpose() * weight;
            let mut block = normal.fixed_view_mut::<3, 3>(1, 1);
            block += weighted * jacobian;
            let mut part = gradient.fixed_rows_mut::<3>(1);
            part += weighted * residual;
        };
        if let (Some((residual, weight)), Some(gravity)) = (gravity, self.support.gravity) {
            // d(R up) / dθ = −[R up]×.
            let turn = -(state.rotation * gravity.up_in_world).cross_matrix();
            add(turn, Matrix3::from_diagonal_element(weight), residual);
        }
        if let Some((residual, weight)) = attitude {
            add(Matrix3::identity(), weight, residual);
        }
        normal[(7, 7)] += self.offset_weight();
        gradient[7] += self.offset_weight() * offset_s;
        (normal, gradient)
    }

    /// Updates the weight of each fix by the others, and the noise by residuals (docs/maths/metric.md, eqs. 4 and 5).
    fn reweigh(&mut self) -> Option<()> {
        let residuals = self.residuals(&self.state);
        let mut distances = [vec![0.0; self.groups.len()], vec![0.0; self.groups.len()]];
        let mut sums = [[0.0; 2]; 2];
        for axis in 0..3 {
            let kind = usize::from(axis == 2);
            let members = self.members(axis);
            if members.is_empty() {
                continue;
            }
            let errors = self.errors(axis, &members)?;
            let residual = DMatrix::from_iterator(members.len(), 1, members.iter().map(|&j| residuals[j][axis]));
            let inverse = errors.inverse();
            let alpha = &inverse * residual;
            for (row, &j) in members.iter().enumerate() {
                let (precision, noise, weight) = (inverse[(row, row)], errors.noise[row], self.weights[kind][j]);
                let predicted = (1.0 / precision - noise).max(0.0) + noise * weight;
                distances[kind][j] += (alpha[row] / precision).powi(2) / predicted;
                if weight > 0.5 {
                    sums[kind][0] += noise * alpha[row] * alpha[row];
                    sums[kind][1] += noise * precision;
                }
            }
            // The parameters reduce the degrees of freedom: eight over three axes.
            sums[kind][1] -= (NUM_PARAMETERS as f64 / 3.0) * (1.0 - wander_share(&errors, &members, self, kind));
        }
        for kind in 0..2 {
            for (weight, distance2) in self.weights[kind].iter_mut().zip(&distances[kind]) {
                *weight = weight_of(distance2.sqrt());
            }
            let [found, expected] = sums[kind];
            let expected = expected.max(0.0);
            let noise = self.noise[kind] * (found + NOISE_PRIOR / self.noise[kind]) / (expected + NOISE_PRIOR);
            self.noise[kind] = noise.clamp(1e-3, 1e3);
        }
        // A jump is one of the whole fix.
        for j in 0..self.groups.len() {
            if self.weights[0][j] <= NO_WEIGHT {
                self.weights[1][j] = NO_WEIGHT;
            }
        }
        Some(())
    }

    fn finish(self, num_fixes: usize) -> Option<Refined> {
        let errors = self.axis_errors()?;
        let (normal, _) = self.normal(&errors);
        let covariance = normal.cholesky()?.inverse();
        let rejected = self.weights[0].iter().filter(|weight| **weight <= NO_WEIGHT).count();
        let chi2 = self.cost(&self.state, &errors);
        let State { log_scale, rotation, place, offset_s } = self.state;
        let scale = log_scale.exp();
        let translation = place.coords - rotation * self.anchor_in_world.coords * scale;
        let alignment = Alignment {
            metric_from_world: Sim3::new(scale, rotation, translation),
            anchor_in_world: self.anchor_in_world,
            covariance: covariance.fixed_view::<7, 7>(0, 0).into_owned(),
            offset_s,
            offset_std_s: covariance[(7, 7)].sqrt(),
            num_fixes,
            rejected_share: rejected as f64 / self.groups.len() as f64,
            noise_factor: self.noise[0].sqrt(),
        };
        let is_finite = covariance.iter().all(|value| value.is_finite()) && log_scale.is_finite();
        let (num_groups, extent_m) = (self.groups.len(), extent_m(&self.groups));
        is_finite.then_some(Refined { alignment, chi2, num_groups, extent_m })
    }
}

/// Mean share of correlated noise in the variance of an axis.
fn wander_share(errors: &Errors, members: &[usize], fit: &Fit, kind: usize) -> f64 {
    let drift: f64 = members.iter().map(|&j| fit.groups[j].wander_m[kind].powi(2)).sum();
    drift / (drift + errors.noise.sum())
}

fn weight_of(distance: f64) -> f64 {
    if distance <= SUSPECT {
        1.0
    } else if distance <= REJECTED {
        (SUSPECT / distance).powi(2)
    } else {
        NO_WEIGHT
    }
}

/// Limits a step to the validity of the linearisation.
fn limited(step: Step) -> Step {
    // Maximum step of each parameter: logarithm of the scale, rotation in radians, position, clock offset in seconds.
    const MAX_STEP: [f64; NUM_PARAMETERS] = [0.7, 0.5, 0.5, 0.5, f64::INFINITY, f64::INFINITY, f64::INFINITY, 1.0];
    let shares = step.iter().zip(MAX_STEP).map(|(value, most)| value.abs() / most);
    step / shares.fold(1.0, f64::max)
}

fn extent_m(groups: &[Group]) -> f64 {
    let side = |axis: usize| {
        let values = groups.iter().map(|group| group.position_m[axis]);
        let (least, most) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        most - least
    };
    side(0).hypot(side(1))
}
