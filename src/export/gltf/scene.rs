//! The nodes, meshes and animations of a scene.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use serde_json::{Value, json};

use super::buffer::{Buffer, linear};
use super::{asset, vehicle};
use crate::export::{RegisteredFrame, Results};
use crate::math::Sim3;
use crate::report::object_colour;
use crate::scene::{GroundTrack, ObjectId, ObjectTrajectory, Reconstruction};

/// Topology of primitives.
#[derive(Clone, Copy)]
pub(super) enum Mode {
    Points = 0,
    Lines = 1,
    LineStrip = 3,
}

/// A scene under construction.
pub(super) struct Scene<'a> {
    results: &'a Results,
    /// Transform from the background's frame to that of the scene, y up.
    scene_from_world: Sim3,
    pub(super) buffer: Buffer,
    nodes: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    samplers: Vec<Value>,
    channels: Vec<Value>,
    camera: Value,
}

impl<'a> Scene<'a> {
    /// Builds the scene of results and the models of their vehicles.
    pub(super) fn of(results: &'a Results, models: &BTreeMap<ObjectId, Reconstruction>) -> Self {
        let mut scene = Self {
            results,
            scene_from_world: scene_from_world(results),
            buffer: Buffer::default(),
            nodes: Vec::new(),
            meshes: Vec::new(),
            materials: Vec::new(),
            samplers: Vec::new(),
            channels: Vec::new(),
            camera: json!([]),
        };
        scene.add_background();
        scene.add_camera();
        for object in &results.trajectories.objects {
            scene.add_vehicle(object, models.get(&object.id));
        }
        results.trajectories.ground_tracks.iter().for_each(|track| scene.add_ground_track(track));
        scene
    }

    /// The document and its buffer.
    pub(super) fn finish(self) -> (Value, Vec<u8>) {
        let all: Vec<usize> = (0..self.nodes.len()).collect();
        let mut document = json!({
            "asset": asset(self.results),
            "extensionsUsed": ["KHR_materials_unlit"],
            "scene": 0,
            "scenes": [{ "name": self.results.title, "nodes": all }],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "cameras": self.camera,
            "accessors": self.buffer.accessors,
            "bufferViews": self.buffer.views,
            "buffers": [{ "byteLength": self.buffer.bytes.len() }],
        });
        if !self.channels.is_empty() {
            document["animations"] = json!([
                { "name": "drive", "samplers": self.samplers, "channels": self.channels }
            ]);
        }
        // glTF forbids empty lists.
        if let Some(document) = document.as_object_mut() {
            document.retain(|_, value| value.as_array().is_none_or(|list| !list.is_empty()));
        }
        (document, self.buffer.bytes)
    }

    fn add_background(&mut self) {
        let all: Vec<_> = self.results.background.points.values().collect();
        let near = near_points(&all.iter().map(|point| point.position).collect::<Vec<_>>());
        let points: Vec<_> = near.into_iter().map(|index| all[index]).collect();
        let places: Vec<_> = points.iter().map(|point| self.scene_from_world * point.position).collect();
        let colours: Vec<_> = points.iter().map(|point| point.rgb).collect();
        if let Some(cloud) = self.cloud(&places, &colours) {
            self.add_mesh("background", cloud);
        }
    }

    fn add_camera(&mut self) {
        let views = &self.results.views;
        let Some(first) = views.first() else { return };
        let [_, focal_y] = first.camera.focal;
        let (width, height) = (f64::from(first.camera.width), f64::from(first.camera.height));
        self.camera = json!([{
            "type": "perspective",
            "perspective": {
                "yfov": 2.0 * (0.5 * height / focal_y).atan(),
                "aspectRatio": width / height,
                "znear": self.near(first),
            },
        }]);
        let times: Vec<f64> = views.iter().map(|view| self.results.seconds(view.frame.time_s)).collect();
        let places: Vec<_> = views.iter().map(|view| self.scene_from_world * view.cam_from_world.center()).collect();
        // A camera of glTF looks along −z with y up.
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let turns: Vec<_> = views
            .iter()
            .map(|view| self.scene_from_world.rotation * view.cam_from_world.rotation.inverse() * turn)
            .collect();
        let node = self.nodes.len();
        let (translation, rotation) = (numbers(places[0].coords), quaternion(turns[0]));
        self.nodes.push(json!({
            "name": "camera", "camera": 0, "translation": translation, "rotation": rotation,
        }));
        self.animate(node, &times, &places, &turns);
        self.add_path("camera path", &places, Mode::LineStrip, [240, 200, 40]);
    }

