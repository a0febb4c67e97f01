//! An animated scene: glTF 2.0 in one binary file (`.glb`), which Blender and browsers open.
//!
//! glTF uses y up and meters; the scene has meters where they are known, else units of the background, as stated in
//! `asset.extras.unit`. With a map x points east and −z north. The background's points are static; one animation moves
//! the nodes of the camera and each vehicle. A vehicle is visible from its first frame to its last: outside, its scale
//! is 0, glTF's convention for hidden nodes. Its node holds the points of its model and their bounding box.
//!
//! The two crates for glTF are readers; a writer needs only a few tables of JSON over one buffer.

mod buffer;
mod scene;
mod vehicle;

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};

use super::results::there;
use super::{ExportError, Results};
use crate::io::{IoError, RunFolder, atomic};
use crate::scene::{ObjectId, ObjectTrajectory, Reconstruction};
use scene::Scene;

/// The models of the vehicles that have a trajectory.
///
/// # Errors
/// A damaged model. A missing one leaves a vehicle without points.
pub(super) fn models(folder: &RunFolder, results: &Results) -> Result<BTreeMap<ObjectId, Reconstruction>, ExportError> {
    let model = |object: &ObjectTrajectory| {
        there(folder.read_object(object.id)).map(|found| found.map(|model| (object.id, model))).transpose()
    };
    Ok(results.trajectories.objects.iter().filter_map(model).collect::<Result<_, _>>()?)
}

/// Writes the scene.
pub(super) fn write(
    path: &Path,
    results: &Results,
    models: &BTreeMap<ObjectId, Reconstruction>,
) -> Result<(), ExportError> {
    let (document, buffer) = Scene::of(results, models).finish();
    let bytes = container(path, &document, &buffer)?;
    Ok(atomic::write_with(path, |out| out.write_all(&bytes))?)
}

/// Head, JSON and buffer, each padded to four bytes.
fn container(path: &Path, document: &Value, buffer: &[u8]) -> Result<Vec<u8>, ExportError> {
    let mut text = serde_json::to_vec(document).map_err(|error| IoError::content(path, error.to_string()))?;
    text.resize(text.len().next_multiple_of(4), b' ');
    // Twelve bytes in front of the file, eight in front of each of its two parts.
    let total = 12 + 2 * 8 + text.len() + buffer.len();
    let too_large = || ExportError::TooLarge {
        path: path.to_owned(),
        problem: format!("scene of {total} bytes, a .glb file holds at most 4 GiB"),
    };
    let length = |bytes: usize| u32::try_from(bytes).map_err(|_| too_large());
    let mut bytes = b"glTF".to_vec();
    // The version of the container.
    for number in [2, length(total)?] {
        bytes.extend(number.to_le_bytes());
    }
    for (kind, chunk) in [(b"JSON", text.as_slice()), (b"BIN\0", buffer)] {
        bytes.extend(length(chunk.len())?.to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    Ok(bytes)
}

/// Metadata of the file.
fn asset(results: &Results) -> Value {
    json!({
        "version": "2.0",
        "generator": format!("tractrix {}", crate::VERSION),
        "extras": { "unit": results.unit(), "input": results.title },
    })
}

#[cfg(test)]
mod tests;
