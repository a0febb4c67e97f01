//! Problems of *Bundle Adjustment in the Large* (Agarwal et al., ECCV 2010).
//!
//! A text file: the numbers of cameras, points and observations; per observation its camera, its point and a pixel
//! position; then nine numbers per camera (rotation vector, translation, f, k1, k2) and three per point. There a camera
//! looks down its negative z axis, y points up and the principal point is the origin:
//!
//! ```text
//! P = R X + t,   p = −P / P_z,   pixel = f (1 + k1 ‖p‖² + k2 ‖p‖⁴) p.
//! ```
//!
//! On reading, cameras are rotated by 180° about their x axis, so that z points forward, and the second pixel
//! coordinate changes its sign; residuals keep their length. Image sizes are not in the file and are read as zero.

use std::path::Path;

use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};

use super::words::{Text, Words};
use crate::camera::Camera;
use crate::io::IoError;
use crate::math::Rigid3;
use crate::scene::{CameraId, Image, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

/// Reads a problem with one camera per image; camera, image and point ids are the file's indices plus one.
///
/// # Errors
/// [`IoError`] with path, line and field if the file is truncated, has a number that is not finite, or an index past
/// the counts in its first line.
pub fn read(path: &Path) -> Result<Reconstruction, IoError> {
    parse(&mut Text::read_file(path)?.words())
}

fn parse(words: &mut Words<'_>) -> Result<Reconstruction, IoError> {
    let num_images = count(words, "number of cameras")?;
    let num_points = count(words, "number of points")?;
    let num_observations = count(words, "number of observations")?;
    let mut seen = Vec::new();
    for _ in 0..num_observations {
        let image = index(words, "camera index", num_images)?;
        let point = index(words, "point index", num_points)?;
        let pixel = Point2::new(words.finite("pixel x")?, -words.finite("pixel y")?);
        seen.push((image, point, pixel));
    }
    let mut model = Reconstruction::default();
    for index in 0..num_images {
        let (camera, cam_from_world) = camera(words)?;
        let id = index + 1;
        model.cameras.insert(CameraId(id), camera);
        let name = format!("{index:06}");
        let image = Image { name, camera: CameraId(id), cam_from_world, observations: Vec::new() };
        model.images.insert(ImageId(id), image);
    }
    for index in 0..num_points {
        let position = Point3::from(words.finites("point")?);
        let point = Point3d { position, rgb: [0; 3], error_px: 0.0, track: Vec::new() };
        model.points.insert(Point3dId(u64::from(index) + 1), point);
    }
    connect(&mut model, &seen);
    Ok(model)
}

fn connect(model: &mut Reconstruction, seen: &[(u32, u32, Point2<f64>)]) {
    for (image, point, pixel) in seen {
        let (image_id, point_id) = (ImageId(image + 1), Point3dId(u64::from(*point) + 1));
        let (Some(image), Some(point)) = (model.images.get_mut(&image_id), model.points.get_mut(&point_id)) else {
            continue;
        };
        let observation_idx = image.observations.len() as u32;
        image.observations.push(Observation { pixel: *pixel, point: Some(point_id) });
        point.track.push(TrackElement { image: image_id, observation_idx });
    }
}

/// Reads a count; ids and sums of two counts fit in 32 bits.
fn count(words: &mut Words<'_>, field: &str) -> Result<u32, IoError> {
    // An entry has at least a digit and a blank.
    let count = words.count(field, 2)?;
    u32::try_from(count).ok().filter(|&count| count < u32::MAX / 2).ok_or_else(|| words.error(field, "too large"))
}

fn index(words: &mut Words<'_>, field: &str, count: u32) -> Result<u32, IoError> {
    let value: u32 = words.number(field)?;
    let wrong = || words.error(field, format!("index {value} out of range, count is {count}"));
    (value < count).then_some(value).ok_or_else(wrong)
}

fn camera(words: &mut Words<'_>) -> Result<(Camera, Rigid3), IoError> {
    let (rotation, translation) = (Vector3::from(words.finites("rotation")?), words.finites("translation")?.into());
    let focal = words.finite("focal length")?;
    if focal <= 0.0 {
        return Err(words.error("focal length", format!("{focal} is not positive")));
    }
    let radial = [words.finite("k1")?, words.finite("k2")?];
    let camera = Camera { focal: [focal; 2], principal: [0.0; 2], radial, ..Camera::prior(0, 0) };
    let cam_from_bal =
        Rigid3::new(UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI), Vector3::zeros());
    let bal_from_world = Rigid3::new(UnitQuaternion::from_scaled_axis(rotation), translation);
    Ok((camera, cam_from_bal * bal_from_world))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_CAMERAS: &str = "2 1 2\n0 0 -3.5 2.5\n1 0 4.0 -1.0\n\
        0.1\n-0.2\n0.3\n1\n2\n-5\n700\n-0.1\n0.01\n0\n0\n0\n0\n0\n-9\n650\n0\n0\n0.5\n0.25\n-1\n";

    fn parse_text(text: &str) -> Result<Reconstruction, IoError> {
        parse(&mut Text::new(Path::new("problem.txt"), text.to_owned()).words())
    }

    #[test]
    fn projection_is_that_of_the_format() {
        let model = parse_text(TWO_CAMERAS).unwrap();
        let x = Vector3::new(0.5, 0.25, -1.0);
        let p = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.2, 0.3)) * x + Vector3::new(1.0, 2.0, -5.0);
        let (px, py) = (-p.x / p.z, -p.y / p.z);
        let r2 = px * px + py * py;
        let factor = 700.0 * (1.0 - 0.1 * r2 + 0.01 * r2 * r2);
        let image = &model.images[&ImageId(1)];
        let seen = model.camera_of(image).pixel_from_cam(image.cam_from_world * Point3::from(x)).unwrap();
        assert!((seen - Point2::new(factor * px, -factor * py)).norm() < 1e-9);
        assert_eq!(image.observations[0].pixel, Point2::new(-3.5, -2.5));
        assert_eq!(model.points[&Point3dId(1)].track.len(), 2);
    }

    #[test]
    fn a_truncated_file_is_an_error_with_its_line() {
        let last_value = TWO_CAMERAS.trim_end().len() - 2;
        for length in 0..last_value {
            match parse_text(&TWO_CAMERAS[..length]) {
                Err(IoError::Line { line, problem, .. }) => {
                    assert!(line <= TWO_CAMERAS[..length].lines().count() + 1);
                    assert!(!problem.is_empty());
                }
                other => panic!("cut at {length}: {other:?}"),
            }
        }
    }

    #[test]
    fn wrong_values_name_line_and_field() {
        let cases = [
            ("2 1 2\n0 0 1 1\n2 0 1 1\n", 3, "camera index"),
            ("2 1 2\n0 0 1 1\n1 7 1 1\n", 3, "point index"),
            ("2 1 2\n0 0 nan 1\n", 2, "pixel x"),
            ("2 1 2\n0 0 1 1e999\n", 2, "pixel y"),
            ("-2 1 2\n", 1, "number of cameras"),
            ("99999999999 1 2\n", 1, "number of cameras"),
            ("4000000000 4000000000 4000000000\n", 1, "number of cameras"),
            ("\u{fffd}\u{0}", 1, "number of cameras"),
            ("1 1 0\n0 0 0 0 0 0 -700 0 0", 2, "focal length"),
        ];
        for (text, at, name) in cases {
            match parse_text(text) {
                Err(IoError::Line { line, field, .. }) => assert_eq!((line, field.as_str()), (at, name), "{text:?}"),
                other => panic!("{text:?}: {other:?}"),
            }
        }
    }
}
