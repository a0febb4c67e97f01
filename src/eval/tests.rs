use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::Rng as _;
use rand_distr::{Distribution, StandardNormal};

use super::registration::InitialScale;
use super::*;
use crate::math::seeded_rng;
use crate::scene::{ModelState, ObjectId, ObjectTrajectory, ScaleEstimate, TriangleMesh};

/// One unit of the object's model in units of the background.
const TRUE_RATIO: f64 = 0.37;

/// A box of 4.2 × 1.8 × 1.5 metres standing on z = 0.
fn vehicle() -> TriangleMesh {
    let corner = |i: u32| {
        Point3::new(f64::from(i & 1) * 4.2 - 2.1, f64::from(i >> 1 & 1) * 1.8 - 0.9, f64::from(i >> 2 & 1) * 1.5)
    };
    let quads = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    TriangleMesh { vertices: (0..8).map(corner).collect(), triangles }
}

/// A camera at `center` that looks at `target`.
fn looking(center: Point3<f64>, target: Point3<f64>) -> Rigid3 {
    let forward = (target - center).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let rotation =
        nalgebra::Matrix3::from_rows(&[right.transpose(), forward.cross(&right).transpose(), forward.transpose()]);
    let rotation = UnitQuaternion::from_matrix(&rotation);
    Rigid3::from_rotation_and_center(rotation, center)
}

/// Points on the side of the box that the cameras see.
fn surface_points() -> Vec<Point3<f64>> {
    let mut rng = seeded_rng(3, 0);
    (0..200).map(|_| Point3::new(rng.random_range(-2.1..2.1), -0.9, rng.random_range(0.0..1.5))).collect()
}

/// An exact world: a vehicle on a curve seen from a flying camera, and models of it in frames and units of their own.
fn world(num_frames: u32, camera_center: impl Fn(f64) -> Point3<f64>) -> Input {
    let mut frames = BTreeMap::new();
    for k in 0..num_frames {
        let t = f64::from(k) / 10.0;
        let position = Point3::new(3.0 * t, 0.2 * t * t, 0.1 * t);
        let world_from_object = Rigid3::new(UnitQuaternion::from_euler_angles(0.0, 0.02, 0.1 * t), position.coords);
        let cam_from_world = looking(camera_center(t), position);
        frames
            .insert(FrameId(k), TruthFrame { cam_from_world, world_from_object, target_px2: 900, visible_share: None });
    }
    let background_from_world =
        Sim3::new(0.21, UnitQuaternion::from_euler_angles(0.5, -1.0, 2.0), Vector3::new(1.0, 7.0, -3.0));
    let model_from_object = Sim3::new(
        background_from_world.scale / TRUE_RATIO,
        UnitQuaternion::from_euler_angles(-0.3, 0.8, 1.1),
        Vector3::new(-4.0, 0.5, 2.0),
    );
    let background = Model {
        cam_from_world: frames
            .iter()
            .map(|(id, f)| (*id, background_from_world.transform_camera(&f.cam_from_world)))
            .collect(),
        ..Model::default()
    };
    let cam_from_object = |f: &TruthFrame| f.cam_from_world * f.world_from_object;
    let points: Vec<_> = surface_points().iter().map(|p| model_from_object * *p).collect();
    let model = Model {
        cam_from_world: frames
            .iter()
            .map(|(id, f)| (*id, model_from_object.transform_camera(&cam_from_object(f))))
            .collect(),
        seen: frames.keys().map(|id| (*id, (0..points.len()).collect())).collect(),
        points,
        unmatched: vec![],
    };
    let placements = trajectory::family(&background.cam_from_world, &model.cam_from_world, TRUE_RATIO);
    let object = ObjectInput {
        id: ObjectId(1),
        iou: Some(0.98),
        model: Ok(model),
        as_reconstructed: None,
        trajectory: Ok(some_trajectory(TRUE_RATIO)),
        placements,
    };
    Input {
        sequence: "exact".into(),
        vehicle: None,
        frames,
        mesh: Ok(MeshIndex::new(&vehicle()).unwrap()),
        background: Ok(background),
        objects: vec![object],
    }
}

fn some_trajectory(ratio: f64) -> ObjectTrajectory {
    let alternatives = [(ScaleMethod::ConstantDistance, ratio), (ScaleMethod::Intersection, ratio * 0.9)].into();
    let scale = ScaleEstimate { alternatives, ..ScaleEstimate::new(ratio, ScaleMethod::ConstantDistance) };
    ObjectTrajectory::new(ObjectId(1), "car", 1.0, scale)
}

