//! Motion of a vehicle relative to the camera, which distinguishes moving from stationary vehicles.
//!
//! The points of a stationary vehicle can be triangulated from the cameras of the background: its model is in the
//! background's frame and unit. The rays of a moving vehicle do not intersect, unless it moves along a scaled copy of
//! the camera's path, oᵢ = const + (1 − λ) cᵢ. The images do not distinguish such a vehicle from a stationary one.
//! There are two kinds of other evidence:
//!
//! * *The ground.* With the camera centers cᵢ and the vehicle's positions pᵢ at the scale ratio r̂ that the ground
//!   gives, both in the background's frame,
//!
//!   ```text
//!   pᵢ − cᵢ = a − s cᵢ + eᵢ,    s = (1 − v) r̂ / r
//!   ```
//!
//!   for a vehicle that moves at v times the camera's velocity, r the true ratio. A stationary vehicle has s = r̂ / r:
//!   1 within the errors of r̂ and s. For a moving vehicle v has a Cauchy distribution, that of the ratio of two normal
//!   velocities of equal variance. The likelihood ratio decides.
//! * *Camera shake* ([`motion_by_shaking`]). No vehicle moves along a copy of the path of a handheld camera.
//!
//! Derivation and figures: docs/maths/motion.md, section *Moving or stationary trajectory*.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use nalgebra::{Point3, Vector2, Vector3};

use super::smoother::DRIFT;
use crate::camera::Camera;
use crate::math::student_4;
use crate::scene::{Frame, Image, ImageId, ObjectPose, Reconstruction, TrackElement};

/// Half of the time over which the camera's path is compared with its chord, seconds: a third of a walking step.
const SHAKE_S: f64 = 0.15;
/// Acceleration over velocity of a vehicle, 1/s: 1 m/s² at 36 km/h. A handheld camera has 1, one in a car 0.02.
const VEHICLE_HZ: f64 = 0.1;

/// Slope s of the vehicle's displacement relative to the camera over the camera's own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativeMotion {
    /// The slope s.
    pub slope: f64,
    /// Its standard deviation. Residuals are persistent errors of the model, and count as a single one. Drift that does
    /// not appear in the residuals is added.
    pub std: f64,
}

impl RelativeMotion {
    /// Regression over the positions of a vehicle; `None` for fewer than four, or a camera that does not move.
    pub fn of(poses: &[ObjectPose], background: &Reconstruction) -> Option<Self> {
        let sample = |pose: &ObjectPose| {
            let center = background.images.get(&ImageId::from(pose.frame))?.cam_from_world.center().coords;
            let relative = Vector3::from(pose.position) - center;
            let weight = relative.norm_squared().recip();
            (weight.is_finite() && center.norm_squared().is_finite()).then_some((weight, center, relative))
        };
        let samples: Vec<(f64, Vector3<f64>, Vector3<f64>)> = poses.iter().filter_map(sample).collect();
        // The same minimum as for the smoother.
        (samples.len() >= 4).then(|| regression(&samples))?
    }

    /// Likelihood of a moving vehicle over that of a stationary one.
    ///
    /// * `ratio_std` – relative standard deviation of the scale ratio. It comes from a jackknife over five groups, so
    ///   that the error has Student's distribution with four degrees of freedom.
    pub fn odds_of_motion(&self, ratio_std: f64) -> f64 {
        let std = ratio_std.hypot(self.std);
        let off = 1.0 - self.slope;
        let stationary = student_4(off / std) / std;
        let spread = 1.0 + std;
        let moving = (PI * spread * (1.0 + (off / spread).powi(2))).recip();
        moving / stationary.max(f64::MIN_POSITIVE)
    }
}

/// Relative motion from camera shake, for a model triangulated from the background's cameras.
///
/// A vehicle at κ times the distance of the model, whose own path is smooth, has residuals J R (1 − 1/κ) Δcᵢ. Δcᵢ is
/// the camera's displacement from the chord of its path, and J R the derivative of the image position by the point. The
/// regression of the residuals on it gives the slope s = 1/κ. The paths of vehicles are not quite smooth: the resulting
/// standard deviation is their acceleration over the camera's. `None` where too few points are tracked.
///
/// * `frames` – for their times.
pub fn motion_by_shaking(object: &Reconstruction, frames: &[Frame]) -> Option<RelativeMotion> {
    let camera = object.cameras.values().next()?;
    let times: BTreeMap<ImageId, f64> = frames.iter().map(|frame| (ImageId::from(frame.id), frame.time_s)).collect();
    let mut shaking = Shaking::default();
    for point in object.points.values() {
        let seen = |element: &TrackElement| {
            let image = object.images.get(&element.image)?;
            let in_cam = image.cam_from_world * point.position;
            let residual =
                image.observations.get(element.observation_idx as usize)?.pixel - camera.pixel_from_cam(in_cam)?;
            Some(PointObservation { time: *times.get(&element.image)?, image, in_cam, residual })
        };
        let mut track: Vec<PointObservation> = point.track.iter().filter_map(seen).collect();
        track.sort_by(|a, b| a.time.total_cmp(&b.time));
        (0..track.len()).for_each(|k| shaking.add(&track, k, camera));
    }
    shaking.motion()
}

