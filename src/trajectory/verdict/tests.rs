//! Verdicts on correct vehicles and on false ones.

use std::collections::BTreeMap;

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::scene::{
    CameraPathRatio, DetectionCounts, Movement, MovementFinding, ObjectId, Outline, ReasonKind, ScaleEstimate,
    ScaleMethod,
};
use crate::synthetic::drive::{self, Drive, Noise, drive};
use crate::trajectory::{ObjectDescription, assemble};

const NOISE: Noise = Noise { pixel_px: 0.3, plane_height_m: 0.02, plane_tilt_deg: 0.2, bad_planes: 0.0 };

/// A moving car, with its data.
#[derive(Clone)]
struct Car {
    world: Drive,
    trajectory: ObjectTrajectory,
    tracked: TrackedObject,
}

fn estimate(ratio: f64, relative_std: f64) -> ScaleEstimate {
    ScaleEstimate { std: Some(relative_std * ratio), ..ScaleEstimate::new(ratio, ScaleMethod::Joint) }
}

/// * `error` – factor by which the ratio is wrong.
fn car(id: u32, error: f64, options: &drive::Options) -> Car {
    let world = drive(options, u64::from(id));
    let tracked = TrackedObject {
        id: ObjectId(id),
        class: "car".into(),
        confidence: 0.8,
        found_in: DetectionCounts { detector: 50, ..DetectionCounts::default() },
        outline: Outline::Network,
        mask_quality: Some(0.93),
        movement: MovementFinding { state: Movement::Moving, reason: "its points move".into() },
        left_out: None,
        gaps: Vec::new(),
        apart: Vec::new(),
        frames: world.frames.iter().map(|frame| frame.id).collect(),
    };
    let description = ObjectDescription { id: ObjectId(id), class: "car".into(), confidence: 0.8 };
    let scale = estimate(error * world.ratio, 0.01);
    let trajectory = assemble(description, &world.background, &world.object, scale, &world.frames);
    Car { world, trajectory, tracked }
}

fn usual() -> drive::Options {
    drive::Options { noise: NOISE, ..drive::Options::default() }
}

impl Car {
    fn candidate(&self) -> Candidate<'_> {
        Candidate {
            trajectory: &self.trajectory,
            tracked: Some(&self.tracked),
            object: &self.world.object,
            background: &self.world.background,
            planes: &self.world.planes,
        }
    }
}

fn judge(cars: &[Car]) -> Vec<Verdict> {
    let candidates: Vec<Candidate> = cars.iter().map(Car::candidate).collect();
    verdicts(&candidates, TimeBase::Seconds, &[])
}

fn finding(verdict: &Verdict, kind: ReasonKind) -> Option<Finding> {
    verdict.reasons.iter().find(|reason| reason.kind == kind).map(|reason| reason.finding)
}

fn moved(car: &mut Car, by: impl Fn(usize) -> Vector3<f64>) {
    for (k, pose) in car.trajectory.poses.iter_mut().enumerate() {
        pose.world_from_object.translation += by(k);
        pose.position = (Vector3::from(pose.position) + by(k)).into();
    }
}

/// Height of the car in units of the background.
fn height(car: &Car) -> f64 {
    1.5 / usual().background_unit_m * car.trajectory.scale.ratio / car.world.ratio
}

fn normal(car: &Car) -> Vector3<f64> {
    car.world.planes.values().next().map_or(Vector3::z(), |plane| plane.normal)
}

#[test]
fn a_moving_car_is_good_and_every_check_supports_it() {
    let verdict = judge(&[car(1, 1.0, &usual())]).remove(0);
    assert_eq!(verdict.state, Trust::Good, "{verdict:#?}");
    for kind in [
        ReasonKind::Deviation,
        ReasonKind::Amount,
        ReasonKind::Pixels,
        ReasonKind::Detection,
        ReasonKind::Movement,
        ReasonKind::Ground,
        ReasonKind::Shape,
        ReasonKind::Speed,
        ReasonKind::Path,
    ] {
        assert_eq!(finding(&verdict, kind), Some(Finding::Supports), "{kind:?}: {verdict:#?}");
    }
}

#[test]
fn a_wrong_ratio_floats_or_sinks() {
    for (error, wanted) in [(0.6, "floats"), (1.3, "below the ground")] {
        let verdict = judge(&[car(1, error, &usual())]).remove(0);
        let reason = verdict.against().next().unwrap();
        assert!(reason.kind == ReasonKind::Ground && reason.says.contains(wanted), "{error}: {verdict:#?}");
        assert!(verdict.is_refuted());
    }
}

