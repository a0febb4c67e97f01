//! Tests of scenes read back from their bytes.

use super::*;
use crate::export::testing::{models_of, results_of, with_metres};
use crate::synthetic::showcase::showcase;

/// The document and the buffer of a file.
fn read(path: &Path) -> (Value, Vec<u8>) {
    let bytes = std::fs::read(path).unwrap();
    let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], number(4), number(8)), (&b"glTF"[..], 2, bytes.len()));
    let length = number(12);
    let document = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    (document, bytes[28 + length..].to_vec())
}

fn floats(document: &Value, buffer: &[u8], accessor: &Value) -> Vec<f32> {
    let accessor = &document["accessors"][accessor.as_u64().unwrap() as usize];
    let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let [offset, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
    assert_eq!(offset % 4, 0);
    buffer[offset..offset + length].as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

#[test]
fn the_scene_holds_points_camera_and_moving_vehicles() {
    let found = showcase(12, 1);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    for results in [results_of(&found), with_metres(results_of(&found))] {
        write(&path, &results, &models_of(&found)).unwrap();
        let (document, buffer) = read(&path);
        assert_eq!(document["buffers"][0]["byteLength"], buffer.len());
        assert_eq!(document["asset"]["extras"]["unit"], results.unit());
        let names: Vec<_> = document["nodes"].as_array().unwrap().iter().map(|node| node["name"].clone()).collect();
        assert_eq!(names.len(), 7, "{names:?}");
        assert_eq!((&names[1], &names[3]), (&"camera".into(), &"car 1".into()));
        let animation = &document["animations"][0];
        // Position and rotation of the camera and of two vehicles, and the visibility of the latter.
        assert_eq!(animation["channels"].as_array().unwrap().len(), 8);
        let times = floats(&document, &buffer, &animation["samplers"][2]["input"]);
        let places = floats(&document, &buffer, &animation["samplers"][2]["output"]);
        let poses = &results.trajectories.objects[0].poses;
        assert_eq!((times.len(), places.len()), (poses.len(), 3 * poses.len()));
        assert!((f64::from(times[2]) - poses[2].time_s).abs() < 1e-6);
        // In meters y is the height.
        if let Some(frame) = results.metric_frame() {
            let origin = frame.metric_from_world() * nalgebra::Point3::from(poses[2].world_from_object.translation);
            assert!((f64::from(places[7]) - origin.z).abs() < 1e-4);
        }
    }
}

#[test]
fn missing_parts_are_omitted() {
    let mut results = results_of(&showcase(12, 1));
    results.trajectories.objects.clear();
    results.views.clear();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    write(&path, &results, &BTreeMap::new()).unwrap();
    let (document, _) = read(&path);
    assert!(document.get("animations").is_none() && document.get("cameras").is_none());
    assert_eq!(document["nodes"].as_array().unwrap().len(), 1);
}

#[test]
fn outliers_do_not_blow_up_the_scene() {
    let found = showcase(12, 1);
    let mut results = results_of(&found);
    let extent = |results: &_| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.glb");
        write(&path, results, &models_of(&found)).unwrap();
        let (document, _) = read(&path);
        let places = document["accessors"].as_array().unwrap().iter().flat_map(|accessor| accessor["max"].as_array());
        places.flatten().filter_map(Value::as_f64).fold(0.0, f64::max)
    };
    let before = extent(&results);
    if let Some(point) = results.background.points.values_mut().next() {
        point.position *= 1e5;
    }
    assert!(extent(&results) <= before);
}
