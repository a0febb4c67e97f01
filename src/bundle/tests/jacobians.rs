//! Every derivative against finite differences.

use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};

use super::super::layout::{Columns, Layout};
use super::super::linearize::Linearization;
use super::super::one_point::OnePoint;
use super::super::piece::Pass;
use super::super::plane_prior;
use super::super::priors;
use super::super::residual::{Derivatives, linearize, plain_residual};
use super::super::schur::Reduced;
use super::super::simd::{One, Two};
use super::super::state::{State, View, move_camera, perturb};
use super::super::trial::cost;
use super::*;
use crate::bundle::Whitening;

/// Compares the columns of a Jacobian with central differences of `residual` about zero.
fn check_jacobian<const N: usize>(
    name: &str,
    residual: impl Fn(&[f64; N]) -> Vec<f64>,
    jacobian: impl Fn(usize, usize) -> f64,
    steps: [f64; N],
) {
    for (k, h) in steps.into_iter().enumerate() {
        let at = |sign: f64| {
            let mut delta = [0.0; N];
            delta[k] = sign * h;
            residual(&delta)
        };
        for (row, (plus, minus)) in at(1.0).iter().zip(at(-1.0)).enumerate() {
            let (numeric, analytic) = ((plus - minus) / (2.0 * h), jacobian(row, k));
            assert!(
                (numeric - analytic).abs() < 1e-6 * (1.0 + analytic.abs()),
                "{name}: row {row}, column {k}: {analytic} but numerically {numeric}"
            );
        }
    }
}

fn pose() -> Rigid3 {
    Rigid3::new(UnitQuaternion::from_euler_angles(0.3, -0.8, 0.2), Vector3::new(0.4, -0.3, 5.0))
}

#[test]
fn reprojection() {
    let all = [800.0, 820.0, 470.0, 280.0, -0.1, 0.02, 0.003, -0.002, 0.01];
    for count in [6, 9] {
        check_reprojection(&Camera::prior(960, 540).with_parameters(&all[..count]).unwrap());
    }
}