#[test]
fn a_stationary_car_may_be_lower_than_the_ground_around_it() {
    let mut car = car(1, 1.0, &usual());
    let lift = 1.2 * height(&car);
    car.world.planes.values_mut().for_each(|plane| plane.point += plane.normal * lift);
    assert_eq!(finding(&judge(&[car.clone()]).remove(0), ReasonKind::Ground), Some(Finding::Refutes));
    let (ratio, std) = (car.world.ratio, 0.01);
    car.trajectory.scale.camera_path = Some(CameraPathRatio {
        ratio,
        std,
        residual: std,
        ratio_without: ratio,
        std_without: None,
        degenerate_without: true,
    });
    assert_eq!(finding(&judge(&[car]).remove(0), ReasonKind::Ground), Some(Finding::Supports));
}

#[test]
fn an_uncertain_ground_does_not_refute_a_floating_vehicle() {
    for (share_of_height, is_refuted) in [(0.01, true), (1.0, false)] {
        let mut floating = car(1, 0.6, &usual());
        let std = share_of_height * height(&floating);
        floating.world.planes.values_mut().for_each(|plane| plane.common_height_std = std);
        let verdict = judge(&[floating]).remove(0);
        assert_eq!(finding(&verdict, ReasonKind::Ground) == Some(Finding::Refutes), is_refuted, "{verdict:#?}");
    }
}

/// Like a patch at the horizon of an aerial clip that a detector classified as a car: static, 17 points, a small
/// standard deviation, and a path of pure noise.
#[test]
fn a_patch_at_the_horizon_is_rejected() {
    let few = drive::Options { num_frames: 16, num_object_points: 17, has_wheels: false, ..usual() };
    let mut patch = car(8, 1.0, &few);
    patch.trajectory.scale = estimate(patch.trajectory.scale.ratio, 0.0037);
    patch.tracked.confidence = 0.3;
    patch.tracked.found_in = DetectionCounts { detector: 6, carried: 10, ..DetectionCounts::default() };
    patch.tracked.movement = MovementFinding { state: Movement::Undetermined, reason: "too small".into() };
    let (up, size) = (normal(&patch), height(&patch));
    let aside = up.cross(&Vector3::x()).normalize();
    moved(&mut patch, |k| aside * size * if k % 2 == 0 { 1.5 } else { -1.5 });
    let verdict = judge(&[patch]).remove(0);
    assert!(verdict.is_refuted(), "{verdict:#?}");
    assert_eq!(finding(&verdict, ReasonKind::Path), Some(Finding::Refutes), "{verdict:#?}");
    assert_eq!(finding(&verdict, ReasonKind::Detection), Some(Finding::Doubts));
    assert_eq!(finding(&verdict, ReasonKind::Movement), Some(Finding::Doubts));
}

#[test]
fn a_model_stretched_along_the_line_of_sight_is_refuted() {
    let mut long = car(1, 1.0, &usual());
    let camera = long.world.object.images.values().next().unwrap().cam_from_world.center();
    let ray = (crate::trajectory::object_center(&long.world.object) - camera).normalize();
    let ids: Vec<_> = long.world.object.points.keys().copied().collect();
    for (k, id) in ids.iter().enumerate() {
        let by = ((k % 41) as f64 - 20.0) * 1.0;
        long.world.object.points.get_mut(id).unwrap().position += ray * by;
    }
    let verdict = judge(&[long]).remove(0);
    assert!(verdict.is_refuted() && verdict.against().any(|r| r.says.contains("line of sight")), "{verdict:#?}");
}

#[test]
fn a_car_a_tenth_as_large_as_the_others_is_refuted() {
    let mut cars: Vec<Car> = (1..=3).map(|id| car(id, 1.0, &usual())).collect();
    let verdicts = judge(&cars);
    assert!(verdicts.iter().all(|v| finding(v, ReasonKind::Size) == Some(Finding::Supports)), "{verdicts:#?}");
    // The third is a tenth as large: the same image of a car, with a ground at a tenth of the distance.
    let third = &mut cars[2];
    let camera = |frame: FrameId| {
        let image = third.world.background.images.values().find(|image| image.name == format!("{:06}.jpg", frame.0));
        image.unwrap().cam_from_world.center()
    };
    for (frame, plane) in &mut third.world.planes {
        plane.point = camera(*frame) + 0.1 * (plane.point - camera(*frame));
    }
    let scale = estimate(0.1 * third.world.ratio, 0.01);
    let description = ObjectDescription { id: ObjectId(3), class: "car".into(), confidence: 0.8 };
    let Drive { background, object, frames, .. } = &third.world;
    third.trajectory = assemble(description, background, object, scale, frames);
    let verdicts = judge(&cars);
    assert_eq!(finding(&verdicts[2], ReasonKind::Size), Some(Finding::Refutes), "{:#?}", verdicts[2]);
    assert_eq!(finding(&verdicts[0], ReasonKind::Size), Some(Finding::Supports), "{:#?}", verdicts[0]);
}

