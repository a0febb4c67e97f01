//! Tilt of the ground by any subset of its sources, and contradictions between sources.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Matrix3, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::vehicle_sizes::{Problem, observed_vehicles};
use crate::camera::MAX_TILT_STD;
use crate::scene::{FrameId, Reconstruction, Rect};

/// Estimate of the ground's tilt relative to the camera of the first frame, by a source other than vehicles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltEstimate {
    /// Display name of the source.
    pub source: String,
    /// Inclination of the camera's axis below the horizon, and of the horizon to the right, radians.
    pub angles: [f64; 2],
    /// Standard deviations of the angles; `None` for an angle that is not given.
    pub std: [Option<f64>; 2],
    /// Plane or direction whose tilt it is.
    pub kind: TiltKind,
}

/// Plane or direction whose tilt a source gives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum TiltKind {
    /// The ground.
    Ground,
    /// The vertical, by a sensor or by buildings; the prior of a level horizon is then omitted.
    Vertical,
    /// The plane of a map that defines the frame of positions.
    ///
    /// It is used without fusion: rays intersect it where a homography to the map projects them, whatever its error. A
    /// more accurate plane would not give these positions.
    Map {
        /// Ground points with heights, in the background's frame; empty for a plane.
        relief_in_world: Vec<Point3<f64>>,
    },
}

/// Contradiction between one source of the normal and all others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltContradiction {
    /// Name of the source.
    pub source: String,
    /// Angle between the normals, radians.
    pub angle: f64,
    /// The same, in standard deviations of both together.
    pub deviations: f64,
}

impl TiltEstimate {
    /// Tilt of a vertical or normal in the camera's frame, with its covariance.
    pub fn of_up(source: &str, up_in_cam: &Vector3<f64>, covariance: &Matrix3<f64>) -> Self {
        let [x, y, z] = [up_in_cam.x.clamp(-1.0, 1.0), up_in_cam.y, up_in_cam.z];
        let across = (y * y + z * z).max(f64::MIN_POSITIVE);
        let by_up = [Vector3::new(0.0, z, -y) / across, Vector3::x() / across.sqrt()];
        let std = by_up.map(|by| Some(by.dot(&(covariance * by)).max(0.0).sqrt()));
        Self { source: source.to_owned(), angles: [(-z).atan2(-y), x.asin()], std, kind: TiltKind::Ground }
    }

    /// The angles and their covariance, if both are given.
    pub(super) fn known_angles(&self) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let variances = Vector2::new(self.std[0]?.powi(2), self.std[1]?.powi(2));
        Some((Vector2::from(self.angles), Matrix2::from_diagonal(&variances)))
    }

    /// Residuals of the given angles: axis, difference, standard deviation.
    pub(super) fn differences(&self, angles: Vector2<f64>) -> impl Iterator<Item = (usize, f64, f64)> {
        (0..2).filter_map(move |k| Some((k, angles[k] - self.angles[k], self.std[k]?)))
    }
}

/// Inclination and tilt estimated from vehicles and sources.
pub(super) struct Tilt {
    pub(super) angles: Vector2<f64>,
    pub(super) covariance: Matrix2<f64>,
    /// Change of the angles by one standard deviation of the focal length.
    pub(super) by_focal: Vector2<f64>,
}

impl Tilt {
    /// Standard deviations, with the share of the focal length.
    fn std(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.covariance[(axis, axis)].sqrt().hypot(self.by_focal[axis]))
    }
}

/// Difference between one source and all others.
pub(super) struct Difference {
    source: String,
    /// For each given angle: the difference, and the same in standard deviations of both together.
    angles: Vec<(f64, f64)>,
}

impl Difference {
    pub(super) fn contradiction(&self) -> Option<TiltContradiction> {
        let deviations = self.angles.iter().map(|(_, deviations)| deviations.abs()).fold(0.0, f64::max);
        let angle = self.angles.iter().map(|(difference, _)| *difference).fold(0.0, f64::hypot);
        let source = self.source.clone();
        // The same limit as for sources of scale.
        (deviations > 3.0).then_some(TiltContradiction { source, angle, deviations })
    }
}

/// Birge's ratio, at least 1: the factor on the standard deviation where sources disagree.
pub(super) fn birge_ratio(differences: &[Difference]) -> f64 {
    let squares: Vec<f64> =
        differences.iter().flat_map(|one| &one.angles).map(|(_, difference)| difference * difference).collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt().max(1.0)
}

/// Estimates the tilt from any subset of the sources.
///
/// The focal length is not adjusted; its share of the uncertainty is the change of the angles with another focal
/// length.
pub(super) struct TiltSolver {
    pub(super) problem: Problem,
    /// Problems with a focal length one standard deviation shorter and longer; `None` where it is known exactly.
    zoomed: Option<[Problem; 2]>,
}

impl TiltSolver {
    pub(super) fn new(
        background: &Reconstruction,
        vehicles: &[BTreeMap<FrameId, Rect>],
        focal_std: f64,
    ) -> Option<Self> {
        let world_from_cam = background.images.values().next()?.cam_from_world.rotation.inverse();
        let problem = |log_focal: f64, noise: f64| {
            let vehicles = observed_vehicles(background, vehicles, log_focal.exp());
            Problem { vehicles, world_from_cam, noise }
        };
        let noise = problem(0.0, 1.0).noise_factor();
        let zoomed = (focal_std > 0.0).then(|| [-focal_std, focal_std].map(|by| problem(by, noise)));
        Some(Self { problem: problem(0.0, noise), zoomed })
    }

    /// Tilt by vehicles and the given sources; `None` where they do not determine it.
    pub(super) fn tilt(&self, estimates: &[&TiltEstimate]) -> Option<Tilt> {
        let (angles, covariance) = self.problem.minimum(estimates, None)?;
        let angles_of = |problem: &Problem| Some(problem.minimum(estimates, Some(angles))?.0);
        let by_focal = match &self.zoomed {
            Some([shorter, longer]) => 0.5 * (angles_of(longer)? - angles_of(shorter)?),
            None => Vector2::zeros(),
        };
        Some(Tilt { angles, covariance, by_focal })
    }

    /// Tilt by the sizes of vehicles alone.
    pub(super) fn by_vehicles(&self) -> Option<TiltEstimate> {
        let tilt = self.tilt(&[]).filter(|_| !self.problem.vehicles.is_empty())?;
        let ([inclination, to_side], source) = (tilt.std(), "sizes of vehicles".to_owned());
        let std = [Some(inclination), Some(to_side)];
        let estimate = TiltEstimate { source, angles: tilt.angles.into(), std, kind: TiltKind::Ground };
        (inclination.hypot(to_side) <= MAX_TILT_STD).then_some(estimate)
    }

    /// Differences between each source and all others, where these determine the tilt.
    pub(super) fn differences(&self, all: &[&TiltEstimate]) -> Vec<Difference> {
        let against_others = |k: usize| {
            let others: Vec<&TiltEstimate> = all[..k].iter().chain(&all[k + 1..]).copied().collect();
            let tilt = self.tilt(&others)?;
            let others_std = tilt.std();
            let normalized =
                |(axis, difference, std): (usize, f64, f64)| (difference, difference / std.hypot(others_std[axis]));
            let angles = all[k].differences(tilt.angles).map(normalized).collect();
            Some(Difference { source: all[k].source.clone(), angles })
        };
        (0..all.len()).filter_map(against_others).collect()
    }
}
