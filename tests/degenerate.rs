//! Degenerate worlds: every estimator returns finite values, or nothing, and never panics.

use std::collections::BTreeMap;
use std::fmt::Debug;

use nalgebra::{Point2, Point3, Rotation3, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;
use rand::Rng as _;
use tractrix::bundle::{self, CameraBlock, Problem, Wanted, Whitening};
use tractrix::camera::Camera;
use tractrix::features::tracks::{Track, TrackTable};
use tractrix::geometry::resection::{self, PixelsAndPoints};
use tractrix::geometry::solvers::{essential_five_point, homography_from_points, p3p};
use tractrix::geometry::triangulation::{self, Limits};
use tractrix::geometry::two_view::{self, Correspondences};
use tractrix::ground::{self, GroundChain};
use tractrix::mapper::{self, Intrinsics};
use tractrix::math::{Rigid3, Rng, RobustLoss, Sim3, seeded_rng, umeyama};
use tractrix::metric::{
    CameraPath, Dimension, Extent, Offset, PositionFix, Support, VehicleClass, align_to_fixes, vehicle_sizes,
};
use tractrix::scene::{
    FrameId, ImageId, Movement, ObjectId, Point3dId, Reconstruction, ScaleMethod, TimeBase, TrackedObject,
};
use tractrix::sfm::Options;
use tractrix::synthetic::drive::{self, Drive, drive};
use tractrix::synthetic::{empty_table, observe};
use tractrix::trajectory::{
    self, Candidate, CommonStd, Evidence, ModelOrigin, ObjectDescription, PositionError, PositionMeasurement, Subject,
};

/// Whether all numbers of a value are finite, by its debug output.
fn is_finite(value: &impl Debug) -> bool {
    let text = format!("{value:?}");
    !text.split(|c: char| !c.is_alphanumeric()).any(|word| word == "NaN" || word == "inf")
}

/// Failures are not stored: the seed that proptest prints is enough.
fn config() -> ProptestConfig {
    ProptestConfig { max_shrink_iters: 200, failure_persistence: None, ..ProptestConfig::default() }
}

macro_rules! prop_finite {
    ($value:expr) => {
        let value = &$value;
        prop_assert!(is_finite(value), "{}: {:?}", stringify!($value), value);
    };
}

/// How the camera moves from view to view.
#[derive(Clone, Copy, Debug)]
enum Motion {
    /// Along its line of sight, between the points.
    Forward,
    /// Across its line of sight.
    Sideways,
    /// On the spot.
    Turn,
    /// Not at all.
    Still,
    /// Sideways, each view twice.
    Duplicated,
    /// By a distance that rounding hides beside that of the points.
    Tiny,
}

/// Where the points are.
#[derive(Clone, Copy, Debug)]
enum Shape {
    Cloud,
    Plane,
    Line,
    /// On the line of motion of [`Motion::Forward`].
    Axis,
    OnePlace,
    /// A million times as far away.
    Distant,
}

#[derive(Clone, Copy, Debug)]
struct World {
    motion: Motion,
    shape: Shape,
    num_views: usize,
    num_points: usize,
    /// Unit of length, and of the positions in the image.
    unit: f64,
    noise_px: f64,
    seed: u64,
}

fn motions() -> impl Strategy<Value = Motion> {
    use Motion::{Duplicated, Forward, Sideways, Still, Tiny, Turn};
    prop::sample::select(vec![Forward, Forward, Forward, Sideways, Turn, Still, Duplicated, Tiny])
}

fn shapes() -> impl Strategy<Value = Shape> {
    use Shape::{Axis, Cloud, Distant, Line, OnePlace, Plane};
    prop::sample::select(vec![Cloud, Cloud, Plane, Line, Axis, OnePlace, Distant])
}

fn worlds(most_points: usize) -> impl Strategy<Value = World> {
    let few_or_many = prop_oneof![0..8usize, 8..=most_points, Just(most_points)];
    let units = prop::sample::select(vec![1.0, 1.0, 1e-9, 1e9, 1e150]);
    let noise = prop::sample::select(vec![0.0, 0.3, 5.0]);
    (motions(), shapes(), 0..9usize, few_or_many, units, noise, any::<u64>()).prop_map(
        |(motion, shape, num_views, num_points, unit, noise_px, seed)| World {
            motion,
            shape,
            num_views,
            num_points,
            unit,
            noise_px,
            seed,
        },
    )
}

const CAMERA: Camera = Camera {
    width: 640,
    height: 360,
    focal: [500.0; 2],
    principal: [320.0, 180.0],
    radial: [0.0; 2],
    higher: tractrix::camera::HigherTerms::ZERO,
};

impl World {
    fn pose(&self, k: usize) -> Rigid3 {
        let t = k as f64;
        let (angle, center) = match self.motion {
            Motion::Forward => (0.0, Vector3::new(0.0, 0.0, t)),
            Motion::Sideways => (0.0, Vector3::new(0.5 * t, 0.0, 0.0)),
            Motion::Turn => (0.02 * t, Vector3::zeros()),
            Motion::Still => (0.0, Vector3::zeros()),
            Motion::Duplicated => (0.0, Vector3::new((k / 2) as f64, 0.0, 0.0)),
            Motion::Tiny => (0.0, Vector3::new(1e-14 * t, 0.0, 0.0)),
        };
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_axis_angle(&Vector3::y_axis(), angle));
        Rigid3::from_rotation_and_center(rotation, Point3::from(center * self.unit))
    }

    fn point(&self, rng: &mut Rng) -> Point3<f64> {
        let mut side = || rng.random_range(-1.0..1.0);
        let [x, y, z] = [3.0 * side(), 2.0 * side(), 9.0 + 7.0 * side()];
        let point = match self.shape {
            Shape::Cloud => Vector3::new(x, y, z),
            Shape::Plane => Vector3::new(x, y, 8.0 + 0.5 * x),
            Shape::Line => Vector3::new(x, 0.3 * x, 8.0 + 0.5 * x),
            Shape::Axis => Vector3::new(1e-7 * x, 1e-7 * y, z),
            Shape::OnePlace => Vector3::new(0.3, 0.2, 9.0),
            Shape::Distant => Vector3::new(x, y, z) * 1e6,
        };
        Point3::from(point * self.unit)
    }

    fn poses(&self) -> Vec<Rigid3> {
        (0..self.num_views).map(|k| self.pose(k)).collect()
    }

    fn points(&self) -> Vec<Point3<f64>> {
        let mut rng = seeded_rng(self.seed, 1);
        (0..self.num_points).map(|_| self.point(&mut rng)).collect()
    }

    /// Where a view sees a point, with noise.
    fn pixel(&self, pose: &Rigid3, point: Point3<f64>, rng: &mut Rng) -> Option<Point2<f64>> {
        let noise = Vector2::from_fn(|_, _| self.noise_px * rng.random_range(-1.0..1.0));
        let pixel = CAMERA.pixel_from_cam(*pose * point)? + noise;
        // Far beyond the border, as a wrong track may lie; not where no table of tracks would have it.
        pixel.iter().all(|side| side.abs() < 1e6).then_some(pixel)
    }

    fn table(&self) -> TrackTable {
        let mut rng = seeded_rng(self.seed, 2);
        let mut table = empty_table(self.num_views);
        for point in self.points() {
            let mut track = Track::new();
            for (k, pose) in self.poses().iter().enumerate() {
                let Some(pixel) = self.pixel(pose, point, &mut rng) else { continue };
                observe(&mut table, &mut track, k, pixel);
            }
            table.tracks.push(track);
        }
        table.tracks.retain(|track| track.len() >= 2);
        table
    }
}