fn curve(t: f64) -> Point3<f64> {
    Point3::new(2.0 * t - 3.0, -15.0 + t, 8.0 + (0.7 * t).sin())
}

fn straight_flight(t: f64) -> Point3<f64> {
    Point3::new(2.0 * t - 3.0, -15.0, 8.0)
}

#[track_caller]
fn assert_exact(evaluation: &Evaluation) {
    let reference = evaluation.reference_scale.as_ref().unwrap();
    assert!((reference.ratio / TRUE_RATIO - 1.0).abs() < 1e-9, "{}", reference.ratio);
    assert!((reference.ratio_from_seen.unwrap() / TRUE_RATIO - 1.0).abs() < 1e-9);
    assert!(evaluation.trajectory.as_ref().unwrap().mean_m < 1e-9);
    assert!(evaluation.trajectory_at_reference.as_ref().unwrap().mean_m < 1e-9);
    assert!(evaluation.scale.as_ref().unwrap().deviation.unwrap() < 1e-9);
    let cameras = evaluation.cameras.as_ref().unwrap();
    assert!(cameras.center_rmse_m < 1e-9 && cameras.registered_center_rmse_m < 1e-9);
    assert!(cameras.rotation_max_deg < 1e-5);
}

#[test]
fn an_exact_run_has_no_error() {
    let evaluation = evaluate(&world(40, curve));
    assert_exact(&evaluation);
    assert_eq!(evaluation.registration.as_ref().unwrap().initial_scale, InitialScale::Centers);
    assert_eq!(evaluation.registered.object_fraction, Some(1.0));
    // A ratio of 10 % too little moves every point towards the camera by a tenth of its distance, 15 to 20 m.
    let intersection = &evaluation.alternatives[&ScaleMethod::Intersection];
    assert!((intersection.deviation.unwrap() - 0.1).abs() < 1e-9);
    assert!((1.0..2.5).contains(&intersection.trajectory_error_m.unwrap()));
    assert!(evaluation.alternatives[&ScaleMethod::ConstantDistance].trajectory_error_m.unwrap() < 1e-9);
}

#[test]
fn a_straight_flight_is_registered_by_its_directions() {
    let input = world(40, straight_flight);
    let evaluation = evaluate(&input);
    assert_exact(&evaluation);
    // Noise in the centres makes Umeyama succeed there, with a rotation worth nothing; the result must not depend on
    // it.
    let mut rng = seeded_rng(5, 0);
    let mut noisy = input;
    for cam in noisy.background.as_mut().unwrap().cam_from_world.values_mut() {
        let noise = Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng)) * 1e-6;
        *cam = Rigid3::from_rotation_and_center(cam.rotation, cam.center() + noise);
    }
    let evaluation = evaluate(&noisy);
    assert!(evaluation.cameras.as_ref().unwrap().rotation_max_deg < 1e-3);
    assert!(evaluation.trajectory.as_ref().unwrap().mean_m < 1e-3);
}

#[test]
fn centres_exactly_on_a_line_take_the_scale_from_their_spread() {
    let pair = |k: f64| {
        let truth = Rigid3::from_rotation_and_center(UnitQuaternion::identity(), Point3::new(k, 0.0, 0.0));
        (Sim3::new(4.0, UnitQuaternion::identity(), Vector3::zeros()).transform_camera(&truth), truth)
    };
    let found = registration::register(&[pair(0.0), pair(1.0), pair(2.0), pair(4.0)]).unwrap();
    assert_eq!(found.initial_scale, InitialScale::Spread);
    assert!((found.world_from_background.scale - 0.25).abs() < 1e-12);
    assert!(found.world_from_background.rotation.angle() < 1e-9);
}

#[test]
fn the_error_of_displaced_points_is_their_displacement() {
    let mut input = world(20, curve);
    // One metre away from the vehicle's side, in the true world.
    let metres = 1.0;
    let registration_scale = 0.21;
    for (id, placement) in &mut input.objects[0].placements {
        let frame = &input.frames[id];
        let side_in_world = frame.world_from_object.rotation * -Vector3::y() * metres;
        let background_from_world = UnitQuaternion::from_euler_angles(0.5, -1.0, 2.0);
        placement.translation += background_from_world * side_in_world * registration_scale;
    }
    let error = evaluate(&input).trajectory;
    let error = error.as_ref().unwrap();
    assert!((error.mean_m - metres).abs() < 1e-9 && (error.median_m - metres).abs() < 1e-9);
    assert_eq!((error.num_frames, error.num_points, error.frames.len()), (20, 200, 20));
    let nearness = input.frames.values().map(|frame| 1.0 / frame.distance_m()).sum::<f64>() / 20.0;
    assert!((error.mean_share_of_distance.unwrap() - metres * nearness).abs() < 1e-9);
}

