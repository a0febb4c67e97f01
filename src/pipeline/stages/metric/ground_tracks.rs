//! Ground tracks in metres and on the map, with the verdict on each.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Point3, Vector3};

use super::placed::{Placing, metric_of, span};
use super::vehicles::{in_metres, size_of_body};
use crate::math::rounding::percent;
use crate::math::{median, quantile};
use crate::metric::ObservedPoint;
use crate::pipeline::driver::run::Outcome;
use crate::scene::{
    Dimensions, Estimate, GroundPosition, GroundTrack, GroundTrackTrust, GroundTrackVerdict, Motion, Movement,
    ObjectId, TimeBase, Topic,
};
use crate::trajectory::{BodyOnGround, CommonStd, PositionError, PositionMeasurement, Smoothed, smooth};

/// Maximum relative standard deviation of distance and displacement of a usable track: that of a scale ratio beyond
/// which a trajectory is doubtful.
const USABLE: f64 = 0.1;
/// Maximum 0.9 quantile of the residuals to the smoothed trajectory, in standard deviations of the positions: a
/// twentieth of normal ones is beyond two.
const CONSISTENT: f64 = 3.0;
/// The 0.9 quantile of normal residuals; where it is exceeded, the standard deviations are enlarged by the ratio.
const NORMAL: f64 = 1.64;
/// Minimum mean detector score of a vehicle with an inconsistent track: the one from which detections count however
/// rare they are. A sign over the road is no vehicle, and moves over the ground as the camera does.
const SURE: f64 = 0.5;
/// Range of the larger apparent side of a vehicle, meters: from the height of a motorcycle from behind to the length of
/// a truck with its trailer.
const LARGER_M: [f64; 2] = [1.0, 25.0];
/// Maximum of the smaller apparent side of a vehicle, meters: the height of a truck. From above, the limit is that of a
/// truck diagonal in the image.
const SMALLER_M: f64 = 5.0;
/// Standard deviations by which a size must be out of range.
const OUTSIDE: f64 = 2.0;

/// Computes the values that depend on the metric frame. Tracks of objects that are no vehicles by their size are
/// dropped.
pub(super) fn fill(
    placing: &Placing,
    tracks: Vec<GroundTrack>,
    bodies: &BTreeMap<ObjectId, BodyOnGround>,
    outcome: &mut Outcome,
) -> Vec<GroundTrack> {
    let mut kept = Vec::new();
    for mut track in tracks {
        let body = bodies.get(&track.id).copied().unwrap_or_default();
        placing.fill_ground(&mut track, body);
        let dip_sine = placing.dip_sine(&track);
        let of_size = |size: &[Estimate; 2]| impossible_size(size, dip_sine);
        match track.apparent_size_m.as_ref().and_then(of_size).or_else(|| off_the_ground(&track)) {
            None => kept.push(track),
            Some(problem) => {
                let text = format!("object {}: no ground track: {problem}; probably not a vehicle", track.id);
                outcome.warn(Topic::VehicleSkipped.warning(text));
            }
        }
    }
    kept
}

/// Problem of an apparent size.
///
/// * `dip_sine` – sine of the angle of the line of sight below the horizon.
fn impossible_size([width, height]: &[Estimate; 2], dip_sine: f64) -> Option<String> {
    let (larger, smaller) = if width.value > height.value { (width, height) } else { (height, width) };
    let is_below = |size: &Estimate, limit: f64| size.value + OUTSIDE * size.std < limit;
    let is_above = |size: &Estimate, limit: f64| size.value - OUTSIDE * size.std > limit;
    let most = SMALLER_M.max(FRAC_1_SQRT_2 * LARGER_M[1] * dip_sine);
    let is_odd = is_below(larger, LARGER_M[0]) || is_above(larger, LARGER_M[1]) || is_above(smaller, most);
    is_odd.then(|| format!("apparent size {:.1} × {:.1} m", width.value, height.value))
}

/// Problem of a track that neither its trajectory nor its detections support.
fn off_the_ground(track: &GroundTrack) -> Option<String> {
    let verdict = track.verdict.as_ref().filter(|verdict| verdict.state == GroundTrackTrust::Inconsistent)?;
    (track.confidence < SURE).then(|| format!("{}, and the detector score is {:.2}", verdict.says, track.confidence))
}

