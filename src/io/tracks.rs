//! `tracks.json`: the tracked objects, the source of their detections, and their state of motion.

use std::path::Path;

use schemars::{JsonSchema, Schema};
use serde::{Deserialize, Serialize};

use super::{IoError, atomic, json};
use crate::scene::TrackedObject;

/// Only version of the format.
const VERSION: u32 = 1;

/// Tracked objects of a run (docs/formats.md).
#[derive(Serialize, Deserialize, JsonSchema)]
struct Document {
    /// Version of this format.
    version: u32,
    /// Ascending by id.
    objects: Vec<TrackedObject>,
}

/// The JSON schema of the file.
pub fn schema() -> Schema {
    json::schema_of::<Document>()
}

/// Writes the tracked objects of a run, ascending by id.
///
/// # Errors
/// A system error; or objects or frames out of order.
pub fn write(path: &Path, objects: &[TrackedObject]) -> Result<(), IoError> {
    check(path, objects)?;
    atomic::write_json(path, &Document { version: VERSION, objects: objects.to_vec() })
}

/// Reads the tracked objects of a run.
///
/// # Errors
/// A missing file, JSON of another shape or version, or objects or frames out of order.
pub fn read(path: &Path) -> Result<Vec<TrackedObject>, IoError> {
    let document: Document = json::read(path)?;
    json::check_version(path, document.version, VERSION)?;
    check(path, &document.objects)?;
    Ok(document.objects)
}

fn check(path: &Path, objects: &[TrackedObject]) -> Result<(), IoError> {
    if let Some(pair) = objects.windows(2).find(|pair| pair[0].id >= pair[1].id) {
        let [before, after] = [pair[0].id, pair[1].id];
        return Err(IoError::content(path, format!("object {after} after object {before}: ids must ascend")));
    }
    for object in objects {
        let wrong = |problem: String| Err(IoError::content(path, format!("object {}: {problem}", object.id)));
        if let Some(pair) = object.frames.windows(2).find(|pair| pair[0] >= pair[1]) {
            return wrong(format!("frame {} after frame {}: frames must ascend", pair[1].0, pair[0].0));
        }
        let shares = [Some(object.confidence), object.mask_quality];
        if let Some(share) = shares.into_iter().flatten().find(|share| !(0.0..=1.0).contains(share)) {
            return wrong(format!("{share}: not between 0 and 1"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{DetectionCounts, FrameId, Movement, MovementFinding, ObjectId, Outline};

    fn object(id: u32) -> TrackedObject {
        TrackedObject {
            id: ObjectId(id),
            class: "car".into(),
            confidence: 0.5,
            found_in: DetectionCounts { detector: 2, carried: 1, ..DetectionCounts::default() },
            outline: Outline::Network,
            mask_quality: Some(0.9),
            movement: MovementFinding { state: Movement::Moving, reason: "12 of 14 points move".into() },
            left_out: None,
            frames: [3, 4, 7].map(FrameId).to_vec(),
            gaps: Vec::new(),
            apart: Vec::new(),
        }
    }

    #[test]
    fn tracked_objects_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tracks.json");
        let objects = [object(1), object(4)];
        write(&path, &objects).unwrap();
        assert_eq!(read(&path).unwrap(), objects);
    }

    #[test]
    fn invalid_tracks_are_neither_written_nor_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tracks.json");
        let unordered = TrackedObject { frames: [4, 3].map(FrameId).to_vec(), ..object(1) };
        let unsure = TrackedObject { confidence: f64::NAN, ..object(1) };
        for wrong in [vec![object(2), object(2)], vec![unordered], vec![unsure]] {
            assert!(write(&path, &wrong).is_err());
        }
        write(&path, &[object(1)]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to) in [("\"version\": 1", "\"version\": 2"), ("0.9", "1.9"), ("\"moving\"", "\"flying\"")] {
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            assert!(read(&path).is_err(), "{from}");
        }
    }
}
