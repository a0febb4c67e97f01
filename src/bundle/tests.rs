//! Exact and noisy worlds, gauge, held blocks, solvers against each other, hostile problems.

mod covariances;
mod jacobians;

use nalgebra::{Point2, Point3, Vector3};

use super::layout::Layout;
use super::*;
use crate::bundle::Whitening;
use crate::camera::Camera;
use crate::math::{Rigid3, RobustLoss, umeyama};
use crate::scene::Reconstruction;
use crate::synthetic::scene::{self, CameraMotion, disturb, static_scene};

impl Layout {
    /// Problem of an exact world in which one camera with known intrinsics takes all images.
    pub fn of_world(num_images: u32, num_points: u32) -> Self {
        let truth = static_scene(&scene::Options { num_images, num_points, ..Default::default() });
        let problem = Problem::from_reconstruction(&truth, |_, camera| CameraBlock::fixed(*camera));
        Self::new(&problem, &Options::default(), false)
    }
}

/// Ground truth, and a problem with perturbed initial values.
fn disturbed(options: &scene::Options, block: fn(Camera) -> CameraBlock) -> (Reconstruction, Problem) {
    let truth = static_scene(options);
    let mut start = truth.clone();
    disturb(&mut start, 0.01, 0.05, 5);
    (truth, Problem::from_reconstruction(&start, |_, camera| block(*camera)))
}

fn tight() -> Options {
    Options {
        function_tolerance: 1e-14,
        parameter_tolerance: 1e-14,
        max_iterations: 200,
        threads: 1,
        ..Options::default()
    }
}

/// Largest distances of camera centers and points to the truth after alignment by the centers, and largest rotation
/// error.
fn errors(truth: &Reconstruction, problem: &Problem) -> (f64, f64, f64) {
    let mut found = truth.clone();
    problem.store(&mut found);
    let centers = |model: &Reconstruction| -> Vec<Point3<f64>> {
        model.images.values().map(|i| i.cam_from_world.center()).collect()
    };
    found.transform(&umeyama(&centers(&found), &centers(truth)).unwrap());
    let largest =
        |a: Vec<Point3<f64>>, b: Vec<Point3<f64>>| a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    let points = |model: &Reconstruction| model.points.values().map(|p| p.position).collect();
    let images = found.images.values().zip(truth.images.values());
    let turn = images.map(|(a, b)| a.cam_from_world.angle_to(&b.cam_from_world)).fold(0.0, f64::max);
    (largest(centers(&found), centers(truth)), largest(points(&found), points(truth)), turn)
}

#[test]
fn an_exact_world_is_found_exactly() {
    for path in [CameraMotion::Arc, CameraMotion::Flight] {
        for camera_per_image in [false, true] {
            let options =
                scene::Options { path, camera_per_image, num_images: 12, num_points: 200, ..Default::default() };
            let (truth, mut problem) = disturbed(&options, CameraBlock::fixed);
            let summary = adjust(&mut problem, &tight()).unwrap();
            assert!(summary.initial_cost > 1e4 && summary.final_cost < 1e-12, "{path:?}: {summary:?}");
            let (centers, points, turn) = errors(&truth, &problem);
            assert!(centers < 1e-7 && points < 1e-6 && turn < 1e-8, "{path:?}: {centers} {points} {turn}");
        }
    }
}

#[test]
fn unknown_focal_and_distortion_are_found() {
    for camera_per_image in [false, true] {
        let options = scene::Options { camera_per_image, num_points: 300, ..Default::default() };
        let (truth, mut problem) = disturbed(&options, CameraBlock::free_focal_and_radial);
        for block in &mut problem.cameras {
            block.camera.focal = [860.0; 2];
            block.camera.radial = [0.0; 2];
        }
        let summary = adjust(&mut problem, &tight()).unwrap();
        assert!(summary.final_cost < 1e-10, "{summary:?}");
        for block in &problem.cameras {
            assert!((block.camera.focal[0] - 800.0).abs() < 1e-4 && block.camera.focal[0] == block.camera.focal[1]);
            assert!((block.camera.radial[0] + 0.05).abs() < 1e-5, "{:?}", block.camera);
        }
        assert!(errors(&truth, &problem).0 < 1e-6);
    }
}

