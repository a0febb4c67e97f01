//! All reconstructions in the view of the reference, packed for `compare.js`.

use serde::Serialize;

use super::{Data, colour};
use crate::math::Sim3;
use crate::report::scene::{self, Cloud, cloud};
use crate::report::view::{RADIUS, View, rounded};
use crate::scene::{Image, Reconstruction};

/// Input of `compare.js`.
#[derive(Debug, Serialize)]
pub(super) struct Scene {
    scale: f64,
    ground: f64,
    radius: f64,
    sides: Vec<SceneSide>,
}

#[derive(Debug, Serialize)]
struct SceneSide {
    name: String,
    colour: &'static str,
    points: Cloud,
    cameras: Vec<SceneCamera>,
    num_cameras: usize,
}

/// A camera: its center, `view_from_cam` as w x y z, and half width and height of its image plane at distance 1.
#[derive(Debug, Serialize)]
struct SceneCamera {
    name: String,
    pose: [f64; 7],
    tangent: [f64; 2],
    lost: bool,
}

impl Scene {
    /// `None` if the reference has no camera.
    pub fn new(data: &Data) -> Option<Self> {
        let view = View::of_model(data.models[0])?;
        let comparison = data.comparison;
        let limit = scene::MAX_POINTS / data.models.len();
        let reference = side(&comparison.reference.name, 0, data.models[0], &[], limit, &view);
        let others = comparison.others.iter().zip(&data.models[1..]).enumerate().filter_map(|(k, (other, model))| {
            let alignment = other.alignment.as_ref().ok()?;
            let moved = in_frame(model, &alignment.reference_from_other);
            Some(side(&other.subject.name, k + 1, &moved, &alignment.lost, limit, &view))
        });
        Some(Self {
            scale: view.view_from_world.scale,
            ground: rounded(view.ground),
            radius: RADIUS,
            sides: std::iter::once(reference).chain(others).collect(),
        })
    }

    /// Omissions, in sentences.
    pub fn omissions(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for side in &self.sides {
            let Cloud { total, count, beyond, .. } = side.points;
            if count < total {
                let name = &side.name;
                notes.push(format!("{name}: {count} of {total} points are shown; {beyond} are too far outside."));
            }
            if side.cameras.len() < side.num_cameras {
                notes.push(format!("{}: {} of {} cameras are shown.", side.name, side.cameras.len(), side.num_cameras));
            }
        }
        notes
    }
}

fn in_frame(model: &Reconstruction, target_from_world: &Sim3) -> Reconstruction {
    let mut moved = model.clone();
    moved.transform(target_from_world);
    moved
}

fn side(name: &str, k: usize, model: &Reconstruction, lost: &[String], limit: usize, view: &View) -> SceneSide {
    let step = model.images.len().div_ceil(scene::MAX_FRAMES).max(1);
    let mut images: Vec<&Image> = model.images.values().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    SceneSide {
        name: name.to_owned(),
        colour: colour(k),
        points: cloud(model, &[], limit, view),
        cameras: images.iter().step_by(step).filter_map(|image| camera(model, image, lost, view)).collect(),
        num_cameras: model.images.len(),
    }
}

/// `None` where a value is not finite.
fn camera(model: &Reconstruction, image: &Image, lost: &[String], view: &View) -> Option<SceneCamera> {
    let pose = view.camera(&image.cam_from_world);
    let tangent = model.cameras.get(&image.camera).map_or([0.5, 0.3], |camera| {
        [camera.width, camera.height].map(|side| rounded(0.5 * f64::from(side) / camera.mean_focal()))
    });
    let is_usable = pose.iter().chain(&tangent).all(|v| v.is_finite());
    is_usable.then(|| SceneCamera { name: image.name.clone(), pose, tangent, lost: lost.contains(&image.name) })
}
