//! The readers of files, what they read, and how that is damaged: for the loop of `examples/damage_files.rs`, the
//! default test `tests/damaged.rs`, and the fuzz targets of `tests/fuzz`, which all take it from here.

#![allow(dead_code)] // Each of them uses its own share of this.

use std::fs;
use std::path::{Path, PathBuf};

use rand::Rng as _;
use tractrix::io::interchange::model::{self, Format};
use tractrix::io::interchange::{bal, colmap, ply};
use tractrix::io::{Sequence, ground, masks, tracks, trajectories};
use tractrix::math::Rng;
use tractrix::scene::{LabelMap, TriangleMesh};

#[path = "logs.rs"]
mod logs;

pub type Failed = Box<dyn std::error::Error>;

/// All readers, by name; those of logs where the room `telemetry` is compiled.
pub fn readers() -> Vec<&'static str> {
    let logs: &[&str] = if cfg!(feature = "telemetry") { &LOGS } else { &[] };
    [&READERS[..], logs].concat()
}

/// Where a camera was: subtitles, tracks, sentences, tables, the EXIF blocks of photographs, and
/// GoPro's telemetry.
const LOGS: [&str; 6] = ["subtitles", "gpx", "nmea", "table", "photograph", "gpmf"];

const READERS: [&str; 16] = [
    "colmap-text",
    "colmap-binary",
    "openmvg",
    "opensfm",
    "nerfstudio",
    "nvm",
    "bundler",
    "tum",
    "kitti",
    "ply",
    "bal",
    "trajectories",
    "tracks",
    "ground",
    "mask",
    "sequence",
];

/// What numbers in text are replaced by.
const WORDS: [&str; 16] = [
    "0",
    "-1",
    "1e999",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "-0.0",
    "9999999999999999999999",
    "",
    "\"\"",
    "null",
    "[]",
];

/// Small files of a reader's format, written into a folder: models from the golden one, others by hand. The first is
/// the one that is read.
pub fn written(reader: &str, folder: &Path) -> Result<Vec<PathBuf>, Failed> {
    let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let golden = above.map(|folder| folder.join("tests/golden/models/colmap_binary")).find(|path| path.is_dir());
    let (mut model, _) = model::read(&golden.ok_or("the golden model is missing")?)?;
    let (format, name) = match reader {
        "colmap-text" => (Format::ColmapText, "model"),
        "colmap-binary" => (Format::ColmapBinary, "model"),
        "openmvg" => (Format::OpenMvg, "sfm_data.json"),
        "opensfm" => (Format::OpenSfm, "reconstruction.json"),
        "nerfstudio" => (Format::Nerfstudio, "transforms.json"),
        "nvm" => (Format::Nvm, "model.nvm"),
        "bundler" => (Format::Bundler, "bundle.out"),
        "tum" | "kitti" => return camera_path(reader, folder),
        log if LOGS.contains(&log) => return logs::written(log, folder),
        _ => return by_hand(reader, folder),
    };
    if matches!(format, Format::Nvm | Format::Bundler) {
        let simple = |camera: &mut tractrix::camera::Camera| {
            *camera = tractrix::camera::Camera::with_focal(camera.width, camera.height, camera.focal[0]);
        };
        model.cameras.values_mut().for_each(simple);
        model.camera_forms.clear();
    }
    model::write(&folder.join(name), &model, format)?;
    Ok(model::files_of(&folder.join(name), format))
}

fn camera_path(reader: &str, folder: &Path) -> Result<Vec<PathBuf>, Failed> {
    let path = folder.join("path.txt");
    let line = if reader == "tum" { "1.5 1 2 3 0 0 0 1\n" } else { "1 0 0 0.5 0 1 0 2 0 0 1 3\n" };
    fs::write(&path, format!("# a path\n{}", line.repeat(20)))?;
    Ok(vec![path])
}

const TRAJECTORIES: &str = r#"{"version": 1, "unit": "background", "objects": [{"id": 1, "class": "car",
  "confidence": 0.93, "scale": {"ratio": 0.5, "std": 0.01, "method": "joint", "degenerate": false, "reason": null,
  "alternatives": {"intersection": 0.51}}, "frames": [
  {"frame": 0, "name": "000000.jpg", "time_s": 0.0, "position": [1.5, 2, 3], "world_from_object": {"scale": 0.5,
   "rotation_wxyz": [1, 0, 0, 0], "translation": [4, 5, 6]}, "speed": null},
  {"frame": 1, "name": "000001.jpg", "time_s": 0.1, "position": [1.6, 2, 3], "world_from_object": {"scale": 0.5,
   "rotation_wxyz": [0, 1, 0, 0], "translation": [4, 5, 6]}, "speed": 3.5}]}]}"#;
const TRACKS: &str = r#"{"version": 1, "objects": [{"id": 1, "class": "car", "confidence": 1.0, "found_in": {"given": 3,
  "detector": 0, "motion": 0, "both": 0, "prompted": 0, "carried": 0}, "outline": "given",
  "mask_quality": null, "movement": {"state": "moving", "reason": "no"}, "left_out": null, "frames": [0, 1, 2],
  "gaps": [], "apart": []}]}"#;
const GROUND: &str = r#"{"version": 1, "source": "masks", "point_ids": [1, 2, 3], "planes": [{"object": 1, "frame": 0,
  "normal": [0, 0.6, 0.8], "point": [1, 2, 3], "num_points": 9, "num_inliers": 8, "rms": 0.01,
  "basis": "labelled-points", "height_std": 0.1, "common_height_std": 0.05, "tilt_std": 0.01}]}"#;