/// Sums of the regression of residuals on camera shake.
#[derive(Default)]
struct Shaking {
    /// For each interval of twice [`SHAKE_S`]: products of residual and predicted displacement, and squares of the
    /// latter.
    intervals: BTreeMap<i64, [f64; 2]>,
    /// Sum of the squares of the camera's acceleration.
    accelerations: f64,
    /// Sum of the squares of the camera's velocity.
    velocities: f64,
}

impl Shaking {
    /// Adds a point in one frame of its track, relative to two frames [`SHAKE_S`] or more before and after; nothing
    /// where there are none, or the track has a gap.
    fn add(&mut self, track: &[PointObservation], k: usize, camera: &Camera) {
        let middle = &track[k];
        let before = track[..k].iter().rev().find(|sample| sample.time <= middle.time - SHAKE_S);
        let after = track[k..].iter().find(|sample| sample.time >= middle.time + SHAKE_S);
        let near = |(a, b): &(&PointObservation, &PointObservation)| b.time - a.time <= 4.0 * SHAKE_S;
        let Some((start, end)) = before.zip(after).filter(near) else { return };
        let duration = end.time - start.time;
        let part = (middle.time - start.time) / duration;
        let [first, center, last] = [start, middle, end].map(|sample| sample.image.cam_from_world.center());
        let bend = center - (first + (last - first) * part);
        let residual = middle.residual - (start.residual * (1.0 - part) + end.residual * part);
        let predicted = camera.project(middle.in_cam).d_point * (middle.image.cam_from_world.rotation * bend);
        let interval = (middle.time / (2.0 * SHAKE_S)).floor() as i64;
        let [products, squares] = self.intervals.entry(interval).or_default();
        *products += predicted.dot(&residual);
        *squares += predicted.norm_squared();
        self.accelerations += (2.0 * bend.norm() / (part * (1.0 - part) * duration.powi(2))).powi(2);
        self.velocities += ((last - first).norm() / duration).powi(2);
    }

    /// Slope with its standard deviation, from the scatter of the intervals, which are assumed independent, and the
    /// vehicle's own acceleration. `None` for too few intervals.
    fn motion(&self) -> Option<RelativeMotion> {
        let num = self.intervals.len() as f64;
        let [products, squares] = [0, 1].map(|k| self.intervals.values().map(|sums| sums[k]).sum::<f64>());
        let off = products / squares;
        let scatter: f64 = self.intervals.values().map(|[g, h]| (g - off * h).powi(2)).sum();
        let noise = (num / (num - 1.0) * scatter).sqrt() / squares;
        let std = noise.hypot(VEHICLE_HZ * (self.velocities / self.accelerations).sqrt());
        (self.intervals.len() >= 4 && off.is_finite() && std.is_finite())
            .then_some(RelativeMotion { slope: 1.0 - off, std })
    }
}

/// Observation of a point.
struct PointObservation<'a> {
    time: f64,
    image: &'a Image,
    in_cam: Point3<f64>,
    /// Observed minus projected, pixels.
    residual: Vector2<f64>,
}

