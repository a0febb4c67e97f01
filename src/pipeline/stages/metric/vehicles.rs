//! Metres by the vehicles' sizes, and their sizes in metres.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::math::median;
use crate::math::rounding::significant;
use crate::metric::{
    Dimension, Extent, Kind, KnownLength, Measured, OddVehicle, Oddity, Source, VehicleClass, VehicleSizes,
    contradicted_sizes, is_car_by_size, vehicle_sizes,
};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::scene::{
    Dimensions, Estimate, GroundPosition, GroundTrack, MetricContradiction, MetricFrame, ObjectId, ObjectTrajectory,
    Reason, ReasonKind, Reconstruction, ScaleEstimate, ScaleShares, Topic, Trajectories, Trust,
};
use crate::trajectory::{BodyOnGround, with_reason};

/// Length, width and height of an object, in units of the background; `None` for a dimension that was never visible.
pub(in crate::pipeline) type Size = [Option<Estimate>; 3];

/// Size of a vehicle on the ground.
///
/// * `distance_std` – relative standard deviation of its distance to the camera.
pub(super) fn size_of_body(body: &BodyOnGround, distance_std: f64) -> Size {
    let with_distance = |found: Estimate| Estimate { std: found.std.hypot(distance_std * found.value), ..found };
    [body.length, body.width, body.height].map(|found| found.map(with_distance))
}

/// A size in metres, with the uncertainty of the scale.
pub(super) fn in_metres(size: &Size, frame: &MetricFrame) -> Dimensions {
    let metres = |units: Estimate| {
        let value = frame.scale * units.value;
        Estimate { value, std: value * frame.log_scale_std().hypot(units.std / units.value) }
    };
    let [length_m, width_m, height_m] = size.map(|found| found.map(metres));
    Dimensions { length_m, width_m, height_m }
}

/// Known dimensions of single vehicles, each a source of its own.
pub(super) fn known(run: &Run, sizes: &BTreeMap<ObjectId, Size>, outcome: &mut Outcome) -> Vec<Source> {
    let known = run.options.metric.known_lengths.iter();
    let source = |known: &KnownLength| {
        let text = |reason| format!("--known-length {known} gives no scale: {reason}");
        of_length(known, sizes).map_err(|reason| outcome.warn(Topic::KnownLengthUnusable.warning(text(reason)))).ok()
    };
    known.filter_map(source).collect()
}

fn of_length(known: &KnownLength, sizes: &BTreeMap<ObjectId, Size>) -> Result<Source, String> {
    let KnownLength { object, dimension, length } = known;
    let name = dimension.name();
    let size = sizes.get(object).ok_or_else(|| format!("vehicle {object}: no trajectory"))?;
    let units = size[*dimension as usize].and_then(|units| Measured::new(units.value, units.std));
    let units = units.ok_or_else(|| format!("vehicle {object}: {name} not measured, never visible well enough"))?;
    let (log_scale, std) = length.log_ratio(&units);
    Ok(Source { name: format!("{name} of vehicle {object}"), kind: Kind::Surveyed, log_scale, std })
}

/// Meters by the vehicles with trusted trajectories; if they determine no scale, by the doubtful ones.
pub(super) fn typical_sizes(trajectories: &Trajectories, sizes: &BTreeMap<ObjectId, Size>) -> VehicleSizes {
    let (doubtful, trusted): (Vec<&ObjectTrajectory>, Vec<_>) =
        trajectories.objects.iter().filter(|trajectory| !trajectory.is_ruled_out()).partition(|t| is_doubtful(t));
    let sizes_of = |vehicles: Vec<&ObjectTrajectory>| {
        let extents: Vec<Extent> = vehicles.into_iter().flat_map(|trajectory| extents(trajectory, sizes)).collect();
        vehicle_sizes(&extents)
    };
    let trusted = sizes_of(trusted);
    if trusted.log_scale.is_some() {
        return trusted;
    }
    let doubtful = sizes_of(doubtful);
    VehicleSizes { odd: [trusted.odd, doubtful.odd].concat(), ..doubtful }
}

/// Meters by typical vehicle sizes as one source; `None` if no vehicle is of a class of uniform size.
pub(super) fn source_of(sizes: &VehicleSizes) -> Option<Source> {
    let (log_scale, std) = sizes.log_scale?;
    Some(Source { name: "typical vehicle sizes".to_owned(), kind: Kind::Prior, log_scale, std })
}

