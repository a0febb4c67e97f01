//! Top views as SVG: one thumbnail per trajectory, and the whole scene for print and for browsers without WebGL.

use serde::Serialize;

use super::data::{Data, Object};
use super::metres::{Ruler, frame as metric_frame};
use super::overlay::{css_colour, object_colour, spread};
use super::view::{View, quantile};
use crate::scene::{GroundTrack, MetricAxes, MetricFrame, ObjectId};
use nalgebra::{Point3, Vector3};

/// Units of a plan per unit of the view, where the plan shows the whole scene; `page.js` moves markers in them.
const SCENE_ZOOM: f64 = 10.0;
/// Longer side of a plan of one path, in its own units: coordinates have one decimal.
const PATH_SIDE: f64 = 1000.0;
/// Minimum longer side of a box; a stationary vehicle's path has no extent.
const LEAST_SIDE: f64 = 1e-4;
/// Length of an arrowhead, as a share of the plan's shorter side.
const ARROW: f64 = 0.05;

/// A top view: x right, y down (towards the viewer).
#[derive(Clone, Debug, Serialize)]
pub(super) struct Plan {
    /// x, y, width, height.
    view_box: [f64; 4],
    points: String,
    camera: String,
    paths: Vec<PlanPath>,
    bar: ScaleBar,
    /// North arrow, where north is known.
    north: Option<String>,
}

#[derive(Clone, Debug, Serialize)]
struct PlanPath {
    id: u32,
    colour: String,
    degenerate: bool,
    /// True of a ground track.
    ground: bool,
    path: String,
    start: [f64; 2],
    end: [f64; 2],
    /// Arrowhead at the end, in the direction of travel.
    arrow: String,
    /// Rectangle of a stationary vehicle; empty for others.
    footprint: String,
}

/// A bar of a round length.
#[derive(Clone, Debug, Serialize)]
struct ScaleBar {
    path: String,
    label: String,
}

/// The top view with the extent of a plan.
#[derive(Clone, Copy, Debug)]
struct Paper<'a> {
    view: &'a View,
    turn: Turn,
    ruler: Ruler,
    /// The metric frame, where known.
    frame: Option<&'a MetricFrame>,
    /// Position of the plan's origin, in the rotated view.
    origin: [f64; 2],
    zoom: f64,
}

/// Rotation of the plan against the view: the direction that points up the page, x and z of a unit vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Turn([f64; 2]);

impl Turn {
    /// The orientation of the view.
    const NONE: Self = Self([0.0, -1.0]);

    /// The metric frame's second axis, which is north where that is known, points up the page.
    pub fn of(data: &Data, view: &View) -> Self {
        let turn = data.metric.and_then(metric_frame).and_then(|frame| {
            let second = frame.metric_from_world().rotation.inverse() * Vector3::y();
            let seen = view.view_from_world.rotation * second;
            let length = seen.x.hypot(seen.z);
            (length > 1e-3).then(|| Self([seen.x / length, seen.z / length]))
        });
        turn.unwrap_or(Self::NONE)
    }

    /// Rows of the matrix that turns x and z of the view.
    pub fn rows(self) -> [[f64; 2]; 2] {
        let [x, z] = self.0;
        [[-z, x], [-x, -z]]
    }

    fn apply(self, [x, z]: [f64; 2]) -> [f64; 2] {
        self.rows().map(|[a, b]| a * x + b * z)
    }
}

impl Plan {
    /// The whole scene.
    ///
    /// * `padding` – room around all paths, as a share of their longer side.
    pub fn scene(data: &Data, view: &View, padding: f64) -> Self {
        let paper = Paper { zoom: SCENE_ZOOM, ..Paper::new(data, view) };
        let background = data.background.reconstruction;
        let camera: Vec<_> = background.images.values().map(|i| paper.place(i.cam_from_world.center())).collect();
        let mut all = camera.clone();
        all.extend(data.objects.iter().flat_map(|o| paper.positions(o)));
        let ground_tracks = || data.objects.iter().filter_map(|o| o.ground_track);
        all.extend(ground_tracks().flat_map(|track| paper.contacts(track)));
        // A trajectory of undetermined scale may be anywhere; the plan's extent follows the scene.
        all.retain(|p| p.iter().all(|v| v.abs() < 30.0 * SCENE_ZOOM));
        let view_box = frame(&all, &[], padding, 0.45);
        let arrow = ARROW * view_box[2].min(view_box[3]);
        let near = background.points.values().map(|p| paper.place(p.position)).filter(|p| holds(view_box, p));
        Self {
            view_box,
            points: dots(&near.collect::<Vec<_>>()),
            camera: polyline(&camera),
            paths: (data.objects.iter().filter_map(|o| paper.path(o, arrow)))
                .chain(ground_tracks().filter_map(|track| paper.ground_path(track, arrow)))
                .collect(),
            bar: paper.scale_bar(view_box),
            north: north(data, view_box),
        }
    }

