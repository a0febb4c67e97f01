//! What vehicles are like: lengths, widths and heights of a class as a source of metres.
//!
//! The logarithms of a vehicle's dimensions are normal, with a part that all vehicles of a place and time share (what
//! is sold there), a part that the dimensions of one vehicle share (large or small), and a part of each. Generalised
//! least squares over everything that was measured gives the logarithm of metres per unit; docs/maths/metric.md, eq. 8.

use nalgebra::{DMatrix, DVector};

/// A class whose vehicles are alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VehicleClass {
    /// Cars, sport utility vehicles and small vans.
    Car,
    /// Lorries from delivery trucks to articulated ones.
    Truck,
    /// Buses and coaches.
    Bus,
    /// Motorcycles and scooters, without their riders.
    Motorcycle,
}

/// A dimension of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// Between its bumpers.
    Length,
    /// Between its sides, without mirrors.
    Width,
    /// Above the ground, without racks.
    Height,
}

impl Dimension {
    /// The name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Length => "length",
            Self::Width => "width",
            Self::Height => "height",
        }
    }
}

/// A dimension that was measured, in units of the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Which vehicle: extents of one vehicle share whether it is large or small.
    pub vehicle: u32,
    /// Its class.
    pub class: VehicleClass,
    /// What was measured.
    pub dimension: Dimension,
    /// Units.
    pub value: f64,
    /// Standard deviation, units.
    pub std: f64,
}

/// Median in metres, and standard deviation of the logarithm, over the vehicles of a class.
#[derive(Clone, Copy, Debug)]
struct Likeness {
    median_m: f64,
    spread: f64,
}

/// Share of the variance of the logarithm that the dimensions of one vehicle have in common.
const SHARED_BY_VEHICLE: f64 = 0.4;

/// Deviation of what the vehicles of one place have in common: cars of KITTI (Karlsruhe, 2011) and of nuScenes (Boston
/// and Singapore, 2018) differ by 17 % in length, 18 % in width and 12 % in height of their boxes, half of which the
/// labels' different margins explain.
const SHARED_BY_PLACE: f64 = 0.035;

impl VehicleClass {
    /// The class of a label of COCO or of the rendered sequences; `None` of one whose members are not alike.
    pub fn from_label(label: &str) -> Option<Self> {
        match label {
            "car" => Some(Self::Car),
            "truck" => Some(Self::Truck),
            "bus" => Some(Self::Bus),
            "motorcycle" => Some(Self::Motorcycle),
            _ => None,
        }
    }

    /// Cars: between the means of KITTI (3.88 × 1.63 × 1.53 m, deviations 0.43, 0.10, 0.14; Geiger et al., *Are we
    /// ready for autonomous driving?*, CVPR 2012) and of nuScenes (4.61 × 1.95 × 1.72 m; Caesar et al., CVPR 2020), the
    /// latter with mirrors. Others: means of nuScenes within what Directive 96/53/EC allows, trucks with the spread of
    /// a class that goes from 5 to 16.5 m. `docs/maths/metric.md` says where each number comes from.
    fn likeness(self, dimension: Dimension) -> Likeness {
        let (median_m, spread) = match (self, dimension) {
            (Self::Car, Dimension::Length) => (4.30, 0.10),
            (Self::Car, Dimension::Width) => (1.79, 0.055),
            (Self::Car, Dimension::Height) => (1.55, 0.09),
            (Self::Truck, Dimension::Length) => (6.9, 0.35),
            (Self::Truck, Dimension::Width) => (2.45, 0.10),
            (Self::Truck, Dimension::Height) => (2.9, 0.22),
            (Self::Bus, Dimension::Length) => (11.2, 0.20),
            (Self::Bus, Dimension::Width) => (2.55, 0.06),
            (Self::Bus, Dimension::Height) => (3.3, 0.13),
            (Self::Motorcycle, Dimension::Length) => (2.1, 0.12),
            (Self::Motorcycle, Dimension::Width) => (0.77, 0.18),
            (Self::Motorcycle, Dimension::Height) => (1.2, 0.15),
        };
        Likeness { median_m, spread }
    }
}

