//! Ground-constrained poses of the views of objects.
//!
//! A deterministic initialization of structure from motion: the object is on the ground and heads in its direction of
//! motion ([`ground_constrained_poses`]). The planes are those that are found without labels, before the object has a
//! model: rough poses need no better ones, and the stage `ground` finds those.

use std::cell::OnceCell;

use nalgebra::Point2;

use super::super::ground::GroundResults;
use super::object_boxes::object_boxes;
use crate::features::tracks::{TrackTable, View};
use crate::ground::{GroundChain, dominant_plane_points, find_mount};
use crate::mapper::PosePriors;
use crate::math::{Rigid3, median};
use crate::pipeline::Options;
use crate::pipeline::driver::run::Run;
use crate::scene::{Image, ObjectId, Observation, Point3dId, Reconstruction, Rect};
use crate::trajectory::ground_constrained_poses;

/// Error of an initial position, as a share of the object's extent: 0.05 and 0.1 gave models as good.
const POSITION_ERROR: f64 = 0.25;

/// The ground of a scene, as far as it can be determined without labels.
pub(super) struct ObjectGround<'a> {
    run: &'a Run<'a>,
    background: &'a Reconstruction,
    /// Computed for the first object that needs it.
    found: OnceCell<GroundResults>,
}

impl<'a> ObjectGround<'a> {
    pub(super) fn new(run: &'a Run<'a>, background: &'a Reconstruction) -> Self {
        Self { run, background, found: OnceCell::new() }
    }

    /// Poses of the views of an object; `None` if there is no ground.
    pub(super) fn poses(&self, id: ObjectId, table: &TrackTable) -> Option<PosePriors> {
        let (options, seed) = (&self.run.options.ground, self.run.options.seed);
        let found = self.found.get_or_init(|| GroundResults {
            dominant: dominant_plane_points(self.background, options, seed).ok(),
            mount: find_mount(self.background, None, options, seed).ok(),
            ..GroundResults::default()
        });
        object_pose_priors(&found.chain(self.background, self.run.options), id, table, self.run.options)
    }
}

/// Poses of the views of an object on the ground; `None` if there is none.
pub fn object_pose_priors(
    chain: &GroundChain,
    id: ObjectId,
    table: &TrackTable,
    options: &Options,
) -> Option<PosePriors> {
    let boxes = object_boxes(table);
    let extent_px = median(boxes.values().map(Rect::extent_px).collect())?;
    let planes = chain.planes(id, &without_poses(table), &options.ground, options.seed).planes;
    let found = ground_constrained_poses(chain.background, &planes, &boxes);
    let poses = table.views.iter().map(|view| found.get(&view.image.frame()).copied()).collect();
    (!found.is_empty()).then_some(PosePriors { poses, error_px: POSITION_ERROR * extent_px })
}

/// The views of an object as a model without points: local planes need nothing else.
fn without_poses(table: &TrackTable) -> Reconstruction {
    let seen = |pixel: &Point2<f64>| Observation { pixel: *pixel, point: Some(Point3dId(1)) };
    let image = |view: &View| Image {
        name: view.name.clone(),
        camera: crate::scene::CameraId(1),
        cam_from_world: Rigid3::identity(),
        observations: view.pixels.iter().map(seen).collect(),
    };
    let images = table.views.iter().map(|view| (view.image, image(view))).collect();
    Reconstruction { images, ..Reconstruction::default() }
}
