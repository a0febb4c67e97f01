//! Stage `follow`: tracks of image points on every object, inside its masks.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::features::tracks_of;
use super::{background, track};
use crate::features::{FrontEnd, TrackTable};
use crate::image::Picture;
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::{cameras, images, order};
use crate::pipeline::{Result, Stage};
use crate::scene::ObjectId;

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let camera = cameras::first(run)?.camera;
    let (_, objects) = order::sfm_options(run)?;
    Ok(json!({
        "camera": camera,
        "objects": objects.front_end,
        "given_objects": run.options.object_models.keys().collect::<Vec<_>>(),
        "only_objects": run.options.only_objects,
        "seed": run.options.seed,
    }))
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let objects = run.workspace.read_tracked()?;
    track::check_ids(run, &objects, outcome)?;
    let camera = cameras::first(run)?.camera;
    let (_, sfm_options) = order::sfm_options(run)?;
    let options = run.options;
    // Models are reconstructed only where the camera translates.
    let with_model = objects.iter().filter(|object| object.left_out.is_none() && !background::hovers(run));
    let wanted = with_model.map(|object| object.id);
    let wanted = wanted.filter(|id| options.wants(*id) && !options.object_models.contains_key(id));
    let mut front_ends: BTreeMap<ObjectId, FrontEnd> =
        wanted.map(|id| (id, FrontEnd::new(&sfm_options.front_end, camera))).collect();

    let frames = run.frames()?;
    let followed = || objects.iter().filter(|object| front_ends.contains_key(&object.id));
    let visible = frames.iter().filter(|frame| followed().any(|object| object.is_visible_in(frame.id)));
    let visible = visible.map(|frame| frame.id).collect();
    images::for_each(run, Stage::Follow, visible, outcome, |frame, picture| {
        let picture = Picture::new(&picture);
        for (id, mask) in track::masks_of(run, &objects, &frame)? {
            if let Some(front_end) = front_ends.get_mut(&id) {
                front_end.push(&frame, &picture, &mask)?;
            }
        }
        Ok(())
    })?;

    let folder = run.workspace.intermediate(Stage::Follow, &outcome.fingerprint)?;
    for (id, front_end) in front_ends {
        intermediate::write(&tracks_of(&folder, &id.to_string()), &front_end.finish(options.seed)?)?;
    }
    outcome.outputs.push(folder);
    Ok(())
}

/// The tracks of one object; the stage must be done.
pub(in crate::pipeline) fn of_object(run: &Run, id: ObjectId) -> Result<TrackTable> {
    intermediate::read(&tracks_of(&run.folder(Stage::Follow), &id.to_string()))
}