/// Sizes of all vehicles that have one: by usable trajectories, else by outlines on the ground, else by other
/// trajectories.
pub(super) fn sizes_of_all(
    trajectories: &Trajectories,
    sizes: &BTreeMap<ObjectId, Size>,
    bodies: &BTreeMap<ObjectId, BodyOnGround>,
    background: &Reconstruction,
) -> BTreeMap<ObjectId, Size> {
    let on_ground = trajectories.ground_tracks.iter().filter_map(|track| {
        let distance_std = common_distance_std(track, background)?;
        Some((track.id, size_of_body(bodies.get(&track.id)?, distance_std)))
    });
    let usable = trajectories.objects.iter().filter(|trajectory| !trajectory.is_ruled_out());
    let usable = usable.filter_map(|trajectory| Some((trajectory.id, *sizes.get(&trajectory.id)?)));
    sizes.iter().map(|(id, size)| (*id, *size)).chain(on_ground).chain(usable).collect()
}

/// Meters by the vehicles with a ground track.
pub(super) fn typical_sizes_on_ground(
    tracks: &[GroundTrack],
    bodies: &BTreeMap<ObjectId, BodyOnGround>,
    background: &Reconstruction,
) -> VehicleSizes {
    let with_body = || tracks.iter().filter_map(|track| Some((track, bodies.get(&track.id)?)));
    let of_class = |(track, body)| {
        let mut found = extents_on_ground(track, body, 0.0);
        if is_car_by_size(&found, None) {
            found.iter_mut().for_each(|extent| extent.class = VehicleClass::Car);
        }
        found
    };
    let extents: Vec<Extent> = with_body().flat_map(of_class).collect();
    let common = |(track, body): (_, &BodyOnGround)| Some(common_distance_std(track, background)?.hypot(body.mask_std));
    let common = median(with_body().filter_map(common).collect());
    let found = vehicle_sizes(&extents);
    let log_scale = found.log_scale.zip(common).map(|((log_scale, std), common)| (log_scale, std.hypot(common)));
    VehicleSizes { log_scale, ..found }
}

/// Relative standard deviation of a vehicle's distances that is common to all vehicles: that of the plane and of the
/// focal length.
fn common_distance_std(track: &GroundTrack, background: &Reconstruction) -> Option<f64> {
    let share = |at: &GroundPosition| {
        let sight =
            Vector3::from(at.position) - background.images.get(&at.frame.into())?.cam_from_world.center().coords;
        let along = |error: [f64; 3]| sight.dot(&Vector3::from(error)) / sight.norm_squared();
        Some(along(at.error.common).hypot(along(at.error.focal)))
    };
    median(track.positions.iter().filter_map(share).collect())
}

/// Dimensions of a vehicle on the ground; none if its class has no typical ones.
///
/// * `ratio_std` – common relative standard deviation of the dimensions.
fn extents_on_ground(track: &GroundTrack, body: &BodyOnGround, ratio_std: f64) -> Vec<Extent> {
    extents_of(track.id, &track.class, &size_of_body(body, 0.0), ratio_std, false)
}

/// Reclassifies every bus or truck on the ground with the size of a car as a car, and its trajectory, too.
///
/// * `known` – as for [`doubt_sizes`].
pub(super) fn correct_classes_on_ground(
    tracks: &mut [GroundTrack],
    objects: &mut [ObjectTrajectory],
    bodies: &BTreeMap<ObjectId, BodyOnGround>,
    known: Option<(f64, f64)>,
    background: &Reconstruction,
) {
    for track in tracks {
        let Some((body, common)) = bodies.get(&track.id).zip(common_distance_std(track, background)) else { continue };
        if is_car_by_size(&extents_on_ground(track, body, common.hypot(body.mask_std)), known) {
            let trajectory = objects.iter_mut().find(|trajectory| trajectory.id == track.id);
            trajectory.into_iter().for_each(|trajectory| trajectory.class = "car".to_owned());
            track.class = "car".to_owned();
        }
    }
}

fn is_doubtful(trajectory: &ObjectTrajectory) -> bool {
    trajectory.verdict.as_ref().is_some_and(|verdict| verdict.state >= Trust::Doubtful)
}

/// Returns true if a scale ratio is a guess: no outline shows the contact with the ground, on which most of its
/// variance depends. A car parked half a meter below the plane of the road was found at 0.73 times its distance.
fn is_guessed(scale: &ScaleEstimate) -> bool {
    let has_outline = scale.support.is_some_and(|support| support.frames_with_outline > 0);
    let depends = |shares: ScaleShares| 2.0 * shares.contact.powi(2) > shares.given_focal().powi(2);
    !has_outline && scale.shares.is_some_and(depends)
}

