//! A vehicle's motion, in metres, from all of its positions together.
//!
//! Positions are smoothed under white jerk ([`track`], [`chain`]): speed and acceleration follow with their deviations.
//! Where the object's model says which way the vehicle points, its heading is smoothed likewise, and speeds are counted
//! along it. Errors of positions lie mostly along the line of sight, part of them new in every frame and part wandering
//! slowly. What all frames have in common, the scale ratio and metres per unit, is no noise: smoothing leaves it as it
//! is, and it is added to the deviations. Path length and displacement: [`travel`]. docs/maths/smoother.md derives all.

mod chain;
mod track;
mod travel;

#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use self::track::{Kind, Observed, Track, is_at_rest, track};
use self::travel::resolved_amount;
use crate::scene::{ContactError, Estimate, Motion, Movement};

/// Where a vehicle was seen, in a frame in metres whose third axis points up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionMeasurement {
    /// When, seconds.
    pub time_s: f64,
    /// Where.
    pub position_m: Vector3<f64>,
    /// Where the camera was.
    pub camera_m: Vector3<f64>,
    /// Direction in which the object's model points; `None` where it has no forward axis.
    pub forward: Option<Vector3<f64>>,
    /// Its error.
    pub error: PositionError,
}

/// Error of a measured position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PositionError {
    /// Of a reconstructed vehicle: shares of the distance to the camera, and the scale ratio's error in all frames.
    Model {
        /// Covariance of its pose in this frame, in addition, m².
        pose: Matrix3<f64>,
    },
    /// Of a contact point with the ground, meters.
    Contact(ContactError),
}

impl Default for PositionError {
    /// Of a reconstructed vehicle whose poses are all exact.
    fn default() -> Self {
        Self::Model { pose: Matrix3::zeros() }
    }
}

/// Errors that all frames have in common: standard deviations of logarithms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CommonStd {
    /// Of the object's scale ratio, which moves it along the lines of sight.
    pub ratio: f64,
    /// Of metres per unit, which stretches everything.
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
/// Positions of a vehicle in traffic: metres, m/s, m/s², m²/s⁵.
const MOVING: Kind = Kind { first: [10.0, 40.0, 5.0], usual_jerk: 1.0, last_axis: 0.1, drift_s: &[1.0, 3.0, 3.0, 3.0] };
/// Headings: radians, rad/s, rad/s², rad²/s⁵.
const HEADING: Kind = Kind { first: [1.0, 1.0, 1.0], usual_jerk: 0.05, last_axis: 1.0, drift_s: &[1.0] };
/// Deviation of the forward axis of a model that went far, radians: the same in all frames.
const FORWARD: f64 = 0.02;
/// Standard deviations by which a speed or a displacement must differ from zero to show a heading.
const CLEAR: f64 = 3.0;

/// A vehicle's motion, metres and seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothed {
    /// At every sighting.
    pub motions: Vec<Motion>,
    /// Length of the smoothed trajectory at the resolution of its uncertainty; the standard deviation is the whole one.
    pub path_m: Estimate,
    /// Distance between the first and the last position.
    pub displacement_m: Estimate,
    /// Greatest speed in any frame, and its standard deviation there; a speed within three standard deviations of zero
    /// is corrected for noise.
    pub max_speed_m_s: Estimate,
}

/// Smooths a vehicle's motion; `None` where there are fewer than four, or numbers that are not finite.
///
/// * `sightings` – ascending in time; gaps are bridged, with deviations that grow.
/// * `movement` – motion state by other evidence: a moving vehicle is not smoothed at rest.
///
/// A vehicle at rest is recognized by its positions alone, by the likelihood of rest and of motion.
pub fn smooth(sightings: &[PositionMeasurement], common: &CommonStd, movement: Movement) -> Option<Smoothed> {
    let in_motion = in_motion(sightings)?;
    let origin = sightings[0].position_m;
    // Also of a vehicle at rest: a slow one that moves along with the camera has the same positions, for another error
    // of the ratio.
    let response = |errors: Vec<DVector<f64>>| in_motion.response(&errors);
    let moved = [
        response(sightings.iter().map(|s| s.common_error(common.ratio)).collect())?,
        response(sightings.iter().map(PositionMeasurement::focal_error).collect())?,
    ];
    // Contact points are too coarse to tell rest from motion: a speed that is rest by default would have the wrong
    // standard deviation.
    let is_coarse = sightings.iter().any(|s| matches!(s.error, PositionError::Contact(_)));
    let may_rest = !is_coarse && movement != Movement::Moving;
    let rest = may_rest.then(|| at_rest(sightings, &origin, common.ratio)).flatten();
    let stands = rest.is_some();
    let positions = rest.unwrap_or(in_motion);
    let forward_std = forward_std(sightings, common.ratio).filter(|_| !stands);
    let headings = forward_std.and_then(|std| Some((headings(sightings)?, std)));
    let all = Tracks { sightings, origin, positions, moved, headings, scale_std: common.scale };
    let motions: Vec<Motion> = (0..sightings.len()).map(|k| all.motion(k)).collect();
    let (path_m, displacement_m) = (all.path(), all.displacement());
    let fastest = motions.iter().max_by(|a, b| a.speed_m_s.abs().total_cmp(&b.speed_m_s.abs()))?;
    let max_speed_m_s = resolved_amount(fastest.speed_m_s, fastest.speed_std_m_s);
    let lengths = [path_m, displacement_m, max_speed_m_s];
    let are_finite = lengths.iter().all(|e| e.value.is_finite() && e.std.is_finite()) && motions.iter().all(is_finite);
    are_finite.then_some(Smoothed { motions, path_m, displacement_m, max_speed_m_s })
}

