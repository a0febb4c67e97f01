//! Typical vehicle sizes: lengths, widths and heights of a class as a source of meters.
//!
//! A class consists of segments of similar vehicles: the logarithms of a vehicle's dimensions are normally distributed
//! about those of its segment, with a part common to its dimensions (large or small) and an independent part of each.
//! Each vehicle gives the logarithm of metres per unit as a mixture over the segments of its class ([`single`]).
//! Vehicles that fit no segment, or that contradict the others, are rejected and reported. The rest are averaged by
//! inverse variances, and the variance common to all vehicles of a location is added; docs/maths/metric.md, eq. 8.

mod segments;
mod single;

use std::collections::BTreeMap;

use self::single::{SizeEstimate, answer, probability_of_car};

/// Class of vehicles with known size statistics.
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

with_names!(Dimension { Length = "length", Width = "width", Height = "height" });

impl Dimension {
    /// Index in an array of length, width and height.
    fn index(self) -> usize {
        self as usize
    }
}

/// Measured dimension, in units of the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Id of the vehicle: extents of one vehicle have a common deviation from its segment.
    pub vehicle: u32,
    /// Its class.
    pub class: VehicleClass,
    /// Measured dimension.
    pub dimension: Dimension,
    /// Units.
    pub value: f64,
    /// Standard deviation, units, without that of the scale ratio.
    pub std: f64,
    /// Standard deviation of the vehicle's scale ratio as a share of it, which its extents have in common.
    pub ratio_std: f64,
    /// True if nothing confirms the vehicle's trajectory: it is doubtful, or its scale ratio is a guess.
    pub is_unconfirmed: bool,
}

impl Extent {
    fn is_usable(&self) -> bool {
        let is_positive = |x: f64| x.is_finite() && x > 0.0;
        is_positive(self.value) && is_positive(self.std) && self.ratio_std.is_finite()
    }
}

/// Meters per unit by the sizes of vehicles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VehicleSizes {
    /// Logarithm of metres per unit and its standard deviation; `None` where no vehicle determines it.
    pub log_scale: Option<(f64, f64)>,
    /// Vehicles of unexpected size, in the order in which they were found.
    pub odd: Vec<OddVehicle>,
}

/// A vehicle of unexpected size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OddVehicle {
    /// Id of the vehicle.
    pub vehicle: u32,
    /// Anomaly.
    pub oddity: Oddity,
    /// Size of the anomaly, standard deviations.
    pub deviations: f64,
}

/// Anomaly of a vehicle's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Oddity {
    /// Its proportions fit no segment of its class. It is rejected.
    Shape,
    /// Ratio of the unit by its size to the unit by the sizes of the others. It is rejected if two others remain to
    /// contradict it, or if only one of its extents is known.
    Scale(f64),
}

/// Share of the variance of the logarithm that the dimensions of one vehicle have in common.
const SHARED_BY_VEHICLE: f64 = 0.4;

/// Standard deviation common to the vehicles of one location: cars of KITTI (Karlsruhe, 2011) and of nuScenes (Boston
/// and Singapore, 2018) differ by 17 % in length, 18 % in width and 12 % in height of their boxes, half of which the
/// labels' different margins explain.
const SHARED_BY_PLACE: f64 = 0.035;

/// Standard deviation of the logarithm of the size of an unconfirmed vehicle: only one dimension is known, so that its
/// proportions cannot be tested, its trajectory is doubtful, or its scale ratio is a guess. Vehicles of one clip have
/// similar visibility (a roof without points, only the rear), so they have it in common. Of 51 cars of rendered
/// sequences with one known dimension, two thirds are within one standard deviation with it, 31 % without; those with
/// more dimensions need none.
const UNCONFIRMED: f64 = 0.25;

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
}

/// Metres per unit from all extents together. Extents that are not positive and finite are ignored.
pub fn vehicle_sizes(extents: &[Extent]) -> VehicleSizes {
    let by_vehicle = by_vehicle(extents);
    let answers = by_vehicle.values().filter_map(|extents| answer(extents));
    let mut answers: Vec<SizeEstimate> = answers.collect();
    let mut odd: Vec<OddVehicle> = answers.iter().filter_map(shape_outlier).collect();
    answers.retain(|answer| shape_outlier(answer).is_none());
    odd.extend(take_outliers(&mut answers));
    // The variance common to all vehicles of a location is added.
    let log_scale = mean(&answers).map(|(log_scale, std)| (log_scale, std.hypot(SHARED_BY_PLACE)));
    VehicleSizes { log_scale, odd }
}

