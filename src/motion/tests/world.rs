//! Synthetic world: ground, trees and a vehicle, observed by a camera with different motions.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Point2, Point3, Rotation3, UnitQuaternion, Vector3};
use rand::Rng as _;
use rand_distr::StandardNormal;

use super::super::{ContactDepth, GroundModel, PointTrack, Surroundings, TrackLabel, View};
use crate::camera::Camera;
use crate::math::{Rigid3, Rng, seeded_rng};
use crate::scene::Rect;

/// Frames per second.
const FPS: f64 = 10.0;
/// Width and height of the image, pixels.
const SIZE: (u32, u32) = (960, 540);

/// Motion of the camera. The world is metric, z up; the camera looks along x, slightly down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Flight {
    /// No motion.
    Hovering,
    /// Rotation about its center.
    Turning,
    /// Translation along x at 8 m/s, `height_m` over the ground.
    Forward { height_m: f64 },
    /// Translation along y at 5 m/s, 15 m over the ground.
    Sideways,
}

/// Content of the world besides the camera.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    pub flight: Flight,
    /// Initial position of the vehicle's center, meters, and its velocity, meters per second.
    pub vehicle: Option<([f64; 2], [f64; 2])>,
    /// Frames in which the vehicle moves.
    pub moves_in: [u32; 2],
    /// Height over the ground up to which the vehicle is occluded, meters.
    pub hidden_m: f64,
    /// True if there are trees: posts, and swaying crowns.
    pub has_trees: bool,
    /// Standard deviation of the positions, pixels.
    pub noise_px: f64,
    pub num_frames: u32,
    pub seed: u64,
}

impl Default for Plan {
    fn default() -> Self {
        Self {
            flight: Flight::Sideways,
            vehicle: None,
            moves_in: [0, u32::MAX],
            hidden_m: 0.0,
            has_trees: true,
            noise_px: 0.2,
            num_frames: 30,
            seed: 1,
        }
    }
}

/// Output of a follower, with the truth.
pub struct World {
    pub tracks: Vec<PointTrack>,
    /// True for each track on the vehicle.
    pub is_vehicle: Vec<bool>,
    pub views: Vec<Option<View>>,
    pub times_s: Vec<f64>,
    pub ground: GroundModel,
    plan: Plan,
}

impl World {
    pub fn surroundings(&self) -> Surroundings<'_> {
        Surroundings { size: SIZE, times_s: &self.times_s, views: &self.views, ground: Some(&self.ground) }
    }

    /// Contact depth of the vehicle below a point on it, as by its mask.
    pub fn contact_depth(&self, track: &PointTrack, label: &TrackLabel) -> Option<ContactDepth> {
        /// Half the width of the column in which the lower edge is searched, pixels.
        const COLUMN_PX: f64 = 4.0;
        let point = label.static_point?;
        let view = self.views[point.frame as usize]?;
        let [x, _] = track.at(point.frame)?;
        let (start, velocity) = self.plan.vehicle?;
        let edge = (0..1600).filter_map(|k| {
            let (side, at) = (k % 4, f64::from(k / 4) / 200.0 - 1.0);
            let at = [[at, -1.0], [at, 1.0], [-1.0, at], [1.0, at]][side as usize];
            let position = Plan::on_vehicle(start, velocity, [at[0], at[1]], self.plan.hidden_m);
            let position = position + self.plan.offset(velocity, point.frame);
            view.camera.pixel_from_cam(view.cam_from_world * position).filter(|p| (p.x - x).abs() <= COLUMN_PX)
        });
        let bottom = edge.map(|p| p.y).max_by(f64::total_cmp)?;
        let last = f64::from(SIZE.1);
        self.ground.contact_depth(&view, [x, bottom.min(last)], bottom >= last, &point)
    }
}

/// Position of a point by frame.
type PointTrajectory = Box<dyn Fn(u32) -> Point3<f64>>;

pub fn world(plan: &Plan) -> World {
    let rng = &mut seeded_rng(plan.seed, 0x6d6f_7669);
    let views: Vec<Option<View>> = (0..plan.num_frames).map(|frame| Some(view(plan.flight, frame))).collect();
    let mut trajectories: Vec<(PointTrajectory, bool)> = Vec::new();
    for _ in 0..2500 {
        let position = Point3::new(rng.random_range(3.0..90.0), rng.random_range(-35.0..35.0), 0.0);
        trajectories.push((Box::new(move |_| position), false));
    }
    if plan.has_trees {
        trajectories.extend(trees(rng).into_iter().map(|trajectory| (trajectory, false)));
    }
    if let Some((start, velocity)) = plan.vehicle {
        trajectories.extend(vehicle(plan, start, velocity, rng).into_iter().map(|trajectory| (trajectory, true)));
    }
    let occluded = occluded(&trajectories, &views);
    let nothing = vec![None; views.len()];
    let tracked = trajectories.iter().filter_map(|(trajectory, is_vehicle)| {
        let occluded = if *is_vehicle { &nothing } else { &occluded };
        Some((track(trajectory, &views, occluded, plan.noise_px, rng)?, *is_vehicle))
    });
    let (tracks, is_vehicle) = tracked.unzip();
    let ground = GroundModel::new(Vector3::z(), Point3::origin(), &[]).unwrap();
    let times_s = (0..plan.num_frames).map(|k| f64::from(k) / FPS).collect();
    World { tracks, is_vehicle, views, times_s, ground, plan: *plan }
}

