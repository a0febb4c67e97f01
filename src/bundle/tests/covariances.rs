//! Covariances against the inverse of the whole normal matrix, and against the scatter of repeated adjustments.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Matrix3, Point2, SMatrix};

use super::super::intrinsics_share::intrinsics_share;
use super::super::layout::{Layout, NONE};
use super::super::one_point::OnePoint;
use super::super::piece::Pass;
use super::super::residual::{Derivatives, linearize};
use super::super::simd::Two;
use super::super::state::State;
use super::*;

/// The inverse of JᵀJ over all free parameters, with six rows per pose, from the same Jacobians.
fn whole_inverse(problem: &Problem, options: &Options) -> (Layout, DMatrix<f64>) {
    let layout = Layout::new(problem, options, false);
    let state = State::new(problem, &layout);
    let pass = Pass { layout: &layout, observations: &problem.observations, loss: options.loss, parallel: false };
    let mut one = OnePoint::<6>::new(&layout, 0..layout.points.len());
    let (cameras, shared) = (layout.num_blocks() * 6, layout.shared.len() * 6);
    let size = cameras + shared + layout.points.len() * 3;
    let mut jacobian = DMatrix::zeros(layout.num_obs() * 2, size);
    let points = (0..layout.points.len()).flat_map(|point| layout.obs_of_point(point).map(move |o| (o, point)));
    for (o, point) in points {
        let (mut d_point, mut d_shared) = ([[0.0; 3]; 2], [[0.0; 6]; 2]);
        let measured = pass.measured(o);
        let view = &state.views[measured.pose as usize];
        let derivatives = Derivatives { d_point: &mut d_point, d_shared: (shared > 0).then_some(&mut d_shared) };
        linearize::<6, Two>(view, &state.points[point], measured, &options.loss, derivatives);
        one.work_out::<Two>(&pass, &state, point, 0.0);
        for i in 0..2 {
            let mut row = jacobian.row_mut(2 * o + i);
            if layout.obs_block[o] != NONE {
                let first = layout.obs_block[o] as usize * 6;
                (0..6).for_each(|k| row[first + k] = one.residuals[o - one.first_obs].d_view[i][k]);
            }
            if shared > 0 {
                (0..6).for_each(|k| row[cameras + k] = d_shared[i][k]);
            }
            let first = cameras + shared + point * 3;
            (0..3).for_each(|k| row[first + k] = d_point[i][k]);
        }
    }
    let mut normal = jacobian.transpose() * jacobian;
    for k in (0..size).filter(|k| normal[(*k, *k)] == 0.0).collect::<Vec<_>>() {
        normal[(k, k)] = 1.0;
    }
    (layout, normal.try_inverse().unwrap())
}

fn of_poses(problem: &Problem, poses: &[usize]) -> Result<Vec<PoseCovariance>, BundleError> {
    let wanted = Wanted { poses: poses.to_vec(), ..Wanted::default() };
    Ok(covariances(problem, &tight(), &wanted)?.poses)
}

#[test]
fn they_are_blocks_of_the_inverse_normal_matrix() {
    for block in [CameraBlock::fixed as fn(Camera) -> CameraBlock, CameraBlock::free_focal_and_radial] {
        let options = scene::Options { num_images: 5, num_points: 30, noise_px: 0.5, ..Default::default() };
        let (_, mut problem) = disturbed(&options, block);
        adjust(&mut problem, &tight()).unwrap();
        let (layout, inverse) = whole_inverse(&problem, &tight());
        for (pose, found) in (1..5).zip(of_poses(&problem, &[1, 2, 3, 4]).unwrap()) {
            let first = layout.block_of_pose[pose] as usize * 6;
            let expected: SMatrix<f64, 6, 6> = SMatrix::from_fn(|r, c| {
                let mask = &layout.pose_mask[layout.block_of_pose[pose] as usize];
                if mask[r] && mask[c] { inverse[(first + r, first + c)] } else { 0.0 }
            });
            let difference = (found.pose - expected).norm();
            assert!(difference < 1e-6 * expected.norm(), "pose {pose}: {} and {expected}", found.pose);
        }
    }
}

