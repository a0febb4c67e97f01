//! Parameters during the iterations.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::layout::{Columns, IntrinsicsUse, Layout, NONE, POSE_DIM};
use super::problem::Problem;
use crate::camera::Camera;
use crate::math::Rigid3;

/// Values of all parameters; points in the order of [`Layout::points`].
#[derive(Clone, Debug)]
pub(super) struct State {
    pub poses: Vec<Rigid3>,
    pub cameras: Vec<Camera>,
    pub points: Vec<[f64; 3]>,
    /// Derived from the above: pose and intrinsics in the form used by residuals.
    pub views: Vec<View>,
}

/// Pose as a matrix, with intrinsics.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    /// Rows of R.
    pub rotation: [[f64; 3]; 3],
    pub translation: [f64; 3],
    pub camera: Camera,
    pub columns: Columns,
}

impl View {
    pub fn new(pose: &Rigid3, camera: &Camera, columns: Columns) -> Self {
        let r = pose.rotation.to_rotation_matrix();
        let row = |i: usize| [r[(i, 0)], r[(i, 1)], r[(i, 2)]];
        Self { rotation: [row(0), row(1), row(2)], translation: pose.translation.into(), camera: *camera, columns }
    }
}

impl State {
    pub fn new(problem: &Problem, layout: &Layout) -> Self {
        let mut state = Self {
            poses: problem.poses.iter().map(|p| p.cam_from_world).collect(),
            cameras: problem.cameras.iter().map(|c| c.camera).collect(),
            points: layout.points.iter().map(|p| problem.points[*p as usize].position.coords.into()).collect(),
            views: Vec::new(),
        };
        state.refresh_views(problem, layout);
        state
    }

    /// Updates [`State::views`] from poses and cameras.
    pub fn refresh_views(&mut self, problem: &Problem, layout: &Layout) {
        let view = |(pose, block): (&Rigid3, &super::PoseBlock)| {
            View::new(pose, &self.cameras[block.camera], layout.columns[block.camera])
        };
        self.views = self.poses.iter().zip(&problem.poses).map(view).collect();
    }

    /// Applies a step of the reduced system to poses and intrinsics (eq. 2).
    ///
    /// The step has `size` entries per view block, then six per shared camera. Returns true if all values are in range
    /// (focal lengths positive, everything finite).
    pub fn move_cameras(&mut self, from: &Self, problem: &Problem, layout: &Layout, step: &[f64], size: usize) -> bool {
        self.poses.clone_from(&from.poses);
        self.cameras.clone_from(&from.cameras);
        for (block, pose) in layout.pose_of_block.iter().enumerate() {
            let delta = &step[block * size..(block + 1) * size];
            self.poses[*pose as usize] = perturb(&from.poses[*pose as usize], delta);
            let camera = problem.poses[*pose as usize].camera;
            if layout.intrinsics_use[camera] == IntrinsicsUse::Fused {
                self.cameras[camera] = move_camera(&from.cameras[camera], &layout.columns[camera], &delta[POSE_DIM..]);
            }
        }
        let border = layout.num_blocks() * size;
        for (place, camera) in layout.shared.iter().enumerate() {
            let delta = &step[border + place * 6..border + (place + 1) * 6];
            let camera = *camera as usize;
            self.cameras[camera] = move_camera(&from.cameras[camera], &layout.columns[camera], delta);
        }
        self.refresh_views(problem, layout);
        self.cameras.iter().all(|c| c.focal.iter().all(|f| *f > 0.0 && f.is_finite()))
            && step.iter().all(|v| v.is_finite())
    }

    /// Sum of the squares of all parameters except the points.
    pub fn cameras_norm_sq(&self) -> f64 {
        let poses: f64 = self.poses.iter().map(|p| p.translation.norm_squared() + 1.0).sum();
        let cameras: f64 = self.cameras.iter().map(|c| c.intrinsics().iter().map(|v| v * v).sum::<f64>()).sum();
        poses + cameras
    }

    /// Sum of the squares of the points' coordinates.
    pub fn points_norm_sq(&self) -> f64 {
        self.points.iter().map(|p| p.iter().map(|v| v * v).sum::<f64>()).sum()
    }

    /// Writes the values back, after restoring the length of the baseline fixed by the gauge (an exact freedom).
    pub fn write(mut self, problem: &mut Problem, layout: &Layout) {
        self.restore_scale(problem, layout);
        for (block, pose) in problem.poses.iter_mut().zip(&self.poses) {
            block.cam_from_world = *pose;
        }
        for (block, camera) in problem.cameras.iter_mut().zip(&self.cameras) {
            block.camera = *camera;
        }
        for (index, value) in layout.points.iter().zip(&self.points) {
            problem.points[*index as usize].position = Point3::from(*value);
        }
    }

    fn restore_scale(&mut self, problem: &Problem, layout: &Layout) {
        let Some((held, far)) = layout.scale_pair else { return };
        let center = self.poses[held].center();
        let before = (problem.poses[far].cam_from_world.center() - problem.poses[held].cam_from_world.center()).norm();
        let after = (self.poses[far].center() - center).norm();
        let scale = before / after;
        if !(scale.is_finite() && scale > 0.0) {
            return;
        }
        for (index, pose) in self.poses.iter_mut().enumerate() {
            if index != held && layout.block_of_pose[index] != NONE {
                *pose = Rigid3::from_rotation_and_center(pose.rotation, center + (pose.center() - center) * scale);
            }
        }
        for point in &mut self.points {
            *point = (center + (Point3::from(*point) - center) * scale).coords.into();
        }
    }
}

/// `Exp(ω, v) ∘ cam_from_world` for δ = (ω, v): R' = exp(ω) R, t' = exp(ω) t + v (eq. 2).
pub(super) fn perturb(cam_from_world: &Rigid3, delta: &[f64]) -> Rigid3 {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(delta[0], delta[1], delta[2]));
    // Rounding would otherwise let the length drift over many steps.
    let rotation = UnitQuaternion::new_normalize((turn * cam_from_world.rotation).into_inner());
    Rigid3::new(rotation, turn * cam_from_world.translation + Vector3::new(delta[3], delta[4], delta[5]))
}

/// Intrinsics after a step along their free columns.
pub(super) fn move_camera(camera: &Camera, columns: &Columns, delta: &[f64]) -> Camera {
    let mut values = camera.intrinsics();
    for (k, source) in columns.source[..columns.len].iter().enumerate() {
        values[*source] += delta[k];
        if *source == 0 {
            values[1] += columns.aspect * delta[k];
        }
    }
    camera.with_intrinsics(values)
}
