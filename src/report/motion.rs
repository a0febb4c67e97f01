//! Metric motion of a vehicle, for cards, tooltips and charts.

use super::data::{Data, Fact, Object};
use super::metres;
use super::travel::{KM_H, estimate};
use super::view::quantile;
use super::words::figure;
use crate::scene::{Dimensions, Estimate, FrameId, MetricPose, Motion, Position, TimeBase};

/// The motion of a pose; without a rate a motion has no meaning.
fn motion<'a>(data: &Data, metric: &'a MetricPose) -> Option<&'a Motion> {
    metric.motion.as_ref().filter(|_| data.time_base == TimeBase::Seconds)
}

/// Summary of one pose, in a few words.
pub(super) fn tooltip(data: &Data, metric: Option<&MetricPose>) -> Option<String> {
    data.metric.and_then(metres::frame)?;
    let metric = metric?;
    let away = format!("{} m away", figure(metric.distance_to_camera_m, 2));
    Some(match motion(data, metric) {
        Some(motion) => format!("{}, {away}", km_h(motion.speed_m_s)),
        None => away,
    })
}

/// "38 km/h".
fn km_h(speed_m_s: f64) -> String {
    // Below a tenth it would be rounded to zero.
    let rounded = if speed_m_s.abs() * KM_H < 9.95 {
        (10.0 * KM_H * speed_m_s).round() / 10.0
    } else {
        (KM_H * speed_m_s).round()
    };
    format!("{rounded} km/h").replacen('-', "−", 1)
}

/// Size and distance of a vehicle; none where meters are unknown.
pub(super) fn facts(data: &Data, object: &Object) -> Vec<Fact> {
    let trajectory = object.trajectory.filter(|_| data.metric.and_then(metres::frame).is_some());
    let metric = trajectory.into_iter().flat_map(|trajectory| &trajectory.poses).filter_map(|pose| pose.metric);
    let mut distances: Vec<f64> = metric.map(|metric| metric.distance_to_camera_m).collect();
    let mut facts = Vec::new();
    if distances.is_empty() {
        return facts;
    }
    facts.extend(trajectory.and_then(|trajectory| Some(size(trajectory.dimensions?, trajectory.is_ruled_out()))));
    let range = [0.0, 1.0].map(|q| figure(quantile(&mut distances, q), 3));
    facts.push(Fact::new("distance to the camera", format!("{} to {} m", range[0], range[1])));
    facts
}

pub(super) fn size(size: Dimensions, is_ruled_out: bool) -> Fact {
    let said = |name: &str, dimension: Option<Estimate>| match dimension {
        Some(found) => format!("{name} {}", estimate(is_ruled_out, found, "m")),
        None => format!("{name} not visible"),
    };
    let Dimensions { length_m, width_m, height_m } = size;
    Fact::new("size", [said("length", length_m), said("width", width_m), said("height", height_m)].join(", "))
}

/// Length, width and height for a table: `4.30 ± 0.21 × 1.80 ± 0.09 × – m`; `None` where none is known.
pub(super) fn size_in_brief(size: Dimensions, is_ruled_out: bool) -> Option<String> {
    let Dimensions { length_m, width_m, height_m } = size;
    let said = |dimension: Option<Estimate>| {
        let said = dimension.map(|found| estimate(is_ruled_out, found, "m"));
        said.map_or("–".to_owned(), |said| said.trim_end_matches(" m").to_owned())
    };
    let sides = [length_m, width_m, height_m];
    sides.iter().any(Option::is_some).then(|| format!("{} m", sides.map(said).join(" × ")))
}

/// A quantity over the frames of an object.
#[derive(Clone, Copy, Debug)]
pub(super) enum Quantity {
    /// Kilometers per hour, along the heading.
    Speed,
    /// Meters per second².
    Acceleration,
    /// Degrees, without jumps at north.
    Heading,
}

/// Value, its σ, and its raw value.
pub(super) struct Reading {
    pub frame: FrameId,
    pub value: f64,
    pub std: f64,
    pub raw: Option<f64>,
}

/// A quantity at every pose that has it; of a ground track that is the reported result, at its positions
/// without headings.
pub(super) fn readings(data: &Data, object: &Object, quantity: Quantity) -> Vec<Reading> {
    let value = |motion: &Motion, heading: Option<f64>| {
        Some(match quantity {
            Quantity::Speed => {
                (KM_H * motion.speed_m_s, KM_H * motion.speed_std_m_s, Some(KM_H * motion.raw_speed_m_s))
            }
            Quantity::Acceleration => (motion.acceleration_m_s2, motion.acceleration_std_m_s2, None),
            Quantity::Heading => (heading?, motion.heading_std_deg?, None),
        })
    };
    let reading = |at: Position, heading: Option<f64>| {
        let (value, std, raw) = value(motion(data, at.metric?)?, heading)?;
        Some(Reading { frame: at.frame, value, std, raw })
    };
    match (data.metric.and_then(metres::frame), object.answering_track(), object.trajectory) {
        (Some(_), Some(track), _) => track.positions.iter().filter_map(|at| reading(at.into(), None)).collect(),
        (Some(_), None, Some(trajectory)) => {
            let headings = trajectory.unwrapped_headings_deg();
            trajectory.poses.iter().zip(headings).filter_map(|(at, heading)| reading(at.into(), heading)).collect()
        }
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn sizes_and_distances_are_said_only_where_metres_are_known() {
        let world = testing::World::in_metres();
        let data = world.data();
        let said = facts(&data, &data.objects[0]);
        let value = |label: &str| &said.iter().find(|fact| fact.label == label).unwrap().value;
        assert!(
            value("size").starts_with("length 4.30 ± ") && value("size").ends_with("height not visible"),
            "{said:?}"
        );
        let brief = size_in_brief(world.trajectory.dimensions.unwrap(), false).unwrap();
        assert!(brief.starts_with("4.30 ± ") && brief.ends_with(" × – m"), "{brief}");
        assert!(value("distance to the camera").ends_with(" m"), "{said:?}");
        assert!(!readings(&data, &data.objects[0], Quantity::Heading).is_empty());
        let mut north = testing::World::in_metres();
        for (k, pose) in north.trajectory.poses.iter_mut().enumerate() {
            let motion = pose.metric.as_mut().unwrap().motion.as_mut().unwrap();
            motion.heading_deg = Some(if k % 2 == 0 { 5.0 } else { 357.0 });
        }
        let data_north = north.data();
        let headings = readings(&data_north, &data_north.objects[0], Quantity::Heading);
        let step = |pair: &[Reading]| (pair[1].value - pair[0].value).abs();
        assert!(headings.windows(2).all(|pair| (step(pair) - 8.0).abs() < 1e-9), "no jump at north");
        assert!(headings.iter().all(|reading| (-10.0..=370.0).contains(&reading.value)));
        let pose = &world.trajectory.poses[10];
        assert!(tooltip(&data, pose.metric.as_ref()).unwrap().ends_with(" m away"));
        let unknown = testing::world();
        let data = unknown.data();
        assert!(facts(&data, &data.objects[0]).is_empty() && tooltip(&data, pose.metric.as_ref()).is_none());
    }

    #[test]
    fn stationary_vehicle_is_reported_as_stationary() {
        assert_eq!([km_h(0.004), km_h(-2.0), km_h(13.9)], ["0 km/h", "−7.2 km/h", "50 km/h"]);
    }
}