    /// The plan of one object's path; `None` without a trajectory.
    pub fn object(data: &Data, object: &Object, view: &View) -> Option<Self> {
        let paper = Paper::new(data, view);
        let paper = paper.around(&paper.positions(object));
        Some(paper.alone(data, paper.path(object, ARROW * PATH_SIDE)?, &paper.positions(object)))
    }

    /// The plan of one ground track; `None` without drawable positions.
    pub fn ground_track(data: &Data, track: &GroundTrack, view: &View) -> Option<Self> {
        let paper = Paper::new(data, view);
        let all = |paper: &Paper| [paper.contacts(track), paper.footprint(track).unwrap_or_default()].concat();
        let paper = paper.around(&all(&paper));
        Some(paper.alone(data, paper.ground_path(track, ARROW * PATH_SIDE)?, &all(&paper)))
    }
}

impl<'a> Paper<'a> {
    fn new(data: &Data<'a>, view: &'a View) -> Self {
        let frame = data.metric.and_then(metric_frame);
        Self { view, turn: Turn::of(data, view), ruler: Ruler::of(data.metric), frame, origin: [0.0; 2], zoom: 1.0 }
    }

    fn place(&self, world: Point3<f64>) -> [f64; 2] {
        let p = self.view.view_from_world * world;
        let [x, y] = self.turn.apply([p.x, p.z]);
        [(x - self.origin[0]) * self.zoom, (y - self.origin[1]) * self.zoom]
    }

    /// The same view, moved and enlarged to contain some positions.
    fn around(&self, positions: &[[f64; 2]]) -> Self {
        let [x, y, width, height] = frame(positions, &[], 0.0, 0.0);
        let origin = [x + width / 2.0, y + height / 2.0];
        Self { origin, zoom: PATH_SIDE / width.max(height).max(LEAST_SIDE), ..*self }
    }

    /// The plan of one path.
    fn alone(&self, data: &Data, path: PlanPath, positions: &[[f64; 2]]) -> Plan {
        let view_box = frame(positions, &[path.start, path.end], 0.25, 0.6);
        let bar = self.scale_bar(view_box);
        let north = north(data, view_box);
        Plan { view_box, points: String::new(), camera: String::new(), paths: vec![path], bar, north }
    }

    fn contacts(&self, track: &GroundTrack) -> Vec<[f64; 2]> {
        track.positions.iter().map(|at| self.place(Point3::from(at.position))).filter(drawable).collect()
    }

    fn ground_path(&self, track: &GroundTrack, arrow: f64) -> Option<PlanPath> {
        let footprint = self.footprint(track).map(|corners| polyline(&corners) + "Z").unwrap_or_default();
        Some(PlanPath { ground: true, footprint, ..Self::line(track.id, &self.contacts(track), arrow)? })
    }

    /// Corners of a stationary vehicle, around the median of its positions.
    fn footprint(&self, track: &GroundTrack) -> Option<Vec<[f64; 2]>> {
        let corners = track.footprint(self.frame?)?.map(|corner| self.place(corner));
        corners.iter().all(drawable).then(|| corners.to_vec())
    }

    fn positions(&self, object: &Object) -> Vec<[f64; 2]> {
        let poses = object.trajectory.iter().flat_map(|t| &t.poses);
        poses.map(|p| self.place(Point3::from(p.position))).filter(drawable).collect()
    }

    fn path(&self, object: &Object, arrow: f64) -> Option<PlanPath> {
        let degenerate = object.trajectory.is_some_and(|trajectory| trajectory.is_ruled_out());
        Some(PlanPath { degenerate, ..Self::line(object.id, &self.positions(object), arrow)? })
    }