/// Weighted regression of the relative displacement on the camera's.
///
/// * `samples` – weight, camera center, and vehicle relative to it. Weights are inverse squares of distances, since
///   errors of positions are proportional to the distance.
fn regression(samples: &[(f64, Vector3<f64>, Vector3<f64>)]) -> Option<RelativeMotion> {
    let total: f64 = samples.iter().map(|(weight, ..)| weight).sum();
    let center = samples.iter().map(|(weight, c, _)| *weight * c).sum::<Vector3<f64>>() / total;
    let relative = samples.iter().map(|(weight, _, u)| *weight * u).sum::<Vector3<f64>>() / total;
    let sum = |of: &dyn Fn(Vector3<f64>, Vector3<f64>) -> f64| {
        samples.iter().map(|(weight, c, u)| weight * of(c - center, u - relative)).sum::<f64>() / total
    };
    let spread = sum(&|c, _| c.norm_squared());
    let slope = -sum(&|c, u| c.dot(&u)) / spread;
    let num = samples.len() as f64;
    // The unknowns are s and a.
    let freedom = 3.0 * num / (3.0 * num - 4.0);
    let squares = freedom * sum(&|c, u| (u + slope * c).norm_squared());
    // Weights are inverse squares of distances, so that num / total is the weighted mean of those squares.
    let distance_squared = num / total;
    let std = ((squares + DRIFT * DRIFT * distance_squared) / spread).sqrt();
    (slope.is_finite() && std.is_finite()).then_some(RelativeMotion { slope, std })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::math::Rigid3;
    use crate::scene::FrameId;
    use crate::synthetic::drive::{self, Drive, drive};
    use crate::trajectory::assemble::poses;

    /// Relative motion in a drive, with a ratio that is wrong by a factor.
    fn found(speed_m_s: f64, factor: f64) -> RelativeMotion {
        let Drive { background, object, frames, ratio, .. } =
            drive(&drive::Options { speed_m_s, ..drive::Options::default() }, 3);
        RelativeMotion::of(&poses(&background, &object, factor * ratio, &frames), &background).unwrap()
    }

    #[test]
    fn slope_is_the_error_of_a_stationary_vehicles_ratio() {
        for factor in [1.0, 1.3, 0.6] {
            assert!((found(0.0, factor).slope - factor).abs() < 1e-9);
        }
    }

    /// A vehicle in a drive whose camera shakes by `shake` meters at 2 Hz, and its model in the background's frame. The
    /// vehicle is at the model's distance divided by `nearness`; the model fits all but the shake.
    pub(in crate::trajectory) fn shaken(shake: f64, nearness: f64) -> (Drive, Reconstruction) {
        let mut world = drive(&drive::Options { speed_m_s: 0.0, ..drive::Options::default() }, 3);
        let mut object = world.object.clone();
        let pose = poses(&world.background, &object, world.ratio, &world.frames)[0].world_from_object;
        for point in object.points.values_mut() {
            point.position = pose * point.position;
        }
        let camera = object.cameras.values().next().copied().unwrap();
        for frame in &world.frames {
            let up = Vector3::new(0.0, 0.0, shake * (2.0 * PI * 2.0 * frame.time_s).sin());
            let id = ImageId::from(frame.id);
            let Some(image) = world.background.images.get_mut(&id) else { continue };
            let calm = image.cam_from_world;
            let moved = |by: Vector3<f64>| Rigid3::from_rotation_and_center(calm.rotation, calm.center() + by);
            image.cam_from_world = moved(up);
            let Some(of_object) = object.images.get_mut(&id) else { continue };
            of_object.cam_from_world = moved(up);
            // Relative to a vehicle farther away than its model the camera shakes by less.
            let seen_from = moved(up * nearness);
            for seen in &mut of_object.observations {
                let Some(point) = seen.point.and_then(|id| object.points.get(&id)) else { continue };
                seen.pixel = camera.pixel_from_cam(seen_from * point.position).unwrap();
            }
        }
        (world, object)
    }

    #[test]
    fn camera_shake_distinguishes_a_stationary_vehicle_from_one_along_the_cameras_path() {
        for nearness in [1.0, 0.5, 1.6] {
            let (world, object) = shaken(0.3, nearness);
            let found = motion_by_shaking(&object, &world.frames).unwrap();
            assert!((found.slope - nearness).abs() < 0.05 && found.std < 0.2, "{found:?}");
            let odds = found.odds_of_motion(0.0);
            assert!(if nearness == 1.0 { odds < 0.2 } else { odds > 1.0 }, "{nearness}: {odds}");
        }
        let (world, object) = shaken(0.0, 1.0);
        let calm = motion_by_shaking(&object, &world.frames).unwrap();
        assert!((0.2..5.0).contains(&calm.odds_of_motion(0.0)), "{calm:?}");
    }

    #[test]
    fn odds_distinguish_moving_vehicles_as_far_as_the_ratio_allows() {
        assert!(found(0.0, 1.05).odds_of_motion(0.05) < 0.2);
        // More than three standard deviations off, as for a parked car in front of a dashcam: the ratio may be wrong.
        assert!((0.2..5.0).contains(&found(0.0, 0.83).odds_of_motion(0.05)));
        for slope in [-0.5, 0.1, 2.0] {
            let motion = RelativeMotion { slope, std: 0.05 };
            assert!(motion.odds_of_motion(0.1) > 5.0, "{slope}");
            let odds = motion.odds_of_motion(5.0);
            assert!((0.2..5.0).contains(&odds), "{odds}");
        }
    }

    #[test]
    fn a_hovering_camera_and_few_positions_do_not_determine_motion() {
        let Drive { background, object, frames, ratio, .. } = drive(&drive::Options::default(), 3);
        let all = poses(&background, &object, ratio, &frames);
        assert_eq!(RelativeMotion::of(&all[..3], &background), None);
        let same: Vec<ObjectPose> = all.iter().map(|pose| ObjectPose { frame: FrameId(0), ..pose.clone() }).collect();
        assert!(RelativeMotion::of(&same, &background).is_none_or(|motion| motion.std > 1e3));
    }
}
