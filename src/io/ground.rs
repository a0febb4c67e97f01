//! `ground.json` of the output contract: the ground points and the local planes.
//!
//! ```json
//! {"version": 1, "source": "masks" | "model" | "geometric", "point_ids": [3, 17],
//!  "planes": [{"object": 1, "frame": 0, "normal": [0, 0, 1], "point": [1, 2, 3],
//!              "num_points": 50, "num_inliers": 48, "rms": 0.01, "basis": "points",
//!              "height_std": 0.004, "common_height_std": 0.002, "tilt_std": 0.003}]}
//! ```
//!
//! Point ids are those of `background/`; planes are in its frame, normals of unit length towards the camera's side.

use std::collections::BTreeMap;
use std::path::Path;

use schemars::{JsonSchema, Schema};
use serde::{Deserialize, Serialize};

use super::extent::{LARGEST, is_sensible};
use super::{IoError, atomic, json};
use crate::scene::{FrameId, Ground, GroundPlane, GroundSource, ObjectId, Point3dId};

/// Only version of the format.
const VERSION: u32 = 1;

/// Ground points and local planes of a run (docs/formats.md).
#[derive(Serialize, Deserialize, JsonSchema)]
struct Document {
    /// Version of this format.
    version: u32,
    /// Source of the ground labels.
    source: GroundSource,
    /// Ground points of `background/`.
    point_ids: Vec<Point3dId>,
    /// By object, then frame.
    planes: Vec<Plane>,
}

/// A local plane, in the frame and unit of `background/`.
#[derive(Serialize, Deserialize, JsonSchema)]
struct Plane {
    /// The object.
    object: ObjectId,
    /// The frame.
    frame: FrameId,
    #[serde(flatten)]
    plane: GroundPlane,
}

/// The JSON schema of the file.
pub fn schema() -> Schema {
    json::schema_of::<Document>()
}

/// Writes the ground of a run; planes are ordered by object, then frame.
///
/// # Errors
/// A system error, or a plane with a number that is not finite.
pub fn write(path: &Path, ground: &Ground) -> Result<(), IoError> {
    let planes = ground.planes.iter().map(|(&(object, frame), &plane)| Plane { object, frame, plane }).collect();
    let document = Document { version: VERSION, source: ground.source, point_ids: ground.point_ids.clone(), planes };
    check(path, &document)?;
    atomic::write_json(path, &document)
}

/// Reads the ground of a run.
///
/// # Errors
/// A missing file, JSON of another structure or version, a normal that is not of unit length, or the same plane twice.
pub fn read(path: &Path) -> Result<Ground, IoError> {
    let document: Document = json::read(path)?;
    json::check_version(path, document.version, VERSION)?;
    check(path, &document)?;
    let num_planes = document.planes.len();
    let planes: BTreeMap<_, _> = document.planes.into_iter().map(|p| ((p.object, p.frame), p.plane)).collect();
    if planes.len() != num_planes {
        return Err(IoError::content(path, "an object has two planes in one frame"));
    }
    Ok(Ground { source: document.source, point_ids: document.point_ids, planes })
}

fn check(path: &Path, document: &Document) -> Result<(), IoError> {
    for Plane { object, frame, plane } in &document.planes {
        let deviations = [&plane.rms, &plane.height_std, &plane.common_height_std, &plane.tilt_std];
        let mut numbers = plane.normal.iter().chain(plane.point.iter()).chain(deviations);
        let length = plane.normal.norm();
        let problem = match numbers.find(|n| !is_sensible(n)) {
            Some(number) => format!("{number} is not a number of at most {LARGEST:e}"),
            None if deviations.iter().any(|n| **n < 0.0) => "negative standard deviation".to_owned(),
            None if (length - 1.0).abs() > 1e-6 => format!("normal of length {length}, expected 1"),
            None => continue,
        };
        return Err(IoError::content(path, format!("plane of object {object} in frame {}: {problem}", frame.0)));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::scene::PlaneBasis;

    fn sample() -> Ground {
        let plane = GroundPlane {
            normal: Vector3::new(0.6, 0.0, 0.8),
            point: Point3::new(1.0 / 3.0, 2.0, -1e-9),
            num_points: 50,
            num_inliers: 48,
            rms: 0.0125,
            basis: PlaneBasis::Mount,
            height_std: 0.02,
            common_height_std: 0.01,
            tilt_std: 0.004,
        };
        let planes = [((ObjectId(2), FrameId(0)), plane), ((ObjectId(1), FrameId(7)), plane)].into();
        Ground { source: GroundSource::Geometric, point_ids: vec![Point3dId(3), Point3dId(17)], planes }
    }

    #[test]
    fn ground_round_trips() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ground.json");
        write(&path, &sample()).unwrap();
        assert_eq!(read(&path).unwrap(), sample());
        let value: serde_json::Value = json::read(&path).unwrap();
        assert_eq!(value["source"], "geometric");
        assert_eq!(value["planes"][0]["object"], 1);
        assert_eq!(value["planes"][0]["basis"], PlaneBasis::Mount.name());
    }

    #[test]
    fn invalid_planes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ground.json");
        let mut ground = sample();
        ground.planes.get_mut(&(ObjectId(1), FrameId(7))).unwrap().normal.x = 0.7;
        let error = write(&path, &ground).unwrap_err().to_string();
        assert!(error.contains("object 1 in frame 7"), "{error}");
        write(&path, &sample()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("\"object\": 2", "\"object\": 1").replace("\"frame\": 0", "\"frame\": 7"))
            .unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("two planes"));
    }
}
