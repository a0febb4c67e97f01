//! Measures of trajectories.

use super::timeline::Timeline;
use crate::scene::{ObjectPose, ObjectTrajectory};

/// Speed over time, in units of length per unit of time: the distance between the neighbors of a pose over the time
/// between them.
pub(super) fn speeds(trajectory: &ObjectTrajectory, timeline: &Timeline) -> Vec<(f64, f64)> {
    let between = |w: &[ObjectPose]| {
        let (before, after) = (timeline.of(w[0].frame)?, timeline.of(w[2].frame)?);
        let speed = w[0].distance_to(&w[2]) / (after - before);
        speed.is_finite().then_some((timeline.of(w[1].frame)?, speed))
    };
    trajectory.poses.windows(3).filter_map(between).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn speed_is_distance_over_time_and_skips_invalid_values() {
        let mut world = testing::world();
        let all = speeds(&world.trajectory, &Timeline::new(&world.data()));
        assert_eq!(all.len(), world.trajectory.poses.len() - 2);
        let way = world.trajectory.travel.unwrap().path_units.value;
        let poses = &world.trajectory.poses;
        let mean = way / (poses[poses.len() - 1].time_s - poses[0].time_s);
        assert!((all[all.len() / 2].1 / mean - 1.0).abs() < 0.5, "{} beside a mean of {mean}", all[all.len() / 2].1);
        world.trajectory.poses[5].position[0] = f64::NAN;
        assert_eq!(speeds(&world.trajectory, &Timeline::new(&world.data())).len(), all.len() - 2);
    }
}