impl VehicleSizes {
    /// Reports the vehicles of inconsistent size.
    pub(super) fn warn(&self, outcome: &mut Outcome) {
        for OddVehicle { vehicle, oddity, deviations } in &self.odd {
            let text = match oddity {
                Oddity::Shape => format!(
                    "vehicle {vehicle}: proportions differ from its class ({deviations:.1} standard deviations off); \
                     its size is not used for the scale"
                ),
                Oddity::Scale(ratio) => format!(
                    "vehicle {vehicle}: size contradicts the other vehicles ({ratio:.3} times their meters per unit, \
                     {deviations:.1} standard deviations)"
                ),
            };
            outcome.warn(Topic::VehicleProportionsOdd.warning(text));
        }
    }

    /// The vehicles that contradict the others, in the format of the result.
    pub(super) fn contradictions(&self) -> impl Iterator<Item = MetricContradiction> {
        self.odd.iter().filter_map(|&OddVehicle { vehicle, oddity, deviations }| match oddity {
            Oddity::Shape => None,
            Oddity::Scale(ratio) => {
                Some(MetricContradiction { source: format!("size of vehicle {vehicle}"), ratio, deviations })
            }
        })
    }
}

/// Reclassifies every bus or truck with the size of a car as a car: from above, detectors confuse them.
///
/// * `known` – as for [`doubt_sizes`].
pub(super) fn correct_classes(
    objects: &mut [ObjectTrajectory],
    sizes: &BTreeMap<ObjectId, Size>,
    known: Option<(f64, f64)>,
) {
    for trajectory in objects.iter_mut().filter(|trajectory| !trajectory.is_ruled_out()) {
        if is_car_by_size(&extents(trajectory, sizes), known) {
            let says = format!("size of a car; detected as {}", trajectory.class);
            trajectory.class = "car".to_owned();
            let verdict = trajectory.verdict.take();
            trajectory.verdict = verdict.map(|verdict| with_reason(verdict, Reason::supports(ReasonKind::Size, says)));
        }
    }
}

/// Adds a doubt to the verdict on every vehicle whose proportions do not fit its class, or whose size contradicts
/// meters from other sources.
///
/// * `known` – logarithm of meters per unit without typical vehicle sizes, and its standard deviation.
pub(super) fn doubt_sizes(
    objects: &mut [ObjectTrajectory],
    sizes: &BTreeMap<ObjectId, Size>,
    known: Option<(f64, f64)>,
    outcome: &mut Outcome,
) {
    for trajectory in objects {
        let found = contradicted_sizes(&extents(trajectory, sizes), known);
        let was_ruled_out = trajectory.is_ruled_out();
        let Some(verdict) = trajectory.verdict.take() else { continue };
        let reasons: Vec<Reason> = found.iter().map(|odd| size_doubt(odd, &trajectory.class)).collect();
        let says = reasons.first().map(|reason| reason.says.clone()).unwrap_or_default();
        trajectory.verdict = Some(reasons.into_iter().fold(verdict, with_reason));
        if trajectory.is_ruled_out() && !was_ruled_out {
            outcome.warn(Topic::VehicleRejected.warning(format!("object {}: rejected: {says}", trajectory.id)));
        }
    }
}

fn size_doubt(odd: &OddVehicle, class: &str) -> Reason {
    let deviations = odd.deviations;
    match odd.oddity {
        Oddity::Shape => {
            let says = format!("proportions of no {class} ({deviations:.1} standard deviations off)");
            Reason::doubts(ReasonKind::Shape, 1.0, says)
        }
        Oddity::Scale(ratio) => {
            let size = significant(ratio.recip(), 2);
            let says = format!("{size} times as large as usual for a {class} ({deviations:.1} standard deviations)");
            Reason::doubts(ReasonKind::Size, 1.0, says)
        }
    }
}

fn extents(trajectory: &ObjectTrajectory, sizes: &BTreeMap<ObjectId, Size>) -> Vec<Extent> {
    let Some(size) = sizes.get(&trajectory.id) else { return Vec::new() };
    let ratio_std = trajectory.scale.std.unwrap_or(0.0) / trajectory.scale.ratio;
    let is_unconfirmed = is_doubtful(trajectory) || is_guessed(&trajectory.scale);
    let alone = |Estimate { value, std }: Estimate| {
        // The uncertainty of a size includes that of the ratio. No size is known better than to a thousandth.
        let std = (std * std - (ratio_std * value).powi(2)).max(0.0).sqrt().max(1e-3 * value);
        Estimate { value, std }
    };
    let size = size.map(|found| found.map(alone));
    extents_of(trajectory.id, &trajectory.class, &size, ratio_std, is_unconfirmed)
}

