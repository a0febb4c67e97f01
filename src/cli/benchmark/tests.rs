use std::fs;

use super::sequences::{SequenceFolders, find, names};

fn data_set(folders: &[(&str, bool)]) -> tempfile::TempDir {
    let place = tempfile::tempdir().unwrap();
    for (name, has_scene) in folders {
        fs::create_dir(place.path().join(name)).unwrap();
        if *has_scene {
            fs::write(place.path().join(name).join("scene.json"), b"{}").unwrap();
        }
    }
    place
}

#[test]
fn sequences_are_the_folders_with_a_scene() {
    let place = data_set(&[("b_van", true), ("a_van", true), ("textures", false), (".cache", false), ("out", false)]);
    fs::write(place.path().join("notes.txt"), b"").unwrap();
    let list = |only: &[&str]| {
        let only: Vec<String> = only.iter().map(|text| (*text).to_owned()).collect();
        let found = find(place.path(), &only, &place.path().join("out"))?;
        let SequenceFolders { sequences, left_out } = found;
        let names = sequences.iter().map(|path| path.file_name().unwrap().to_str().unwrap().to_owned());
        Ok::<_, super::Failure>((names.collect::<Vec<_>>(), left_out))
    };
    assert_eq!(list(&[]).unwrap(), (vec!["a_van".to_owned(), "b_van".to_owned()], vec!["textures".to_owned()]));
    assert_eq!(list(&["b_"]).unwrap().0, ["b_van"]);
    assert!(list(&["suv"]).unwrap_err().to_string().contains("no sequence name contains suv"));
}

#[test]
fn a_folder_without_sequences_is_refused_with_a_cure() {
    let said = |folder: &std::path::Path| find(folder, &[], folder).err().unwrap().to_string();
    let place = data_set(&[("textures", false), ("a_van", true)]);
    assert!(said(&place.path().join("textures")).contains("render sequences first"));
    assert!(said(&place.path().join("a_van")).contains("give the folder that contains it"));
    assert!(said(&place.path().join("none")).contains("cannot be read"));
}

#[test]
fn names_are_those_of_the_scene_or_of_the_folder() {
    let sequence = |vehicle: Option<&str>, trajectory: Option<&str>| crate::io::Sequence {
        folder: "f".into(),
        name: "n".into(),
        vehicle: vehicle.map(Into::into),
        trajectory: trajectory.map(Into::into),
        fps: 10.0,
        camera: crate::camera::Camera::with_focal(4, 3, 8.0),
        frames: vec![],
    };
    let of = |folder: &str, vehicle, trajectory| names(folder, Some(&sequence(vehicle, trajectory)));
    let pair = |vehicle: &str, trajectory: &str| (vehicle.to_owned(), trajectory.to_owned());
    assert_eq!(of("x", Some("van"), Some("bridge")), pair("van", "bridge"));
    assert_eq!(of("right_curve", Some("hatchback"), None), pair("hatchback", "right_curve"));
    assert_eq!(of("steep_street_van", Some("van"), None), pair("van", "steep_street"));
    assert_eq!(of("steep_street_van", None, Some("steep_street")), pair("van", "steep_street"));
    assert_eq!(names("bumpy_road_smart", None), pair("smart", "bumpy_road"));
    assert_eq!(names("broken", None), pair("broken", "broken"));
}