    /// Adds an animated node, and the line of its path.
    fn add_vehicle(&mut self, object: &ObjectTrajectory, model: Option<&Reconstruction>) {
        let Some(first) = object.poses.first() else { return };
        let name = object.name();
        let colour = object_colour(object.id);
        let scene_from_object: Vec<Sim3> =
            object.poses.iter().map(|pose| self.scene_from_world * pose.world_from_object).collect();
        let times: Vec<f64> = object.poses.iter().map(|pose| self.results.seconds(pose.time_s)).collect();
        let mut primitives = Vec::new();
        if let Some(model) = model {
            let points: Vec<_> = model.points.values().map(|point| point.position).collect();
            let near = near_points(&points);
            let colours: Vec<_> = model.points.values().map(|point| point.rgb).collect();
            let colours: Vec<_> = near.iter().map(|index| colours[*index]).collect();
            let points: Vec<_> = near.into_iter().map(|index| points[index]).collect();
            primitives.extend(self.cloud(&points, &colours));
            let edges = vehicle::box_edges(&points, &scene_from_object);
            primitives.extend(edges.map(|edges| self.lines(&edges, Mode::Lines, colour)));
        }
        let pose = scene_from_object[0];
        let mut node = json!({
            "name": name,
            "translation": numbers(pose.translation),
            "rotation": quaternion(pose.rotation),
            "scale": [pose.scale, pose.scale, pose.scale],
            "extras": { "vehicle": object.id, "class": object.class, "first_frame": first.frame },
        });
        if !primitives.is_empty() {
            node["mesh"] = json!(self.mesh(&name, primitives));
        }
        let index = self.nodes.len();
        self.nodes.push(node);
        let places: Vec<_> = scene_from_object.iter().map(|pose| Point3::from(pose.translation)).collect();
        let turns: Vec<_> = scene_from_object.iter().map(|pose| pose.rotation).collect();
        self.animate(index, &times, &places, &turns);
        self.show_while(index, &times, pose.scale);
        let centers: Vec<_> =
            object.poses.iter().map(|pose| self.scene_from_world * Point3::from(pose.position)).collect();
        self.add_path(&format!("path of {name}"), &centers, Mode::LineStrip, colour);
    }

    /// Adds a point moving over the ground, and its path as a dashed line.
    fn add_ground_track(&mut self, track: &GroundTrack) {
        let places: Vec<_> =
            track.positions.iter().map(|at| self.scene_from_world * Point3::from(at.position)).collect();
        let (Some(first), Some(first_place)) = (track.positions.first(), places.first()) else { return };
        let name = format!("ground track of {}", track.name());
        let colour = object_colour(track.id);
        let times: Vec<f64> = track.positions.iter().map(|at| self.results.seconds(at.time_s)).collect();
        let point = self.cloud(&[Point3::origin()], &[colour]);
        let mesh = self.mesh(&name, point.into_iter().collect());
        let index = self.nodes.len();
        self.nodes.push(json!({
            "name": name,
            "translation": numbers(first_place.coords),
            "scale": [1.0, 1.0, 1.0],
            "mesh": mesh,
            "extras": {
                "vehicle": track.id, "class": track.class, "method": track.method.name(), "first_frame": first.frame,
            },
        }));
        self.animate(index, &times, &places, &vec![UnitQuaternion::identity(); places.len()]);
        self.show_while(index, &times, 1.0);
        // Every other segment.
        let dashes: Vec<_> = places.windows(2).step_by(2).flatten().copied().collect();
        self.add_path(&format!("path of {name}"), &dashes, Mode::Lines, colour);
    }

    fn add_path(&mut self, name: &str, places: &[Point3<f64>], mode: Mode, colour: [u8; 3]) {
        if places.len() > 1 {
            let lines = self.lines(places, mode, colour);
            self.add_mesh(name, lines);
        }
    }

    /// Adds a node with one primitive.
    fn add_mesh(&mut self, name: &str, primitive: Value) {
        let mesh = self.mesh(name, vec![primitive]);
        self.nodes.push(json!({ "name": name, "mesh": mesh }));
    }

    /// Adds a mesh of colored points; `None` without points.
    fn cloud(&mut self, points: &[Point3<f64>], colours: &[[u8; 3]]) -> Option<Value> {
        if points.is_empty() {
            return None;
        }
        let (position, colour) = (self.buffer.positions(points), self.buffer.colours(colours));
        let material = self.material([255; 3]);
        let attributes = json!({ "POSITION": position, "COLOR_0": colour });
        Some(json!({ "attributes": attributes, "mode": Mode::Points as u32, "material": material }))
    }

    fn lines(&mut self, points: &[Point3<f64>], mode: Mode, colour: [u8; 3]) -> Value {
        let (position, material) = (self.buffer.positions(points), self.material(colour));
        json!({ "attributes": { "POSITION": position }, "mode": mode as u32, "material": material })
    }

    fn mesh(&mut self, name: &str, primitives: Vec<Value>) -> usize {
        self.meshes.push(json!({ "name": name, "primitives": primitives }));
        self.meshes.len() - 1
    }

    /// Adds an unlit material of one color.
    fn material(&mut self, colour: [u8; 3]) -> usize {
        let [r, g, b] = colour.map(linear);
        self.materials.push(json!({
            "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0 },
            "extensions": { "KHR_materials_unlit": {} },
        }));
        self.materials.len() - 1
    }