    /// A path that is neither degenerate nor on the ground.
    fn line(id: ObjectId, positions: &[[f64; 2]], arrow: f64) -> Option<PlanPath> {
        let (start, end) = (*positions.first()?, *positions.last()?);
        Some(PlanPath {
            id: id.0,
            colour: css_colour(object_colour(id)),
            degenerate: false,
            ground: false,
            path: polyline(positions),
            start: start.map(tenth),
            end: end.map(tenth),
            arrow: arrow_head(positions, arrow),
            footprint: String::new(),
        })
    }

    /// A bar of about a quarter of the width, 1, 2 or 5 times a power of ten long, in the lower left corner.
    fn scale_bar(&self, [x, y, width, height]: [f64; 4]) -> ScaleBar {
        let per_unit = self.view.view_from_world.scale * self.zoom / self.ruler.factor;
        let rough = width / 4.0 / per_unit;
        let power = 10f64.powf(rough.log10().floor());
        let length = [5.0, 2.0, 1.0].map(|m| m * power).into_iter().find(|l| *l <= rough).unwrap_or(power);
        let (left, bottom, tick) = (x + 0.02 * width, y + 0.98 * height, 0.025 * height);
        let (right, top) = (left + length * per_unit, bottom - tick);
        let path = format!("M{left:.1} {top:.1}V{bottom:.1}H{right:.1}V{top:.1}");
        ScaleBar { path, label: self.ruler.round_length(length) }
    }
}

/// Arrowhead at the end of a path: two strokes of a length, back along the last segment of that length; empty for a
/// shorter path.
fn arrow_head(positions: &[[f64; 2]], length: f64) -> String {
    let Some(&[x, y]) = positions.last() else { return String::new() };
    let from = positions.iter().rev().find(|[a, b]| (x - a).hypot(y - b) >= length);
    let Some([a, b]) = from else { return String::new() };
    let back = (b - y).atan2(a - x);
    // Half the angle between the strokes, radians.
    let stroke = |turn: f64| format!("{:.1} {:.1}", x + length * (back + turn).cos(), y + length * (back + turn).sin());
    format!("M{}L{x:.1} {y:.1}L{}", stroke(0.45), stroke(-0.45))
}

/// North arrow with an N below it, in the upper right corner; `None` where north is unknown.
fn north(data: &Data, [x, y, width, height]: [f64; 4]) -> Option<String> {
    data.metric.and_then(metric_frame).filter(|frame| frame.axes == MetricAxes::EastNorthUp)?;
    let size = 0.09 * width.min(height);
    let (right, top) = (x + 0.97 * width, y + 0.03 * height);
    let at = |dx: f64, dy: f64| format!("{:.1} {:.1}", right + dx * size, top + dy * size);
    let arrow = format!("M{}L{}M{}L{}L{}", at(-0.4, 1.2), at(-0.4, 0.0), at(-0.65, 0.4), at(-0.4, 0.0), at(-0.15, 0.4));
    let letter = format!("M{}L{}L{}L{}", at(-0.65, 2.1), at(-0.65, 1.5), at(-0.15, 2.1), at(-0.15, 1.5));
    Some(arrow + &letter)
}

/// Returns true if a position can be drawn.
fn drawable(place: &[f64; 2]) -> bool {
    place.iter().all(|v| v.is_finite() && v.abs() < 1e6)
}

fn holds([x, y, width, height]: [f64; 4], p: &[f64; 2]) -> bool {
    p[0] > x && p[1] > y && p[0] < x + width && p[1] < y + height
}

fn dots(places: &[[f64; 2]]) -> String {
    // Points drawn in the plan of the whole scene.
    let chosen = spread(places.len(), 2_500).into_iter().map(|i| places[i]);
    chosen.map(|[x, y]| format!("M{x:.0} {y:.0}h0")).collect()
}

fn polyline(points: &[[f64; 2]]) -> String {
    // Vertices drawn of one path.
    let chosen = spread(points.len(), 300).into_iter().map(|i| points[i]);
    let usable = chosen.filter(drawable);
    usable.enumerate().map(|(i, [x, y])| format!("{}{x:.1} {y:.1}", if i == 0 { "M" } else { "L" })).collect()
}