impl Placing<'_> {
    /// Computes the values that depend on the metric frame, and enlarges the errors if the residuals contradict them.
    fn fill_ground(&self, track: &mut GroundTrack, body: BodyOnGround) {
        let common = CommonStd { ratio: 0.0, scale: self.frame.log_scale_std() };
        let measured = self.contacts(track);
        let worst = smooth(&measured, &common, Movement::Undetermined).map(|found| worst_deviation(&measured, &found));
        let factor = worst.map_or(1.0, |worst| worst / NORMAL).max(1.0);
        track.positions.iter_mut().for_each(|position| position.error = position.error.scaled(factor));
        let shares: Vec<f64> = track.positions.iter().filter_map(|position| self.distance_std(position)).collect();
        let distance_std = median(shares).unwrap_or(f64::MAX);
        if !self.is_nominal {
            let log_std = distance_std.hypot(self.frame.log_scale_std());
            let size = |units: f64| Estimate { value: units, std: log_std * units }.scaled(self.frame.scale);
            track.apparent_size_m = Some(track.apparent_size.map(size));
            for position in &mut track.positions {
                position.metric = self.observed(position).and_then(|at| metric_of(self.frame, self.map.as_ref(), &at));
            }
        }
        let measured = self.contacts(track);
        let found = smooth(&measured, &common, Movement::Undetermined);
        let verdict = verdict(distance_std, displacement_by_focal(track), worst);
        // If positions jump, the mask is not that of one vehicle.
        if !self.is_nominal && verdict.state != GroundTrackTrust::Inconsistent {
            let size = in_metres(&size_of_body(&body, distance_std), self.frame);
            track.dimensions = Some(size).filter(|size| *size != Dimensions::default());
            track.axis_deg = body.axis.map(|axis| self.axis_deg(axis));
        }
        track.verdict = Some(verdict);
        let Some(found) = found else { return };
        track.travel = Some(self.travel(span(&track.positions, |position| position.time_s), &found));
        if self.times == TimeBase::Seconds {
            let placed = track.positions.iter_mut().filter_map(|position| position.metric.as_mut());
            placed.zip(found.motions).for_each(|(metric, motion)| metric.motion = Some(motion));
        }
    }

    /// Direction of a level unit vector of the background, degrees clockwise from the frame's second axis, 0 to 180.
    fn axis_deg(&self, (axis, std): ([f64; 3], f64)) -> Estimate {
        let axis = self.frame.metric_from_world().rotation * Vector3::from(axis);
        Estimate { value: axis.x.atan2(axis.y).to_degrees().rem_euclid(180.0), std: std.to_degrees() }
    }

    /// Median sine of the angle of the lines of sight below the horizon.
    fn dip_sine(&self, track: &GroundTrack) -> f64 {
        let up = self.frame.metric_from_world().rotation.inverse() * Vector3::z();
        let of = |position: &GroundPosition| {
            let ObservedPoint { point, center, .. } = self.observed(position)?;
            Some(up.dot(&(center - point).try_normalize(0.0)?).max(0.0))
        };
        median(track.positions.iter().filter_map(of).collect()).unwrap_or(0.0)
    }

    fn observed(&self, position: &GroundPosition) -> Option<ObservedPoint> {
        let center = self.images.get(position.name.as_str())?.cam_from_world.center();
        let (point, pose_covariance) = (Point3::from(position.position), position.error.covariance());
        Some(ObservedPoint { point, center, log_ratio_std: 0.0, direction_std: 0.0, pose_covariance })
    }

    /// Standard deviation of the distance as a share of it, without that of metres per unit.
    fn distance_std(&self, position: &GroundPosition) -> Option<f64> {
        let ObservedPoint { point, center, pose_covariance, .. } = self.observed(position)?;
        let along = (point - center).try_normalize(0.0)?;
        Some(along.dot(&(pose_covariance * along)).max(0.0).sqrt() / (point - center).norm())
    }

    fn contacts(&self, track: &GroundTrack) -> Vec<PositionMeasurement> {
        let metric_from_world = self.frame.metric_from_world();
        let contact = |position: &GroundPosition| {
            let ObservedPoint { point, center, .. } = self.observed(position)?;
            Some(PositionMeasurement {
                time_s: self.step_s() * position.time_s,
                position_m: (metric_from_world * point).coords,
                camera_m: (metric_from_world * center).coords,
                forward: None,
                error: PositionError::Contact(position.error.transformed(&metric_from_world)),
            })
        };
        track.positions.iter().filter_map(contact).collect()
    }
}

/// 0.9 quantile of the residuals to the smoothed trajectory, in standard deviations of the positions.
fn worst_deviation(measured: &[PositionMeasurement], found: &Smoothed) -> f64 {
    let normalized = |(seen, motion): (&PositionMeasurement, &Motion)| {
        let PositionError::Contact(error) = seen.error else { return 0.0 };
        let residual = seen.position_m - Vector3::from(motion.smoothed_position_m);
        let along = residual.try_normalize(0.0).unwrap_or_default();
        let std = along.dot(&(error.frame_covariance() * along)).max(0.0).sqrt();
        if std > 0.0 { residual.norm() / std } else { 0.0 }
    };
    let mut all: Vec<f64> = measured.iter().zip(&found.motions).map(normalized).collect();
    quantile(&mut all, 0.9).unwrap_or_default()
}

