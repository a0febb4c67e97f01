//! Top views as SVG: one small picture per trajectory, and the whole scene for print and for browsers without WebGL.

use serde::Serialize;

use super::data::{Data, Object};
use super::overlay::{css_colour, object_colour, spread};
use super::view::{View, quantile};
use nalgebra::Point3;

/// Points drawn in the plan of the whole scene.
const MAX_POINTS: usize = 2_500;
/// Vertices drawn of one path.
const MAX_VERTICES: usize = 300;

/// A top view: coordinates are view units × 10, x right, y down (towards the viewer).
#[derive(Clone, Debug, Serialize)]
pub(super) struct Plan {
    /// x, y, width, height.
    view_box: [f64; 4],
    /// Length of one view unit, for markers.
    pub scale: f64,
    points: String,
    camera: String,
    paths: Vec<PlanPath>,
    bar: ScaleBar,
}

#[derive(Clone, Debug, Serialize)]
struct PlanPath {
    id: u32,
    colour: String,
    degenerate: bool,
    path: String,
    start: [f64; 2],
    end: [f64; 2],
}

/// A bar of a round length.
#[derive(Clone, Debug, Serialize)]
struct ScaleBar {
    length: f64,
    label: String,
}

impl Plan {
    /// The whole scene.
    pub fn scene(data: &Data, view: &View, unit: &str) -> Self {
        let background = data.background.reconstruction;
        let camera: Vec<_> = background.images.values().map(|i| flat(view, i.cam_from_world.center())).collect();
        let paths: Vec<_> = data.objects.iter().filter_map(|o| path(o, view)).collect();
        let mut all: Vec<[f64; 2]> = camera.clone();
        for object in &data.objects {
            all.extend(positions(object, view));
        }
        // A trajectory of undetermined scale may lie anywhere; the plan keeps to the scene.
        all.retain(|p| p.iter().all(|v| v.abs() < 30.0 * 10.0));
        let near: Vec<_> = background.points.values().map(|p| flat(view, p.position)).collect();
        let view_box = frame(&all, 0.9, 0.45);
        let inside = |p: &&[f64; 2]| {
            p[0] > view_box[0]
                && p[1] > view_box[1]
                && p[0] < view_box[0] + view_box[2]
                && p[1] < view_box[1] + view_box[3]
        };
        let near: Vec<_> = near.iter().filter(inside).collect();
        let points =
            spread(near.len(), MAX_POINTS).into_iter().map(|i| format!("M{:.0} {:.0}h0", near[i][0], near[i][1]));
        Self {
            view_box,
            scale: 10.0,
            points: points.collect(),
            camera: polyline(&camera),
            paths,
            bar: scale_bar(view, view_box[2], unit),
        }
    }

    /// One object's path alone; `None` without a trajectory.
    pub fn object(object: &Object, view: &View, unit: &str) -> Option<Self> {
        let path = path(object, view)?;
        let view_box = frame(&positions(object, view), 0.25, 0.6);
        let bar = scale_bar(view, view_box[2], unit);
        Some(Self {
            view_box,
            scale: view_box[2] / 20.0,
            points: String::new(),
            camera: String::new(),
            paths: vec![path],
            bar,
        })
    }
}

fn flat(view: &View, world: Point3<f64>) -> [f64; 2] {
    let p = view.view_from_world * world;
    [p.x * 10.0, p.z * 10.0]
}

fn positions(object: &Object, view: &View) -> Vec<[f64; 2]> {
    let poses = object.trajectory.iter().flat_map(|t| &t.poses);
    poses.map(|p| flat(view, Point3::from(p.position))).filter(|p| p.iter().all(|v| v.is_finite())).collect()
}

fn path(object: &Object, view: &View) -> Option<PlanPath> {
    let positions = positions(object, view);
    let (start, end) = (*positions.first()?, *positions.last()?);
    Some(PlanPath {
        id: object.id.0,
        colour: css_colour(object_colour(object.id)),
        degenerate: object.trajectory.is_some_and(|t| t.scale.degenerate),
        path: polyline(&positions),
        start: start.map(|v| v.round()),
        end: end.map(|v| v.round()),
    })
}

fn polyline(points: &[[f64; 2]]) -> String {
    let chosen = spread(points.len(), MAX_VERTICES).into_iter().map(|i| points[i]);
    let usable = chosen.filter(|p| p.iter().all(|v| v.is_finite() && v.abs() < 1e6));
    usable.enumerate().map(|(i, [x, y])| format!("{}{x:.1} {y:.1}", if i == 0 { "M" } else { "L" })).collect()
}

/// A box round nearly all points, padded by a share of its longer side, at least `aspect` times as high as wide and
/// the other way round.
fn frame(points: &[[f64; 2]], padding: f64, aspect: f64) -> [f64; 4] {
    let range = |k: usize| {
        let mut values: Vec<_> = points.iter().map(|p| p[k]).filter(|v| v.is_finite()).collect();
        (quantile(&mut values, 0.01), quantile(&mut values, 0.99))
    };
    let ((x0, x1), (y0, y1)) = (range(0), range(1));
    let longer = (x1 - x0).max(y1 - y0).max(1e-3);
    let mut width = x1 - x0 + longer * padding;
    let mut height = y1 - y0 + longer * padding;
    height = height.max(width * aspect);
    width = width.max(height * aspect);
    let tenth = |v: f64| (v * 10.0).round() / 10.0;
    [(x0 + x1 - width) / 2.0, (y0 + y1 - height) / 2.0, width, height].map(tenth)
}

/// A bar of about a fifth of the width, 1, 2 or 5 times a power of ten long.
fn scale_bar(view: &View, width: f64, unit: &str) -> ScaleBar {
    let per_unit = view.view_from_world.scale * 10.0;
    let rough = width / 4.0 / per_unit;
    let power = 10f64.powf(rough.log10().floor());
    let length = [5.0, 2.0, 1.0].map(|m| m * power).into_iter().find(|l| *l <= rough).unwrap_or(power);
    let decimals = (-length.log10().floor()).clamp(0.0, 9.0) as usize;
    ScaleBar { length: length * per_unit, label: format!("{length:.decimals$} {unit}") }
}
