//! A receiver's fixes as positions of single cameras, for an adjustment with position priors.

use nalgebra::{Point3, Vector3};

use super::align::covariance::WANDER_TIME_S;
use super::fix::{WANDER_SHARE, distinct};
use super::{Alignment, CameraPath, PositionFix};

/// Position of a camera by a fix near it in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CenterFix {
    /// Index of the camera in its path.
    pub index: usize,
    /// Position in the frame of the fixes, meters; up is that of the path where it is unknown.
    pub position_m: Point3<f64>,
    /// Standard deviations east, north and up, meters; infinite where up is unknown.
    pub std_m: Vector3<f64>,
}

/// Fixes in the time of a path, as positions of the cameras nearest in time. The way from the fix to the camera is that
/// of the path.
///
/// The fixes of a short time share their slow error. A similarity takes up most of it; the rest, over the duration of
/// the path, is in the standard deviations as often as there are fixes, so that they do not average it out. The same
/// holds for the way during an unknown offset of the clocks.
pub fn center_fixes(path: &CameraPath, fixes: &[PositionFix], alignment: &Alignment) -> Vec<CenterFix> {
    let similarity = alignment.metric_from_world;
    let used: Vec<PositionFix> = distinct(fixes)
        .into_iter()
        .map(|fix| PositionFix { time_s: fix.time_s - alignment.offset_s, ..fix })
        .filter(|fix| path.covers(fix.time_s))
        .collect();
    let count = used.len() as f64;
    let (start_s, end_s) = path.span_s();
    let slow_share = WANDER_SHARE * (1.0 - (-(end_s - start_s) / WANDER_TIME_S).exp());
    let noise_share = (1.0 - WANDER_SHARE) * alignment.noise_factor.powi(2).max(1.0);
    used.iter()
        .map(|fix| {
            let (center, velocity) = path.at(fix.time_s);
            let index = path.nearest(fix.time_s);
            let to_camera = similarity * path.centers()[index] - similarity * center;
            let shift_m = (similarity.rotation * velocity * similarity.scale).norm() * alignment.offset_std_s;
            let variance = |std_m: f64| {
                let rounding = fix.rounding_m.powi(2) / 12.0;
                noise_share * std_m.powi(2) + rounding + count * (slow_share * std_m.powi(2) + shift_m.powi(2))
            };
            let horizontal = variance(fix.horizontal_std_m).sqrt().max(LEAST_STD_M);
            let vertical = fix.up_m.map_or(f64::INFINITY, |_| variance(fix.vertical_std_m).sqrt().max(LEAST_STD_M));
            let up_m = fix.up_m.unwrap_or((similarity * center).z);
            CenterFix {
                index,
                position_m: Point3::new(fix.east_north_m.x, fix.east_north_m.y, up_m) + to_camera,
                std_m: Vector3::new(horizontal, horizontal, vertical),
            }
        })
        .collect()
}

/// Standard deviation below which no fix is believed, meters: antenna and camera are not at one place.
const LEAST_STD_M: f64 = 0.005;

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, Vector2};

    use super::*;
    use crate::math::Sim3;

    #[test]
    fn fixes_move_to_the_nearest_camera_and_share_their_slow_error() {
        let path = CameraPath::new((0..11).map(|k| (f64::from(k), Point3::new(f64::from(k), 0.0, 0.0))), 0.0).unwrap();
        let alignment = Alignment {
            metric_from_world: Sim3::new(2.0, nalgebra::UnitQuaternion::identity(), Vector3::zeros()),
            anchor_in_world: Point3::origin(),
            covariance: SMatrix::zeros(),
            offset_s: 100.0,
            offset_std_s: 0.0,
            num_fixes: 3,
            rejected_share: 0.0,
            noise_factor: 1.0,
        };
        let fix = |time_s: f64, up_m| PositionFix {
            time_s: time_s + 100.0,
            east_north_m: Vector2::new(2.0 * time_s, 0.5),
            up_m,
            horizontal_std_m: 1.0,
            vertical_std_m: 2.0,
            rounding_m: 0.0,
        };
        let found = center_fixes(&path, &[fix(1.2, Some(3.0)), fix(5.9, None), fix(70.0, None)], &alignment);
        assert_eq!(found.iter().map(|fix| fix.index).collect::<Vec<_>>(), [1, 6]);
        assert!((found[0].position_m - Point3::new(2.0, 0.5, 3.0)).norm() < 1e-12, "{found:?}");
        assert!((found[1].position_m - Point3::new(12.0, 0.5, 0.0)).norm() < 1e-12, "{found:?}");
        let slow = 0.8 * (1.0 - (-10.0f64 / 120.0).exp());
        assert!((found[0].std_m.x - (0.2 + 2.0 * slow).sqrt()).abs() < 1e-12, "{found:?}");
        assert!((found[0].std_m.z / found[0].std_m.x - 2.0).abs() < 1e-12 && found[1].std_m.z.is_infinite());
    }
}