/// A box around nearly all points and all `ends`, padded by a share of its longer side. Neither side is shorter than
/// `aspect` times the other.
fn frame(points: &[[f64; 2]], ends: &[[f64; 2]], padding: f64, aspect: f64) -> [f64; 4] {
    let range = |k: usize| {
        let mut values: Vec<_> = points.iter().map(|p| p[k]).filter(|v| v.is_finite()).collect();
        let (low, high) = (quantile(&mut values, 0.01), quantile(&mut values, 0.99));
        ends.iter().fold((low, high), |(low, high), end| (low.min(end[k]), high.max(end[k])))
    };
    let ((x0, x1), (y0, y1)) = (range(0), range(1));
    let longer = (x1 - x0).max(y1 - y0).max(LEAST_SIDE);
    let mut width = x1 - x0 + longer * padding;
    let mut height = y1 - y0 + longer * padding;
    height = height.max(width * aspect);
    width = width.max(height * aspect);
    [(x0 + x1 - width) / 2.0, (y0 + y1 - height) / 2.0, width, height]
}

fn tenth(v: f64) -> f64 {
    (v * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn a_small_path_is_drawn_as_finely_as_a_large_one() {
        let mut world = testing::world();
        let view = View::new(&world.data()).unwrap();
        let first = world.trajectory.poses[0].position;
        for pose in &mut world.trajectory.poses {
            pose.position = std::array::from_fn(|k| first[k] + 1e-3 * (pose.position[k] - first[k]));
        }
        let plan = Plan::object(&world.data(), &world.data().objects[0], &view).unwrap();
        let numbers: Vec<f64> = plan.paths[0].path.split(['M', 'L', ' ']).filter_map(|n| n.parse().ok()).collect();
        let places: Vec<&[f64]> = numbers.chunks(2).collect();
        assert_eq!(*places[0], plan.paths[0].start, "the dot lies where the line begins");
        assert_eq!(*places[places.len() - 1], plan.paths[0].end, "and where it ends");
        assert!(places.windows(2).all(|w| w[0] != w[1]), "no two places fall together");
        assert!(plan.view_box[2] > PATH_SIDE && plan.view_box[2] < 3.0 * PATH_SIDE, "{:?}", plan.view_box);
    }

    #[test]
    fn stationary_vehicle_is_a_rectangle_of_its_size() {
        let world = testing::World::with_vehicle_at_rest();
        let data = world.data();
        let view = View::new(&data).unwrap();
        let track = world.ground_track.as_ref().unwrap();
        let corners = Paper::new(&data, &view).footprint(track).unwrap();
        let side = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let [wide, long] = [side(corners[0], corners[1]), side(corners[1], corners[2])];
        assert!((long / wide - 2.0).abs() < 0.05, "{corners:?}");
        let plan = Plan::ground_track(&data, track, &view).unwrap();
        assert!(plan.paths[0].footprint.ends_with('Z') && plan.view_box[2] < 3.0 * PATH_SIDE, "{plan:?}");
        let unknown = GroundTrack { axis_deg: None, ..track.clone() };
        assert_eq!(Plan::ground_track(&data, &unknown, &view).unwrap().paths[0].footprint, "");
    }

    #[test]
    fn an_arrow_points_along_the_end_of_a_path() {
        let positions = [[0.0, 0.0], [50.0, 0.0], [100.0, 0.0]];
        assert_eq!(arrow_head(&positions, 10.0), "M91.0 -4.3L100.0 0.0L91.0 4.3");
        assert_eq!(arrow_head(&positions, 200.0), "");
        assert_eq!(arrow_head(&[], 1.0), "");
    }

    #[test]
    fn stationary_vehicle_has_a_plan() {
        let mut world = testing::world();
        let view = View::new(&world.data()).unwrap();
        let first = world.trajectory.poses[0].position;
        world.trajectory.poses.iter_mut().for_each(|pose| pose.position = first);
        let plan = Plan::object(&world.data(), &world.data().objects[0], &view).unwrap();
        assert!(plan.view_box.iter().all(|v| v.is_finite()) && plan.view_box[2] > 0.0, "{:?}", plan.view_box);
        world.trajectory.poses.clear();
        assert!(Plan::object(&world.data(), &world.data().objects[0], &view).is_none());
    }
}
