//! VisualSFM's N-View Match files, `.nvm`.
//!
//! Format and conventions are those of C. Wu's page "VisualSFM: the NVM format": after `NVM_V3` the cameras, one a line
//! (name, focal length, quaternion w x y z of `cam_from_world`, camera *center*, radial distortion r, 0), then the
//! points (position, color, and per observation the index of its image, a feature index, and the position relative to
//! the image center). Camera axes are this program's. A blank in a name is written as `"`.
//!
//! r applies to the *measured* position m, divided by the focal length: the undistorted one is (1 + r |m|²) m. On
//! reading, it becomes k₁ = −r, k₂ = 3 r², k₃ = −12 r³, the first terms of the inverse series. The written r is the
//! best approximation of the distortion over the image; a camera that no r approximates to half a pixel is refused.
//! Image sizes are not in the file: they are those of the image files if these are next to it, otherwise the smallest
//! even ones that contain all features. Of several models in a file the first is read.
//!
//! VisualSFM itself also writes positions from the upper left corner, without stating it. A file in which no position
//! is left of or above its origin is assumed to be one of these. The center is then half the size of the image if that
//! is next to the file, otherwise it is estimated from poses and points: the median difference between positions and
//! projections.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Point2, Point3, Quaternion, Vector2};

use super::assembly::{
    Losses, Short, check_finite, check_lenses, check_line_names, unit_quaternion, unsupported_camera,
};
use super::centered::{
    Centered, Sizes, add_points, check_one_focal_length, losses, places, set_picture_sizes, sizes_of_files,
};
use super::words::{Text, Words};
use crate::camera::{Camera, HigherTerms};
use crate::io::{IoError, atomic};
use crate::math::{Rigid3, median};
use crate::scene::{CameraId, Image, ImageId, Reconstruction};

/// First line of the file.
pub const MAGIC: &str = "NVM_V3";

/// Maximum error of the written distortion against the camera's, pixels.
const MAX_FIT_ERROR_PX: f64 = 0.5;

const FORMAT: &str = "the NVM format";

/// Reads the first model of a file. Ids are indices in the file plus one.
///
/// # Errors
/// A missing file, an invalid field (with its position), a calibration shared by all cameras, or a missing view.
pub fn read(path: &Path) -> Result<Reconstruction, IoError> {
    let text = Text::read_file(path)?;
    let mut words = text.words();
    let magic = words.rest_of_line();
    if magic != MAGIC {
        return Err(IoError::unsupported(path, format!("'{magic}'"), "save it as NVM_V3 without a fixed calibration"));
    }
    let num_cameras = words.count("number of cameras", 22)?;
    let mut model = Reconstruction::default();
    for index in 0..num_cameras {
        add_camera(&mut words, index as u32, &mut model)?;
    }
    let num_points = words.count("number of points", 13)?;
    let mut points =
        (0..num_points).map(|_| Centered::read(&mut words, num_cameras, 1.0)).collect::<Result<Vec<_>, _>>()?;
    let sizes = sizes_of_files(path, &model);
    let sizes = if count_from_the_corner(&points) { centered_positions(&model, &mut points, sizes) } else { sizes };
    set_picture_sizes(&mut model, &points, &sizes);
    add_points(path, &mut model, points)?;
    Ok(model)
}

/// Returns true if no position is left of or above the origin, as about half are that count from the center.
fn count_from_the_corner(points: &[Centered]) -> bool {
    // By chance so many are right of and below the center in 1 of 2³² files.
    const MIN_OBSERVATIONS: usize = 16;
    let mut places = points.iter().flat_map(|point| &point.seen).map(|(_, place)| place);
    points.iter().map(|point| point.seen.len()).sum::<usize>() >= MIN_OBSERVATIONS
        && places.all(|p| p.x >= 0.0 && p.y >= 0.0)
}

/// Shifts positions from the corner to the center, and returns the sizes of all images.
fn centered_positions(model: &Reconstruction, points: &mut [Centered], mut sizes: Sizes) -> Sizes {
    let mut differences: BTreeMap<ImageId, [Vec<f64>; 2]> = BTreeMap::new();
    for point in points.iter() {
        for (id, place) in &point.seen {
            let Some(image) = model.images.get(id) else { continue };
            let camera = model.camera_of(image);
            let Some(pixel) = camera.pixel_from_cam(image.cam_from_world * point.position) else { continue };
            let from_middle = pixel - Point2::from(camera.principal);
            let found = differences.entry(*id).or_default();
            found[0].push(place.x - from_middle.x);
            found[1].push(place.y - from_middle.y);
        }
    }
    let twice = |values: Vec<f64>| (2.0 * median(values).unwrap_or(0.0)).round().clamp(1.0, 1e6) as u32;
    for (id, [x, y]) in differences {
        sizes.entry(id).or_insert_with(|| (twice(x), twice(y)));
    }
    for (id, place) in points.iter_mut().flat_map(|point| &mut point.seen) {
        let (width, height) = sizes.get(id).copied().unwrap_or_default();
        *place -= Vector2::new(f64::from(width) / 2.0, f64::from(height) / 2.0);
    }
    sizes
}

