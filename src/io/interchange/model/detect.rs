//! Detection of a model's format by content, with a remedy for known but unsupported formats.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use serde::de::IgnoredAny;

use super::Format;
use crate::files;
use crate::io::interchange::colmap;
use crate::io::{IoError, RunFolder, json};

/// Readable formats, for messages.
const READABLE: &str = "a COLMAP folder, an output folder, OpenMVG's sfm_data.json, OpenSfM's reconstruction.json, \
                        nerfstudio's transforms.json, an .nvm, a Bundler file, or a camera path of TUM, EuRoC or KITTI";

/// Models inside a folder, in the order of the search.
const INSIDE: [&str; 4] = ["sfm_data.json", "reconstruction.json", "transforms.json", "bundle.out"];

/// Returns the path of a model and its format. For a folder this is a COLMAP model in it, the background of an output
/// folder, the only numbered folder in `sparse`, or a file with the usual name of another program.
///
/// # Errors
/// A missing file; or another kind of file, with the remedy.
pub fn detect(path: &Path) -> Result<(PathBuf, Format), IoError> {
    let found = std::fs::metadata(path).map_err(IoError::system("read", path))?;
    if found.is_dir() { of_folder(path) } else { of_file(path) }
}

fn of_folder(path: &Path) -> Result<(PathBuf, Format), IoError> {
    let background = RunFolder::at(path).background();
    if let Some(format) =
        [path, &background].into_iter().find_map(|folder| Some((folder.to_owned(), colmap_in(folder)?)))
    {
        return Ok(format);
    }
    let mut numbered: Vec<PathBuf> =
        [path.to_owned(), path.join("sparse")].iter().flat_map(|folder| numbered_models(folder)).collect();
    numbered.extend(Some(path.join("sparse")).filter(|folder| colmap::is_model(folder)));
    if let [only] = &numbered[..] {
        return detect(only);
    }
    if let [first, .., last] = &numbered[..] {
        let problem = format!("several models, {} to {}; give one of them", first.display(), last.display());
        return Err(IoError::content(path, problem));
    }
    let files = INSIDE.iter().map(|name| path.join(name)).find(|file| file.is_file());
    files.map_or_else(
        || Err(IoError::content(path, format!("no model in the folder; give {READABLE}"))),
        |file| of_file(&file),
    )
}

fn colmap_in(folder: &Path) -> Option<Format> {
    if folder.join("cameras.bin").exists() {
        Some(Format::ColmapBinary)
    } else {
        folder.join("cameras.txt").exists().then_some(Format::ColmapText)
    }
}

/// COLMAP numbers its models of one set of images; returned in the order of their numbers.
fn numbered_models(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let number = |path: &Path| path.file_name()?.to_str()?.parse::<u32>().ok();
    let mut found: Vec<_> = entries.filter_map(|entry| Some((number(&entry.path())?, entry.path()))).collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).filter(|path| colmap::is_model(path)).collect()
}

fn of_file(path: &Path) -> Result<(PathBuf, Format), IoError> {
    let is_colmap = path.file_name().and_then(|name| name.to_str()).is_some_and(colmap::is_file_name);
    if let (true, Some(folder)) = (is_colmap, path.parent()) {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        return of_folder(folder);
    }
    let start = start_of(path)?;
    let text = String::from_utf8_lossy(&start);
    let format = match text.trim_start().chars().next() {
        Some('{' | '[') => of_json(path),
        _ => of_text(path, &text),
    }?;
    Ok((path.to_owned(), format))
}

fn start_of(path: &Path) -> Result<Vec<u8>, IoError> {
    let mut start = Vec::new();
    let file = files::open(path).map_err(IoError::system("read", path))?;
    file.take(4096).read_to_end(&mut start).map_err(IoError::system("read", path))?;
    Ok(files::without_mark(start))
}

