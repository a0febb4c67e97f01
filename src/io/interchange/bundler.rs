//! Bundler's `bundle.out`, and the list of its images.
//!
//! The format of N. Snavely's Bundler (`doc/output.txt`, "Bundle file v0.3"): per camera f, k₁, k₂, the rows of R and
//! t; per point position, color, and its observations. A camera looks along its *negative* z axis, x right and y *up*:
//!
//! ```text
//! P = R X + t,    p = −(P.x, P.y) / P.z,    p' = f (1 + k₁ |p|² + k₂ |p|⁴) p.
//! ```
//!
//! p' has its origin in the image center. So y and z of the camera change their sign here, k₁ and k₂ are those of this
//! program, and a pixel is (w/2 + x, h/2 − y). Neither names nor sizes of images are in the file. Names are read from
//! `list.txt`, `NAME.list.txt` or the only other list next to it (`imagelist.lst`), one line per camera, and written to
//! `list.txt`; without it they are six-digit numbers from 0. Of absolute file paths only the file name is used. Sizes
//! are those of the image files if these are next to the file, otherwise the smallest even ones that contain all
//! features. A camera with f = 0 is not registered.
//!
//! Written are pinholes with one focal length and k₁, k₂. Positions are relative to the principal point, as in the
//! models that COLMAP writes, so that all adjusted values keep their meaning for readers that assume a central
//! principal point.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::assembly::{Losses, check_finite, check_lenses, check_line_names, rotation};
use super::centered::{Centered, add_points, check_two_radial, losses, places, set_picture_sizes, sizes_of_files};
use super::words::{Text, Words};
use crate::camera::Camera;
use crate::io::{IoError, atomic};
use crate::math::Rigid3;
use crate::scene::{CameraId, Image, ImageId, Reconstruction};

/// First line of the file.
pub const MAGIC: &str = "# Bundle file v0.3";

const FORMAT: &str = "Bundler's format";

/// Rotation from Bundler's camera axes to ours and back.
fn turn() -> Rotation3<f64> {
    Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)))
}

/// Reads a reconstruction. Ids are indices in the file plus one.
///
/// # Errors
/// A missing file, an invalid field (with its position), an invalid rotation, another version of the format, or a
/// missing view.
pub fn read(path: &Path) -> Result<Reconstruction, IoError> {
    let text = Text::read_file(path)?;
    let mut words = text.words();
    let magic = words.rest_of_line();
    if magic != MAGIC {
        return Err(IoError::unsupported(path, format!("'{magic}'"), "write it as version 0.3"));
    }
    let num_cameras = words.count("number of cameras", 10)?;
    let num_points = words.count("number of points", 10)?;
    let names = names(path)?;
    let mut model = Reconstruction::default();
    for index in 0..num_cameras {
        let name = names.get(index).cloned().unwrap_or_else(|| format!("{index:06}.jpg"));
        add_camera(&mut words, index as u32, name, &mut model)?;
    }
    let points =
        (0..num_points).map(|_| Centered::read(&mut words, num_cameras, -1.0)).collect::<Result<Vec<_>, _>>()?;
    let sizes = sizes_of_files(path, &model);
    set_picture_sizes(&mut model, &points, &sizes);
    add_points(path, &mut model, points)?;
    Ok(model)
}

fn add_camera(words: &mut Words<'_>, index: u32, name: String, model: &mut Reconstruction) -> Result<(), IoError> {
    let [focal, k1, k2] = words.finites("f k1 k2")?;
    let r: [f64; 9] = words.finites("rotation")?;
    let translation = Vector3::from(words.finites::<3>("translation")?);
    if focal == 0.0 {
        return Ok(());
    }
    let matrix = Matrix3::from_row_slice(&r);
    let stored = rotation(&matrix).ok_or_else(|| words.error("rotation", "not a rotation"))?;
    if focal < 0.0 {
        return Err(words.error("f", "negative"));
    }
    let camera = Camera { radial: [k1, k2], ..Camera::with_focal(2, 2, focal) };
    let ours = nalgebra::UnitQuaternion::from_rotation_matrix(&turn());
    let cam_from_world = Rigid3::new(ours * stored, turn() * translation);
    model.cameras.insert(CameraId(index + 1), camera);
    let image = Image { name, camera: CameraId(index + 1), cam_from_world, observations: Vec::new() };
    model.images.insert(ImageId(index + 1), image);
    Ok(())
}