/// Deviation of a position from the smooth motion through all of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residual {
    pub(super) distance_m: f64,
    /// In standard deviations of the errors that are new in every frame.
    pub(super) deviation: f64,
}

/// The residuals of a moving vehicle; `None` as for [`smooth`].
pub(super) fn residuals(sightings: &[PositionMeasurement]) -> Option<Vec<Residual>> {
    let track = in_motion(sightings)?;
    let origin = sightings[0].position_m;
    let residual = |(k, seen): (usize, &PositionMeasurement)| {
        let smoothed = track.states[k].mean.fixed_rows::<3>(0) + origin;
        Residual { distance_m: (seen.position_m - smoothed).norm(), deviation: track.squares[k].sqrt() }
    };
    Some(sightings.iter().enumerate().map(residual).collect())
}

/// The positions of a vehicle that moves, relative to the first; `None` as for [`smooth`].
fn in_motion(sightings: &[PositionMeasurement]) -> Option<Track> {
    if sightings.len() < 4 || !sightings.iter().all(PositionMeasurement::is_usable) {
        return None;
    }
    let origin = sightings[0].position_m;
    track(&sightings.iter().map(|s| s.observed(&origin)).collect::<Vec<_>>(), &MOVING)
}

/// The positions of a vehicle at rest; `None` where they are likelier in motion, or where only a ratio that is off by
/// more than a standard deviation would explain them.
///
/// An error of the ratio takes a vehicle at rest along with the camera, by that share of the camera's path. It is a
/// state of both hypotheses, or else no vehicle that a moving camera sees would ever be at rest.
fn at_rest(sightings: &[PositionMeasurement], origin: &Vector3<f64>, ratio: f64) -> Option<Track> {
    let observed: Vec<Observed> =
        sightings.iter().map(|s| s.observed(origin).with_common(&s.common_error(ratio))).collect();
    // The error of the ratio stays.
    let moving = Kind { drift_s: &[1.0, 3.0, 3.0, 3.0, f64::INFINITY], ..MOVING };
    let rest = moving.at_rest(0.02);
    let found = is_at_rest(&observed, &moving, &rest).then(|| track(&observed, &rest))??;
    let last = found.states.last()?;
    // One standard deviation is where lengths corrected for noise ([`travel`]) become positive: what is taken for rest
    // up to here has no length in motion either, so that a vehicle at any speed keeps its coverage.
    (last.mean[last.mean.len() - 1].abs() <= 1.0).then_some(found)
}

impl PositionMeasurement {
    /// Displacement by one standard deviation of the error that all frames share; of a model that of the ratio, as a
    /// share.
    fn common_error(&self, ratio: f64) -> DVector<f64> {
        match self.error {
            PositionError::Model { .. } => dynamic(&(ratio * (self.position_m - self.camera_m))),
            PositionError::Contact(error) => dynamic(&Vector3::from(error.common)),
        }
    }

    /// The same of the focal length; that of a model is part of its ratio.
    fn focal_error(&self) -> DVector<f64> {
        match self.error {
            PositionError::Model { .. } => DVector::zeros(3),
            PositionError::Contact(error) => dynamic(&Vector3::from(error.focal)),
        }
    }

