//! Content of the 3D view, thinned and packed for `view3d.js`.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use serde::Serialize;

use super::data::{Data, Object};
use super::metres::{self, Ruler};
use super::motion;
use super::overlay::{css_colour, object_colour, spread};
use super::plan::Turn;
use super::timeline::Timeline;
use super::view::{RADIUS, View, rounded};
use crate::math::is_finite;
use crate::scene::{Estimate, Frame, FrameId, GroundPosition, GroundTrack, Image, Point3d, Point3dId, Reconstruction};

/// Maximum number of background points shown: 12 characters each in the page.
pub(super) const MAX_POINTS: usize = 60_000;
/// Maximum number of stops of the time slider, and of cameras shown per reconstruction.
pub(super) const MAX_FRAMES: usize = 1_500;

/// Input of `view3d.js`.
#[derive(Debug, Serialize)]
pub(super) struct Scene {
    /// Length of the reported unit in the view: a meter, or a unit of the background.
    scale: f64,
    /// Rows of the matrix that turns x and z of the view into the plan's.
    turn: [[f64; 2]; 2],
    ground: f64,
    radius: f64,
    /// Half width and height of the image plane at distance 1.
    tangent: [f64; 2],
    frames: Vec<SceneFrame>,
    points: Cloud,
    objects: Vec<SceneObject>,
}

/// A stop of the time slider.
#[derive(Debug, Serialize)]
struct SceneFrame {
    frame: u32,
    time: f64,
    /// Camera center and `view_from_cam` as w x y z; absent where the camera is unknown.
    camera: Option<[f64; 7]>,
    /// Overrides the scene's value where this frame has other intrinsics.
    #[serde(skip_serializing_if = "Option::is_none")]
    tangent: Option<[f64; 2]>,
}

/// Packed points.
#[derive(Debug, Serialize)]
pub(super) struct Cloud {
    /// Numbers of points in the model, in this cloud, and beyond its reach.
    pub total: usize,
    pub count: usize,
    pub beyond: usize,
    /// Coordinates from −reach to +reach as 16-bit fractions, little endian.
    reach: f64,
    positions: String,
    /// Four bytes each: red, green, blue, and 255 for ground.
    colours: String,
}

/// Index in `frames`; position; `view_from_object` as scale, w x y z, translation; description of its motion.
type ScenePose = (usize, [f64; 3], [f64; 8], Option<String>);

/// A vehicle in the 3D view.
#[derive(Debug, Default, Serialize)]
struct SceneObject {
    id: u32,
    name: String,
    colour: String,
    degenerate: bool,
    /// True of a ground track, which has no points.
    ground: bool,
    /// Length, height and width of the box on the ground that a ground track is shown as, along x, y and z of the
    /// object's frame; absent where length, width or every direction is unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    size: Option<[f64; 3]>,
    total: usize,
    count: usize,
    /// In the object's frame: 32-bit floats, little endian.
    positions: String,
    colours: String,
    poses: Vec<ScenePose>,
}

impl Scene {
    pub fn new(data: &Data, view: &View, timeline: &Timeline, names: &[String]) -> Self {
        let chosen = spread(data.frames.len(), MAX_FRAMES);
        let images = data.background.images(data.frames);
        let background = data.background.reconstruction;
        let usual = tangent(background);
        let frames = chosen.iter().map(|&i| SceneFrame {
            tangent: images[i].map(|image| tangent_of(background, image)).filter(|own| *own != usual),
            ..scene_frame(&data.frames[i], images[i], view, timeline)
        });
        let frames = frames.collect();
        let shown = data.objects.iter().filter(|o| o.trajectory.is_some()).count().max(1);
        // Points shown per object, 22 characters each, and of all objects together.
        let budget = 3_000.min(24_000 / shown);
        let objects = || data.objects.iter().zip(names);
        let placed = objects().filter_map(|(o, n)| scene_object(data, view, o, n, &chosen, budget));
        let on_ground = objects().filter_map(|(o, n)| ground_track(data, view, o, n, &chosen));
        Self {
            scale: view.view_from_world.scale / Ruler::of(data.metric).factor,
            turn: Turn::of(data, view).rows(),
            ground: rounded(view.ground),
            radius: RADIUS,
            tangent: usual,
            frames,
            points: cloud(data.background.reconstruction, data.ground.map_or(&[], |g| &g.point_ids), MAX_POINTS, view),
            objects: placed.chain(on_ground).collect(),
        }
    }

