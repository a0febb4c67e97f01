//! Smoothed motion of a vehicle, in meters, from all of its positions.
//!
//! Positions are smoothed under white jerk ([`track`], [`chain`]), which gives speed and acceleration with their
//! standard deviations. If the object's model has a forward axis, the heading is smoothed in the same way, and speeds
//! are signed along it. Errors of positions are mostly along the line of sight: a part is independent in every frame,
//! and a part is slowly correlated. The errors that all frames share, those of the scale ratio and of meters per unit,
//! are not reduced by smoothing, and are added to the standard deviations. Path length and displacement: [`travel`].
//! Derivations: docs/maths/smoother.md.

mod chain;
mod track;
mod travel;

#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use self::track::{MotionPrior, Observed, Track, is_at_rest, track};
use self::travel::resolved_amount;
use crate::scene::{ContactError, Estimate, Motion, Movement};

/// Measured position of a vehicle, in a frame in meters whose third axis points up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionMeasurement {
    /// Time, seconds.
    pub time_s: f64,
    /// Position of the vehicle.
    pub position_m: Vector3<f64>,
    /// Position of the camera.
    pub camera_m: Vector3<f64>,
    /// Forward direction of the object's model; `None` without a forward axis.
    pub forward: Option<Vector3<f64>>,
    /// Error of the position.
    pub error: PositionError,
}

/// Error of a measured position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PositionError {
    /// Of a reconstructed vehicle: proportional to the distance to the camera, and the error of the scale ratio, which
    /// all frames share.
    Model {
        /// Additional covariance by its pose in this frame, m².
        pose: Matrix3<f64>,
    },
    /// Of a contact point with the ground, meters.
    Contact(ContactError),
}

impl Default for PositionError {
    /// Of a reconstructed vehicle with exact poses.
    fn default() -> Self {
        Self::Model { pose: Matrix3::zeros() }
    }
}

/// Errors that all frames share: standard deviations of logarithms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CommonStd {
    /// Of the object's scale ratio, which moves it along the lines of sight.
    pub ratio: f64,
    /// Of meters per unit, which scales all lengths.
    pub scale: f64,
}

/// Standard deviation of a position along the line of sight, independent in every frame, as a share of the distance to
/// the camera. It and the next three were chosen on fifteen rendered sequences; docs/maths/smoother.md.
const ALONG: f64 = 5e-4;
/// Standard deviation of a position across the line of sight, independent in every frame, as a share of the distance.
const ACROSS: f64 = 1e-4;
/// Standard deviation of the correlated error along the line of sight, as a share of the distance.
pub(super) const DRIFT: f64 = 1.5e-3;
/// Standard deviation of the correlated error across the line of sight, as a share of the distance.
const DRIFT_ACROSS: f64 = 1.2e-3;
/// Positions of a vehicle in traffic: meters, m/s, m/s², m²/s⁵.
const MOVING: MotionPrior =
    MotionPrior { first: [10.0, 40.0, 5.0], prior_jerk: 1.0, last_axis: 0.1, drift_s: &[1.0, 3.0, 3.0, 3.0] };
/// Headings: radians, rad/s, rad/s², rad²/s⁵.
const HEADING: MotionPrior = MotionPrior { first: [1.0, 1.0, 1.0], prior_jerk: 0.05, last_axis: 1.0, drift_s: &[1.0] };
/// Standard deviation of the forward axis after a long displacement, radians: the same error in all frames.
const FORWARD_STD: f64 = 0.02;
/// Standard deviations by which a speed or a displacement must differ from zero to be significant.
const SIGNIFICANT_STDS: f64 = 3.0;

/// Smoothed motion of a vehicle, meters and seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothed {
    /// Motion at every measurement.
    pub motions: Vec<Motion>,
    /// Length of the smoothed trajectory at the resolution of its uncertainty, with its total standard deviation.
    pub path_m: Estimate,
    /// Distance between the first and the last position.
    pub displacement_m: Estimate,
    /// Maximum speed in any frame, with its standard deviation there; a speed within three standard deviations of zero
    /// is corrected for noise.
    pub max_speed_m_s: Estimate,
}

