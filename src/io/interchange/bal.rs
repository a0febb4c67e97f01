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
//! On reading, cameras are turned by 180° about their x axis, so that z points forward, and the second pixel coordinate
//! changes its sign; residuals keep their length. Image sizes are not in the file and read as zero.

use std::path::Path;
use std::str::FromStr;

use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};

use crate::camera::Camera;
use crate::files;
use crate::io::IoError;
use crate::math::Rigid3;
use crate::scene::{CameraId, Image, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

/// Reads a problem: one camera of its own for every image; camera, image and point ids are the file's indices plus one.
///
/// # Errors
/// [`IoError`] with path, line and field where the file breaks off, holds what is no finite number, or an index past
/// the counts in its first line.
pub fn read(path: &Path) -> Result<Reconstruction, IoError> {
    let system = |source| IoError::System { action: "read", path: path.to_path_buf(), source };
    let bytes = files::read_text(path).map_err(system)?;
    // Bytes that are no text become signs that are no number, and are reported with their line.
    parse(path, &String::from_utf8_lossy(&bytes))
}

/// Reads a problem from text; `path` is for messages only.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, text: &str) -> Result<Reconstruction, IoError> {
    let mut words = Words::new(path, text);
    let num_images = words.count("number of cameras")?;
    let num_points = words.count("number of points")?;
    let num_observations = words.count("number of observations")?;
    let mut seen = Vec::new();
    for _ in 0..num_observations {
        let image = words.index("camera index", num_images)?;
        let point = words.index("point index", num_points)?;
        let pixel = Point2::new(words.number("pixel x")?, -words.number("pixel y")?);
        seen.push((image, point, pixel));
    }
    let mut model = Reconstruction::default();
    for index in 0..num_images {
        let (camera, cam_from_world) = words.camera()?;
        let id = index + 1;
        model.cameras.insert(CameraId(id), camera);
        let name = format!("{index:06}");
        let image = Image { name, camera: CameraId(id), cam_from_world, observations: Vec::new() };
        model.images.insert(ImageId(id), image);
    }
    for index in 0..num_points {
        let position = Point3::new(words.number("point x")?, words.number("point y")?, words.number("point z")?);
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

/// Words of a text with their line numbers.
struct Words<'a> {
    path: &'a Path,
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    words: std::str::SplitAsciiWhitespace<'a>,
    line: usize,
}

impl<'a> Words<'a> {
    fn new(path: &'a Path, text: &'a str) -> Self {
        Self { path, lines: text.lines().enumerate(), words: "".split_ascii_whitespace(), line: 1 }
    }

    fn next(&mut self, field: &str) -> Result<&'a str, IoError> {
        loop {
            if let Some(word) = self.words.next() {
                return Ok(word);
            }
            let Some((index, line)) = self.lines.next() else {
                return Err(self.fault(field, "the file ends here; it is truncated".into()));
            };
            self.line = index + 1;
            self.words = line.split_ascii_whitespace();
        }
    }

    fn parse<T: FromStr>(&mut self, field: &str, kind: &str) -> Result<T, IoError> {
        let word = self.next(field)?;
        word.parse().map_err(|_| self.fault(field, format!("{:?}: expected {kind}", shorten(word))))
    }

    fn count(&mut self, field: &str) -> Result<u32, IoError> {
        let value: u32 = self.parse(field, "a count")?;
        if value < u32::MAX / 2 { Ok(value) } else { Err(self.fault(field, format!("{value} is too large"))) }
    }

    fn index(&mut self, field: &str, count: u32) -> Result<u32, IoError> {
        let value: u32 = self.parse(field, "an index")?;
        if value < count {
            Ok(value)
        } else {
            Err(self.fault(
                field,
                format!(
                    "index {value} out of range, count is \
             {count}"
                ),
            ))
        }
    }

    fn number(&mut self, field: &str) -> Result<f64, IoError> {
        let value: f64 = self.parse(field, "a number")?;
        if value.is_finite() { Ok(value) } else { Err(self.fault(field, format!("{value} is not finite"))) }
    }

    fn camera(&mut self) -> Result<(Camera, Rigid3), IoError> {
        let mut vector = |field: &str| Ok(Vector3::new(self.number(field)?, self.number(field)?, self.number(field)?));
        let (rotation, translation) = (vector("rotation")?, vector("translation")?);
        let focal = self.number("focal length")?;
        if focal <= 0.0 {
            return Err(self.fault("focal length", format!("{focal} is not positive")));
        }
        let radial = [self.number("k1")?, self.number("k2")?];
        let camera = Camera { focal: [focal; 2], principal: [0.0; 2], radial, ..Camera::prior(0, 0) };
        let cam_from_bal =
            Rigid3::new(UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI), Vector3::zeros());
        let bal_from_world = Rigid3::new(UnitQuaternion::from_scaled_axis(rotation), translation);
        Ok((camera, cam_from_bal * bal_from_world))
    }

    fn fault(&self, field: &str, problem: String) -> IoError {
        IoError::Line { path: self.path.to_path_buf(), line: self.line, field: field.into(), problem }
    }
}

/// A word for a message: never more than a few characters of a broken file.
fn shorten(word: &str) -> String {
    word.chars().take(24).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_CAMERAS: &str = "2 1 2\n0 0 -3.5 2.5\n1 0 4.0 -1.0\n\
        0.1\n-0.2\n0.3\n1\n2\n-5\n700\n-0.1\n0.01\n0\n0\n0\n0\n0\n-9\n650\n0\n0\n0.5\n0.25\n-1\n";

    fn parse_text(text: &str) -> Result<Reconstruction, IoError> {
        parse(Path::new("problem.txt"), text)
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
    fn a_file_cut_anywhere_is_an_error_with_its_line() {
        let last_value = TWO_CAMERAS.trim_end().len() - 2;
        for length in 0..last_value {
            match parse_text(&TWO_CAMERAS[..length]) {
                Err(IoError::Line { line, problem, .. }) => {
                    assert!(line <= TWO_CAMERAS[..length].lines().count().max(1));
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