#[test]
fn fast_backward_and_jumping_paths_are_reported() {
    let fast = judge(&[car(1, 1.0, &drive::Options { speed_m_s: 200.0, ..usual() })]).remove(0);
    assert_eq!(finding(&fast, ReasonKind::Speed), Some(Finding::Refutes), "{fast:#?}");
    let mut jumping = car(1, 1.0, &usual());
    let (up, size) = (normal(&jumping), height(&jumping));
    let aside = up.cross(&Vector3::x()).normalize();
    moved(&mut jumping, |k| if k >= 30 { aside * size * 10.0 } else { Vector3::zeros() });
    let verdict = judge(&[jumping]).remove(0);
    assert!(verdict.against().any(|reason| reason.says.contains("jumps")), "{verdict:#?}");
    let mut back = car(1, 1.0, &usual());
    let last = back.trajectory.poses.len() - 1;
    let path = Vector3::from(back.trajectory.poses[last].position) - Vector3::from(back.trajectory.poses[0].position);
    moved(&mut back, |k| -path * (k.saturating_sub(50) as f64) * 2.0 / last as f64);
    let verdict = judge(&[back]).remove(0);
    assert!(verdict.against().any(|reason| reason.says.contains("backward")), "{verdict:#?}");
}

#[test]
fn a_folded_model_is_doubted_or_rejected() {
    let turned = |degrees: f64| {
        let mut car = car(1, 1.0, &usual());
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), degrees.to_radians());
        for pose in &mut car.trajectory.poses[50..] {
            pose.world_from_object.rotation *= turn;
        }
        let verdict = judge(&[car]).remove(0);
        let says = verdict.reasons.iter().find(|reason| reason.says.contains("folded")).map(|reason| reason.finding);
        (says, verdict.state == Trust::Rejected)
    };
    assert_eq!(turned(0.0), (None, false));
    assert_eq!(turned(20.0), (Some(Finding::Doubts), false));
    assert_eq!(turned(60.0), (Some(Finding::Refutes), true));
}

#[test]
fn uncertain_planes_do_not_show_a_varying_height() {
    let with_planes = |change: &dyn Fn(u32, &mut GroundPlane, f64)| {
        let mut car = car(1, 1.0, &usual());
        let size = height(&car);
        car.world.planes.iter_mut().for_each(|(frame, plane)| change(frame.0, plane, size));
        let verdict = judge(&[car]).remove(0);
        verdict.against().any(|reason| reason.says.contains("height above ground varies"))
    };
    let lift = |plane: &mut GroundPlane, by: f64| plane.point += plane.normal * by;
    let wave = |frame: u32| (f64::from(frame) * std::f64::consts::PI / 20.0).sin();
    assert!(with_planes(&|frame, plane, size| lift(plane, 0.3 * size * wave(frame))));
    assert!(!with_planes(&|frame, plane, size| {
        lift(plane, 0.3 * size * wave(frame));
        plane.height_std = 0.3 * size;
    }));
}

#[test]
fn with_a_change_of_the_focal_length_no_verdict_is_better_than_doubtful() {
    let car = car(1, 1.0, &usual());
    let judged = |changes: &[FocalChange]| verdicts(&[car.candidate()], TimeBase::Seconds, changes).remove(0);
    assert!(judged(&[]).state < Trust::Doubtful);
    let change = FocalChange { first: FrameId(20), last: FrameId(40), factor: 1.4 };
    let verdict = judged(&[change]);
    assert_eq!(verdict.state, Trust::Doubtful);
    let reason = verdict.against().find(|reason| reason.kind == ReasonKind::FocalLength).unwrap();
    assert!(reason.says.contains("by a factor of 1.40 in frames 20–40; cut the clip"), "{}", reason.says);
}

#[test]
fn frames_without_seconds_have_no_speed_and_tiny_inputs_do_not_panic() {
    let single = car(1, 1.0, &usual());
    let of = |trajectory: &ObjectTrajectory, object: &Reconstruction| {
        let planes = BTreeMap::new();
        let background = &single.world.background;
        let candidate = Candidate { trajectory, tracked: None, object, background, planes: &planes };
        verdicts(&[candidate], TimeBase::Frames, &[]).remove(0)
    };
    let verdict = of(&single.trajectory, &single.world.object);
    assert_eq!((finding(&verdict, ReasonKind::Speed), verdict.state), (None, Trust::Doubtful), "{verdict:#?}");
    let mut one = single.trajectory.clone();
    one.poses.truncate(1);
    assert_ne!(of(&one, &Reconstruction::default()).state, Trust::Good);
    one.poses.clear();
    assert_ne!(of(&one, &Reconstruction::default()).state, Trust::Good);
    let mut broken = single.trajectory.clone();
    broken.poses.iter_mut().for_each(|pose| pose.position = [f64::NAN; 3]);
    let text = serde_json::to_string(&of(&broken, &single.world.object)).unwrap();
    assert!(!text.contains("NaN") && !text.contains("null"), "{text}");
}