/// Smooths a vehicle's motion; `None` for fewer than four measurements, or if numbers are not finite.
///
/// * `measurements` – ascending in time; gaps are bridged with growing standard deviations.
/// * `movement` – motion state by other evidence: a moving vehicle is not smoothed as stationary.
///
/// A stationary vehicle is recognized by its positions alone, from the likelihoods of rest and of motion.
pub fn smooth(measurements: &[PositionMeasurement], common: &CommonStd, movement: Movement) -> Option<Smoothed> {
    let in_motion = in_motion(measurements)?;
    let origin = measurements[0].position_m;
    // Also for a stationary vehicle: a slow one that moves parallel to the camera has the same positions, with another
    // error of the ratio.
    let response = |errors: Vec<DVector<f64>>| in_motion.response(&errors);
    let moved = [
        response(measurements.iter().map(|s| s.common_error(common.ratio)).collect())?,
        response(measurements.iter().map(PositionMeasurement::focal_error).collect())?,
    ];
    // Contact points are too coarse to distinguish rest from motion: rest by default would give the speed a wrong
    // standard deviation.
    let is_coarse = measurements.iter().any(|s| matches!(s.error, PositionError::Contact(_)));
    let may_rest = !is_coarse && movement != Movement::Moving;
    let rest = may_rest.then(|| at_rest(measurements, &origin, common.ratio)).flatten();
    let is_stationary = rest.is_some();
    let positions = rest.unwrap_or(in_motion);
    let forward_std = forward_std(measurements, common.ratio).filter(|_| !is_stationary);
    let headings = forward_std.and_then(|std| Some((headings(measurements)?, std)));
    let all = Tracks { measurements, origin, positions, moved, headings, scale_std: common.scale };
    let motions: Vec<Motion> = (0..measurements.len()).map(|k| all.motion(k)).collect();
    let (path_m, displacement_m) = (all.path(), all.displacement());
    let fastest = motions.iter().max_by(|a, b| a.speed_m_s.abs().total_cmp(&b.speed_m_s.abs()))?;
    let max_speed_m_s = resolved_amount(fastest.speed_m_s, fastest.speed_std_m_s);
    let lengths = [path_m, displacement_m, max_speed_m_s];
    let are_finite = lengths.iter().all(|e| e.value.is_finite() && e.std.is_finite()) && motions.iter().all(is_finite);
    are_finite.then_some(Smoothed { motions, path_m, displacement_m, max_speed_m_s })
}

/// Residual of a position from the smoothed motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residual {
    pub(super) distance_m: f64,
    /// In standard deviations of the errors that are independent in every frame.
    pub(super) normalized: f64,
}

/// Residuals of a moving vehicle; `None` as for [`smooth`].
pub(super) fn residuals(measurements: &[PositionMeasurement]) -> Option<Vec<Residual>> {
    let track = in_motion(measurements)?;
    let origin = measurements[0].position_m;
    let residual = |(k, seen): (usize, &PositionMeasurement)| {
        let smoothed = track.states[k].mean.fixed_rows::<3>(0) + origin;
        Residual { distance_m: (seen.position_m - smoothed).norm(), normalized: track.squares[k].sqrt() }
    };
    Some(measurements.iter().enumerate().map(residual).collect())
}

/// Smoothed positions of a moving vehicle, relative to the first; `None` as for [`smooth`].
fn in_motion(measurements: &[PositionMeasurement]) -> Option<Track> {
    if measurements.len() < 4 || !measurements.iter().all(PositionMeasurement::is_usable) {
        return None;
    }
    let origin = measurements[0].position_m;
    track(&measurements.iter().map(|s| s.observed(&origin)).collect::<Vec<_>>(), &MOVING)
}