/// Logarithm of metres per unit and its standard deviation, from all extents together. `None` without any that is
/// positive and finite.
pub fn vehicle_sizes(extents: &[Extent]) -> Option<(f64, f64)> {
    let is_positive = |value: f64| value.is_finite() && value > 0.0;
    let extents: Vec<&Extent> =
        extents.iter().filter(|extent| is_positive(extent.value) && is_positive(extent.std)).collect();
    let likeness: Vec<Likeness> = extents.iter().map(|extent| extent.class.likeness(extent.dimension)).collect();
    let logs = extents.iter().zip(&likeness).map(|(extent, like)| like.median_m.ln() - extent.value.ln());
    let logs = DVector::from_iterator(extents.len(), logs);
    let covariance = DMatrix::from_fn(extents.len(), extents.len(), |j, k| {
        let mut covariance = SHARED_BY_PLACE * SHARED_BY_PLACE;
        if extents[j].vehicle == extents[k].vehicle {
            covariance += SHARED_BY_VEHICLE * likeness[j].spread * likeness[k].spread;
        }
        if j == k {
            let measured = extents[j].std / extents[j].value;
            covariance += (1.0 - SHARED_BY_VEHICLE) * likeness[j].spread.powi(2) + measured * measured;
        }
        covariance
    });
    let weights = covariance.cholesky()?.solve(&DVector::repeat(extents.len(), 1.0));
    let information = weights.sum();
    (information > 0.0).then(|| (weights.dot(&logs) / information, information.sqrt().recip()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All that an outline shows of a car of this length, width and height at half a metre per unit.
    fn car(vehicle: u32, [length, width, height]: [f64; 3]) -> Vec<Extent> {
        let of = |dimension, metres: f64| {
            let value = 2.0 * metres;
            Extent { vehicle, class: VehicleClass::Car, dimension, value, std: 0.02 * value }
        };
        vec![of(Dimension::Length, length), of(Dimension::Width, width), of(Dimension::Height, height)]
    }

    #[test]
    fn one_car_is_known_to_a_tenth_and_three_to_six_hundredths() {
        let one = car(1, [4.47, 1.83, 1.50]);
        let (log, std) = vehicle_sizes(&one).unwrap();
        assert!((log - 0.5f64.ln()).abs() < 0.05 && std < 0.10, "{log} {std}");
        let three: Vec<Extent> =
            [one, car(2, [3.95, 1.70, 1.48]), car(3, [4.75, 1.88, 1.67])].into_iter().flatten().collect();
        let (log, narrow) = vehicle_sizes(&three).unwrap();
        assert!((log - 0.5f64.ln()).abs() < 0.06 && narrow < 0.06 && narrow < std, "{log} {narrow}");
        let many: Vec<Extent> = (0..200).flat_map(|vehicle| car(vehicle, [4.3, 1.79, 1.55])).collect();
        // What all cars of a place share does not average out.
        assert!(vehicle_sizes(&many).unwrap().1 > 0.9 * SHARED_BY_PLACE);
    }

    #[test]
    fn a_vehicle_seen_from_behind_says_less() {
        let whole = car(1, [4.47, 1.83, 1.50]);
        let (_, all) = vehicle_sizes(&whole).unwrap();
        let (_, behind) = vehicle_sizes(&whole[1..]).unwrap();
        assert!(behind > all && behind < 0.10, "{all} {behind}");
        assert_eq!(vehicle_sizes(&[]), None);
        let broken = Extent { value: f64::NAN, ..whole[0] };
        assert_eq!(vehicle_sizes(&[broken]), None);
        assert_eq!(VehicleClass::from_label("boat"), None);
    }
}