    /// Covariance of a single contact point without the errors that all frames share; none of a model's position.
    fn single_error(&self) -> Matrix3<f64> {
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

    /// Relative to an origin nearby, which keeps the numbers small.
    fn observed(&self, origin: &Vector3<f64>) -> Observed {
        let ray = self.position_m - self.camera_m;
        // Errors of headings, radians: new in every frame, and wandering.
        let distance = ray.norm().max(1e-3);
        let sight = ray / distance;
        let along = sight * sight.transpose();
        let across = (Matrix3::identity() - along) * (ACROSS * distance).powi(2);
        let (noise, drift) = match self.error {
            PositionError::Model { pose } => {
                (along * (ALONG * distance).powi(2) + across + pose, drift(&sight, distance))
            }
            // The plane has no noise of its own across it: a little, so that the covariance has an inverse.
            PositionError::Contact(error) => (error.noise() + across, slow(&error)),
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

/// Correlated errors: one along the line of sight, three of fixed axes as far as they lie across it.
fn drift(sight: &Vector3<f64>, distance: f64) -> DMatrix<f64> {
    let across = (Matrix3::identity() - sight * sight.transpose()) * (DRIFT_ACROSS * distance);
    let mut columns = DMatrix::zeros(3, 4);
    columns.column_mut(0).copy_from(&(sight * (DRIFT * distance)));
    columns.columns_mut(1, 3).copy_from(&across);
    columns
}

/// The correlated error of a contact point, in the place of that along the line of sight.
fn slow(error: &ContactError) -> DMatrix<f64> {
    let mut columns = DMatrix::zeros(3, 4);
    columns.column_mut(0).copy_from(&Vector3::from(error.drift));
    columns
}

/// Deviation of the model's forward axis, radians, which the vehicle's motion shows; `None` unless that is beyond the
/// errors of the positions that show it: of a vehicle that hardly moved the axis is noise.
fn forward_std(sightings: &[PositionMeasurement], ratio: f64) -> Option<f64> {
    let first = &sightings[0];
    let way = |s: &PositionMeasurement| (s.position_m - first.position_m).norm();
    let furthest = sightings.iter().max_by(|a, b| way(a).total_cmp(&way(b)))?;
    let off = |s: &PositionMeasurement| DRIFT * (s.position_m - s.camera_m).norm();
    let error = off(first).hypot(off(furthest));
    // The ratio's error moves a parked vehicle along with the camera, which is not where its model points.
    let by_ratio = (furthest.common_error(ratio) - first.common_error(ratio)).norm();
    (way(furthest) > CLEAR * error.hypot(by_ratio)).then(|| FORWARD.hypot(error / way(furthest)))
}

/// The heading under white jerk; `None` unless the model points somewhere in every frame.
fn headings(sightings: &[PositionMeasurement]) -> Option<Track> {
    let mut before: Option<f64> = None;
    let mut observed = Vec::new();
    for sighting in sightings {
        let yaw = sighting.yaw()?;
        let turns = before.map_or(0.0, |last| ((last - yaw) / std::f64::consts::TAU).round());
        let unwrapped = yaw + turns * std::f64::consts::TAU;
        before = Some(unwrapped);
        observed.push(Observed {
            time_s: sighting.time_s,
            value: DVector::from_element(1, unwrapped),
            // Headings err by 0.001 rad, independently in every frame, and drift.
            noise: DMatrix::from_element(1, 1, 1e-6),
            drift: DMatrix::from_element(1, 1, 1e-2),
        });
    }
    track(&observed, &HEADING)
}

/// Everything that was smoothed.
struct Tracks<'a> {
    sightings: &'a [PositionMeasurement],
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
        let from_camera = position - self.sightings[k].camera_m;
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

    /// The whole deviation, along a direction, of the part of the state that begins at `first` and is proportional to
    /// `stretched` where metres per unit are concerned.
    fn std(&self, k: usize, first: usize, direction: &Vector3<f64>, stretched: &Vector3<f64>) -> f64 {
        let covariance = self.positions.states[k].covariance.fixed_view::<3, 3>(first, first);
        let own = (direction.transpose() * covariance * direction)[0].max(0.0);
        let shared = self.moved.iter().map(|moved| moved[k].fixed_rows::<3>(first).dot(direction).powi(2));
        (own + shared.sum::<f64>() + (self.scale_std * stretched.dot(direction)).powi(2)).sqrt()
    }

    /// Unit direction along which speeds count: that of the model, turned as the smoothed heading; else that of the
    /// motion.
    fn direction(&self, k: usize, velocity: &Vector3<f64>) -> Vector3<f64> {
        let moving = velocity.try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let (Some((headings, _)), Some(forward)) = (&self.headings, self.sightings[k].forward) else { return moving };
        let Some(forward) = forward.try_normalize(1e-9) else { return moving };
        let (sin, cos) = headings.states[k].mean[0].sin_cos();
        let level = forward.xy().norm();
        Vector3::new(level * cos, level * sin, forward.z)
    }

    /// Where it points, radians to the left of the first axis, and the rate, each with its standard deviation: by the
    /// model; without it by the motion, where that is clear.
    fn heading(&self, k: usize, velocity: &Vector3<f64>, speed_std: f64) -> Option<([f64; 2], Option<[f64; 2]>)> {
        if let Some((Track { states, .. }, forward_std)) = &self.headings {
            let std = |i: usize| states[k].covariance[(i, i)].max(0.0).sqrt();
            return Some(([states[k].mean[0], std(0).hypot(*forward_std)], Some([states[k].mean[1], std(1)])));
        }
        let level = velocity.xy().norm();
        let across = Vector3::new(-velocity.y, velocity.x, 0.0).try_normalize(1e-9).unwrap_or_else(Vector3::y);
        let std = self.std(k, 3, &across, velocity) / level;
        (level > CLEAR * speed_std).then(|| ([velocity.y.atan2(velocity.x), std], None))
    }

    /// Between the neighbouring positions, m/s.
    fn raw_velocity(&self, k: usize) -> Vector3<f64> {
        let (before, after) =
            (&self.sightings[k.saturating_sub(1)], &self.sightings[(k + 1).min(self.sightings.len() - 1)]);
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