/// Poses, cameras, and points with their errors.
type Numbers = (Vec<Rigid3>, Vec<Camera>, Vec<(Point3<f64>, f64)>);

/// Returns all numbers of a model.
fn numbers(model: &Reconstruction) -> Numbers {
    let poses = model.images.values().map(|image| image.cam_from_world).collect();
    let points = model.points.values().map(|point| (point.position, point.error_px)).collect();
    (poses, model.cameras.values().copied().collect(), points)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..config() })]

    #[test]
    fn geometry_of_few_views_is_finite(world in worlds(60), min_angle in prop::sample::select(vec![0.0, 1e-9, 0.02])) {
        let (poses, points) = (world.poses(), world.points());
        let rng = &mut seeded_rng(world.seed, 3);
        let limits = Limits { max_error_px: 3.0, min_angle };
        for point in points.iter().take(10) {
            let seen: Vec<(Rigid3, Point2<f64>)> =
                poses.iter().filter_map(|pose| Some((*pose, world.pixel(pose, *point, rng)?))).collect();
            let views: Vec<_> = seen
                .iter()
                .map(|(pose, pixel)| triangulation::View {
                    camera: &CAMERA,
                    cam_from_world: pose,
                    pixel: *pixel,
                    whitening: Whitening::IDENTITY,
                })
                .collect();
            if let Some(found) = triangulation::triangulate(&views, &limits) {
                prop_finite!(found);
            }
            let centers = seen.iter().map(|(pose, _)| pose.center());
            prop_finite!(tractrix::math::widest_angle(*point, centers));
        }
        for pose in &poses {
            let seen: Vec<(Point2<f64>, Point3<f64>)> =
                points.iter().filter_map(|point| Some((world.pixel(pose, *point, rng)?, *point))).collect();
            let (pixels, points): (Vec<_>, Vec<_>) = seen.into_iter().unzip();
            let data = PixelsAndPoints { camera: &CAMERA, pixels: &pixels, points: &points };
            if let Some(found) = resection::estimate(&data, 3.0, rng) {
                prop_finite!(found);
            }
            if let Some(found) = resection::refine_from(&data, &poses[0], 3.0) {
                prop_finite!(found);
            }
            if points.len() >= 3 {
                let rays = std::array::from_fn(|k| CAMERA.ray_from_pixel(pixels[k]));
                prop_finite!(p3p(&rays, &[points[0], points[1], points[2]]));
            }
        }
        if let Some(found) = umeyama(&points, &points) {
            prop_finite!(found);
        }
    }

    #[test]
    fn geometry_of_two_views_is_finite(world in worlds(60)) {
        let poses = World { num_views: 2, ..world }.poses();
        let rng = &mut seeded_rng(world.seed, 3);
        let seen = |point: &Point3<f64>, rng: &mut Rng| {
            let [first, second] = [0, 1].map(|k| world.pixel(&poses[k], *point, rng));
            Some((CAMERA.normalized_from_pixel(first?), CAMERA.normalized_from_pixel(second?)))
        };
        let (first, second): (Vec<_>, Vec<_>) = world.points().iter().filter_map(|p| seen(p, rng)).unzip();
        let pairs = Correspondences { first: first.clone(), second: second.clone() };
        if let Some(found) = two_view::estimate(&pairs, 0.006, rng) {
            prop_finite!(found);
        }
        two_view::verify(&pairs, 0.006, rng);
        two_view::verify_of_two_cameras(&pairs, 0.006, rng);
        two_view::num_explained(&pairs, &(poses[1] * poses[0].inverse()), 0.006);
        prop_finite!(homography_from_points(&first, &second));
        if first.len() >= 5 {
            let rays = |side: &[Vector2<f64>]| std::array::from_fn(|k| side[k].push(1.0));
            prop_finite!(essential_five_point(&rays(&first), &rays(&second)));
        }
    }

    #[test]
    fn bundle_adjustment_is_finite(world in worlds(60), off in prop::sample::select(vec![0.0, 0.01, 3.0])) {
        let rng = &mut seeded_rng(world.seed, 4);
        let mut problem = Problem { cameras: vec![CameraBlock::free_focal_and_radial(CAMERA)], ..Problem::default() };
        let shift = |rng: &mut Rng| Vector3::from_fn(|_, _| world.unit * off * rng.random_range(-1.0..1.0));
        for pose in world.poses() {
            let center = pose.center() + shift(rng);
            let cam_from_world = Rigid3::from_rotation_and_center(pose.rotation, center);
            problem.poses.push(bundle::PoseBlock { cam_from_world, camera: 0, fixed: false });
        }
        for (k, point) in world.points().into_iter().enumerate() {
            problem.points.push(bundle::PointBlock { position: point + shift(rng), fixed: false });
            for (pose, cam_from_world) in world.poses().iter().enumerate() {
                if let Some(pixel) = world.pixel(cam_from_world, point, rng) {
                    problem.observations.push(bundle::Observation::new(pose as u32, k as u32, pixel));
                }
            }
        }
        let options = bundle::Options { loss: RobustLoss::SoftL1 { scale: 1.0 }, ..bundle::Options::default() };
        let summary = bundle::adjust(&mut problem, &options);
        prop_assert!(summary.is_ok(), "{summary:?}");
        prop_finite!((&problem.cameras, &problem.poses, &problem.points));
        let wanted = Wanted {
            poses: (1..problem.poses.len()).collect(),
            cameras: vec![0],
        };
        if let Ok(found) = bundle::covariances(&problem, &options, &wanted) {
            prop_finite!(found);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..config() })]

    #[test]
    fn maps_are_finite(world in worlds(150), is_given in any::<bool>(), is_background in any::<bool>()) {
        let options = if is_background { Options::background() } else { Options::object() }.mapper;
        let (camera, known) = match is_given {
            true => (CAMERA, Intrinsics::FIXED),
            false => (Camera::prior(640, 360), Intrinsics::GUESSED),
        };
        let mut table = world.table();
        mapper::cut_long_tracks(&mut table, &[camera], known, &options, 1);
        let (model, report) = mapper::reconstruct(&table, &[camera], known, &options, 1).unwrap();
        prop_finite!(numbers(&model));
        prop_finite!(report);
        prop_finite!(mapper::focal_changes(&model, camera.principal));
        if let Ok(Some(found)) = bundle::center_deviations(&model, 16, &BTreeMap::new()) {
            prop_finite!(found);
        }
    }
}