/// Names from the list next to the file; none without a list. Bundler writes `name 0 focal`, other programs only the
/// name.
fn names(path: &Path) -> Result<Vec<String>, IoError> {
    let Some(list) = lists(path).into_iter().next() else { return Ok(Vec::new()) };
    let text = Text::read_file(&list)?;
    let name = |line: &str| {
        let mut fields = line.rsplitn(3, ' ');
        let (last, middle, first) = (fields.next(), fields.next(), fields.next());
        match (first, middle, last) {
            (Some(name), Some("0"), Some(focal)) if focal.parse::<f64>().is_ok() => name.to_owned(),
            _ => line.to_owned(),
        }
    };
    Ok(text.records().map(|(_, line)| relative(name(line))).collect())
}

/// A relative name unchanged; of an absolute path, of any system, the file name.
fn relative(name: String) -> String {
    let is_absolute = name.starts_with(['/', '\\']) || name.get(1..3) == Some(":\\");
    if is_absolute { name.rsplit(['/', '\\']).next().unwrap_or_default().to_owned() } else { name }
}

/// The image list next to a file, if there is one: of the usual names, or the only one of another name.
pub(super) fn lists(path: &Path) -> Vec<PathBuf> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let usual = ["list.txt".to_owned(), format!("{stem}.list.txt")].map(|name| path.with_file_name(name));
    if let Some(list) = usual.into_iter().find(|list| list.is_file()) {
        return vec![list];
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_list = |file: &PathBuf| {
        let name = file.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        name.ends_with(".lst") || (name.ends_with(".txt") && name.contains("list"))
    };
    let others: Vec<PathBuf> = entries.filter(|file| is_list(file) && file.is_file()).collect();
    if others.len() == 1 { others } else { Vec::new() }
}

/// The files that are written: the model and its image list.
pub fn files(path: &Path) -> [PathBuf; 2] {
    [path.to_path_buf(), path.with_file_name("list.txt")]
}

/// Writes a reconstruction and its image list, and returns the losses of the format.
///
/// # Errors
/// A system error, a number that is not finite, or a camera other than a pinhole with one focal length and k₁, k₂.
pub fn write(path: &Path, model: &Reconstruction) -> Result<Losses, IoError> {
    check_finite(path, model)?;
    check_lenses(path, model, FORMAT)?;
    check_line_names(path, model)?;
    for (id, camera) in &model.cameras {
        check_two_radial(path, *id, camera, FORMAT)?;
    }
    let [bundle, list] = files(path);
    let names: String = model.images.values().map(|image| format!("{}\n", image.name)).collect();
    atomic::write(&list, names.as_bytes())?;
    atomic::write_with(&bundle, |out| write_bundle(out, model))?;
    Ok(losses(model))
}