/// The usable extents of each vehicle.
fn by_vehicle(extents: &[Extent]) -> BTreeMap<u32, Vec<Extent>> {
    let mut by_vehicle: BTreeMap<u32, Vec<Extent>> = BTreeMap::new();
    for extent in extents.iter().filter(|extent| extent.is_usable()) {
        by_vehicle.entry(extent.vehicle).or_default().push(*extent);
    }
    by_vehicle
}

/// Rejects the vehicle that contradicts the others most, while three are left. Of two that contradict each other the
/// one with untestable proportions is rejected; otherwise both are reported and kept.
fn take_outliers(answers: &mut Vec<SizeEstimate>) -> Vec<OddVehicle> {
    let mut odd = Vec::new();
    loop {
        let mut found: Vec<(usize, OddVehicle)> =
            (0..answers.len()).filter_map(|k| against_others(answers, k).map(|odd| (k, odd))).collect();
        found.sort_by(|(_, a), (_, b)| b.deviations.total_cmp(&a.deviations));
        let taken = if answers.len() > 2 { found.first() } else { untested(answers, &found) };
        let Some(&(k, worst)) = taken else {
            odd.extend(found.into_iter().map(|(_, one)| one));
            return odd;
        };
        odd.push(worst);
        answers.remove(k);
    }
}

/// The vehicle with a single known extent, if there is exactly one such vehicle.
fn untested<'a>(answers: &[SizeEstimate], found: &'a [(usize, OddVehicle)]) -> Option<&'a (usize, OddVehicle)> {
    let is_untested = |k: usize| answers[k].num_extents == 1;
    let mut untested = found.iter().filter(|(k, _)| is_untested(*k));
    untested.next().filter(|_| untested.next().is_none())
}

/// Tests the `k`-th against the mean of the others; `None` where they agree.
fn against_others(answers: &[SizeEstimate], k: usize) -> Option<OddVehicle> {
    let others: Vec<SizeEstimate> = (0..answers.len()).filter(|&j| j != k).map(|j| answers[j]).collect();
    contradiction(&answers[k], mean(&others)?)
}

/// Tests one against a logarithm of meters per unit and its standard deviation; `None` where they agree.
fn contradiction(answer: &SizeEstimate, (log_scale, std): (f64, f64)) -> Option<OddVehicle> {
    let apart = answer.log_scale - log_scale;
    let deviations = apart.abs() / std.hypot(answer.total_std());
    let oddity = Oddity::Scale(apart.exp().clamp(f64::MIN_POSITIVE, f64::MAX));
    // Vehicles that are further from the others contradict them.
    (deviations > 3.0).then_some(OddVehicle { vehicle: answer.vehicle, oddity, deviations })
}

/// Tests the proportions against every segment of the class; `None` where they fit one.
fn shape_outlier(answer: &SizeEstimate) -> Option<OddVehicle> {
    let SizeEstimate { vehicle, misfit, .. } = *answer;
    // Proportions that are further from those of every segment are no vehicle's of the class.
    (misfit > 4.0).then_some(OddVehicle { vehicle, oddity: Oddity::Shape, deviations: misfit })
}

/// Vehicles whose size contradicts the scale of other sources, and those without the proportions of their class.
///
/// * `known` – logarithm of meters per unit by other sources, and its standard deviation; `None` if unknown.
pub fn contradicted_sizes(extents: &[Extent], known: Option<(f64, f64)>) -> Vec<OddVehicle> {
    let known = known.map(|(log_scale, std)| (log_scale, std.hypot(SHARED_BY_PLACE)));
    let answers = by_vehicle(extents).into_values().filter_map(|extents| answer(&extents));
    answers.filter_map(|a| known.and_then(|known| contradiction(&a, known)).or_else(|| shape_outlier(&a))).collect()
}

/// Returns true if the extents of one vehicle, labeled as a bus or a truck, are those of a car.
///
/// * `known` – as for [`contradicted_sizes`].
pub fn is_car_by_size(extents: &[Extent], known: Option<(f64, f64)>) -> bool {
    let extents: Vec<Extent> = extents.iter().filter(|extent| extent.is_usable()).copied().collect();
    // One in twenty is wrong at most.
    probability_of_car(&extents, known) > 0.95
}