/// The last adjustment of this map leaves a point behind a camera that observes it, where its error is infinite.
#[test]
fn a_point_behind_a_camera_is_rejected_and_counted() {
    let world = World {
        motion: Motion::Sideways,
        shape: Shape::Line,
        num_views: 2,
        num_points: 132,
        unit: 1.0,
        noise_px: 0.3,
        seed: 17_617_361_927_016_870_534,
    };
    let options = Options::object().mapper;
    let (model, report) = mapper::reconstruct(&world.table(), &[CAMERA], Intrinsics::FIXED, &options, 1).unwrap();
    assert!(is_finite(&numbers(&model)) && is_finite(&report), "{report:?}");
    assert!(report.num_infinite_points > 0 && model.points.len() == report.num_points, "{report:?}");
}

/// How a drive past a vehicle degenerates.
#[derive(Clone, Copy, Debug)]
enum Flaw {
    /// Poses of the background's, the vehicle's, or both models are all those of the first image.
    NoMotion([bool; 2]),
    /// Points of the background's, the vehicle's, or both models lie on a plane, a line, or in one place.
    Flat([bool; 2], usize),
    /// Units of both models.
    Units([f64; 2]),
    /// So many points are left of each model.
    FewPoints([usize; 2]),
    /// So many images are left of each model.
    FewImages([usize; 2]),
    /// A point of each model lies in a camera center.
    PointInCamera,
    /// A point of each model lies behind cameras that observe it.
    PointBehind,
    /// The ground passes through the cameras.
    CameraOnGround,
    /// The ground stands upright, along the line of sight.
    UprightGround,
}