/// Smoothed positions of a stationary vehicle.
///
/// `None` where motion is likelier, or where rest requires an error of the ratio of more than a standard deviation. An
/// error of the ratio moves a stationary vehicle along with the camera, by that share of the camera's path. It is a
/// state of both hypotheses, otherwise no vehicle would be stationary for a moving camera.
fn at_rest(measurements: &[PositionMeasurement], origin: &Vector3<f64>, ratio: f64) -> Option<Track> {
    let observed: Vec<Observed> =
        measurements.iter().map(|s| s.observed(origin).with_common(&s.common_error(ratio))).collect();
    // The error of the ratio is constant.
    let moving = MotionPrior { drift_s: &[1.0, 3.0, 3.0, 3.0, f64::INFINITY], ..MOVING };
    let rest = moving.at_rest(0.02);
    let found = is_at_rest(&observed, &moving, &rest).then(|| track(&observed, &rest))??;
    let last = found.states.last()?;
    // From one standard deviation on, lengths corrected for noise ([`travel`]) are positive. Below, the length in
    // motion is zero as well, so that a decision for rest keeps the coverage at any speed.
    (last.mean[last.mean.len() - 1].abs() <= 1.0).then_some(found)
}

impl PositionMeasurement {
    /// Displacement by one standard deviation of the error that all frames share: of a model, that of the ratio.
    ///
    /// * `ratio` – relative standard deviation of the ratio.
    fn common_error(&self, ratio: f64) -> DVector<f64> {
        match self.error {
            PositionError::Model { .. } => dynamic(&(ratio * (self.position_m - self.camera_m))),
            PositionError::Contact(error) => dynamic(&Vector3::from(error.common)),
        }
    }

    /// The same for the focal length; that of a model is part of its ratio.
    fn focal_error(&self) -> DVector<f64> {
        match self.error {
            PositionError::Model { .. } => DVector::zeros(3),
            PositionError::Contact(error) => dynamic(&Vector3::from(error.focal)),
        }
    }

    /// Covariance of a contact point without the errors that all frames share; zero for the position of a model.
    fn frame_covariance(&self) -> Matrix3<f64> {
        match self.error {
            PositionError::Model { .. } => Matrix3::zeros(),
            PositionError::Contact(error) => error.frame_covariance(),
        }
    }

    fn is_usable(&self) -> bool {
        let forward = self.forward.unwrap_or_default();
        let error = match self.error {
            PositionError::Model { pose } => pose,
            PositionError::Contact(error) => error.covariance(),
        };
        [self.position_m, self.camera_m, forward].iter().all(|v| v.iter().all(|x| x.is_finite() && x.abs() < 1e9))
            && error.iter().all(|x| x.is_finite() && x.abs() < 1e18)
            && self.time_s.is_finite()
    }

    /// Observation relative to a nearby origin, for numerical precision.
    fn observed(&self, origin: &Vector3<f64>) -> Observed {
        let ray = self.position_m - self.camera_m;
        let distance = ray.norm().max(1e-3);
        let direction = ray / distance;
        let along = direction * direction.transpose();
        let across = (Matrix3::identity() - along) * (ACROSS * distance).powi(2);
        let (noise, drift) = match self.error {
            PositionError::Model { pose } => {
                (along * (ALONG * distance).powi(2) + across + pose, drift(&direction, distance))
            }
            // The noise of a contact point is within the plane: a little noise across it keeps the covariance
            // invertible.
            PositionError::Contact(error) => (error.noise() + across, contact_drift(&error)),
        };
        Observed {
            time_s: self.time_s,
            value: dynamic(&(self.position_m - origin)),
            noise: DMatrix::from_iterator(3, 3, noise.iter().copied()),
            drift,
        }
    }

    /// Angle to the left of the first axis, radians.
    fn yaw(&self) -> Option<f64> {
        self.forward.filter(|f| f.xy().norm() > 1e-6).map(|f| f.y.atan2(f.x))
    }
}

fn dynamic(v: &Vector3<f64>) -> DVector<f64> {
    DVector::from_column_slice(v.as_slice())
}