#[test]
fn all_intrinsics_free_fit_a_camera_with_its_own_aspect_and_principal_point() {
    let camera = Camera { focal: [800.0, 812.0], principal: [470.0, 280.0], ..Camera::with_focal(960, 540, 800.0) };
    let options = scene::Options { camera, num_points: 300, num_images: 12, ..Default::default() };
    let free = |camera| CameraBlock { camera, free: [true; 6], tie_focal: false };
    let (_, mut problem) = disturbed(&options, free);
    problem.cameras[0].camera = Camera::with_focal(960, 540, 780.0);
    let summary = adjust(&mut problem, &tight()).unwrap();
    assert!(summary.final_cost < 1e-9, "{summary:?}");
    let found = problem.cameras[0].camera;
    for (a, b) in found.intrinsics().iter().zip(camera.intrinsics()) {
        assert!((a - b).abs() < 1e-3, "{found:?}");
    }
}

#[test]
fn noise_leaves_the_residual_that_its_freedoms_allow() {
    let options = scene::Options { num_points: 400, num_images: 10, noise_px: 0.7, ..Default::default() };
    let (_, mut problem) = disturbed(&options, CameraBlock::fixed);
    let summary = adjust(&mut problem, &tight()).unwrap();
    let freedoms = 2 * summary.num_residuals - (6 * problem.poses.len() + 3 * problem.points.len() - 7);
    // Σ r² / σ² is χ² with ν degrees of freedom: standard deviation √(2/ν) of the ratio, four of them allowed.
    let ratio = 2.0 * summary.final_cost / (0.7 * 0.7 * freedoms as f64);
    assert!((ratio - 1.0).abs() < 4.0 * (2.0 / freedoms as f64).sqrt(), "{ratio} {freedoms}");
}

#[test]
fn held_rotations_do_not_change_while_positions_and_points_are_found() {
    let (truth, mut problem) = disturbed(&scene::Options::default(), CameraBlock::fixed);
    // True rotations, wrong positions.
    for (pose, image) in problem.poses.iter_mut().zip(truth.images.values()) {
        let center = pose.cam_from_world.center();
        pose.cam_from_world = Rigid3::from_rotation_and_center(image.cam_from_world.rotation, center);
    }
    let before = problem.clone();
    let summary = adjust(&mut problem, &Options { hold_rotations: true, ..tight() }).unwrap();
    assert!(summary.final_cost < 1e-9 && summary.initial_cost > 1e3, "{summary:?}");
    for (pose, before) in problem.poses.iter().zip(&before.poses) {
        assert!(pose.cam_from_world.angle_to(&before.cam_from_world) < 1e-12);
    }
    let (centers, points, _) = errors(&truth, &problem);
    assert!(centers < 1e-5 && points < 1e-4, "{centers} {points}");
}

#[test]
fn the_gauge_is_held_and_held_blocks_do_not_move() {
    let options = scene::Options { noise_px: 0.5, ..Default::default() };
    let (_, before) = disturbed(&options, CameraBlock::fixed);
    let mut problem = before.clone();
    adjust(&mut problem, &tight()).unwrap();
    assert_eq!(problem.poses[0], before.poses[0]);
    assert_eq!(problem.cameras, before.cameras);
    let baseline = |p: &Problem| (p.poses[7].cam_from_world.center() - p.poses[0].cam_from_world.center()).norm();
    assert!((baseline(&problem) - baseline(&before)).abs() < 1e-12 * baseline(&before));

    let mut problem = before.clone();
    for idx in [2, 5] {
        problem.poses[idx].fixed = true;
        problem.points[idx].fixed = true;
    }
    let held = problem.clone();
    adjust(&mut problem, &tight()).unwrap();
    for idx in 0..problem.poses.len() {
        assert_eq!(problem.poses[idx] == held.poses[idx], idx == 2 || idx == 5, "pose {idx}");
        assert_eq!(problem.points[idx] == held.points[idx], idx == 2 || idx == 5, "point {idx}");
    }
}

#[test]
fn every_gauge_reaches_the_same_cost() {
    let options = scene::Options { noise_px: 0.5, ..Default::default() };
    let (_, start) = disturbed(&options, CameraBlock::free_focal_and_radial);
    let costs = [Gauge::Auto, Gauge::Free]
        .map(|gauge| adjust(&mut start.clone(), &Options { gauge, ..tight() }).unwrap().final_cost);
    assert!((costs[0] - costs[1]).abs() < 1e-7 * costs[0], "{costs:?}");
}

