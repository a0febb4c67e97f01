//! Stage `features`: tracks of image points, on the background and on every object, in one pass through the frames.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::masking::Masking;
use super::run::{Outcome, Run};
use super::{PipelineError, Stage, models, order, pictures, track};
use crate::io::{IoError, atomic};
use crate::scene::ObjectId;
use crate::sfm::{FrontEnd, TrackTable};

pub(super) fn depends_on(run: &Run) -> Result<Value, PipelineError> {
    let (camera, _) = models::initial_camera(run)?;
    let (background, objects) = order::sfm_options(run)?;
    Ok(json!({
        "camera": camera,
        "masking": run.options.masking,
        "background": background.front_end,
        "objects": objects.front_end,
        "given_background": run.options.background_model.is_some(),
        "given_objects": run.options.object_models.keys().collect::<Vec<_>>(),
        "only_objects": run.options.only_objects,
        "seed": run.options.seed,
    }))
}

pub(super) fn work(run: &Run, fingerprint: &str) -> Result<Outcome, PipelineError> {
    let mut outcome = Outcome::default();
    let objects = track::objects(run)?;
    track::check_ids(run, &objects, &mut outcome)?;
    let (camera, _) = models::initial_camera(run)?;
    let (background_options, object_options) = order::sfm_options(run)?;
    let masking = Masking::new(run, &objects);
    let mut background =
        run.options.background_model.is_none().then(|| FrontEnd::new(&background_options.front_end, camera));
    let options = run.options;
    let wanted = objects.iter().map(|object| object.id);
    let wanted = wanted.filter(|id| options.wants(*id) && !options.object_models.contains_key(id));
    let mut on_objects: BTreeMap<ObjectId, FrontEnd> =
        wanted.map(|id| (id, FrontEnd::new(&object_options.front_end, camera))).collect();

    run.progress.begin("features", Some(run.frames()?.len() as u64));
    pictures::for_each(run, run.source.frames()?, &mut outcome, |frame, picture| {
        let masks = masking.of(&frame)?;
        if let Some(background) = &mut background {
            background.push(&frame, &picture, &masks.background)?;
        }
        for (id, mask) in &masks.objects {
            if let Some(object) = on_objects.get_mut(id) {
                object.push(&frame, &picture, mask)?;
            }
        }
        Ok(())
    })?;

    let folder = run.workspace.keep_only("features-", &folder_name(fingerprint))?;
    if let Some(background) = background {
        let table = background.finish(run.options.seed)?;
        outcome.figure("background_tracks", table.tracks.len());
        write(&folder.join("background.bin"), &table)?;
    }
    for (id, front_end) in on_objects {
        write(&folder.join(format!("{id}.bin")), &front_end.finish(run.options.seed)?)?;
    }
    outcome.outputs.push(folder);
    Ok(outcome)
}

fn folder_name(fingerprint: &str) -> String {
    format!("features-{}", fingerprint.get(..16).unwrap_or_default())
}

/// Piece by piece: the tracks of a long video are not to lie in memory twice.
fn write(path: &Path, table: &TrackTable) -> Result<(), PipelineError> {
    let written = atomic::write_with(path, |out| {
        let mut out = KeepsError { out, error: None };
        let done = postcard::to_io(table, &mut out);
        let failed = done.err().map(std::io::Error::other);
        out.error.or(failed).map_or(Ok(()), Err)
    });
    Ok(written?)
}

/// Keeps what went wrong, of which [`postcard`] says only that something did.
struct KeepsError<'a> {
    out: &'a mut dyn Write,
    error: Option<std::io::Error>,
}

impl Write for KeepsError<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.out.write(bytes)
    }

    fn write_all(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.out.write_all(bytes).map_err(|e| {
            let kind = e.kind();
            self.error = Some(e);
            kind.into()
        })
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}

/// The tracks of the background.
pub(super) fn of_background(run: &Run) -> Result<TrackTable, PipelineError> {
    read(run, "background")
}

/// The tracks of one object.
pub(super) fn of_object(run: &Run, id: ObjectId) -> Result<TrackTable, PipelineError> {
    read(run, &id.to_string())
}

fn read(run: &Run, target: &str) -> Result<TrackTable, PipelineError> {
    let folder = run.workspace.state(&folder_name(run.fingerprint(Stage::Features)));
    let path = folder.join(format!("{target}.bin"));
    let bytes = std::fs::read(&path).map_err(IoError::system("read", &path))?;
    postcard::from_bytes(&bytes).map_err(|e| damaged(path, e))
}

fn damaged(path: PathBuf, reason: postcard::Error) -> PipelineError {
    PipelineError::State { path, reason: reason.to_string() }
}
