//! Trajectory of a camera over time.

use nalgebra::{Point3, Vector3};

/// Camera centres at increasing times, in the frame of the background, with a standard deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    times_s: Vec<f64>,
    centers: Vec<Point3<f64>>,
    /// Standard deviation of a centre in any direction, units of the background.
    pub center_std: f64,
}

/// Minimum error of camera centers as a share of the path length: the drift of reconstructions.
pub const DRIFT: f64 = 0.002;

impl CameraPath {
    /// As [`CameraPath::new`], with a standard deviation that is a share of the length.
    pub fn with_drift(poses: Vec<(f64, Point3<f64>)>, share: f64) -> Option<Self> {
        let steps = poses.windows(2).map(|pair| (pair[1].1 - pair[0].1).norm());
        let length: f64 = steps.filter(|step| step.is_finite()).sum();
        Self::new(poses, share * length)
    }

    /// From times (seconds of the video) and centres. Entries whose time does not increase, or that are not finite, are
    /// skipped; `None` if fewer than two remain.
    pub fn new(poses: impl IntoIterator<Item = (f64, Point3<f64>)>, center_std: f64) -> Option<Self> {
        let (mut times_s, mut centers): (Vec<f64>, Vec<Point3<f64>>) = (Vec::new(), Vec::new());
        for (time_s, center) in poses {
            let rises = times_s.last().is_none_or(|&last| time_s > last);
            if rises && time_s.is_finite() && center.iter().all(|value| value.is_finite()) {
                times_s.push(time_s);
                centers.push(center);
            }
        }
        (times_s.len() >= 2).then_some(Self { times_s, centers, center_std })
    }

    /// Start and end, seconds.
    pub fn span_s(&self) -> (f64, f64) {
        (self.times_s[0], self.times_s[self.times_s.len() - 1])
    }

    /// Returns true if the path has a position at a time: inside, and not in a gap of more than five usual steps and a
    /// second.
    pub fn covers(&self, time_s: f64) -> bool {
        let (start, end) = self.span_s();
        if !(start..=end).contains(&time_s) {
            return false;
        }
        let usual_s = (end - start) / (self.times_s.len() - 1) as f64;
        let i = self.segment(time_s);
        // Fixes are not compared with the path in gaps of more than this many usual steps, and longer than a second.
        self.times_s[i + 1] - self.times_s[i] <= (5.0 * usual_s).max(1.0)
    }

    /// Centre and velocity at a time, by linear interpolation and extrapolation.
    pub fn at(&self, time_s: f64) -> (Point3<f64>, Vector3<f64>) {
        let i = self.segment(time_s);
        let duration_s = self.times_s[i + 1] - self.times_s[i];
        let velocity = (self.centers[i + 1] - self.centers[i]) / duration_s;
        (self.centers[i] + velocity * (time_s - self.times_s[i]), velocity)
    }

    /// Index of the last pose before a time that also has a pose after it.
    fn segment(&self, time_s: f64) -> usize {
        let after = self.times_s.partition_point(|&time| time <= time_s);
        after.clamp(1, self.times_s.len() - 1) - 1
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{point, vector};

    use super::*;

    #[test]
    fn between_poses_the_path_is_straight() {
        let poses = [(0.0, point![0.0, 0.0, 0.0]), (1.0, point![2.0, 0.0, 0.0]), (1.0, point![9.0, 9.0, 9.0])];
        let path = CameraPath::new(poses.into_iter().chain([(2.0, point![2.0, 4.0, 0.0])]), 0.0).unwrap();
        assert_eq!(path.at(1.5), (point![2.0, 2.0, 0.0], vector![0.0, 4.0, 0.0]));
        assert_eq!(path.at(-0.5).0, point![-1.0, 0.0, 0.0]);
        assert_eq!(path.at(2.5).0, point![2.0, 6.0, 0.0]);
        assert!(path.covers(2.0) && path.covers(0.0) && !path.covers(2.1));
        assert!(CameraPath::new([(0.0, point![0.0, 0.0, 0.0]), (f64::NAN, Point3::origin())], 0.0).is_none());
    }

    #[test]
    fn gaps_are_not_covered() {
        let times = (0..20).map(f64::from).filter(|&t| !(6.0..16.0).contains(&t));
        let path = CameraPath::new(times.map(|t| (t, point![t, 0.0, 0.0])), 0.0).unwrap();
        assert!(path.covers(4.5) && !path.covers(8.0) && path.covers(17.5));
    }
}