#[test]
fn those_of_intrinsics_are_blocks_of_the_inverse_normal_matrix() {
    let options = scene::Options { num_images: 5, num_points: 30, noise_px: 0.5, ..Default::default() };
    let (_, mut problem) = disturbed(&options, CameraBlock::free_focal_and_radial);
    adjust(&mut problem, &tight()).unwrap();
    let (layout, inverse) = whole_inverse(&problem, &tight());
    let wanted = Wanted { cameras: vec![0], ..Wanted::default() };
    let found = covariances(&problem, &tight(), &wanted).unwrap().cameras[0];
    // The free columns are f, k1, k2; fy = fx in these scenes.
    let first = layout.num_blocks() * 6;
    for (r, column_r) in [(0, 0), (1, 0), (4, 1), (5, 2)] {
        for (c, column_c) in [(0, 0), (1, 0), (4, 1), (5, 2)] {
            let expected = inverse[(first + column_r, first + column_c)];
            let scale =
                (inverse[(first + column_r, first + column_r)] * inverse[(first + column_c, first + column_c)]).sqrt();
            assert!((found[(r, c)] - expected).abs() < 1e-6 * scale, "({r}, {c}): {} and {expected}", found[(r, c)]);
        }
    }
    assert!((0..6).all(|k| found[(2, k)] == 0.0 && found[(3, k)] == 0.0), "the principal point is held: {found}");
    // Intrinsics of a camera per image are in the view blocks; their covariance is a block of the same inverse.
    let own = scene::Options { camera_per_image: true, ..options };
    let (_, mut problem) = disturbed(&own, CameraBlock::free_focal_and_radial);
    adjust(&mut problem, &tight()).unwrap();
    let wanted = Wanted { cameras: vec![2], poses: vec![2] };
    let found = covariances(&problem, &tight(), &wanted).unwrap();
    assert!(found.cameras[0][(0, 0)] > 0.0 && found.cameras[0][(0, 0)] == found.cameras[0][(1, 1)]);
}

#[test]
fn deviations_of_centres_follow_from_the_residuals() {
    let options = scene::Options { num_images: 8, num_points: 200, noise_px: 0.5, ..Default::default() };
    let mut model = static_scene(&options);
    let mut problem = Problem::from_reconstruction(&model, |_, camera| CameraBlock::fixed(*camera));
    adjust(&mut problem, &tight()).unwrap();
    problem.store(&mut model);
    let found = center_deviations(&model, 3, &BTreeMap::new()).unwrap().unwrap();
    assert!((found.pixel_px / 0.5 - 1.0).abs() < 0.1, "{found:?}");
    assert_eq!(found.centers.keys().map(|id| id.0).collect::<Vec<_>>(), {
        let ids: Vec<u32> = model.images.keys().map(|id| id.0).collect();
        [ids[1], ids[4], ids[7]]
    });
    let expected = of_poses(&problem, &[1, 4, 7]).unwrap();
    for (deviation, covariance) in found.centers.values().zip(expected) {
        // Here observation errors are independent, and the grouped estimate is about the same.
        let expected = found.pixel_px * covariance.center.trace().sqrt();
        assert!((0.999..1.7).contains(&(deviation / expected)), "{deviation} and {expected}");
    }
    assert_eq!(center_deviations(&Reconstruction::default(), 3, &BTreeMap::new()), Ok(None));
}

#[test]
fn they_predict_the_scatter_of_repeated_adjustments() {
    const RUNS: usize = 300;
    let sigma = 0.5;
    let options = scene::Options { num_images: 5, num_points: 40, ..Default::default() };
    // Two held poses make the gauge the same in every run.
    let problem_of = |seed: u64| {
        // The same world every time, with independent noise.
        let mut exact = static_scene(&options);
        let mut rng = crate::math::seeded_rng(seed, 99);
        for o in exact.images.values_mut().flat_map(|i| &mut i.observations) {
            use rand::Rng as _;
            o.pixel.x += sigma * rng.sample::<f64, _>(rand_distr::StandardNormal);
            o.pixel.y += sigma * rng.sample::<f64, _>(rand_distr::StandardNormal);
        }
        let mut problem = Problem::from_reconstruction(&exact, |_, camera| CameraBlock::fixed(*camera));
        problem.observations.iter_mut().for_each(|o| o.whitening = Whitening::isotropic(sigma));
        (problem.poses[0].fixed, problem.poses[4].fixed) = (true, true);
        problem
    };
    let predicted = of_poses(&problem_of(0), &[2]).unwrap()[0].center;
    let centers: Vec<_> = (0..RUNS as u64)
        .map(|seed| {
            let mut problem = problem_of(seed);
            adjust(&mut problem, &tight()).unwrap();
            problem.poses[2].cam_from_world.center().coords
        })
        .collect();
    let mean = centers.iter().sum::<Vector3<f64>>() / RUNS as f64;
    let scatter: Matrix3<f64> =
        centers.iter().map(|c| (c - mean) * (c - mean).transpose()).sum::<Matrix3<f64>>() / (RUNS - 1) as f64;
    // The standard deviation of a variance from n runs is √(2/n) of it: 8 %; four of them are allowed.
    for k in 0..3 {
        let ratio = scatter[(k, k)] / predicted[(k, k)];
        assert!((ratio - 1.0).abs() < 4.0 * (2.0 / RUNS as f64).sqrt(), "axis {k}: {ratio}");
    }
}

