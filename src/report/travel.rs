//! Path length, displacement and speeds of a vehicle in words: the same on the page and in the terminal.

use super::data::Fact;
use super::words::LENGTH_UNIT;
use crate::math::rounding::{to_std, with_std};
use crate::scene::{Estimate, GroundTrack, ObjectTrajectory, TimeBase, Travel};

/// Kilometers per hour in a meter per second.
pub(super) const KM_H: f64 = 3.6;

/// The figures of a trajectory's [`Travel`], each with its unit; nothing for fewer than four positions.
///
/// A rejected trajectory has them without a standard deviation: it would be taken for the error.
pub fn travel_facts(trajectory: &ObjectTrajectory, times: TimeBase) -> Vec<Fact> {
    let Some(travel) = &trajectory.travel else { return Vec::new() };
    let seconds = trajectory.poses.first().zip(trajectory.poses.last()).map_or(0.0, |(a, b)| b.time_s - a.time_s);
    figures(travel, seconds, times, |of, unit| estimate(trajectory.is_ruled_out(), of, unit))
}

/// The figures of a ground track's travel.
pub fn ground_track_facts(track: &GroundTrack, times: TimeBase) -> Vec<Fact> {
    let Some(travel) = &track.travel else { return Vec::new() };
    let seconds = track.positions.first().zip(track.positions.last()).map_or(0.0, |(a, b)| b.time_s - a.time_s);
    figures(travel, seconds, times, |of, unit| estimate(false, of, unit))
}

fn figures(travel: &Travel, seconds: f64, times: TimeBase, estimate: impl Fn(Estimate, &str) -> String) -> Vec<Fact> {
    let said = |label: &str, of: Estimate, unit: &str| Fact::new(label, estimate(of, unit));
    let Travel { path_units, displacement_units, path_m, displacement_m, mean_speed_m_s, max_speed_m_s } = *travel;
    let lengths = [("path length", path_m, path_units), ("displacement", displacement_m, displacement_units)];
    let length = |(label, metres, units): (&str, Option<Estimate>, Estimate)| match metres {
        Some(metres) => said(label, metres, "m"),
        None => said(label, units, LENGTH_UNIT),
    };
    let speeds = [("mean speed", mean_speed_m_s), ("maximum speed", max_speed_m_s)];
    let speeds = speeds.into_iter().filter(|_| times == TimeBase::Seconds);
    let speeds = speeds.filter_map(|(label, speed)| Some(said(label, speed?.scaled(KM_H), "km/h")));
    let is_unitless = path_m.is_none() && times == TimeBase::Seconds && seconds > 0.0;
    let in_units =
        is_unitless.then(|| said("mean speed", path_units.scaled(seconds.recip()), &format!("{LENGTH_UNIT}/s")));
    lengths.into_iter().map(length).chain(speeds).chain(in_units).collect()
}

/// `4.31 ± 0.12 m`; of a rejected trajectory `4.31 m`.
pub fn estimate(is_ruled_out: bool, Estimate { value, std }: Estimate, unit: &str) -> String {
    let figures = if is_ruled_out { to_std(value, std) } else { with_std(value, std) };
    format!("{figures} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use crate::scene::{Trust, Verdict};

    #[test]
    fn figures_have_their_units_and_a_rejected_path_no_deviation() {
        let mut trajectory = testing::World::in_metres().trajectory;
        let said = |trajectory: &ObjectTrajectory| {
            let facts = travel_facts(trajectory, TimeBase::Seconds);
            facts.into_iter().map(|fact| format!("{} {}", fact.label, fact.value)).collect::<Vec<_>>()
        };
        let [path, away] = [Estimate { value: 12.34, std: 0.56 }, Estimate { value: 11.9, std: 0.56 }];
        let [mean, most] = [Estimate { value: 5.0, std: 0.25 }, Estimate { value: 6.0, std: 0.5 }];
        trajectory.travel = Some(Travel {
            path_units: path.scaled(0.5),
            displacement_units: away.scaled(0.5),
            path_m: Some(path),
            displacement_m: Some(away),
            mean_speed_m_s: Some(mean),
            max_speed_m_s: Some(most),
        });
        let metres = ["path length 12.34 ± 0.56 m", "displacement 11.90 ± 0.56 m"];
        let speeds = ["mean speed 18.00 ± 0.90 km/h", "maximum speed 21.6 ± 1.8 km/h"];
        assert_eq!(said(&trajectory), [metres, speeds].concat());
        trajectory.verdict = Some(Verdict { state: Trust::Rejected, reasons: Vec::new() });
        assert_eq!(said(&trajectory)[0], "path length 12.34 m");
        trajectory.travel.as_mut().unwrap().path_m = None;
        assert_eq!(said(&trajectory)[0], "path length 6.17 units");
        trajectory.travel = None;
        assert!(said(&trajectory).is_empty());
    }
}