const SEQUENCE: &str = r#"{"name": "s", "vehicle": "van", "units": "metre", "fps": 12.5, "n_frames": 1, "width": 96,
  "height": 54, "K": [[80, 0, 48], [0, 80, 27], [0, 0, 1]], "frames": [{"index": 0, "image": "images/0.jpg",
  "mask": "masks/0.png", "time_s": 0.0, "T_world_camera": [[0, -1, 0, 4], [1, 0, 0, 5], [0, 0, 1, 6], [0, 0, 0, 1]],
  "T_world_object": [[1, 0, 0, 4], [0, 1, 0, 5], [0, 0, 1, 6], [0, 0, 0, 1]]}], "others": []}"#;
const BAL: &str = "2 2 4\n0 0 -3.5e1 2.1e1\n1 0 -3.6e1 2.2e1\n0 1 5 6\n1 1 5.5 6.5\n";

fn by_hand(reader: &str, folder: &Path) -> Result<Vec<PathBuf>, Failed> {
    let name = match reader {
        "ply" => "mesh.ply",
        "mask" => "mask.png",
        "sequence" => "scene.json",
        "bal" => "problem.txt",
        "trajectories" | "tracks" | "ground" => "file.json",
        _ => return Err(format!("{reader} is none of {}", readers().join(", ")).into()),
    };
    let path = folder.join(name);
    match reader {
        "ply" => ply::write_mesh(&path, &tetrahedron())?,
        "mask" => masks::write_label_map(&path, &LabelMap { width: 96, height: 54, labels: vec![1; 96 * 54] })?,
        "sequence" => fs::write(&path, SEQUENCE)?,
        "trajectories" => fs::write(&path, TRAJECTORIES)?,
        "tracks" => fs::write(&path, TRACKS)?,
        "ground" => fs::write(&path, GROUND)?,
        _ => fs::write(
            &path,
            format!("{BAL}{}", "0.1\n0.2\n0.3\n-1\n-2\n-3\n500\n-0.1\n0\n".repeat(2) + "1\n2\n3\n4\n5\n6\n"),
        )?,
    }
    Ok(vec![path])
}

fn tetrahedron() -> TriangleMesh {
    let vertices = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let triangles = vec![[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];
    TriangleMesh { vertices: vertices.map(nalgebra::Point3::from).to_vec(), triangles }
}

/// Whether the reader takes what lies there.
pub fn read(reader: &str, place: &Path) -> bool {
    match reader {
        "ply" => ply::read_mesh(place).is_ok(),
        "bal" => bal::read(place).is_ok(),
        "trajectories" => trajectories::read(place).is_ok(),
        "tracks" => tracks::read(place).is_ok(),
        "ground" => ground::read(place).is_ok(),
        "mask" => {
            let _ = masks::read_label_map(place, (96, 54));
            masks::read_mask_of_any_size(place).is_ok()
        }
        "sequence" => place.parent().is_some_and(|folder| Sequence::open(folder).is_ok()),
        log if LOGS.contains(&log) => logs::read(place),
        _ => model::read(place).is_ok_and(|(model, _)| comes_back(place, &model)),
    }
}

/// What was read can be written, and is then read as the same, or is refused with a reason other than a number that no
/// reader may let in.
fn comes_back(place: &Path, model: &tractrix::scene::Reconstruction) -> bool {
    let copy = place.with_extension("copy");
    match colmap::write_binary(&copy, model) {
        Ok(()) => assert_eq!(&colmap::read_any(&copy).expect("what was written is readable").images, &model.images),
        Err(refused) => assert!(!refused.to_string().contains("is not finite"), "{refused}"),
    }
    let _ = fs::remove_dir_all(copy);
    true
}

/// A copy with one to six faults: bytes changed, taken out, doubled, cut off, put in from another file, or a number in
/// text that is another one.
pub fn damaged(whole: &[u8], other: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    for _ in 0..rng.random_range(1..=6) {
        let length = bytes.len();
        if length == 0 {
            break;
        }
        let start = rng.random_range(0..length);
        let end = (start + 1 + rng.random_range(0..64usize)).min(length);
        match rng.random_range(0..9) {
            0 => bytes[start] = rng.random(),
            1 => bytes[start] ^= 1 << rng.random_range(0..8),
            2 => bytes.truncate(start),
            3 => drop(bytes.drain(start..end)),
            4 => drop(bytes.splice(start..start, bytes[start..end].to_vec())),
            5 => bytes[start..end].fill(if rng.random() { 0 } else { 255 }),
            6 => {
                let from = rng.random_range(0..other.len().max(1)).min(other.len());
                let to = (from + rng.random_range(0..64usize)).min(other.len());
                drop(bytes.splice(start..end, other[from..to].iter().copied()));
            }
            _ => number_replaced(&mut bytes, start, rng),
        }
    }
    bytes
}

/// Puts one of [`WORDS`] in the place of the next number.
fn number_replaced(bytes: &mut Vec<u8>, from: usize, rng: &mut Rng) {
    let is_part = |byte: &u8| byte.is_ascii_digit() || b".-+eE".contains(byte);
    let Some(start) = bytes[from..].iter().position(u8::is_ascii_digit).map(|at| from + at) else { return };
    let end = bytes[start..].iter().position(|byte| !is_part(byte)).map_or(bytes.len(), |at| start + at);
    let word = WORDS[rng.random_range(0..WORDS.len())];
    drop(bytes.splice(start..end, word.bytes()));
}