fn add_camera(words: &mut Words<'_>, index: u32, model: &mut Reconstruction) -> Result<(), IoError> {
    let name = words.word("image name")?.replace('"', " ");
    let focal = words.finite("focal length")?;
    let [w, x, y, z] = words.finites("quaternion")?;
    let center = Point3::from(words.finites::<3>("camera center")?);
    let r = words.finite("radial distortion")?;
    let _end: f64 = words.number("end of a camera")?;
    let stored = Quaternion::new(w, x, y, z);
    if !(focal > 0.0) {
        return Err(words.error("focal length", "not positive"));
    }
    let rotation = unit_quaternion(stored).ok_or_else(|| words.error("quaternion", "not a rotation"))?;
    let higher = HigherTerms { k3: -12.0 * r * r * r, ..HigherTerms::ZERO };
    let camera = Camera { radial: [-r, 3.0 * r * r], higher, ..Camera::with_focal(2, 2, focal) };
    let cam_from_world = Rigid3::from_rotation_and_center(rotation, center);
    let id = CameraId(index + 1);
    model.cameras.insert(id, camera);
    model.images.insert(ImageId(index + 1), Image { name, camera: id, cam_from_world, observations: Vec::new() });
    Ok(())
}

/// Writes a reconstruction and returns the losses of the format.
///
/// # Errors
/// A system error, a number that is not finite, two focal lengths, a distortion that one measured-side term cannot
/// approximate, or a name that is not a word.
pub fn write(path: &Path, model: &Reconstruction) -> Result<Losses, IoError> {
    check_finite(path, model)?;
    check_lenses(path, model, FORMAT)?;
    check_line_names(path, model)?;
    let mut worst_px = 0.0;
    let mut distortions = BTreeMap::new();
    for (id, camera) in &model.cameras {
        check_one_focal_length(path, *id, camera, FORMAT)?;
        let (r, error_px) = measured_side(camera);
        if error_px > MAX_FIT_ERROR_PX {
            let what = format!("distortion that one term approximates to {} pixels only", Short(error_px));
            return Err(unsupported_camera(path, *id, &what, FORMAT));
        }
        worst_px = f64::max(worst_px, error_px);
        distortions.insert(*id, r);
    }
    atomic::write_with(path, |out| write_nvm(out, model, &distortions))?;
    let losses = losses(model);
    let fitted = format!("distortion is approximated by one term, to {} pixels", Short(worst_px));
    Ok(if worst_px > 1e-9 { losses.with(fitted) } else { losses })
}

/// Least-squares r of a camera over the image, and its largest error in pixels: minimizes Σ ((1 + r |m|²) m − u)² over
/// positions u of a grid, which are observed at m.
fn measured_side(camera: &Camera) -> (f64, f64) {
    let [width, height] = [camera.width, camera.height].map(f64::from);
    let grid = |k: u32| f64::from(k % 21) / 20.0;
    let rays: Vec<_> = (0..441)
        .map(|k| {
            let pixel = Point2::new(width * grid(k), height * grid(k / 21));
            let seen = (pixel - Point2::from(camera.principal)) / camera.focal[0];
            (seen, camera.normalized_from_pixel(pixel))
        })
        .collect();
    let (above, below) = rays.iter().fold((0.0, 0.0), |(above, below), (seen, true_one)| {
        let row = seen * seen.norm_squared();
        (above + row.dot(&(true_one - seen)), below + row.norm_squared())
    });
    let r = if below > 0.0 { above / below } else { 0.0 };
    let error = |(seen, true_one): &(Vector2<f64>, Vector2<f64>)| {
        (seen * (1.0 + r * seen.norm_squared()) - true_one).norm() * camera.focal[0]
    };
    (r, rays.iter().map(error).fold(0.0, f64::max))
}

