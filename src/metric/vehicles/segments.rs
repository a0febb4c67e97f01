//! Sizes of vehicles: the market segments of each class, with their shares.
//!
//! The sizes of a detector's class are not normally distributed: `car` ranges from two-seaters to vans. Cars of one
//! segment are alike, and the proportions of a car indicate its segment.

use super::VehicleClass;

/// Vehicles of similar size.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    /// Share of the class.
    pub(super) share: f64,
    /// Medians of length, width and height, metres.
    pub(super) median_m: [f64; 3],
    /// Standard deviations of their logarithms.
    pub(super) spread: [f64; 3],
}

/// Standard deviations within a segment of cars. Models of one year differ by 2.3, 1.5 and 2.7 %; older ones and those
/// of other markets differ by more. With these, 67 to 78 % of the models are within one σ in leave-one-out tests.
const CARS: [f64; 3] = [0.05, 0.03, 0.04];

const fn cars(share: f64, median_m: [f64; 3]) -> Segment {
    Segment { share, median_m, spread: CARS }
}

/// Means of models that sell well in Europe, accurate to about a per cent, and shares of registrations;
/// `docs/maths/metric.md` lists the models.
const CAR: [Segment; 10] = [
    cars(0.01, [2.67, 1.52, 1.51]), // two seats
    cars(0.08, [3.59, 1.63, 1.49]), // city cars
    cars(0.19, [4.04, 1.77, 1.46]), // small
    cars(0.17, [4.39, 1.80, 1.46]), // compact
    cars(0.08, [4.82, 1.85, 1.46]), // saloons and estates
    cars(0.15, [4.26, 1.80, 1.58]), // small sport utility vehicles
    cars(0.16, [4.51, 1.85, 1.65]), // middling ones
    cars(0.05, [4.94, 1.97, 1.76]), // large ones
    cars(0.05, [4.48, 1.86, 1.78]), // people carriers
    cars(0.06, [5.06, 1.94, 1.97]), // vans
];

/// Trucks, from delivery trucks of 5 m to the 16.5 m of Directive 96/53/EC.
const TRUCK: [Segment; 11] = or_car([6.9, 2.45, 2.9], [0.35, 0.10, 0.22]);

/// Buses and coaches.
const BUS: [Segment; 11] = or_car([11.2, 2.55, 3.3], [0.20, 0.06, 0.13]);

/// A detector's class of large vehicles, of which half are cars. All eight vehicles of rendered sequences that were
/// labelled `bus` are vans and cars.
const fn or_car(median_m: [f64; 3], spread: [f64; 3]) -> [Segment; 11] {
    let mut segments = [Segment { share: 0.5, median_m, spread }; 11];
    let mut k = 0;
    while k < CAR.len() {
        segments[k + 1] = Segment { share: 0.5 * CAR[k].share, ..CAR[k] };
        k += 1;
    }
    segments
}

/// Motorcycles and scooters.
const MOTORCYCLE: [Segment; 1] = [Segment { share: 1.0, median_m: [2.1, 0.77, 1.2], spread: [0.12, 0.18, 0.15] }];

/// The segments of a class.
pub(super) fn of(class: VehicleClass) -> &'static [Segment] {
    match class {
        VehicleClass::Car => &CAR,
        VehicleClass::Truck => &TRUCK,
        VehicleClass::Bus => &BUS,
        VehicleClass::Motorcycle => &MOTORCYCLE,
    }
}

/// Cars among a class of large vehicles: those that a detector mislabels.
pub(super) fn cars_among(class: VehicleClass) -> &'static [Segment] {
    match class {
        VehicleClass::Truck => &TRUCK[1..],
        VehicleClass::Bus => &BUS[1..],
        VehicleClass::Car | VehicleClass::Motorcycle => &[],
    }
}