fn extents_of(id: ObjectId, class: &str, size: &Size, ratio_std: f64, is_unconfirmed: bool) -> Vec<Extent> {
    let Some(class) = VehicleClass::from_label(class) else { return Vec::new() };
    let extent = |dimension| {
        let Estimate { value, std } = size[dimension as usize]?;
        Some(Extent { vehicle: id.0, class, dimension, value, std, ratio_std, is_unconfirmed })
    };
    Dimension::ALL.into_iter().filter_map(extent).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rigid3;
    use crate::scene::{CameraId, ContactError, FrameId, Image, ImageId, ScaleMethod, ScaleSupport, Unit, Verdict};

    fn sizes() -> BTreeMap<ObjectId, Size> {
        let length = Some(Estimate { value: 2.0, std: 0.02 });
        [(ObjectId(3), [length, None, None])].into()
    }

    #[test]
    fn a_known_length_over_its_units_is_a_source() {
        let found = of_length(&"3:length=4.4±0.044".parse().unwrap(), &sizes()).unwrap();
        assert!((found.log_scale - 2.2f64.ln()).abs() < 1e-12 && (found.std - 0.01f64.hypot(0.01)).abs() < 1e-12);
        assert_eq!(found.name, "length of vehicle 3");
    }

    #[test]
    fn unmeasured_dimensions_are_reported() {
        let of = |text: &str| of_length(&text.parse().unwrap(), &sizes()).unwrap_err();
        assert!(of("3:width=1.8").contains("vehicle 3: width not measured"));
        assert!(of("4:length=4.4").contains("vehicle 4: no trajectory"));
    }

    /// A trusted car, 4.3 units long, with its size.
    fn car(id: u32, factor: f64, state: Trust) -> (ObjectTrajectory, (ObjectId, Size)) {
        let scale = ScaleEstimate::new(1.0, ScaleMethod::Joint);
        let mut trajectory = ObjectTrajectory::new(ObjectId(id), "car", 1.0, scale);
        trajectory.verdict = Some(Verdict { state, reasons: Vec::new() });
        let extent = |units: f64| Some(Estimate { value: factor * units, std: 0.02 * factor * units });
        (trajectory, (ObjectId(id), [4.3, 1.8, 1.48].map(extent)))
    }

    #[test]
    fn impossible_sizes_count_against_the_verdict() {
        let state = |factors: [f64; 3], known: Option<(f64, f64)>| {
            let (trajectory, (id, size)) = car(1, 1.0, Trust::Good);
            let scaled = |k: usize| size[k].map(|extent: Estimate| extent.scaled(factors[k]));
            let size = [0, 1, 2].map(scaled);
            let mut objects = [trajectory];
            doubt_sizes(&mut objects, &[(id, size)].into(), known, &mut Outcome::default());
            let [trajectory] = objects;
            trajectory.verdict.map(|verdict| verdict.state)
        };
        // One metre per unit: by typical sizes themselves no size is wrong, only proportions.
        assert_eq!(state([1.0; 3], Some((0.0, 0.02))), Some(Trust::Good));
        assert_eq!(state([0.5; 3], None), Some(Trust::Good));
        assert_eq!(state([0.5; 3], Some((0.0, 0.02))), Some(Trust::Doubtful));
        assert_eq!(state([0.5; 3], Some((0.0, 0.3))), Some(Trust::Good));
        assert_eq!(state([1.0, 1.0, 0.5], None), Some(Trust::Doubtful));
    }

    #[test]
    fn a_bus_of_the_size_of_a_car_is_a_car() {
        let class = |factor: f64, state: Trust| {
            let (mut trajectory, size) = car(1, factor, state);
            trajectory.class = "bus".to_owned();
            let mut objects = [trajectory];
            correct_classes(&mut objects, &[size].into(), Some((0.0, 0.1)));
            let [trajectory] = objects;
            let reasons = trajectory.verdict.map(|verdict| verdict.reasons).unwrap_or_default();
            (trajectory.class, reasons.first().map(|reason| reason.says.clone()))
        };
        assert_eq!(class(1.0, Trust::Fair), ("car".to_owned(), Some("size of a car; detected as bus".to_owned())));
        assert_eq!(class(1.0, Trust::Rejected), ("bus".to_owned(), None));
        assert_eq!(class(2.5, Trust::Fair), ("bus".to_owned(), None));
    }

    #[test]
    fn a_ratio_from_the_lowest_points_alone_is_a_guess() {
        let std = |frames_with_outline: usize, contact: f64| {
            let (mut trajectory, (id, size)) = car(1, 1.0, Trust::Fair);
            trajectory.scale.support = Some(ScaleSupport { frames_with_outline, ..ScaleSupport::default() });
            trajectory.scale.shares = Some(ScaleShares { contact, frames: 0.02, ..ScaleShares::default() });
            trajectory.scale.std = trajectory.scale.shares.map(|shares| shares.total());
            let objects = vec![trajectory];
            let all = Trajectories { unit: Unit::Background, metric: None, objects, ground_tracks: Vec::new() };
            source_of(&typical_sizes(&all, &[(id, size)].into())).unwrap().std
        };
        assert!(std(5, 0.06) < 0.1 && std(0, 0.01) < 0.1, "{} {}", std(5, 0.06), std(0, 0.01));
        assert!(std(0, 0.06) > 0.25, "{}", std(0, 0.06));
    }

    #[test]
    fn sizes_on_the_ground_serve_where_there_is_no_trajectory() {
        let image = Image {
            name: "0.jpg".into(),
            camera: CameraId(1),
            cam_from_world: Rigid3::identity(),
            observations: Vec::new(),
        };
        let background =
            Reconstruction { images: [(ImageId::from(FrameId(0)), image)].into(), ..Reconstruction::default() };
        let track = |id: u32, class: &str, common: f64| {
            let error = ContactError { common: [0.0, 0.0, common], ..ContactError::default() };
            let (frame, position) = (FrameId(0), [0.0, 0.0, 10.0]);
            let at = GroundPosition { frame, name: "0.jpg".into(), time_s: 0.0, position, error, metric: None };
            GroundTrack { positions: vec![at], ..GroundTrack::new(ObjectId(id), class, 0.5) }
        };
        let extent = |units: f64| Some(Estimate { value: units, std: 0.05 * units });
        let body = |factor: f64| BodyOnGround {
            length: extent(4.3 * factor),
            width: extent(1.8 * factor),
            mask_std: 0.05,
            ..BodyOnGround::default()
        };
        let bodies: BTreeMap<_, _> = [1, 2].map(|id| (ObjectId(id), body(2.0))).into();
        let found = |class: &str, common| {
            let tracks = [1, 2].map(|id| track(id, class, common));
            typical_sizes_on_ground(&tracks, &bodies, &background)
        };
        // One unit is two metres; from above a detector takes a car for a bus.
        for class in ["car", "bus"] {
            let source = source_of(&found(class, 0.0)).unwrap();
            assert!((source.log_scale.exp() - 0.5).abs() < 0.05 && source.std > 0.05, "{class}: {source:?}");
        }
        assert!(source_of(&found("vehicle", 0.0)).is_none(), "anything that moves is no car");
        let unsure = found("car", 2.0);
        assert!(source_of(&unsure).unwrap().std > 0.2, "the error of all distances is the error of all sizes");
        let (trajectory, size) = car(3, 1.0, Trust::Good);
        let all = Trajectories {
            unit: Unit::Background,
            metric: None,
            objects: vec![trajectory],
            ground_tracks: vec![track(1, "car", 0.0), track(3, "car", 0.0)],
        };
        let sizes = sizes_of_all(&all, &[size].into(), &bodies, &background);
        assert_eq!(sizes[&ObjectId(1)][Dimension::Length as usize], extent(8.6), "on the ground, without a trajectory");
        assert_eq!(sizes[&ObjectId(3)], size.1, "a good trajectory has the last word");
        let mut tracks = [track(1, "bus", 0.0), track(2, "bus", 0.0)];
        let of_a_bus = BodyOnGround { length: extent(24.0), width: extent(5.0), ..BodyOnGround::default() };
        let bodies = [(ObjectId(1), body(2.0)), (ObjectId(2), of_a_bus)].into();
        correct_classes_on_ground(&mut tracks, &mut [], &bodies, Some((0.5f64.ln(), 0.02)), &background);
        assert_eq!(tracks.map(|track| track.class), ["car", "bus"]);
    }

    #[test]
    fn doubtful_vehicles_are_used_last() {
        let segment = |cars: Vec<(ObjectTrajectory, (ObjectId, Size))>| {
            let (objects, sizes): (Vec<_>, Vec<_>) = cars.into_iter().unzip();
            let all = Trajectories { unit: Unit::Background, metric: None, objects, ground_tracks: Vec::new() };
            source_of(&typical_sizes(&all, &sizes.into_iter().collect()))
        };
        let (good, doubtful) = (|| car(1, 1.0, Trust::Fair), || car(2, 1.5, Trust::Doubtful));
        assert_eq!(segment(vec![good(), doubtful()]), segment(vec![good()]));
        assert!(segment(vec![doubtful()]).is_some());
        assert!(segment(vec![car(3, 1.0, Trust::Rejected)]).is_none());
    }
}