fn write_bundle(out: &mut dyn std::io::Write, model: &Reconstruction) -> std::io::Result<()> {
    let places = places(model);
    writeln!(out, "{MAGIC}\n{} {}", model.images.len(), model.points.len())?;
    for image in model.images.values() {
        let camera = model.camera_of(image);
        writeln!(out, "{} {} {}", camera.focal[0], camera.radial[0], camera.radial[1])?;
        let r = turn() * image.cam_from_world.rotation.to_rotation_matrix();
        for i in 0..3 {
            writeln!(out, "{} {} {}", r[(i, 0)], r[(i, 1)], r[(i, 2)])?;
        }
        let t = turn() * image.cam_from_world.translation;
        writeln!(out, "{} {} {}", t.x, t.y, t.z)?;
    }
    for point in model.points.values() {
        let (p, [r, g, b]) = (point.position, point.rgb);
        writeln!(out, "{} {} {}\n{r} {g} {b}", p.x, p.y, p.z)?;
        write!(out, "{}", point.track.len())?;
        for element in &point.track {
            let image = &model.images[&element.image];
            let pixel = image.observations[element.observation_idx as usize].pixel;
            let [cx, cy] = model.camera_of(image).principal;
            let view = places[&element.image];
            write!(out, " {view} {} {} {}", element.observation_idx, pixel.x - cx, cy - pixel.y)?;
        }
        writeln!(out)?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::io::testing::{damaged_text_never_panics, model_with, near_but_for_sizes};

    const GOLDEN: &str = "# Bundle file v0.3\n2 1\n500 0.1 0\n1 0 0\n0 1 0\n0 0 1\n0 0 -4\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n\
                          0 0 0\n1 2 0\n10 20 30\n1 0 7 131.25 262.5\n";

    fn read_text(text: &str, list: Option<&str>) -> Result<Reconstruction, IoError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bundle.out");
        std::fs::write(&path, text).unwrap();
        if let Some(list) = list {
            std::fs::write(folder.path().join("list.txt"), list).unwrap();
        }
        read(&path)
    }

    /// P = (1, 2, −4), p = (1/4, 1/2), |p|² = 5/16, p' = 500 (1 + 1/32) p = (128.90625, 257.8125).
    #[test]
    fn a_camera_looks_along_its_negative_z() {
        let model = read_text(GOLDEN, Some("a b.jpg 0 500.5\nother.jpg\n")).unwrap();
        assert_eq!((model.images.len(), model.points.len()), (1, 1), "focal length 0 is not registered");
        let image = &model.images[&ImageId(1)];
        assert_eq!(image.name, "a b.jpg");
        let at = image.cam_from_world * Point3::new(1.0, 2.0, 0.0);
        assert!((at - Point3::new(1.0, -2.0, 4.0)).norm() < 1e-12, "x right, y down, z forward");
        let error = (131.25f64 - 128.90625).hypot(262.5 - 257.8125);
        assert!((model.points.values().next().unwrap().error_px - error).abs() < 1e-9);
        assert_eq!(model.points.values().next().unwrap().rgb, [10, 20, 30]);
        assert_eq!(model.cameras[&CameraId(1)].height, 526);
    }

    #[test]
    fn a_model_round_trips() {
        let lens = |values: &[f64]| Camera::prior(960, 540).with_parameters(values).unwrap();
        let model = model_with(&[lens(&[700.0, 700.0, 480.0, 270.0, -0.1, 0.02]), lens(&[710.0, 710.0, 480.0, 270.0])]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bundle.out");
        assert_eq!(write(&path, &model).unwrap().sentences().len(), 2);
        near_but_for_sizes(&read(&path).unwrap(), &model, 1e-9);
        let other = model_with(&[lens(&[700.0, 700.0, 480.0, 270.0, 0.0, 0.0, 1e-3, 0.0])]);
        assert!(write(&path, &other).unwrap_err().to_string().contains("tangential"));
    }

    #[test]
    fn damage_is_reported_with_its_position() {
        let says = |from: &str, to: &str| read_text(&GOLDEN.replace(from, to), None).unwrap_err().to_string();
        assert!(says("v0.3", "v0.4").contains("version 0.3"));
        assert!(says("1 0 0\n0 1 0", "1 0 0\n0 2 0").contains("not a rotation"));
        assert!(says("1 0 7", "1 5 7").contains("camera 5 does not exist"));
        assert!(says("2 1\n", "2 100000000\n").contains("do not fit"));
        assert!(says("262.5", "x").contains("line 15: position of a feature: 'x'"));
        damaged_text_never_panics(GOLDEN, |text| read_text(text, None).is_ok());
    }
}