fn flaws() -> impl Strategy<Value = Flaw> {
    let which = || prop::sample::select(vec![[true, false], [false, true], [true, true]]);
    let units = || prop::sample::select(vec![1.0, 1e-12, 1e12, 1e150]);
    prop_oneof![
        which().prop_map(Flaw::NoMotion),
        (which(), 0..3usize).prop_map(|(which, dimension)| Flaw::Flat(which, dimension)),
        [units(), units()].prop_map(Flaw::Units),
        [0..12usize, 0..12usize].prop_map(Flaw::FewPoints),
        [0..5usize, 0..5usize].prop_map(Flaw::FewImages),
        Just(Flaw::PointInCamera),
        Just(Flaw::PointBehind),
        Just(Flaw::CameraOnGround),
        Just(Flaw::UprightGround),
    ]
}

fn inflict(flaw: Flaw, drive: &mut Drive) {
    let models = [&mut drive.background, &mut drive.object];
    for (k, model) in models.into_iter().enumerate() {
        let center = model.images.values().next().map(|image| image.cam_from_world);
        let Some(first) = center else { return };
        match flaw {
            Flaw::NoMotion(which) if which[k] => {
                model.images.values_mut().for_each(|image| image.cam_from_world = first);
            }
            Flaw::Flat(which, dimension) if which[k] => {
                model
                    .points
                    .values_mut()
                    .for_each(|point| point.position.coords.rows_mut(dimension, 3 - dimension).fill(0.0));
            }
            Flaw::Units(units) => {
                model.transform(&Sim3::new(units[k], UnitQuaternion::identity(), Vector3::zeros()));
            }
            Flaw::FewPoints(left) => {
                let gone: Vec<Point3dId> = model.points.keys().copied().skip(left[k]).collect();
                model.remove_points(&gone);
            }
            Flaw::FewImages(left) => {
                let gone: Vec<ImageId> = model.images.keys().copied().skip(left[k]).collect();
                model.remove_images(&gone);
            }
            Flaw::PointInCamera => {
                model.points.values_mut().take(1).for_each(|point| point.position = first.center());
            }
            Flaw::PointBehind => {
                let behind = first.inverse() * Point3::new(0.0, 0.0, -5.0);
                model.points.values_mut().take(5).for_each(|point| point.position = behind);
            }
            _ => {}
        }
    }
    for (frame, plane) in &mut drive.planes {
        let Some(image) = drive.background.images.get(&ImageId::from(*frame)) else { continue };
        match flaw {
            Flaw::CameraOnGround => plane.point = image.cam_from_world.center(),
            Flaw::UprightGround => plane.normal = image.cam_from_world.rotation.inverse() * Vector3::x(),
            Flaw::Units([unit, _]) => {
                plane.point = Point3::from(plane.point.coords * unit);
                plane.height_std *= unit;
                plane.common_height_std *= unit;
            }
            _ => {}
        }
    }
}