/// Relative standard deviation of the displacement due to that of the focal length: straight below a camera, distances
/// do not depend on it, and displacements do. `None` for a vehicle that moves by less than its size.
fn displacement_by_focal(track: &GroundTrack) -> Option<f64> {
    let (first, last) = (track.positions.first()?, track.positions.last()?);
    let between = |first: [f64; 3], last: [f64; 3]| (Vector3::from(last) - Vector3::from(first)).norm();
    let displacement = between(first.position, last.position);
    let [width, height] = track.apparent_size;
    (displacement > width.max(height)).then(|| between(first.error.focal, last.error.focal) / displacement)
}

/// The verdict on a track, by its distances, its displacement and the residuals to its smoothed trajectory; `None`
/// without a smoothed trajectory.
fn verdict(distance_std: f64, displacement_std: Option<f64>, worst: Option<f64>) -> GroundTrackVerdict {
    let (state, says) = match worst {
        None => (GroundTrackTrust::Inconsistent, "too few positions for a smooth path".to_owned()),
        Some(worst) if worst > CONSISTENT => (
            GroundTrackTrust::Inconsistent,
            format!(
                "a tenth of the positions deviate from a smooth path by {worst:.1} standard deviations, which are \
                 enlarged accordingly"
            ),
        ),
        Some(_) => match displacement_std.filter(|std| *std > USABLE) {
            Some(std) => {
                let [of_path, of_distance] = [std, distance_std].map(percent);
                let by_focal = format!("displacement ±{of_path} (1σ) by the focal length");
                (GroundTrackTrust::Coarse, format!("{by_focal}, distance to the camera ±{of_distance}"))
            }
            None => {
                let state = if distance_std <= USABLE { GroundTrackTrust::Usable } else { GroundTrackTrust::Coarse };
                (state, format!("distance to the camera ±{} (1σ)", percent(distance_std)))
            }
        },
    };
    GroundTrackVerdict { state, distance_std, says }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{ContactError, FrameId};

    #[test]
    fn sizes_of_no_vehicle_are_impossible() {
        let size = |width: f64, height: f64| [width, height].map(|value| Estimate { value, std: 0.1 * value });
        for vehicle in [size(1.8, 1.4), size(4.5, 1.5), size(0.7, 1.6), size(16.0, 3.8), size(0.9, 0.6)] {
            assert_eq!(impossible_size(&vehicle, 0.2), None, "{vehicle:?}");
        }
        for other in [size(0.3, 0.2), size(40.0, 3.0), size(12.0, 9.0)] {
            assert!(impossible_size(&other, 0.2).unwrap().starts_with("apparent size"), "{other:?}");
        }
    }

    #[test]
    fn a_lorry_across_the_image_is_as_high_as_wide_from_above() {
        let lorry = [7.4, 6.8].map(|value| Estimate { value, std: 0.02 * value });
        assert_eq!(impossible_size(&lorry, 0.98), None);
        assert!(impossible_size(&lorry, 0.3).is_some());
    }

    #[test]
    fn verdicts_are_by_distance_and_smooth_path() {
        let state = |distance_std, worst| verdict(distance_std, None, worst).state;
        assert_eq!(state(0.04, Some(1.5)), GroundTrackTrust::Usable);
        assert_eq!(state(0.2, Some(1.5)), GroundTrackTrust::Coarse);
        assert_eq!(state(0.04, Some(5.0)), GroundTrackTrust::Inconsistent);
        assert_eq!(state(0.04, None), GroundTrackTrust::Inconsistent);
    }

    #[test]
    fn an_unknown_focal_length_below_a_camera_makes_a_track_coarse() {
        let found = verdict(0.01, Some(0.75), Some(1.0));
        assert_eq!(found.state, GroundTrackTrust::Coarse);
        assert!(
            found.says.starts_with("displacement ±75 %") && found.says.ends_with("camera ±1.0 %"),
            "{}",
            found.says
        );
        assert_eq!(verdict(0.01, Some(0.05), Some(1.0)).state, GroundTrackTrust::Usable);
        let position = |x: f64, by_focal: f64| GroundPosition {
            frame: FrameId(0),
            name: String::new(),
            time_s: 0.0,
            position: [x, 0.0, 0.0],
            error: ContactError { focal: [by_focal, 0.0, 0.0], ..ContactError::default() },
            metric: None,
        };
        let share = |path: f64| {
            displacement_by_focal(&GroundTrack {
                apparent_size: [4.0, 2.0],
                positions: vec![position(1.0, -0.5), position(1.0 + path, 0.75 * path - 0.5)],
                ..GroundTrack::new(ObjectId(1), "car", 0.5)
            })
        };
        assert!((share(20.0).unwrap() - 0.75).abs() < 1e-12);
        assert_eq!(share(3.0), None, "it hardly moves");
    }
}