#[test]
fn what_is_held_or_undetermined_has_none() {
    let (_, problem) = disturbed(&scene::Options::default(), CameraBlock::fixed);
    assert_eq!(of_poses(&problem, &[99]), Err(BundleError::NoCovariance { what: "pose", index: 99 }));
    let mut held = problem.clone();
    held.poses[3].fixed = true;
    assert_eq!(of_poses(&held, &[3]), Err(BundleError::NoCovariance { what: "pose", index: 3 }));
    for (wanted, what, index) in [
        (Wanted { cameras: vec![0], ..Wanted::default() }, "camera", 0),
        (Wanted { cameras: vec![5], ..Wanted::default() }, "camera", 5),
    ] {
        assert_eq!(covariances(&held, &tight(), &wanted), Err(BundleError::NoCovariance { what, index }));
    }
    // A pose that observes one point only is not determined.
    let mut lonely = problem.clone();
    let kept = problem.observations.iter().position(|o| o.pose == 5).unwrap();
    lonely.observations =
        problem.observations.iter().enumerate().filter(|(i, o)| o.pose != 5 || *i == kept).map(|(_, o)| *o).collect();
    assert!(matches!(of_poses(&lonely, &[5]), Err(BundleError::Singular { .. })));
}

/// Points of one part of the image that slide together hardly increase residuals, but increase camera errors.
#[test]
fn what_errs_together_makes_centres_less_sure() {
    let options = scene::Options { num_images: 8, num_points: 400, noise_px: 0.3, ..Default::default() };
    let slide = |pixel: Point2<f64>, image: f64, slide_px: f64| {
        let is_even = (((pixel.x / 320.0) as usize) + (pixel.y / 270.0) as usize).is_multiple_of(2);
        (if is_even { slide_px } else { -slide_px }) * (image - 3.5)
    };
    let deviations = |slide_px: f64| {
        let mut model = static_scene(&options);
        for (image, views) in (0..).zip(model.images.values_mut()) {
            for o in &mut views.observations {
                o.pixel.y += slide(o.pixel, f64::from(image), slide_px);
            }
        }
        let mut problem = Problem::from_reconstruction(&model, |_, camera| CameraBlock::fixed(*camera));
        adjust(&mut problem, &tight()).unwrap();
        problem.store(&mut model);
        center_deviations(&model, 3, &BTreeMap::new()).unwrap().unwrap()
    };
    let (apart, together) = (deviations(0.0), deviations(0.2));
    let mean = |found: &CenterDeviations| found.centers.values().sum::<f64>() / found.centers.len() as f64;
    let (of_centres, of_pixels) = (mean(&together) / mean(&apart), together.pixel_px / apart.pixel_px);
    assert!(of_centres > 1.5 * of_pixels, "{of_centres} {of_pixels}");
}

/// The intrinsics' contribution equals the displacement by an adjustment with other intrinsics, up to a similarity.
#[test]
fn intrinsics_move_centers_as_their_share_says() {
    let options = scene::Options { num_images: 8, num_points: 200, noise_px: 0.2, ..Default::default() };
    let model = static_scene(&options);
    let centers_with = |change: f64| {
        let mut problem = Problem::from_reconstruction(&model, |_, camera| CameraBlock::fixed(*camera));
        let [cx, cy] = problem.cameras[0].camera.principal;
        problem.cameras[0].camera.principal = [cx + change, cy];
        adjust(&mut problem, &tight()).unwrap();
        let centers: Vec<Point3<f64>> = problem.poses.iter().map(|pose| pose.cam_from_world.center()).collect();
        (problem, centers)
    };
    const CHANGE: f64 = 0.5;
    let ((mut problem, before), (_, after)) = (centers_with(0.0), centers_with(CHANGE));
    let similarity = umeyama(&after, &before).unwrap();
    // Free, with a prior so strong that the observations add no information.
    problem.cameras[0].free[2] = true;
    let mut sigma = [f64::INFINITY; 6];
    sigma[2] = 1e-6;
    let values = problem.cameras[0].camera.intrinsics();
    problem.priors.intrinsics.push(IntrinsicsPrior { camera: 0, values, sigma });
    let shares = intrinsics_share(&problem, &tight()).unwrap();
    let (mut largest, mut off) = (0.0f64, 0.0f64);
    for ((share, before), after) in shares.iter().zip(&before).zip(&after) {
        let moved = (similarity * *after - before).norm();
        let predicted = share.trace().sqrt() * CHANGE / 1e-6;
        largest = largest.max(moved);
        off = off.max((predicted - moved).abs());
    }
    assert!(largest > 1e-5 && off < 0.1 * largest, "{largest} {off}");
}

#[test]
fn held_intrinsics_have_no_share() {
    let options = scene::Options { num_images: 8, num_points: 200, noise_px: 0.2, ..Default::default() };
    let model = static_scene(&options);
    let largest = |std: [f64; 6]| {
        let intrinsics = model.cameras.keys().map(|id| (*id, std)).collect();
        let found = center_deviations(&model, 8, &intrinsics).unwrap().unwrap();
        found.centers.values().fold(0.0, |a: f64, b| a.max(*b))
    };
    let none = center_deviations(&model, 8, &BTreeMap::new()).unwrap().unwrap();
    let held = largest([0.0; 6]);
    assert_eq!(held, none.centers.values().fold(0.0, |a: f64, b| a.max(*b)));
    let [known, open] = [[8.0, 8.0, 0.0, 0.0, 0.0, 0.0], [80.0, 80.0, 10.0, 10.0, 0.1, 0.1]].map(largest);
    assert!(held < known && known <= open, "{held} {known} {open}");
}