#[test]
fn noise_in_the_cameras_stays_small_in_the_figures() {
    let mut input = world(60, curve);
    let mut rng = seeded_rng(9, 0);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    for cam in input.background.as_mut().unwrap().cam_from_world.values_mut() {
        // 5 mm in metres; the background's unit is 1 / 0.21 m.
        let noise = Vector3::new(normal(), normal(), normal()) * 0.005 * 0.21;
        *cam = Rigid3::from_rotation_and_center(cam.rotation, cam.center() + noise);
    }
    let evaluation = evaluate(&input);
    let rmse = evaluation.cameras.as_ref().unwrap().center_rmse_m;
    // √3 × 5 mm = 8.7 mm.
    assert!((0.006..0.011).contains(&rmse), "{rmse}");
    assert!((evaluation.reference_scale.as_ref().unwrap().ratio / TRUE_RATIO - 1.0).abs() < 2e-3);
}

#[test]
fn frames_that_show_enough_of_the_target_are_counted_where_the_sequence_says_which() {
    let mut input = world(20, curve);
    assert_eq!(evaluate(&input).registered.num_clear, None);
    for (id, frame) in &mut input.frames {
        frame.visible_share = Some(if id.0 < 5 { 0.29 } else { 0.3 });
    }
    let model = input.objects[0].model.as_mut().unwrap();
    model.cam_from_world.retain(|id, _| id.0 != 2 && id.0 != 10);
    input.objects[0].placements.retain(|id, _| id.0 < 18);
    let registered = evaluate(&input).registered;
    assert_eq!((registered.num_clear, registered.num_object_clear), (Some(15), Some(14)));
    assert_eq!(registered.num_placed_clear, Some(13), "5 to 17");
    assert_eq!((registered.num_visible, registered.num_object), (20, 18));
}

#[test]
fn what_is_missing_is_said_and_the_rest_is_still_there() {
    type Change = fn(&mut Input);
    let cases: [(&str, Change, &str); 7] = [
        ("nothing registered", |i| i.background = Ok(Model::default()), "no registration: 0 frames"),
        ("background missing", |i| i.background = Err("background/ is missing".into()), "background/ is missing"),
        (
            "two cameras",
            |i| {
                let cameras = &mut i.background.as_mut().unwrap().cam_from_world;
                *cameras = cameras.iter().take(2).map(|(k, v)| (*k, *v)).collect();
            },
            "2 frames have a background camera",
        ),
        ("no objects", |i| i.objects.clear(), "target not found"),
        ("another vehicle", |i| i.objects[0].iou = Some(0.01), "target not found"),
        ("mesh missing", |i| i.mesh = Err("object_mesh.ply is missing".into()), "object_mesh.ply is missing"),
        ("no points", |i| i.objects[0].model.as_mut().unwrap().points.clear(), "no points"),
    ];
    for (name, change, expected) in cases {
        let mut input = world(20, curve);
        change(&mut input);
        let evaluation = evaluate(&input);
        for reason in [evaluation.trajectory.as_ref().unwrap_err(), evaluation.reference_scale.as_ref().unwrap_err()] {
            assert!(reason.contains(expected), "{name}: {reason}");
        }
        let json = serde_json::to_string(&evaluation).unwrap();
        assert_eq!(serde_json::from_str::<Evaluation>(&json).unwrap(), evaluation, "{name}");
        assert!(evaluation.to_string().contains(expected), "{name}");
    }
}

#[test]
fn rays_that_miss_are_counted_and_all_missing_is_said() {
    let mut input = world(20, curve);
    let points = &mut input.objects[0].model.as_mut().unwrap().points;
    let far = points[0] + Vector3::new(500.0, 500.0, 500.0);
    points.push(far);
    let reference = evaluate(&input).reference_scale;
    assert_eq!(reference.as_ref().unwrap().num_misses, 20);
    assert!((reference.as_ref().unwrap().ratio / TRUE_RATIO - 1.0).abs() < 1e-9);
    for point in &mut input.objects[0].model.as_mut().unwrap().points {
        *point += Vector3::new(500.0, 500.0, 500.0);
    }
    let reference = evaluate(&input).reference_scale;
    assert!(reference.as_ref().unwrap_err().contains("none of 4020 rays"));
}