fn check_reprojection(camera: &Camera) {
    let point = [0.7, -0.4, 0.9];
    let whitening = Whitening([1.7, -0.4, 0.9]);
    let measured = Observation { whitening, ..Observation::new(0, 0, Point2::new(600.0, 200.0)) };
    let tied = Columns { len: 3, source: [0, 4, 5, 0, 0, 0], aspect: 820.0 / 800.0 };
    let all = Columns { len: 6, source: [0, 1, 2, 3, 4, 5], aspect: 0.0 };
    for loss in [RobustLoss::Squared, RobustLoss::Huber { scale: 2.0 }, RobustLoss::Cauchy { scale: 3.0 }] {
        for columns in [Columns::default(), tied, all] {
            for shared in [false, true] {
                let view = View::new(&pose(), camera, columns);
                let (mut d_point, mut d_shared) = ([[0.0; 3]; 2], [[0.0; 6]; 2]);
                let derivatives = Derivatives { d_point: &mut d_point, d_shared: shared.then_some(&mut d_shared) };
                let (_, r) = linearize::<12, One>(&view, &point, &measured, &loss, derivatives);
                let plain = plain_residual(&view, &point, &measured);
                let weight = loss.evaluate(plain[0] * plain[0] + plain[1] * plain[1])[1].sqrt();
                let moved = |d: &[f64; 15]| {
                    let camera = move_camera(camera, &columns, &d[6..12]);
                    let view = View::new(&perturb(&pose(), &d[..6]), &camera, columns);
                    let point = std::array::from_fn(|k| point[k] + d[12 + k]);
                    plain_residual(&view, &point, &measured).map(|v| v * weight).to_vec()
                };
                let intrinsics =
                    if shared { d_shared } else { r.d_view.map(|row| std::array::from_fn(|k| row[6 + k])) };
                let jacobian = |row: usize, k: usize| match k {
                    0..6 => r.d_view[row][k],
                    6..12 => intrinsics[row][k - 6],
                    _ => d_point[row][k - 12],
                };
                let mut steps = [1e-6; 15];
                steps[6..12].fill(1e-5);
                check_jacobian(&format!("{loss:?} {columns:?} shared {shared}"), moved, jacobian, steps);
                assert!((r.value[0] - plain[0] * weight).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn instruction_sets_agree() {
    let view = View::new(&pose(), &Camera::with_focal(960, 540, 800.0), Columns::default());
    let of = |fused: bool| {
        let mut d_point = [[0.0; 3]; 2];
        let derivatives = Derivatives { d_point: &mut d_point, d_shared: None };
        let (point, loss) = ([0.7, -0.4, 0.9], RobustLoss::Squared);
        let measured = Observation::new(0, 0, Point2::new(600.0, 200.0));
        let r = if fused {
            linearize::<6, One>(&view, &point, &measured, &loss, derivatives).1
        } else {
            linearize::<6, Two>(&view, &point, &measured, &loss, derivatives).1
        };
        [r.d_view[0].to_vec(), r.d_view[1].to_vec(), d_point.as_flattened().to_vec()].concat()
    };
    for (a, b) in of(true).iter().zip(of(false)) {
        assert!((a - b).abs() < 1e-12 * (1.0 + b.abs()));
    }
}

#[test]
fn plane_priors() {
    let prior = plane_through(Point3::new(0.3, -0.2, 0.5));
    let (by_turn, by_shift, tilt_by_turn) = plane_prior::jacobians(&prior, &pose());
    let moved = |d: &[f64; 6]| {
        let (distance, tilt) = prior.residual(&perturb(&pose(), d));
        vec![distance, tilt.x, tilt.y, tilt.z]
    };
    let jacobian = |row: usize, k: usize| match (row, k < 3) {
        (0, true) => by_turn[k],
        (0, false) => by_shift[k - 3],
        (_, true) => tilt_by_turn[(row - 1, k)],
        _ => 0.0,
    };
    check_jacobian("plane prior", moved, jacobian, [1e-6; 6]);
}

/// A plane prior of arbitrary position and direction.
fn plane_through(point: Point3<f64>) -> PlanePrior {
    PlanePrior {
        pose: 1,
        normal_in_cam: Vector3::new(0.1, -0.8, -0.5).normalize(),
        camera_height: 3.0,
        point,
        up: Vector3::new(0.2, 0.1, 0.9).normalize(),
        sigma_distance: 0.3,
        sigma_tilt: 0.2,
        loss: RobustLoss::Cauchy { scale: 2.0 },
    }
}

/// Finite differences of the whole cost, priors and robust loss included, against the solver's gradient.
///
/// Also compares the cost-only code path with the one that computes derivatives.
#[test]
fn the_gradient_is_that_of_the_cost() {
    for camera_per_image in [false, true] {
        let options = scene::Options { camera_per_image, num_points: 20, num_images: 4, ..Default::default() };
        let (_, mut problem) = disturbed(&options, |camera| CameraBlock { camera, free: [true; 6], tie_focal: false });
        let (values, sigma) = ([790.0, 810.0, 470.0, 280.0, 0.1, 0.0], [5.0, 6.0, 3.0, f64::INFINITY, 0.2, 0.1]);
        problem.priors.intrinsics.push(IntrinsicsPrior { camera: 0, values, sigma });
        problem.priors.planes.push(plane_through(Point3::new(0.3, -0.2, 0.5)));
        let known = problem.points[3].position + Vector3::new(0.02, -0.01, 0.03);
        for sigma in [0.02, 0.05] {
            problem.priors.points.push(PointPrior { point: 3, position: known, sigma });
        }
        let options = Options { loss: RobustLoss::Cauchy { scale: 2.0 }, gauge: Gauge::Free, ..tight() };
        compare_gradients(&problem, &options);
    }
}

fn compare_gradients(problem: &Problem, options: &Options) {
    let layout = Layout::new(problem, options, false);
    let state = State::new(problem, &layout);
    let pass = Pass { layout: &layout, observations: &problem.observations, loss: options.loss, parallel: false };
    let mut reduced = Reduced::<12>::new(&layout);
    let mut lin = Linearization::<12>::new(&pass, &reduced.pattern);
    let with_derivatives = lin.evaluate(&pass, &state, 1e-4, &mut reduced);
    let plain = cost(&pass, &state);
    assert!((with_derivatives - plain).abs() < 1e-12 * plain);
    reduced.finish(&priors::terms(problem, &layout, &state), 1e-4);
    let total = |state: &State| cost(&pass, state) + priors::cost(problem, state);
    let gradient: Vec<f64> =
        reduced.views.iter().flat_map(|v| v.gradient).chain(reduced.cameras.gradient.clone()).collect();
    let close = |numeric: f64, analytic: f64, what: &str| {
        assert!(
            (numeric - analytic).abs() < 1e-5 * (10.0 + analytic.abs()),
            "{what}: {analytic}, numerically {numeric}"
        );
    };
    for (k, analytic) in gradient.iter().enumerate() {
        let at = |h: f64| {
            let mut step = vec![0.0; gradient.len()];
            step[k] = h;
            let mut moved = state.clone();
            moved.move_cameras(&state, problem, &layout, &step, 12);
            total(&moved)
        };
        close((at(1e-6) - at(-1e-6)) / 2e-6, *analytic, &format!("camera freedom {k}"));
    }
    let mut one = OnePoint::<12>::new(&layout, 0..layout.points.len());
    for p in 0..layout.points.len() {
        one.work_out::<Two>(&pass, &state, p, 1e-4);
        for k in 0..3 {
            let at = |h: f64| {
                let mut moved = state.clone();
                moved.points[p][k] += h;
                total(&moved)
            };
            close((at(1e-6) - at(-1e-6)) / 2e-6, one.terms.gradient[k], &format!("point {p}"));
        }
    }
    assert!(gradient.iter().any(|g| g.abs() > 1.0));
}