    fn animate(&mut self, node: usize, times: &[f64], places: &[Point3<f64>], turns: &[UnitQuaternion<f64>]) {
        let input = self.buffer.times(times);
        let ways: Vec<_> = places.iter().map(|place| place.coords).collect();
        let (translation, rotation) = (self.buffer.vectors(&ways), self.buffer.quaternions(&without_flips(turns)));
        self.channel(node, "translation", input, translation, "LINEAR");
        self.channel(node, "rotation", input, rotation, "LINEAR");
    }

    /// Hides a node before its first time and from the frame after its last one.
    fn show_while(&mut self, node: usize, times: &[f64], scale: f64) {
        let (Some(&first), Some(&last)) = (times.first(), times.last()) else { return };
        let all: Vec<f64> = self.results.views.iter().map(|view| self.results.seconds(view.frame.time_s)).collect();
        let before = all.first().copied().filter(|&begin| begin < first);
        let after = all.iter().copied().find(|&time| time > last);
        let keys: Vec<(f64, f64)> =
            [before.map(|time| (time, 0.0)), Some((first, scale)), after.map(|time| (time, 0.0))]
                .into_iter()
                .flatten()
                .collect();
        let input = self.buffer.times(&keys.iter().map(|key| key.0).collect::<Vec<_>>());
        let scales: Vec<_> = keys.iter().map(|key| Vector3::repeat(key.1)).collect();
        let output = self.buffer.vectors(&scales);
        self.channel(node, "scale", input, output, "STEP");
    }

    fn channel(&mut self, node: usize, path: &str, input: usize, output: usize, interpolation: &str) {
        self.samplers.push(json!({ "input": input, "output": output, "interpolation": interpolation }));
        let sampler = self.samplers.len() - 1;
        self.channels.push(json!({ "sampler": sampler, "target": { "node": node, "path": path } }));
    }

    /// Distance of the camera's near plane.
    fn near(&self, view: &RegisteredFrame) -> f64 {
        let center = view.cam_from_world.center();
        let distances = self.results.background.points.values().map(|point| (point.position - center).norm());
        let middle = crate::math::median(distances.collect()).unwrap_or(1.0);
        // Distance of the near plane, as a share of the camera's median distance to the points.
        (1e-3 * middle * self.scene_from_world.scale).max(f64::from(f32::MIN_POSITIVE))
    }
}

/// Indices of the inliers by distance from the median point: at most three times the 95 % quantile. With the outliers
/// the scene would be a dot in the initial view of programs, which fits the whole scene.
fn near_points(points: &[Point3<f64>]) -> Vec<usize> {
    let middle = |axis: usize| crate::math::median(points.iter().map(|point| point[axis]).collect()).unwrap_or(0.0);
    let center = Point3::new(middle(0), middle(1), middle(2));
    let distances: Vec<f64> = points.iter().map(|point| (point - center).norm()).collect();
    let mut sorted = distances.clone();
    sorted.sort_by(f64::total_cmp);
    // Outlier limit as a multiple of the 95 % quantile of the distances: with the outliers the scene would be a
    // dot in the initial view of programs, which fits the whole scene.
    let limit = sorted.get((0.95 * points.len() as f64) as usize).map_or(0.0, |near| 3.0 * near);
    (0..points.len()).filter(|&index| distances[index] <= limit).collect()
}

/// Meters, y up; without meters the background's frame, rotated so that the mean normal of the ground, or else the mean
/// of the camera's upward direction, points up.
fn scene_from_world(results: &Results) -> Sim3 {
    if results.metric_frame().is_some() {
        let y_up_from_z_up = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2);
        return Sim3::new(1.0, y_up_from_z_up, Vector3::zeros()) * results.export_from_world();
    }
    let up = upward(results);
    // Of the two rotations by half a turn either is valid.
    let half = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let rotation = UnitQuaternion::rotation_between(&up, &Vector3::y()).unwrap_or(half);
    Sim3::new(1.0, rotation, Vector3::zeros())
}

fn upward(results: &Results) -> Vector3<f64> {
    let normals: Vector3<f64> =
        results.ground.iter().flat_map(|ground| ground.planes.values()).map(|plane| plane.normal).sum();
    let of_camera = || results.views.iter().map(|view| view.cam_from_world.rotation.inverse() * -Vector3::y()).sum();
    let up = if normals.norm() > 0.0 { normals } else { of_camera() };
    up.try_normalize(1e-9).unwrap_or(-Vector3::y())
}

/// Quaternions with signs chosen nearest to the preceding one: interpolation then takes the shorter arc.
fn without_flips(turns: &[UnitQuaternion<f64>]) -> Vec<[f32; 4]> {
    let mut all: Vec<nalgebra::Quaternion<f64>> = Vec::with_capacity(turns.len());
    for turn in turns {
        let turn = turn.into_inner();
        let flips = all.last().is_some_and(|before| before.dot(&turn) < 0.0);
        all.push(if flips { -turn } else { turn });
    }
    all.iter().map(|q| [q.i as f32, q.j as f32, q.k as f32, q.w as f32]).collect()
}

fn quaternion(turn: UnitQuaternion<f64>) -> [f64; 4] {
    [turn.i, turn.j, turn.k, turn.w]
}

fn numbers(vector: Vector3<f64>) -> [f64; 3] {
    vector.into()
}