#[test]
fn the_target_is_the_object_with_the_best_overlap() {
    let mut input = world(10, curve);
    let other = |id: u32, iou| ObjectInput {
        id: ObjectId(id),
        iou,
        as_reconstructed: None,
        model: Err("no model".into()),
        trajectory: Err("no trajectory".into()),
        placements: BTreeMap::new(),
    };
    input.objects[0].id = ObjectId(4);
    input.objects.insert(0, other(1, Some(0.3)));
    input.objects.push(other(9, None));
    let evaluation = evaluate(&input);
    assert_eq!(evaluation.target.as_ref().unwrap(), &Target { object: ObjectId(4), iou: Some(0.98) });
    assert_eq!(evaluation.others.len(), 2);
    assert!(evaluation.trajectory.as_ref().is_ok());
    // Found, but neither reconstructed nor placed.
    input.objects[1].iou = Some(0.2);
    let evaluation = evaluate(&input);
    assert_eq!(evaluation.target.as_ref().unwrap().object, ObjectId(1));
    assert_eq!(evaluation.trajectory.as_ref().unwrap_err(), "no model");
    assert_eq!(evaluation.scale.as_ref().unwrap_err(), "no trajectory");
    assert_eq!(evaluation.registered.num_object, 0);
    assert!(evaluation.cameras.as_ref().is_ok());
}

#[test]
fn a_still_camera_has_no_scale() {
    let evaluation = evaluate(&world(20, |_| Point3::new(0.0, -15.0, 8.0)));
    assert!(evaluation.registration.as_ref().unwrap_err().contains("does not move"));
}

#[test]
fn a_target_that_was_adjusted_is_also_measured_as_it_was() {
    let mut input = world(40, curve);
    assert_eq!(evaluate(&input).as_reconstructed, None);
    // Twice the size, so half the ratio; and one estimator of it that is right, one that is not.
    let object = &mut input.objects[0];
    let mut model = object.model.clone().unwrap();
    model.points.iter_mut().for_each(|p| p.coords *= 2.0);
    model.cam_from_world.values_mut().for_each(|cam| cam.translation *= 2.0);
    let half = 0.5 * TRUE_RATIO;
    let ratios = [(ScaleMethod::ConstantDistance, half), (ScaleMethod::RobustLeastSquares, 1.1 * half)].into();
    object.as_reconstructed = Some(Ok(AsReconstructed { model, ratios }));
    let evaluation = evaluate(&input);
    assert_exact(&evaluation);
    let before = evaluation.as_reconstructed.as_ref().unwrap().as_ref().unwrap();
    assert!((before.reference_ratio / half - 1.0).abs() < 1e-9);
    assert!(before.error_at_reference_m < 1e-9);
    assert!(before.alternatives[&ScaleMethod::ConstantDistance].trajectory_error_m.unwrap() < 1e-9);
    assert!((before.alternatives[&ScaleMethod::RobustLeastSquares].deviation.unwrap() - 0.1).abs() < 1e-9);
    assert!(evaluation.to_string().contains("as reconstructed: reference"));
    // In a benchmark these answers replace those of the same name, and the others stay.
    let entry = benchmark::Entry::of(&evaluation);
    assert_eq!(entry.floor_as_reconstructed_m, Some(before.error_at_reference_m));
    assert_eq!(entry.estimators[&ScaleMethod::ConstantDistance].ratio, Some(half));
    assert_eq!(entry.estimators[&ScaleMethod::ConstantDistance].model, ModelState::AsReconstructed);
    assert_eq!(entry.estimators[&ScaleMethod::Intersection].ratio, Some(0.9 * TRUE_RATIO));
    assert_eq!(entry.estimators[&ScaleMethod::Intersection].model, ModelState::Adjusted);

    for (broken, reason) in [(Ok(AsReconstructed::default()), "no points"), (Err("is cut short".into()), "cut short")] {
        input.objects[0].as_reconstructed = Some(broken);
        let evaluation = evaluate(&input);
        assert!(evaluation.as_reconstructed.as_ref().unwrap().as_ref().unwrap_err().contains(reason));
        assert!(evaluation.to_string().contains(reason));
        // Answers on the adjusted target do not stand in for those that are lost.
        let entry = benchmark::Entry::of(&evaluation);
        assert_eq!(entry.estimators.keys().collect::<Vec<_>>(), [&ScaleMethod::ConstantDistance]);
        assert_exact(&evaluation);
    }
}

#[test]
fn a_benchmark_knows_why_a_ratio_is_not_trusted() {
    let mut input = world(40, curve);
    assert_eq!(benchmark::Entry::of(&evaluate(&input)).verdict, None);
    let scale = &mut input.objects[0].trajectory.as_mut().unwrap().scale;
    (scale.degenerate, scale.reason) = (true, Some("no climb".into()));
    assert_eq!(benchmark::Entry::of(&evaluate(&input)).verdict.as_deref(), Some("no climb"));
}
