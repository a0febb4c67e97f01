//! Metres from the vehicles' sizes, and their sizes in metres.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::super::run::{Outcome, Run};
use crate::metric::{Dimension, Extent, Kind, KnownLength, Measured, Source, VehicleClass, vehicle_sizes};
use crate::scene::{Dimensions, Estimate, MetricFrame, ObjectId, ObjectTrajectory, Trajectories};

/// How large an object is, in units of the background; `None` for what it was never seen from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(in crate::pipeline) struct Size {
    /// Between its ends.
    pub(in crate::pipeline) length: Option<Estimate>,
    /// Between its sides.
    pub(in crate::pipeline) width: Option<Estimate>,
    /// Above the ground.
    pub(in crate::pipeline) height: Option<Estimate>,
}

impl Size {
    fn of(&self, dimension: Dimension) -> Option<Estimate> {
        match dimension {
            Dimension::Length => self.length,
            Dimension::Width => self.width,
            Dimension::Height => self.height,
        }
    }

    /// The same in metres, with the deviation of the scale.
    pub(super) fn in_metres(&self, frame: &MetricFrame) -> Dimensions {
        let log_scale_std = frame.log_scale_std();
        let metres = |units: Estimate| {
            let value = frame.scale * units.value;
            Estimate { value, std: value * log_scale_std.hypot(units.std / units.value) }
        };
        Dimensions {
            length_m: self.length.map(metres),
            width_m: self.width.map(metres),
            height_m: self.height.map(metres),
        }
    }
}

/// What is known of single vehicles, each a source of its own.
pub(super) fn known(run: &Run, sizes: &BTreeMap<ObjectId, Size>, outcome: &mut Outcome) -> Vec<Source> {
    let known = run.options.metric.known_lengths.iter();
    let source = |known: &KnownLength| match of_length(known, sizes) {
        Ok(source) => Some(source),
        Err(reason) => {
            outcome.warn(format!("--known-length {known} gives no metres: {reason}"));
            None
        }
    };
    known.filter_map(source).collect()
}

fn of_length(known: &KnownLength, sizes: &BTreeMap<ObjectId, Size>) -> Result<Source, String> {
    let KnownLength { object, dimension, length } = known;
    let name = dimension.name();
    let size = sizes.get(object).ok_or_else(|| format!("vehicle {object} has no trajectory"))?;
    let units = size.of(*dimension).and_then(|units| Measured::new(units.value, units.std));
    let units = units.ok_or_else(|| format!("the {name} of vehicle {object} was never seen well enough"))?;
    let (log_scale, std) = length.log_ratio(&units);
    Ok(Source { name: format!("{name} of vehicle {object}"), kind: Kind::Surveyed, log_scale, std })
}

/// What vehicles are like, as one source; `None` where none is of a class whose members are alike.
pub(super) fn alike(trajectories: &Trajectories, sizes: &BTreeMap<ObjectId, Size>) -> Option<Source> {
    let usable = trajectories.objects.iter().filter(|trajectory| !trajectory.is_ruled_out());
    let extents: Vec<Extent> = usable.flat_map(|trajectory| extents(trajectory, sizes)).collect();
    let (log_scale, std) = vehicle_sizes(&extents)?;
    Some(Source { name: "what vehicles are like".to_owned(), kind: Kind::Prior, log_scale, std })
}

fn extents(trajectory: &ObjectTrajectory, sizes: &BTreeMap<ObjectId, Size>) -> Vec<Extent> {
    let Some(size) = sizes.get(&trajectory.id) else { return Vec::new() };
    let Some(class) = VehicleClass::from_label(&trajectory.class) else { return Vec::new() };
    let extent = |dimension| {
        let Estimate { value, std } = size.of(dimension)?;
        Some(Extent { vehicle: trajectory.id.0, class, dimension, value, std })
    };
    [Dimension::Length, Dimension::Width, Dimension::Height].into_iter().filter_map(extent).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sizes() -> BTreeMap<ObjectId, Size> {
        let length = Some(Estimate { value: 2.0, std: 0.02 });
        [(ObjectId(3), Size { length, ..Size::default() })].into()
    }

    #[test]
    fn a_known_length_over_its_units_is_a_source() {
        let found = of_length(&"3:length=4.4±0.044".parse().unwrap(), &sizes()).unwrap();
        assert!((found.log_scale - 2.2f64.ln()).abs() < 1e-12 && (found.std - 0.01f64.hypot(0.01)).abs() < 1e-12);
        assert_eq!(found.name, "length of vehicle 3");
    }

    #[test]
    fn what_was_not_seen_is_said() {
        let of = |text: &str| of_length(&text.parse().unwrap(), &sizes()).unwrap_err();
        assert!(of("3:width=1.8").contains("the width of vehicle 3 was never seen"));
        assert!(of("4:length=4.4").contains("vehicle 4 has no trajectory"));
    }
}