/// Correlated errors: one along the line of sight, and the components across it of three along fixed axes.
fn drift(direction: &Vector3<f64>, distance: f64) -> DMatrix<f64> {
    let across = (Matrix3::identity() - direction * direction.transpose()) * (DRIFT_ACROSS * distance);
    let mut columns = DMatrix::zeros(3, 4);
    columns.column_mut(0).copy_from(&(direction * (DRIFT * distance)));
    columns.columns_mut(1, 3).copy_from(&across);
    columns
}

/// Correlated error of a contact point, in the column of that along the line of sight.
fn contact_drift(error: &ContactError) -> DMatrix<f64> {
    let mut columns = DMatrix::zeros(3, 4);
    columns.column_mut(0).copy_from(&Vector3::from(error.drift));
    columns
}

/// Standard deviation of the model's forward axis, which is estimated from the vehicle's motion, radians.
///
/// `None` unless the displacement is significant: the axis of a vehicle that hardly moved is noise.
fn forward_std(measurements: &[PositionMeasurement], ratio: f64) -> Option<f64> {
    let first = &measurements[0];
    let displacement = |s: &PositionMeasurement| (s.position_m - first.position_m).norm();
    let farthest = measurements.iter().max_by(|a, b| displacement(a).total_cmp(&displacement(b)))?;
    let off = |s: &PositionMeasurement| DRIFT * (s.position_m - s.camera_m).norm();
    let error = off(first).hypot(off(farthest));
    // The error of the ratio moves a stationary vehicle along with the camera, which is not its forward direction.
    let by_ratio = (farthest.common_error(ratio) - first.common_error(ratio)).norm();
    (displacement(farthest) > SIGNIFICANT_STDS * error.hypot(by_ratio))
        .then(|| FORWARD_STD.hypot(error / displacement(farthest)))
}

/// Headings smoothed under white jerk; `None` unless the model has a forward direction in every frame.
fn headings(measurements: &[PositionMeasurement]) -> Option<Track> {
    let mut before: Option<f64> = None;
    let mut observed = Vec::new();
    for measurement in measurements {
        let yaw = measurement.yaw()?;
        let turns = before.map_or(0.0, |last| ((last - yaw) / std::f64::consts::TAU).round());
        let unwrapped = yaw + turns * std::f64::consts::TAU;
        before = Some(unwrapped);
        observed.push(Observed {
            time_s: measurement.time_s,
            value: DVector::from_element(1, unwrapped),
            // Standard deviation 0.001 rad, independent in every frame, and drift of 0.01 rad.
            noise: DMatrix::from_element(1, 1, 1e-6),
            drift: DMatrix::from_element(1, 1, 1e-2),
        });
    }
    track(&observed, &HEADING)
}

/// Smoothed positions and headings, with the errors that all frames share.
struct Tracks<'a> {
    measurements: &'a [PositionMeasurement],
    origin: Vector3<f64>,
    positions: Track,
    /// Changes of every state of `positions` per standard deviation of each error that all frames share.
    moved: [Vec<DVector<f64>>; 2],
    /// With the standard deviation of the model's forward axis, radians.
    headings: Option<(Track, f64)>,
    /// Standard deviation of the logarithm of meters per unit.
    scale_std: f64,
}