fn small_drive(climbs: bool) -> drive::Options {
    drive::Options {
        num_frames: 12,
        num_ground_points: 300,
        num_other_points: 60,
        num_object_points: 60,
        camera_climb_m: if climbs { 8.0 } else { 0.0 },
        noise: drive::Noise { pixel_px: 0.3, ..drive::Noise::default() },
        ..drive::Options::default()
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..config() })]

    #[test]
    fn ground_is_finite(flaws in prop::collection::vec(flaws(), 1..3), seed in 0..50u64, climbs in any::<bool>()) {
        let mut world = drive(&small_drive(climbs), seed);
        flaws.iter().for_each(|flaw| inflict(*flaw, &mut world));
        let Drive { background, object, ground_points, .. } = &world;
        let options = ground::Options::default();
        let dominant = ground::dominant_plane_points(background, &options, 1).ok();
        prop_finite!(dominant);
        let mount = ground::find_mount(background, None, &options, 1).ok();
        prop_finite!(mount);
        prop_finite!(ground::camera_height(background, ground_points, &options, 1));
        prop_finite!(ground::local_planes(background, ground_points, ObjectId(1), object, &options, 1));
        let shape = ground::BodyShape { clearance: 0.17, max_deviation: 6.0 };
        for labeled in [&[], ground_points.as_slice()] {
            let (dominant, mount) = (dominant.as_ref(), mount.as_ref());
            let chain = GroundChain { background, labeled, dominant, mount, hovering: None, shape };
            prop_finite!(chain.planes(ObjectId(1), object, &options, 1));
        }
        if let Ok(Some(found)) = bundle::center_deviations(background, 16, &BTreeMap::new()) {
            prop_finite!(found);
        }
    }

    #[test]
    fn trajectories_are_finite(
        flaws in prop::collection::vec(flaws(), 1..3),
        seed in 0..50u64,
        climbs in any::<bool>(),
        method in prop::sample::select(ScaleMethod::ALL.to_vec()),
    ) {
        let mut world = drive(&small_drive(climbs), seed);
        flaws.iter().for_each(|flaw| inflict(*flaw, &mut world));
        let Drive { background, object, planes, frames, .. } = &world;
        let silhouettes = BTreeMap::new();
        let evidence = Evidence {
            description: ObjectDescription { id: ObjectId(1), class: "car".into(), confidence: 0.9 },
            origin: ModelOrigin::Reconstructed,
            background,
            object,
            planes,
            silhouettes: &silhouettes,
            frames,
            focal_std: Some(0.01),
        };
        let options = trajectory::Options { method, ..trajectory::Options::default() };
        let placed = trajectory::place(&evidence, &options);
        prop_finite!(numbers(&placed.object));
        prop_finite!(placed.adjustment);
        let Ok(trajectory) = &placed.trajectory else { return Ok(()) };
        prop_finite!(trajectory);
        prop_finite!(trajectory::headings(trajectory));
        let object = &placed.object;
        let subject = Subject { trajectory, object, background, planes, silhouettes: &silhouettes, options: &options };
        prop_finite!(trajectory::extents(&subject));
        let tracked = None::<&TrackedObject>;
        let candidate = Candidate { trajectory, tracked, object, background, planes };
        prop_finite!(trajectory::verdicts(&[candidate; 3], TimeBase::Seconds, &[]));
    }

    #[test]
    fn smoothed_motion_is_finite(
        places in prop::collection::vec((0..4u8, prop::sample::select(vec![0.0, 1e-9, 1.0, 3.0, 1e6, 1e12])), 0..12),
        camera in prop::sample::select(vec![0.0, 10.0, 1e9]),
    ) {
        let sighting = |(k, (step, x)): (usize, &(u8, f64))| PositionMeasurement {
            time_s: 0.1 * (k / usize::from(*step).max(1)) as f64,
            position_m: Vector3::new(*x, 0.0, 0.0),
            camera_m: Vector3::new(camera, 0.0, 0.0),
            forward: (*step > 1).then(Vector3::x),
            error: PositionError::default(),
        };
        let sightings: Vec<PositionMeasurement> = places.iter().enumerate().map(sighting).collect();
        prop_finite!(trajectory::smooth(&sightings, &CommonStd { ratio: 0.02, scale: 0.01 }, Movement::Undetermined));
    }

    #[test]
    fn metres_are_finite(
        ways in prop::collection::vec((prop::sample::select(vec![0.0, 1.0, 1.0, 1e9]), 0.0..2.0f64), 0..40),
        unit in prop::sample::select(vec![1.0, 1e-9, 1e9]),
        stands in any::<bool>(),
        extents in prop::collection::vec((0..4u32, prop::sample::select(vec![0.0, 1e-300, 1.0, 1e300])), 0..9),
    ) {
        let step = if stands { 0.0 } else { unit };
        let poses = (0..20).map(|k| (f64::from(k), Point3::new(step * f64::from(k), 0.0, 0.0)));
        let path = CameraPath::new(poses, 0.01 * unit).unwrap();
        let fixes: Vec<PositionFix> = ways
            .iter()
            .enumerate()
            .map(|(k, (way, off))| PositionFix {
                time_s: k as f64,
                east_north_m: Vector2::new(way * k as f64, *off),
                up_m: Some(0.0),
                horizontal_std_m: 1.0,
                vertical_std_m: 2.0,
                rounding_m: 0.01,
            })
            .collect();
        let support = Support { offset: Offset::SAME_FILE, gravity: None, orientation: None };
        if let Ok(found) = align_to_fixes(&path, &fixes, &support) {
            prop_finite!(found);
        }
        let extent = |&(vehicle, value): &(u32, f64)| Extent {
            vehicle,
            class: VehicleClass::Car,
            dimension: Dimension::Length,
            value,
            std: 0.1 * value,
            ratio_std: 0.02,
            is_unconfirmed: false,
        };
        prop_finite!(vehicle_sizes(&extents.iter().map(extent).collect::<Vec<_>>()));
    }
}

#[test]
fn flaws_change_what_they_say() {
    let whole = drive(&small_drive(true), 1);
    let mut still = whole.clone();
    inflict(Flaw::NoMotion([true, false]), &mut still);
    let centers =
        |model: &Reconstruction| model.images.values().map(|i| i.cam_from_world.center().x).collect::<Vec<_>>();
    assert!(centers(&still.background).windows(2).all(|pair| pair[0] == pair[1]));
    assert_eq!(centers(&still.object), centers(&whole.object));
    let mut few = whole.clone();
    inflict(Flaw::FewPoints([3, 0]), &mut few);
    assert_eq!((few.background.points.len(), few.object.points.len()), (3, 0));
    assert!(few.planes.contains_key(&FrameId(0)));
}