    /// Omissions, in sentences.
    pub fn omissions(&self, num_frames: usize) -> Vec<String> {
        let mut notes = Vec::new();
        let Cloud { total, count, beyond, .. } = self.points;
        if count + beyond < total {
            notes.push(format!("{count} of {total} background points are shown, evenly selected."));
        }
        if beyond > 0 {
            notes.push(format!("{beyond} background points are too far outside the scene to be shown."));
        }
        let (shown, all): (usize, usize) = self.objects.iter().fold((0, 0), |(s, a), o| (s + o.count, a + o.total));
        if shown < all {
            notes.push(format!("{shown} of {all} vehicle points are shown, evenly selected."));
        }
        if self.frames.len() < num_frames {
            notes.push(format!("The time slider has {} of {num_frames} frames.", self.frames.len()));
        }
        notes
    }
}

/// Image plane of the first image.
fn tangent(background: &Reconstruction) -> [f64; 2] {
    background.images.values().next().map_or(USUAL_TANGENT, |image| tangent_of(background, image))
}

/// Default without a known camera: a field of view of 53° by 33°.
const USUAL_TANGENT: [f64; 2] = [0.5, 0.3];

fn tangent_of(background: &Reconstruction, image: &Image) -> [f64; 2] {
    background.cameras.get(&image.camera).map_or(USUAL_TANGENT, |c| {
        [rounded(0.5 * f64::from(c.width) / c.focal[0]), rounded(0.5 * f64::from(c.height) / c.focal[1])]
    })
}

fn scene_frame(frame: &Frame, image: Option<&Image>, view: &View, timeline: &Timeline) -> SceneFrame {
    let camera = image.map(|image| view.camera(&image.cam_from_world)).filter(|c| c.iter().all(|v| v.is_finite()));
    let time = timeline.of(frame.id).unwrap_or_default();
    SceneFrame { frame: frame.id.0, time: rounded(time), camera, tangent: None }
}

/// The points of a reconstruction, at most `limit` of them; `ground` are ids of points on the ground, ascending.
pub(super) fn cloud(model: &Reconstruction, ground: &[Point3dId], limit: usize, view: &View) -> Cloud {
    let points = &model.points;
    let near = |p: &Point3d| {
        let distance = (view.view_from_world * p.position).coords.norm();
        distance <= view.reach
    };
    let inside: Vec<(Point3dId, &Point3d)> = points.iter().filter(|(_, p)| near(p)).map(|(id, p)| (*id, p)).collect();
    let beyond = points.len() - inside.len();
    let chosen = sample(&inside, limit);
    let mut positions = Vec::with_capacity(chosen.len() * 6);
    let mut colours = Vec::with_capacity(chosen.len() * 4);
    for (id, point) in &chosen {
        for v in (view.view_from_world * point.position).coords.iter() {
            let fraction = ((v / view.reach + 1.0) / 2.0).clamp(0.0, 1.0);
            positions.extend(((fraction * 65535.0).round() as u16).to_le_bytes());
        }
        colours.extend(point.rgb);
        colours.push(if ground.binary_search(id).is_ok() { 255 } else { 0 });
    }
    Cloud {
        total: points.len(),
        count: chosen.len(),
        beyond,
        reach: view.reach,
        positions: STANDARD.encode(positions),
        colours: STANDARD.encode(colours),
    }
}

/// At most `limit` points, chosen by a hash of their ids: evenly over the scene, and reproducibly.
fn sample<'a>(points: &[(Point3dId, &'a Point3d)], limit: usize) -> Vec<(Point3dId, &'a Point3d)> {
    let mut all = points.to_vec();
    if all.len() > limit {
        // SplitMix64's finalizer.
        let key = |id: Point3dId| {
            let z = id.0.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb)
        };
        all.sort_by_key(|(id, _)| (key(*id), *id));
        all.truncate(limit);
        all.sort_by_key(|(id, _)| *id);
    }
    all
}