impl Tracks<'_> {
    fn motion(&self, k: usize) -> Motion {
        let mean = &self.positions.states[k].mean;
        let part = |first: usize| Vector3::new(mean[first], mean[first + 1], mean[first + 2]);
        let (position, velocity, acceleration) = (part(0) + self.origin, part(3), part(6));
        let direction = self.direction(k, &velocity);
        let along = |first: usize, v: &Vector3<f64>| (v.dot(&direction), self.std(k, first, &direction, v));
        let (speed_m_s, speed_std_m_s) = along(3, &velocity);
        let (acceleration_m_s2, acceleration_std_m_s2) = along(6, &acceleration);
        let from_camera = position - self.measurements[k].camera_m;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let raw = self.raw_velocity(k);
        let heading = self.heading(k, &velocity, speed_std_m_s);
        Motion {
            smoothed_position_m: position.into(),
            smoothed_position_std_m: axes.map(|axis| self.std(k, 0, &axis, &from_camera)),
            speed_m_s,
            speed_std_m_s,
            raw_speed_m_s: if raw.dot(&direction) < 0.0 { -raw.norm() } else { raw.norm() },
            acceleration_m_s2,
            acceleration_std_m_s2,
            heading_deg: heading.map(|([yaw, _], _)| (90.0 - yaw.to_degrees()).rem_euclid(360.0)),
            heading_std_deg: heading.map(|([_, std], _)| std.to_degrees()),
            yaw_rate_deg_s: heading.and_then(|(_, rate)| rate).map(|[rate, _]| -rate.to_degrees()),
            yaw_rate_std_deg_s: heading.and_then(|(_, rate)| rate).map(|[_, std]| std.to_degrees()),
        }
    }

    /// Total standard deviation, along a direction, of the part of the state that begins at `first`.
    ///
    /// * `stretched` – the vector that is proportional to meters per unit.
    fn std(&self, k: usize, first: usize, direction: &Vector3<f64>, stretched: &Vector3<f64>) -> f64 {
        let covariance = self.positions.states[k].covariance.fixed_view::<3, 3>(first, first);
        let own = (direction.transpose() * covariance * direction)[0].max(0.0);
        let shared = self.moved.iter().map(|moved| moved[k].fixed_rows::<3>(first).dot(direction).powi(2));
        (own + shared.sum::<f64>() + (self.scale_std * stretched.dot(direction)).powi(2)).sqrt()
    }

    /// Unit direction along which speeds are signed: that of the model, with the smoothed heading; else that of the
    /// motion.
    fn direction(&self, k: usize, velocity: &Vector3<f64>) -> Vector3<f64> {
        let moving = velocity.try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let (Some((headings, _)), Some(forward)) = (&self.headings, self.measurements[k].forward) else {
            return moving;
        };
        let Some(forward) = forward.try_normalize(1e-9) else { return moving };
        let (sin, cos) = headings.states[k].mean[0].sin_cos();
        let level = forward.xy().norm();
        Vector3::new(level * cos, level * sin, forward.z)
    }

    /// Yaw, radians to the left of the first axis, and yaw rate, each with its standard deviation.
    ///
    /// From the model; without a model from the motion, where the speed is significant.
    fn heading(&self, k: usize, velocity: &Vector3<f64>, speed_std: f64) -> Option<([f64; 2], Option<[f64; 2]>)> {
        if let Some((Track { states, .. }, forward_std)) = &self.headings {
            let std = |i: usize| states[k].covariance[(i, i)].max(0.0).sqrt();
            return Some(([states[k].mean[0], std(0).hypot(*forward_std)], Some([states[k].mean[1], std(1)])));
        }
        let level = velocity.xy().norm();
        let across = Vector3::new(-velocity.y, velocity.x, 0.0).try_normalize(1e-9).unwrap_or_else(Vector3::y);
        let std = self.std(k, 3, &across, velocity) / level;
        (level > SIGNIFICANT_STDS * speed_std).then(|| ([velocity.y.atan2(velocity.x), std], None))
    }

    /// Velocity between the neighboring positions, m/s.
    fn raw_velocity(&self, k: usize) -> Vector3<f64> {
        let (before, after) =
            (&self.measurements[k.saturating_sub(1)], &self.measurements[(k + 1).min(self.measurements.len() - 1)]);
        let time = after.time_s - before.time_s;
        if time > 0.0 { (after.position_m - before.position_m) / time } else { Vector3::zeros() }
    }
}

fn is_finite(motion: &Motion) -> bool {
    let all = [motion.smoothed_position_m, motion.smoothed_position_std_m].concat();
    let speeds = [motion.speed_m_s, motion.speed_std_m_s, motion.raw_speed_m_s];
    let others = [motion.acceleration_m_s2, motion.acceleration_std_m_s2];
    let turns = [motion.heading_deg, motion.heading_std_deg, motion.yaw_rate_deg_s, motion.yaw_rate_std_deg_s];
    all.iter().chain(&speeds).chain(&others).chain(turns.iter().flatten()).all(|x| x.is_finite())
}