/// Format of a JSON file, by its top-level keys.
fn of_json(path: &Path) -> Result<Format, IoError> {
    let keys = top_keys(path)?;
    let has = |names: &[&str]| names.iter().all(|name| keys.iter().any(|key| key == name));
    if has(&["sfm_data_version"]) || has(&["views", "intrinsics", "extrinsics"]) {
        return Ok(Format::OpenMvg);
    } else if has(&["cameras", "shots"]) {
        return Ok(Format::OpenSfm);
    } else if has(&["frames"]) && !has(&["units"]) {
        return Ok(Format::Nerfstudio);
    }
    let (what, cure) = if has(&["views", "intrinsics", "poses"]) || has(&["featuresFolders"]) {
        ("a scene of Meshroom", "write a COLMAP model with aliceVision_exportColmap and give that folder".to_owned())
    } else if has(&["units", "frames", "K"]) {
        ("a sequence with its truth", "give its folder to tractrix evaluate --truth".to_owned())
    } else {
        let shown: Vec<_> = keys.iter().take(5).map(String::as_str).collect();
        ("JSON of an unknown kind", format!("its keys are {}; give {READABLE}", shown.join(", ")))
    };
    Err(IoError::unsupported(path, what, cure))
}

/// The keys of the object at the top of a JSON file, or of the first one in the list at its top.
fn top_keys(path: &Path) -> Result<Vec<String>, IoError> {
    type Object = BTreeMap<String, IgnoredAny>;
    let bytes = files::read_text(path).map_err(IoError::system("read", path))?;
    let is_list = bytes.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[');
    let object = if is_list {
        serde_json::from_slice::<Vec<Object>>(&bytes).map(|list| list.into_iter().next().unwrap_or_default())
    } else {
        serde_json::from_slice::<Object>(&bytes)
    };
    let problem = "not JSON of a reconstruction from here on; the file is truncated, damaged or of another kind";
    object.map(|object| object.into_keys().collect()).map_err(|error| json::error(path, &error, problem))
}

/// Format of another file, by its first bytes and its name.
fn of_text(path: &Path, start: &str) -> Result<Format, IoError> {
    let ends = |extension: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
    if let Some(format) = plain_text(start) {
        return Ok(format);
    }
    let (what, cure) = if start.starts_with("ply") {
        return Err(points_alone(path));
    } else if start.starts_with("SQLite format 3") {
        ("COLMAP's database", "it has features and matches, but no camera poses; give the model made from it")
    } else if ends("bin") {
        let cure = "write it as text with openMVG_main_ConvertSfM_DataFormat -i sfm_data.bin -o sfm_data.json";
        ("OpenMVG's binary form", cure)
    } else if ends("rec") {
        ("a reconstruction of Theia", "write it with pytheia.io.WriteColmapFiles and give that folder")
    } else if ends("abc") || ends("sfm") {
        ("a scene of Meshroom", "write a COLMAP model with aliceVision_exportColmap and give that folder")
    } else {
        return Err(IoError::content(path, format!("not a reconstruction of a known format; give {READABLE}")));
    };
    Err(IoError::unsupported(path, what, cure))
}

/// Text formats, by their first line.
fn plain_text(start: &str) -> Option<Format> {
    if start.starts_with("NVM_V3") {
        return Some(Format::Nvm);
    } else if start.starts_with("# Bundle file") {
        return Some(Format::Bundler);
    }
    let first = start.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'))?;
    // A header without its magic word is refused with its line.
    if first.starts_with("timestamp ") {
        return Some(Format::Tum);
    }
    let has_commas = first.contains(',');
    let fields = first.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
    let numbers: Result<Vec<f64>, _> = fields.map(str::parse).collect();
    match (numbers.ok()?.len(), has_commas) {
        (8, _) | (9.., true) => Some(Format::Tum),
        (12, false) => Some(Format::Kitti),
        _ => None,
    }
}

/// Error for a point cloud.
pub(super) fn points_alone(path: &Path) -> IoError {
    IoError::unsupported(path, "a point cloud without cameras", format!("give {READABLE}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::interchange::model::{read, read_for_geometry, write};
    use crate::io::testing::{in_repository, model_with, odd_model};

    fn said(name: &str, content: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        read(&path).unwrap_err().to_string()
    }

    #[test]
    fn known_unsupported_formats_have_a_remedy() {
        let cases: [(&str, &[u8], &str); 10] = [
            ("sfm_data.bin", b"\x01\x03\0\0\0\0\0\0\x000.3", "openMVG_main_ConvertSfM_DataFormat"),
            ("theia.rec", b"\x16\0\0\0", "pytheia.io.WriteColmapFiles"),
            ("scene.abc", b"Ogawa", "aliceVision_exportColmap"),
            (
                "scene.sfm",
                br#"{"version": ["1"], "views": [], "intrinsics": [], "poses": []}"#,
                "aliceVision_exportColmap",
            ),
            ("database.db", b"SQLite format 3\0", "the model made from it"),
            ("cloud.ply", b"ply\nformat ascii 1.0\n", "point cloud without cameras"),
            ("scene.json", br#"{"units": "metre", "frames": [], "K": []}"#, "evaluate --truth"),
            ("other.json", br#"{"key": 1, "value": 2}"#, "its keys are key, value"),
            ("broken.json", br#"{"views": [1, 2"#, "truncated, damaged or of another kind"),
            ("notes.txt", b"hello", "not a reconstruction of a known format"),
        ];
        for (name, content, cure) in cases {
            let said = said(name, content);
            assert!(said.contains(cure) && said.contains(name), "{name}: {said}");
        }
    }

    #[test]
    fn every_format_is_recognized_by_its_content() {
        let folder = tempfile::tempdir().unwrap();
        let lens = crate::camera::Camera::with_focal(960, 540, 700.0);
        let formats =
            [Format::ColmapBinary, Format::OpenMvg, Format::OpenSfm, Format::Nerfstudio, Format::Nvm, Format::Bundler];
        for format in formats {
            let place = folder.path().join(format!("{format}/model without a telling name"));
            write(&place, &model_with(&[lens]), format).unwrap();
            let (model, found) = read(&place).unwrap();
            assert_eq!((found, model.images.len()), (format, 4));
        }
    }

    #[test]
    fn a_model_inside_a_folder_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let model = odd_model();
        for place in ["a/sparse/0", "b/0", "c/sparse", "d/background", "e/sparse/3"] {
            write(&folder.path().join(place), &model, Format::ColmapBinary).unwrap();
        }
        write(&folder.path().join("f/sfm_data.json"), &model, Format::OpenMvg).unwrap();
        for place in ["a", "a/sparse", "a/sparse/0/images.bin", "b", "c", "d", "e", "f"] {
            assert_eq!(read(&folder.path().join(place)).unwrap().0.images.len(), 4, "{place}");
        }
        write(&folder.path().join("a/sparse/1"), &model, Format::ColmapBinary).unwrap();
        assert!(read(&folder.path().join("a")).unwrap_err().to_string().contains("several models"));
    }

    #[test]
    fn geometry_refuses_unsupported_cameras_by_name() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["cameras", "images", "points3D"] {
            let file = format!("tests/golden/models/colmap_text/{name}.txt");
            std::fs::copy(in_repository(&file), folder.path().join(format!("{name}.txt"))).unwrap();
        }
        let fisheye = "1 OPENCV_FISHEYE 640 480 500 500 320 240 0.1 0 0 0\n2 PINHOLE 640 480 520 520 318 242\n";
        std::fs::write(folder.path().join("cameras.txt"), fisheye).unwrap();
        let (model, _) = read(folder.path()).unwrap();
        assert!(!model.can_project(crate::scene::CameraId(1)));
        let error = read_for_geometry(folder.path()).unwrap_err().to_string();
        assert!(error.contains("camera 1: camera model OPENCV_FISHEYE"), "{error}");
        let openmvg = folder.path().join("sfm_data.json");
        write(&openmvg, &model, Format::OpenMvg).unwrap();
        assert_eq!(
            read(&openmvg).unwrap().0.camera_forms[&crate::scene::CameraId(1)],
            model.camera_forms[&crate::scene::CameraId(1)]
        );
        let error = write(&folder.path().join("a.nvm"), &model, Format::Nvm).unwrap_err().to_string();
        assert!(error.contains("OPENCV_FISHEYE") && error.contains("NVM"), "{error}");
    }
}