fn write_nvm(
    out: &mut dyn std::io::Write,
    model: &Reconstruction,
    distortions: &BTreeMap<CameraId, f64>,
) -> std::io::Result<()> {
    let places = places(model);
    writeln!(out, "{MAGIC}\n\n{}", model.images.len())?;
    for image in model.images.values() {
        let (q, c) = (image.cam_from_world.rotation, image.cam_from_world.center());
        let (name, focal) = (image.name.replace(' ', "\""), model.camera_of(image).focal[0]);
        write!(out, "{name}\t{focal} {} {} {} {}", q.w, q.i, q.j, q.k)?;
        writeln!(out, " {} {} {} {} 0", c.x, c.y, c.z, distortions[&image.camera])?;
    }
    writeln!(out, "\n{}", model.points.len())?;
    for point in model.points.values() {
        let (p, [r, g, b]) = (point.position, point.rgb);
        write!(out, "{} {} {} {r} {g} {b} {}", p.x, p.y, p.z, point.track.len())?;
        for element in &point.track {
            let image = &model.images[&element.image];
            let pixel = image.observations[element.observation_idx as usize].pixel;
            let [cx, cy] = model.camera_of(image).principal;
            let view = places[&element.image];
            write!(out, " {view} {} {} {}", element.observation_idx, pixel.x - cx, pixel.y - cy)?;
        }
        writeln!(out)?;
    }
    // End of the models and of the point clouds.
    writeln!(out, "\n0\n\n0")?;
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::testing::{damaged_text_never_panics, model_with, near_but_for_sizes};

    const GOLDEN: &str = "NVM_V3\n\n2\na\"b.jpg\t500 1 0 0 0 0 0 -4 0.01 0\nc.jpg\t510 1 0 0 0 1 0 -4 0 0\n\n\
                          1\n1 2 0 10 20 30 2 0 5 124 248 1 6 0 255\n\n0\n\n0\n";

    fn read_text(text: &str) -> Result<Reconstruction, IoError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nvm");
        std::fs::write(&path, text).unwrap();
        read(&path)
    }

    #[test]
    fn centers_and_measured_distortion_are_converted_to_our_conventions() {
        let model = read_text(GOLDEN).unwrap();
        let image = &model.images[&ImageId(1)];
        assert_eq!((image.name.as_str(), image.cam_from_world.center()), ("a b.jpg", Point3::new(0.0, 0.0, -4.0)));
        // m = (0.248, 0.496): undistorted (1 + 0.01 · 0.30752) m, which the camera must project to m.
        let camera = model.camera_of(image);
        let m = nalgebra::Vector2::new(0.248, 0.496);
        let back = camera.pixel_from_normalized(m * (1.0 + 0.01 * m.norm_squared()));
        assert!((back - Point2::from(camera.principal) - m * 500.0).norm() < 1e-4, "{back}");
        let [point] = &model.points.values().collect::<Vec<_>>()[..] else { panic!() };
        assert_eq!((point.rgb, point.track.len()), ([10, 20, 30], 2));
        assert_eq!((camera.width, camera.height), (248, 496));
    }

    #[test]
    fn a_model_round_trips() {
        let lens = |values: &[f64]| Camera::prior(960, 540).with_parameters(values).unwrap();
        let model = model_with(&[lens(&[700.0, 700.0, 480.0, 270.0]), lens(&[710.0, 710.0, 480.0, 270.0])]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nvm");
        assert_eq!(write(&path, &model).unwrap().sentences().len(), 2);
        near_but_for_sizes(&read(&path).unwrap(), &model, 1e-9);
        let slight = model_with(&[lens(&[700.0, 700.0, 480.0, 270.0, -0.01])]);
        assert!(write(&path, &slight).unwrap().sentences().iter().any(|s| s.contains("one term")));
        assert!((read(&path).unwrap().cameras[&CameraId(1)].radial[0] + 0.01).abs() < 1e-3);
        let strong = model_with(&[lens(&[700.0, 700.0, 480.0, 270.0, -0.3, 0.1])]);
        assert!(write(&path, &strong).unwrap_err().to_string().contains("one term"));
    }

    /// Files of VisualSFM with positions from the corner, without a size.
    #[test]
    fn positions_from_the_corner_are_detected() {
        let lens = |f: f64, width| Camera { radial: [0.0; 2], ..Camera::with_focal(width, 540, f) };
        let model = model_with(&[lens(280.0, 960), lens(290.0, 1000)]);
        let mut cornered = model.clone();
        cornered.cameras.values_mut().for_each(|camera| camera.principal = [0.0; 2]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nvm");
        write(&path, &cornered).unwrap();
        let found = read(&path).unwrap();
        for (found, image) in found.images.values().zip(model.images.values()) {
            let (found, camera) = (found.cam_from_world, model.camera_of(image));
            assert!((found.center() - image.cam_from_world.center()).norm() < 1e-9, "{camera:?}");
        }
        // Features are up to half a pixel off their projections.
        let sizes: Vec<_> = found.images.values().map(|i| found.camera_of(i)).map(|c| (c.width, c.height)).collect();
        for ((width, height), expected) in sizes.iter().zip([960u32, 1000, 960, 1000]) {
            assert!(width.abs_diff(expected) < 2 && height.abs_diff(540) < 2, "{sizes:?}");
        }
        let error = found.mean_reprojection_error_px().unwrap();
        assert!(error < 1.0, "{error}");
    }

    #[test]
    fn damage_is_reported_with_its_position() {
        let says = |from: &str, to: &str| read_text(&GOLDEN.replace(from, to)).unwrap_err().to_string();
        assert!(says("NVM_V3", "NVM_V3 FixedK 1 2 3 4 0").contains("without a fixed calibration"));
        assert!(says("500 1 0", "500 0 0").contains("not a rotation"));
        assert!(says("500 1 0", "500 1e308 0").contains("not a rotation"));
        assert!(says("1 6 0", "7 6 0").contains("line 8: view of a point: camera 7 does not exist"));
        damaged_text_never_panics(GOLDEN, |text| read_text(text).is_ok());
    }
}