#[test]
fn solvers_agree() {
    for (camera_per_image, num_images) in [(false, 80), (true, 70), (false, 12)] {
        let options = scene::Options {
            path: CameraMotion::Flight,
            num_images,
            num_points: 900,
            noise_px: 0.5,
            camera_per_image,
            ..Default::default()
        };
        let (_, start) = disturbed(&options, CameraBlock::free_focal_and_radial);
        let solve = |linear_solver| {
            let mut problem = start.clone();
            let summary = adjust(&mut problem, &Options { linear_solver, gauge: Gauge::Auto, ..tight() }).unwrap();
            (summary, problem)
        };
        let (dense, dense_problem) = solve(LinearSolver::Dense);
        let (sparse, sparse_problem) = solve(LinearSolver::Sparse);
        assert!((dense.final_cost - sparse.final_cost).abs() < 1e-9 * dense.final_cost, "{dense:?} {sparse:?}");
        for (a, b) in dense_problem.poses.iter().zip(&sparse_problem.poses) {
            assert!((a.cam_from_world.center() - b.cam_from_world.center()).norm() < 1e-4);
        }
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    for path in [CameraMotion::Arc, CameraMotion::Flight] {
        let options = scene::Options { path, num_images: 66, num_points: 600, noise_px: 0.5, ..Default::default() };
        let (_, start) = disturbed(&options, CameraBlock::free_focal_and_radial);
        let solve = |threads| {
            let mut problem = start.clone();
            adjust(&mut problem, &Options { threads, max_iterations: 6, ..Options::default() }).unwrap();
            problem
        };
        let one = solve(1);
        assert_eq!(one, solve(1));
        assert_eq!(one, solve(2));
        assert_eq!(one, solve(3));
    }
}

#[test]
fn robust_losses_see_through_outliers() {
    let options =
        scene::Options { num_points: 300, num_images: 10, noise_px: 0.3, outliers: 0.05, ..Default::default() };
    let (truth, start) = disturbed(&options, CameraBlock::fixed);
    let error = |loss| {
        let mut problem = start.clone();
        adjust(&mut problem, &Options { loss, ..tight() }).unwrap();
        errors(&truth, &problem).0
    };
    let squared = error(RobustLoss::Squared);
    for loss in [RobustLoss::Cauchy { scale: 1.0 }, RobustLoss::Huber { scale: 1.0 }, RobustLoss::SoftL1 { scale: 1.0 }]
    {
        let robust = error(loss);
        assert!(robust < 0.1 * squared, "{loss:?}: {robust} against {squared}");
    }
}

#[test]
fn points_behind_or_in_the_camera_do_no_harm() {
    let (truth, mut problem) = disturbed(&scene::Options::default(), CameraBlock::fixed);
    let center = problem.poses[0].cam_from_world.center();
    let behind = problem.poses[0].cam_from_world.inverse() * Point3::new(0.1, 0.1, -2.0);
    for position in [center, behind] {
        problem.points.push(PointBlock { position, fixed: false });
        problem.observations.push(Observation::new(0, problem.points.len() as u32 - 1, Point2::new(5.0, 5.0)));
    }
    for behind in [Behind::Ignore, Behind::Project] {
        let mut problem = problem.clone();
        let summary = adjust(&mut problem, &Options { behind, ..tight() }).unwrap();
        assert!(summary.num_ignored > 0 && summary.final_cost.is_finite());
        assert!(problem.points.iter().all(|p| p.position.coords.iter().all(|v| v.is_finite())));
        assert!(problem.poses.iter().all(|p| p.cam_from_world.translation.iter().all(|v| v.is_finite())));
        problem.points.truncate(truth.points.len());
        assert!(errors(&truth, &problem).0 < 1e-6, "{behind:?}");
    }
}

#[test]
fn a_point_seen_twice_in_one_image_is_a_single_point() {
    let (truth, mut problem) = disturbed(&scene::Options::default(), CameraBlock::fixed);
    let doubled: Vec<_> = problem.observations.iter().step_by(3).copied().collect();
    problem.observations.extend(doubled);
    let summary = adjust(&mut problem, &tight()).unwrap();
    assert!(summary.final_cost < 1e-12 && summary.iterations < 15, "{summary:?}");
    assert!(errors(&truth, &problem).0 < 1e-7);
}

#[test]
fn wrong_problems_are_refused_and_unchanged() {
    let (_, good) = disturbed(&scene::Options::default(), CameraBlock::fixed);
    let spoil: [fn(&mut Problem); 8] = [
        |p| p.observations[3].pose = 99,
        |p| p.observations[3].point = u32::MAX,
        |p| p.observations[3].pixel.x = f64::NAN,
        |p| p.observations[3].whitening = Whitening::isotropic(0.0),
        |p| p.poses[1].camera = 7,
        |p| p.poses[1].cam_from_world.translation.y = f64::INFINITY,
        |p| p.points[2].position.z = f64::NAN,
        |p| p.cameras[0].camera.focal[0] = -1.0,
    ];
    for change in spoil {
        let mut problem = good.clone();
        change(&mut problem);
        let before = format!("{problem:?}");
        assert!(adjust(&mut problem, &Options::default()).is_err());
        assert_eq!(before, format!("{problem:?}"));
    }
    for options in [
        Options { initial_damping: 0.0, ..Options::default() },
        Options { function_tolerance: f64::NAN, ..Options::default() },
        Options { loss: RobustLoss::Huber { scale: 0.0 }, ..Options::default() },
    ] {
        assert!(matches!(adjust(&mut good.clone(), &options), Err(BundleError::Option { .. })));
    }
}

#[test]
fn empty_and_held_problems_are_left_alone() {
    let summary = adjust(&mut Problem::default(), &Options::default()).unwrap();
    assert_eq!(summary.termination, Termination::NothingToDo);
    let (_, mut problem) = disturbed(&scene::Options::default(), CameraBlock::fixed);
    problem.poses.iter_mut().for_each(|p| p.fixed = true);
    problem.points.iter_mut().for_each(|p| p.fixed = true);
    let before = problem.clone();
    let summary = adjust(&mut problem, &Options::default()).unwrap();
    assert_eq!(summary.termination, Termination::NothingToDo);
    assert_eq!(summary.initial_cost, summary.final_cost);
    assert_eq!(problem, before);
}

#[test]
fn points_alone_and_poses_alone_are_refined() {
    for points_fixed in [false, true] {
        let truth = static_scene(&scene::Options::default());
        let mut problem = Problem::from_reconstruction(&truth, |_, camera| CameraBlock::fixed(*camera));
        for block in &mut problem.points {
            block.fixed = points_fixed;
            block.position += if points_fixed { Vector3::zeros() } else { Vector3::new(0.05, -0.03, 0.08) };
        }
        for block in &mut problem.poses {
            block.fixed = !points_fixed;
            if points_fixed {
                block.cam_from_world = state::perturb(&block.cam_from_world, &[0.01, 0.02, -0.01, 0.1, -0.1, 0.05]);
            }
        }
        let summary = adjust(&mut problem, &tight()).unwrap();
        assert!(summary.initial_cost > 1e3 && summary.final_cost < 1e-15, "{summary:?}");
    }
}

#[test]
fn priors_pull_as_strongly_as_they_say() {
    let (_, mut problem) = disturbed(&scene::Options::default(), CameraBlock::free_focal_and_radial);
    let mut sigma = [f64::INFINITY; 6];
    sigma[0] = 1e-6;
    let values = [790.0, 790.0, 0.0, 0.0, 0.0, 0.0];
    problem.priors.intrinsics.push(IntrinsicsPrior { camera: 0, values, sigma });
    adjust(&mut problem, &tight()).unwrap();
    assert!((problem.cameras[0].camera.focal[0] - 790.0).abs() < 1e-3);
}

/// Planes under the cameras and a few points with priors determine position, orientation and scale of the world.
#[test]
fn planes_and_points_decide_where_the_world_is() {
    let (truth, mut problem) = disturbed(&scene::Options::default(), CameraBlock::fixed);
    let (up, foot) = (Vector3::z(), Point3::new(0.2, -0.1, -0.4));
    for (pose, image) in truth.images.values().enumerate() {
        let cam_from_world = image.cam_from_world;
        problem.priors.planes.push(PlanePrior {
            pose,
            normal_in_cam: cam_from_world.rotation * up,
            camera_height: cam_from_world.center().z - foot.z,
            point: foot,
            up,
            sigma_distance: 0.1,
            sigma_tilt: 0.1,
            loss: crate::math::RobustLoss::Squared,
        });
    }
    for (point, known) in truth.points.values().enumerate().step_by(10) {
        problem.priors.points.push(PointPrior { point, position: known.position, sigma: 10.0 });
    }
    let summary = adjust(&mut problem, &tight()).unwrap();
    assert!(summary.final_cost < 1e-12, "{summary:?}");
    for (block, known) in problem.poses.iter().zip(truth.images.values()) {
        assert!((block.cam_from_world.center() - known.cam_from_world.center()).norm() < 1e-5);
    }
}