/// Part of each frame that the vehicle occludes.
fn occluded(trajectories: &[(PointTrajectory, bool)], views: &[Option<View>]) -> Vec<Option<Rect>> {
    let in_frame = |(frame, view): (u32, &Option<View>)| {
        let points = trajectories.iter().filter(|(_, is_vehicle)| *is_vehicle);
        let pixels = points.filter_map(|(trajectory, _)| pixel(view.as_ref()?, trajectory(frame)));
        let all = pixels.map(|p| Rect { x0: p.x, y0: p.y, x1: p.x, y1: p.y }).reduce(|a, b| a.union(&b));
        all.map(|rect| rect.grown(-0.03))
    };
    (0u32..).zip(views).map(in_frame).collect()
}

fn view(flight: Flight, frame: u32) -> View {
    let t = f64::from(frame) / FPS;
    let (center, yaw, pitch) = match flight {
        Flight::Hovering => (Point3::new(0.0, 0.0, 12.0), 0.0, 0.45),
        Flight::Turning => (Point3::new(0.0, 0.0, 12.0), 0.08 * t, 0.45),
        Flight::Forward { height_m } => (Point3::new(8.0 * t, 0.0, height_m), 0.0, 0.02 * height_m),
        Flight::Sideways => (Point3::new(0.0, -6.0 + 5.0 * t, 15.0), 0.0, 0.5),
    };
    let forward = Vector3::new(pitch.cos() * yaw.cos(), pitch.cos() * yaw.sin(), -pitch.sin());
    let right = forward.cross(&Vector3::z()).normalize();
    let rows = Matrix3::from_columns(&[right, forward.cross(&right), forward]).transpose();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
    let camera = Camera::with_focal(SIZE.0, SIZE.1, 800.0);
    View { camera, cam_from_world: Rigid3::from_rotation_and_center(rotation, center) }
}

/// Posts of 6 m, and crowns that sway by 3 cm.
fn trees(rng: &mut Rng) -> Vec<PointTrajectory> {
    let mut trajectories: Vec<PointTrajectory> = Vec::new();
    for tree in 0..12 {
        let (x, y) =
            (rng.random_range(12.0..70.0), rng.random_range(4.0..14.0) * if tree % 2 == 0 { 1.0 } else { -1.0 });
        for k in 0..12 {
            let position = Point3::new(x, y, 0.5 * f64::from(k));
            trajectories.push(Box::new(move |_| position));
        }
        for _ in 0..25 {
            let mut offset = || rng.random_range(-1.2..1.2);
            let position = Point3::new(x + offset(), y + offset(), 6.0 + offset());
            let phase = offset();
            trajectories.push(Box::new(move |frame| {
                position + Vector3::new(0.0, 0.03, 0.01) * (TAU * f64::from(frame) / FPS * 0.7 + phase).sin()
            }));
        }
    }
    trajectories
}

/// Visible points on the sides and the top of a box of 4.4 × 1.8 × 1.5 m.
fn vehicle(plan: &Plan, start: [f64; 2], velocity: [f64; 2], rng: &mut Rng) -> Vec<PointTrajectory> {
    let point = |_| {
        let mut at = [0; 3].map(|_| rng.random_range(-1.0..1.0));
        at[rng.random_range(0..3)] = if rng.random() { 1.0 } else { -1.0 };
        let position = Plan::on_vehicle(start, velocity, [at[0], at[1]], 0.75 + 0.75 * at[2]);
        (position.z >= plan.hidden_m).then_some(position)
    };
    let positions: Vec<Point3<f64>> = (0..70).filter_map(point).collect();
    let plan = *plan;
    positions
        .into_iter()
        .map(|position| Box::new(move |frame| position + plan.offset(velocity, frame)) as PointTrajectory)
        .collect()
}

impl Plan {
    /// Initial position of a point on the vehicle: `at` −1 to 1 along and across it, and a height.
    fn on_vehicle(start: [f64; 2], velocity: [f64; 2], at: [f64; 2], height_m: f64) -> Point3<f64> {
        let heading = if velocity == [0.0; 2] { 0.0 } else { velocity[1].atan2(velocity[0]) };
        let (along, across) = (2.2 * at[0], 0.9 * at[1]);
        let (sin, cos) = f64::sin_cos(heading);
        Point3::new(start[0] + along * cos - across * sin, start[1] + along * sin + across * cos, height_m)
    }

    /// Displacement of the vehicle up to a frame.
    fn offset(&self, velocity: [f64; 2], frame: u32) -> Vector3<f64> {
        let [first, last] = self.moves_in;
        let t = f64::from(frame.clamp(first, last) - first) / FPS;
        Vector3::new(velocity[0], velocity[1], 0.0) * t
    }
}

/// Longest run of frames in which a point is visible.
fn track(
    trajectory: &PointTrajectory,
    views: &[Option<View>],
    occluded: &[Option<Rect>],
    noise_px: f64,
    rng: &mut Rng,
) -> Option<PointTrack> {
    let mut best = PointTrack { first: 0, pixels: Vec::new() };
    let mut run = best.clone();
    for (frame, (view, occluded)) in (0u32..).zip(views.iter().zip(occluded)) {
        let is_free = |p: &Point2<f64>| occluded.is_none_or(|rect| !rect.contains(p.x, p.y));
        match view.as_ref().and_then(|view| pixel(view, trajectory(frame))).filter(is_free) {
            Some(p) => {
                let mut noisy = |x: f64| (x + noise_px * rng.sample::<f64, _>(StandardNormal)) as f32;
                run.pixels.push([noisy(p.x), noisy(p.y)]);
            }
            None => run = PointTrack { first: frame + 1, pixels: Vec::new() },
        }
        if run.pixels.len() > best.pixels.len() {
            best.clone_from(&run);
        }
    }
    (best.pixels.len() >= 4).then_some(best)
}

fn pixel(view: &View, position: Point3<f64>) -> Option<Point2<f64>> {
    view.camera.pixel_from_cam(view.cam_from_world * position).filter(|p| view.camera.contains(*p))
}