fn scene_object(
    data: &Data,
    view: &View,
    object: &Object,
    name: &str,
    chosen: &[usize],
    budget: usize,
) -> Option<SceneObject> {
    let trajectory = object.trajectory?;
    let poses = trajectory.poses.iter().filter_map(|pose| {
        let index = stop(data, chosen, pose.frame)?;
        let s = view.view_from_world * pose.world_from_object;
        let (q, t) = (s.rotation, s.translation);
        let numbers = [s.scale, q.w, q.i, q.j, q.k, t.x, t.y, t.z];
        let position = view.point(Point3::from(pose.position));
        let usable = numbers.iter().chain(&position).all(|v| v.is_finite());
        usable.then(|| (index, position, numbers, motion::tooltip(data, pose.metric.as_ref())))
    });
    let all: Vec<_> = object
        .model
        .iter()
        .flat_map(|m| &m.reconstruction.points)
        .filter(|(_, p)| is_finite(&p.position))
        .map(|(id, p)| (*id, p))
        .collect();
    let points = sample(&all, budget);
    let floats = points
        .iter()
        .flat_map(|(_, p)| p.position.coords.iter().flat_map(|&v| (v as f32).to_le_bytes()).collect::<Vec<_>>());
    Some(SceneObject {
        id: object.id.0,
        name: name.to_owned(),
        colour: css_colour(object_colour(object.id)),
        degenerate: trajectory.is_ruled_out(),
        ground: false,
        size: None,
        total: all.len(),
        count: points.len(),
        positions: STANDARD.encode(floats.collect::<Vec<_>>()),
        colours: STANDARD.encode(points.iter().flat_map(|(_, p)| p.rgb).collect::<Vec<_>>()),
        poses: poses.collect(),
    })
}

/// Index of a frame among the stops of the time slider.
fn stop(data: &Data, chosen: &[usize], frame: FrameId) -> Option<usize> {
    let index = data.frames.binary_search_by_key(&frame, |f| f.id).ok()?;
    chosen.binary_search(&index).ok()
}

fn ground_track(data: &Data, view: &View, object: &Object, name: &str, chosen: &[usize]) -> Option<SceneObject> {
    let track = object.ground_track?;
    let (size, turns) = ground_box(data, view, track).unzip();
    let poses = track.positions.iter().enumerate().filter_map(|(k, at)| {
        let index = stop(data, chosen, at.frame)?;
        let [x, y, z] = view.point(Point3::from(at.position));
        let position = [x, y, z];
        let turn = turns.as_ref().map_or(UnitQuaternion::identity(), |turns: &Vec<_>| turns[k]);
        let placement = [1.0, turn.w, turn.i, turn.j, turn.k, x, y, z];
        let usable = position.iter().all(|v| v.is_finite());
        usable.then(|| (index, position, placement, motion::tooltip(data, at.metric.as_ref())))
    });
    Some(SceneObject {
        id: object.id.0,
        name: format!("{name}, ground track"),
        colour: css_colour(object_colour(object.id)),
        ground: true,
        poses: poses.collect(),
        size,
        ..SceneObject::default()
    })
}

