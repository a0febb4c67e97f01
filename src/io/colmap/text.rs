//! The text files: fields separated by blanks, `#` before comments, two lines per image.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::str::FromStr;

use nalgebra::{Point2, Point3, Vector3};

use super::{Cameras, camera_model, unit_quaternion};
use crate::camera::Model;
use crate::io::IoError;
use crate::limits::files;
use crate::math::Rigid3;
use crate::scene::{CameraId, Image, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

pub fn read_cameras(path: &Path) -> Result<Cameras, IoError> {
    let content = read_file(path)?;
    let (mut cameras, mut forms) = Cameras::default();
    for mut line in records(path, &content) {
        let id = CameraId(line.number("camera id")?);
        let name = line.word("camera model")?;
        let model = Model::by_name(name).ok_or_else(|| camera_model::unknown(path, id, name))?;
        let (width, height) = (line.number("width")?, line.number("height")?);
        if width == 0 || height == 0 {
            return Err(line.error("image size", "must not be zero"));
        }
        let params = (0..model.num_params()).map(|_| line.finite("camera parameter")).collect::<Result<Vec<_>, _>>()?;
        line.end()?;
        let (camera, form) = camera_model::camera(model, width, height, params);
        forms.insert(id, form);
        if cameras.insert(id, camera).is_some() {
            return Err(line.error("camera id", format!("{} occurs twice", id.0)));
        }
    }
    Ok((cameras, forms))
}

pub fn read_images(path: &Path) -> Result<BTreeMap<ImageId, Image>, IoError> {
    let content = read_file(path)?;
    let mut images = BTreeMap::new();
    let mut lines = numbered(path, &content);
    // The second line of an image may be empty, so only the first is searched for.
    while let Some(mut line) = lines.find(Line::is_record) {
        let id = ImageId(line.number("image id")?);
        let quaternion = [line.finite("qw")?, line.finite("qx")?, line.finite("qy")?, line.finite("qz")?];
        let rotation = unit_quaternion(quaternion).map_err(|problem| line.error("qw qx qy qz", problem))?;
        let translation = Vector3::new(line.finite("tx")?, line.finite("ty")?, line.finite("tz")?);
        let camera = CameraId(line.number("camera id")?);
        let name = line.rest("name")?;
        let observations = lines.next().map_or(Ok(Vec::new()), observations)?;
        let cam_from_world = Rigid3::new(rotation, translation);
        if images.insert(id, Image { name, camera, cam_from_world, observations }).is_some() {
            return Err(line.error("image id", format!("{} occurs twice", id.0)));
        }
    }
    Ok(images)
}

fn observations(mut line: Line<'_>) -> Result<Vec<Observation>, IoError> {
    let mut observations = Vec::new();
    while !line.is_at_end() {
        let pixel = Point2::new(line.finite("x")?, line.finite("y")?);
        let id: i64 = line.number("point id")?;
        let point = match id {
            -1 => None,
            id => Some(Point3dId(u64::try_from(id).map_err(|_| line.error("point id", format!("{id} is negative")))?)),
        };
        observations.push(Observation { pixel, point });
    }
    Ok(observations)
}

pub fn read_points(path: &Path) -> Result<BTreeMap<Point3dId, Point3d>, IoError> {
    let content = read_file(path)?;
    let mut points = BTreeMap::new();
    for mut line in records(path, &content) {
        let id = Point3dId(line.number("point id")?);
        let position = Point3::new(line.finite("x")?, line.finite("y")?, line.finite("z")?);
        let rgb = [line.number("red")?, line.number("green")?, line.number("blue")?];
        let error_px = line.finite("error")?;
        let mut track = Vec::new();
        while !line.is_at_end() {
            let image = ImageId(line.number("image id of a track")?);
            track.push(TrackElement { image, observation_idx: line.number("observation index of a track")? });
        }
        if points.insert(id, Point3d { position, rgb, error_px, track }).is_some() {
            return Err(line.error("point id", format!("{} occurs twice", id.0)));
        }
    }
    Ok(points)
}

pub fn write_cameras(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    writeln!(out, "# Cameras, one per line: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")?;
    writeln!(out, "# Number of cameras: {}", model.cameras.len())?;
    for (id, camera) in &model.cameras {
        let (kind, params) = camera_model::written(model, *id, camera);
        write!(out, "{} {} {} {}", id.0, kind.name(), camera.width, camera.height)?;
        params.iter().try_for_each(|value| write!(out, " {value}"))?;
        writeln!(out)?;
    }
    Ok(())
}

pub fn write_images(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    writeln!(out, "# Images, two lines each: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")?;
    writeln!(out, "# and the observations: (X Y POINT3D_ID)[], where -1 is no point")?;
    writeln!(out, "# Number of images: {}", model.images.len())?;
    for (id, image) in &model.images {
        let (q, t) = (image.cam_from_world.rotation, image.cam_from_world.translation);
        write!(out, "{} {} {} {} {} {} {} {}", id.0, q.w, q.i, q.j, q.k, t.x, t.y, t.z)?;
        writeln!(out, " {} {}", image.camera.0, image.name)?;
        for (index, observation) in image.observations.iter().enumerate() {
            let blank = if index == 0 { "" } else { " " };
            write!(out, "{blank}{} {} ", observation.pixel.x, observation.pixel.y)?;
            match observation.point {
                Some(point) => write!(out, "{}", point.0)?,
                None => write!(out, "-1")?,
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

pub fn write_points(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    writeln!(out, "# Points, one per line: POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]")?;
    writeln!(out, "# Number of points: {}", model.points.len())?;
    for (id, point) in &model.points {
        let (p, [r, g, b]) = (point.position, point.rgb);
        write!(out, "{} {} {} {} {r} {g} {b} {}", id.0, p.x, p.y, p.z, point.error_px)?;
        point.track.iter().try_for_each(|e| write!(out, " {} {}", e.image.0, e.observation_idx))?;
        writeln!(out)?;
    }
    Ok(())
}

/// A line of a file and how far it is read.
struct Line<'a> {
    path: &'a Path,
    /// From 1.
    number: usize,
    rest: &'a str,
}

fn read_file(path: &Path) -> Result<String, IoError> {
    let bytes = files::read_text(path).map_err(IoError::system("read", path))?;
    String::from_utf8(bytes).map_err(|_| IoError::content(path, "is not a text file (UTF-8)"))
}

fn numbered<'a>(path: &'a Path, content: &'a str) -> impl Iterator<Item = Line<'a>> {
    content.lines().enumerate().map(move |(idx, text)| Line { path, number: idx + 1, rest: text.trim() })
}

/// The lines that are neither empty nor comments.
fn records<'a>(path: &'a Path, content: &'a str) -> impl Iterator<Item = Line<'a>> {
    numbered(path, content).filter(Line::is_record)
}

impl<'a> Line<'a> {
    fn is_record(&self) -> bool {
        !self.rest.is_empty() && !self.rest.starts_with('#')
    }

    fn is_at_end(&self) -> bool {
        self.rest.is_empty()
    }

    fn error(&self, field: &str, problem: impl Into<String>) -> IoError {
        IoError::Line { path: self.path.into(), line: self.number, field: field.into(), problem: problem.into() }
    }

    fn word(&mut self, field: &str) -> Result<&'a str, IoError> {
        let (word, rest) = self.rest.split_once(char::is_whitespace).unwrap_or((self.rest, ""));
        if word.is_empty() {
            return Err(self.error(field, "the line ends before it"));
        }
        self.rest = rest.trim_start();
        Ok(word)
    }

    fn number<T: FromStr>(&mut self, field: &str) -> Result<T, IoError> {
        let word = self.word(field)?;
        word.parse().map_err(|_| self.error(field, format!("'{word}' is not a number in its range")))
    }

    fn finite(&mut self, field: &str) -> Result<f64, IoError> {
        let value: f64 = self.number(field)?;
        if value.is_finite() { Ok(value) } else { Err(self.error(field, format!("{value} is not a finite number"))) }
    }

    /// All that is left, which must not be nothing.
    fn rest(&mut self, field: &str) -> Result<String, IoError> {
        let rest = std::mem::take(&mut self.rest);
        if rest.is_empty() { Err(self.error(field, "the line ends before it")) } else { Ok(rest.into()) }
    }

    fn end(&self) -> Result<(), IoError> {
        if self.is_at_end() { Ok(()) } else { Err(self.error("end of line", format!("'{}' is too much", self.rest))) }
    }
}