/// Mean by inverse variances; its deviation has Birge's factor (`docs/maths/metric.md`, eq. 7), and the common part of
/// unconfirmed vehicles by their share.
fn mean(answers: &[SizeEstimate]) -> Option<(f64, f64)> {
    if answers.is_empty() {
        return None;
    }
    let weights: Vec<f64> = answers.iter().map(|a| a.total_std().powi(-2)).collect();
    let total: f64 = weights.iter().sum();
    let weighted = |value: &dyn Fn(&SizeEstimate) -> f64, power: i32| -> f64 {
        answers.iter().zip(&weights).map(|(a, weight)| (weight / total).powi(power) * value(a)).sum()
    };
    let log_scale = weighted(&|a| a.log_scale, 1);
    let chi2: f64 = answers.iter().map(|a| ((a.log_scale - log_scale) / a.total_std()).powi(2)).sum();
    let freedom = answers.len().saturating_sub(1).max(1) as f64;
    let own = weighted(&|a| a.std.powi(2), 2) * (chi2 / freedom).max(1.0);
    let std = own.sqrt().hypot(weighted(&SizeEstimate::common_std, 1));
    (log_scale.is_finite() && std.is_finite()).then_some((log_scale, std))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All measurable extents of a car of this length, width and height at half a metre per unit.
    fn car(vehicle: u32, [length, width, height]: [f64; 3]) -> Vec<Extent> {
        let of = |dimension, metres: f64| {
            let value = 2.0 * metres;
            Extent {
                vehicle,
                class: VehicleClass::Car,
                dimension,
                value,
                std: 0.03 * value,
                ratio_std: 0.005,
                is_unconfirmed: false,
            }
        };
        vec![of(Dimension::Length, length), of(Dimension::Width, width), of(Dimension::Height, height)]
    }

    /// Cars of five segments, metres.
    const SIZES: [[f64; 3]; 5] =
        [[2.70, 1.66, 1.56], [3.57, 1.63, 1.49], [4.28, 1.79, 1.49], [4.87, 1.86, 1.47], [5.30, 1.90, 1.99]];

    /// Error of the scale and its standard deviation.
    fn error(extents: &[Extent]) -> (f64, f64) {
        let (log_scale, std) = vehicle_sizes(extents).log_scale.unwrap();
        (log_scale - 0.5f64.ln(), std)
    }

    #[test]
    fn proportions_indicate_the_size_of_a_car() {
        for metres in SIZES {
            let (error, std) = error(&car(1, metres));
            assert!(error.abs() < 0.06 && (0.045..0.10).contains(&std), "{metres:?}: {error} {std}");
        }
    }

    #[test]
    fn three_cars_are_more_precise_than_one_and_the_common_part_remains() {
        let one = car(1, [4.47, 1.83, 1.50]);
        let (_, alone) = error(&one);
        let three: Vec<Extent> =
            [one, car(2, [3.95, 1.70, 1.48]), car(3, [4.75, 1.88, 1.67])].into_iter().flatten().collect();
        let (error_of_three, narrow) = error(&three);
        assert!(error_of_three.abs() < 0.06 && narrow < 0.06 && narrow < alone, "{error_of_three} {narrow}");
        let many: Vec<Extent> = (0..200).flat_map(|vehicle| car(vehicle, [4.3, 1.79, 1.55])).collect();
        assert!(error(&many).1 > 0.9 * SHARED_BY_PLACE);
    }

    #[test]
    fn vehicles_observed_from_behind_give_less_evidence() {
        let mean_std = |first: usize| -> f64 {
            let of = |metres: &[f64; 3]| error(&car(1, *metres)[first..]).1;
            SIZES.iter().map(of).sum::<f64>() / SIZES.len() as f64
        };
        let (all, behind) = (mean_std(0), mean_std(1));
        assert!(behind > 1.1 * all && behind < 0.15, "{all} {behind}");
        let broken = Extent { value: f64::NAN, ..car(1, SIZES[0])[0] };
        assert_eq!(vehicle_sizes(&[broken]), VehicleSizes::default());
        assert_eq!(VehicleClass::from_label("boat"), None);
    }

    #[test]
    fn a_car_that_is_labeled_as_a_bus_is_a_car() {
        let labeled = |class, metres| -> Vec<Extent> {
            car(1, metres).into_iter().map(|extent| Extent { class, ..extent }).collect()
        };
        let (small, bus) = ([3.57, 1.63, 1.49], [11.8, 2.55, 3.2]);
        let known = Some((0.5f64.ln(), 0.1));
        for class in [VehicleClass::Bus, VehicleClass::Truck] {
            assert!(is_car_by_size(&labeled(class, small), known));
            assert!(!is_car_by_size(&labeled(class, bus), known) && !is_car_by_size(&labeled(class, bus), None));
            // Its length alone gives no evidence without a scale.
            assert!(!is_car_by_size(&labeled(class, small)[..1], None));
        }
        // Buses are longer for their width; of trucks some have a car's proportions.
        let by_proportions = |class| is_car_by_size(&labeled(class, small), None);
        assert!(by_proportions(VehicleClass::Bus) && !by_proportions(VehicleClass::Truck));
        assert!(!is_car_by_size(&labeled(VehicleClass::Motorcycle, small), known));
        assert!(!is_car_by_size(&[], known));
    }

    #[test]
    fn a_vehicle_without_the_proportions_of_a_car_is_rejected() {
        let mast = car(11, [3.0, 2.0, 4.3]);
        let alone = vehicle_sizes(&mast);
        assert_eq!((alone.log_scale, alone.odd[0].oddity), (None, Oddity::Shape));
        let both = vehicle_sizes(&[car(1, [4.47, 1.83, 1.50]), mast].concat());
        assert_eq!(both.log_scale, vehicle_sizes(&car(1, [4.47, 1.83, 1.50])).log_scale);
        assert_eq!(both.odd.iter().map(|odd| odd.vehicle).collect::<Vec<_>>(), [11]);
    }

    #[test]
    fn a_car_of_another_scale_is_rejected_by_two_others_and_else_widens() {
        let scaled = |vehicle, factor: f64| car(vehicle, [4.3, 1.79, 1.5].map(|metres| factor * metres));
        let three = vehicle_sizes(&[scaled(1, 1.0), scaled(2, 1.02), scaled(3, 1.6)].concat());
        assert_eq!(three.odd.iter().map(|odd| odd.vehicle).collect::<Vec<_>>(), [3]);
        assert!(matches!(three.odd[0].oddity, Oddity::Scale(ratio) if (ratio - 1.0 / 1.58).abs() < 0.03));
        let height_alone = vehicle_sizes(&[scaled(1, 1.0), scaled(3, 3.0)[2..].to_vec()].concat());
        assert_eq!(height_alone.log_scale, vehicle_sizes(&scaled(1, 1.0)).log_scale);
        let two = vehicle_sizes(&[scaled(1, 1.0), scaled(3, 1.6)].concat());
        assert_eq!(two.odd.len(), 2);
        assert!(two.log_scale.unwrap().1 > 0.2, "{two:?}");
    }

    #[test]
    fn the_size_of_unconfirmed_vehicles_is_uncertain() {
        let rear = car(1, [4.3, 1.79, 1.5]);
        let doubtful = |vehicle: u32| -> Vec<Extent> {
            let car = car(vehicle, [4.3, 1.79, 1.5]);
            car.into_iter().map(|extent| Extent { is_unconfirmed: true, ..extent }).collect()
        };
        for extents in [rear[2..].to_vec(), doubtful(1), (1..9).flat_map(doubtful).collect()] {
            let (_, std) = error(&extents);
            assert!((UNCONFIRMED..0.3).contains(&std), "{std}");
        }
        // A well observed car has nearly all the weight.
        let (_, std) = error(&[car(2, [4.3, 1.79, 1.5]), rear[2..].to_vec()].concat());
        assert!(std < 0.08, "{std}");
    }

    #[test]
    fn a_bus_of_the_detector_may_be_a_car() {
        let bus = |metres: [f64; 3]| -> Vec<Extent> {
            car(1, metres).into_iter().map(|extent| Extent { class: VehicleClass::Bus, ..extent }).collect()
        };
        for metres in [[4.6, 1.8, 1.75], [11.5, 2.55, 3.2]] {
            let (error, std) = error(&bus(metres));
            assert!(error.abs() < 2.0 * std && error.abs() < 0.3, "{metres:?}: {error} {std}");
            let (error, std) = self::error(&bus(metres)[2..]);
            assert!(error.abs() < 1.5 * std, "{metres:?}: {error} {std}");
        }
    }

    #[test]
    fn sizes_contradict_a_scale_that_is_known() {
        let known = |factor: f64, std: f64| Some(((0.5 * factor).ln(), std));
        let extents = car(1, [4.3, 1.79, 1.5]);
        assert_eq!(contradicted_sizes(&extents, known(1.0, 0.02)), []);
        assert_eq!(contradicted_sizes(&extents, known(0.5, 0.3)), []);
        assert_eq!(contradicted_sizes(&extents, None), []);
        let found = contradicted_sizes(&extents, known(0.5, 0.02));
        assert!(matches!(found[..], [OddVehicle { vehicle: 1, oddity: Oddity::Scale(ratio), .. }] if ratio > 1.7));
        let low = contradicted_sizes(&car(1, [4.3, 1.79, 0.75]), None);
        assert!(matches!(low[..], [OddVehicle { oddity: Oddity::Shape, .. }]), "{low:?}");
    }

    #[test]
    fn the_scale_ratio_moves_all_extents_of_a_vehicle() {
        let loose = |mut extents: Vec<Extent>| {
            extents.iter_mut().for_each(|extent| extent.ratio_std = 0.1);
            extents
        };
        let (_, std) = error(&loose(car(1, [4.3, 1.79, 1.5])));
        assert!(std > 0.1 && std < 0.13, "{std}");
    }
}