/// Length, height and width of the box of a ground track, and its rotation at each position: by the track's axis, else
/// by the heading there, where it is known, else by that of an earlier or later position.
fn ground_box(data: &Data, view: &View, track: &GroundTrack) -> Option<([f64; 3], Vec<UnitQuaternion<f64>>)> {
    let (frame, size) = (data.metric.and_then(metres::frame)?, track.dimensions?);
    let in_view = |size: Estimate| size.value / frame.scale * view.view_from_world.scale;
    let heading = |at: &GroundPosition| at.metric.as_ref()?.motion.as_ref()?.heading_deg;
    let axis = track.axis_deg.map(|axis| axis.value);
    let mut current = axis.or_else(|| track.positions.iter().find_map(heading))?;
    let turn = |at: &GroundPosition| {
        current = axis.or_else(|| heading(at)).unwrap_or(current);
        let (sin, cos) = current.to_radians().sin_cos();
        let world_from_metric = frame.metric_from_world().rotation.inverse();
        let ahead = view.view_from_world.rotation * (world_from_metric * Vector3::new(sin, cos, 0.0));
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), f64::atan2(-ahead.z, ahead.x))
    };
    let turns = track.positions.iter().map(turn).collect();
    let height = size.height_m.map_or(0.0, in_view);
    Some(([in_view(size.length_m?), height, in_view(size.width_m?)].map(rounded), turns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use crate::report::view::MAX_REACH;

    fn scene(world: &testing::World, view: &View) -> Scene {
        let data = world.data();
        Scene::new(&data, view, &Timeline::new(&data), &world.names())
    }

    #[test]
    fn scene_is_upright_and_far_points_do_not_shrink_it() {
        let mut world = testing::world();
        let before = View::new(&world.data()).unwrap();
        let far_before = scene(&world, &before).points.beyond;
        for k in 0..40 {
            let far = world.background.points.values().next().unwrap().clone();
            let position = Point3::new(1e7, -3e6 * f64::from(k), 2e7);
            world.background.points.insert(Point3dId(1_000_000 + k as u64), Point3d { position, ..far });
        }
        let after = View::new(&world.data()).unwrap();
        assert_eq!(before.view_from_world, after.view_from_world);
        assert!(after.reach <= MAX_REACH * RADIUS);
        let scene = scene(&world, &after);
        assert_eq!(scene.points.beyond, far_before + 40);
        assert_eq!(scene.omissions(world.frames.len()).len(), 1);
        let up = after.view_from_world.rotation * testing::UP;
        assert!((up - Vector3::y()).norm() < 1e-9, "{up}");
        let forward: Vector3<f64> =
            world.background.images.values().map(|i| i.cam_from_world.rotation.inverse() * Vector3::z()).sum();
        assert!((after.view_from_world.rotation * forward).z < 0.0, "cameras look away from the viewer");
    }

    #[test]
    fn stationary_vehicle_is_a_box_along_its_axis() {
        let world = testing::World::with_vehicle_at_rest();
        let (data, track) = (world.data(), world.ground_track.as_ref().unwrap());
        let view = View::new(&data).unwrap();
        let ([length, height, width], turns) = ground_box(&data, &view, track).unwrap();
        assert!((length / width - 2.0).abs() < 0.01 && height == 0.0 && turns.len() == track.positions.len());
        // From the middle of the rear to that of the front.
        let corners = track.footprint(data.metric.unwrap().frame.as_ref().unwrap()).unwrap().map(|c| view.point(c));
        let ahead = Vector3::from(corners[0]) + Vector3::from(corners[1])
            - Vector3::from(corners[2])
            - Vector3::from(corners[3]);
        let shown = turns[0] * Vector3::x() * length;
        assert!((ahead / 2.0 - shown).norm() < 0.05 * length, "{ahead} {shown}");
        let unknown = GroundTrack { axis_deg: None, ..track.clone() };
        assert!(ground_box(&data, &view, &unknown).is_none());
    }

    #[test]
    fn nonfinite_values_are_skipped() {
        let mut world = testing::world();
        let view = View::new(&world.data()).unwrap();
        let far_before = cloud(&world.background, &[], MAX_POINTS, &view).beyond;
        let first = *world.background.points.keys().next().unwrap();
        world.background.points.get_mut(&first).unwrap().position.x = f64::NAN;
        world.trajectory.poses[3].position[1] = f64::INFINITY;
        let data = world.data();
        let scene = scene(&world, &View::new(&data).unwrap());
        assert_eq!(scene.points.beyond, far_before + 1);
        assert_eq!(scene.objects[0].poses.len(), world.trajectory.poses.len() - 1);
    }

    #[test]
    fn selections_keep_their_budget_and_repeat() {
        let point = testing::world().background.points.values().next().unwrap().clone();
        let points: Vec<_> = (0..1000).map(|k| (Point3dId(k), &point)).collect();
        let chosen = sample(&points, 100);
        assert_eq!(chosen.len(), 100);
        assert_eq!(chosen, sample(&points, 100));
        let low = chosen.iter().filter(|(id, _)| id.0 < 500).count();
        assert!((30..70).contains(&low), "{low} of 100 from the first half");
    }
}
