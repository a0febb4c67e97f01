//! The text files: fields separated by blanks, `#` before comments, two lines per image. One line of a file is in
//! memory at a time: text takes more memory than its values.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::path::Path;
use std::str::FromStr;

use nalgebra::{Point2, Point3, Vector3};

use super::{Cameras, camera_model, unit_quaternion};
use crate::camera::Model;
use crate::files;
use crate::io::IoError;
use crate::math::Rigid3;
use crate::scene::{CameraId, Image, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

pub fn read_cameras(path: &Path) -> Result<Cameras, IoError> {
    let mut lines = Lines::open(path)?;
    let (mut cameras, mut forms) = Cameras::default();
    while lines.advance_to_record()? {
        let mut line = lines.line();
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
    let mut lines = Lines::open(path)?;
    let mut images = BTreeMap::new();
    // The second line of an image may be empty, so only the first is searched for.
    while lines.advance_to_record()? {
        let mut line = lines.line();
        let id = ImageId(line.number("image id")?);
        if images.contains_key(&id) {
            return Err(line.error("image id", format!("{} occurs twice", id.0)));
        }
        let quaternion = [line.finite("qw")?, line.finite("qx")?, line.finite("qy")?, line.finite("qz")?];
        let rotation = unit_quaternion(quaternion).map_err(|problem| line.error("qw qx qy qz", problem))?;
        let translation = Vector3::new(line.finite("tx")?, line.finite("ty")?, line.finite("tz")?);
        let camera = CameraId(line.number("camera id")?);
        let name = line.rest("name")?;
        let observations = if lines.advance()? { observations(lines.line())? } else { Vec::new() };
        let cam_from_world = Rigid3::new(rotation, translation);
        images.insert(id, Image { name, camera, cam_from_world, observations });
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
    observations.shrink_to_fit();
    Ok(observations)
}

pub fn read_points(path: &Path) -> Result<BTreeMap<Point3dId, Point3d>, IoError> {
    let mut lines = Lines::open(path)?;
    let mut points = BTreeMap::new();
    while lines.advance_to_record()? {
        let mut line = lines.line();
        let id = Point3dId(line.number("point id")?);
        let position = Point3::new(line.finite("x")?, line.finite("y")?, line.finite("z")?);
        let rgb = [line.number("red")?, line.number("green")?, line.number("blue")?];
        let error_px = line.finite("error")?;
        let mut track = Vec::new();
        while !line.is_at_end() {
            let image = ImageId(line.number("image id of a track")?);
            track.push(TrackElement { image, observation_idx: line.number("observation index of a track")? });
        }
        track.shrink_to_fit();
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

/// File that is read line by line.
struct Lines<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    /// Line read last.
    text: String,
    /// Its number, from 1; 0 before the first.
    number: usize,
}

/// Line of a file and the reading position in it.
struct Line<'a> {
    path: &'a Path,
    /// From 1.
    number: usize,
    rest: &'a str,
}

impl<'a> Lines<'a> {
    fn open(path: &'a Path) -> Result<Self, IoError> {
        let file = files::open_within_memory(path).map_err(IoError::system("read", path))?;
        Ok(Self { path, reader: BufReader::new(file), text: String::new(), number: 0 })
    }

    /// Reads the next line; `false` at the end of the file.
    fn advance(&mut self) -> Result<bool, IoError> {
        self.text.clear();
        let length = self.reader.read_line(&mut self.text).map_err(|error| match error.kind() {
            ErrorKind::InvalidData => IoError::content(self.path, "not a text file (UTF-8)"),
            _ => IoError::system("read", self.path)(error),
        })?;
        if self.number == 0 && self.text.starts_with(files::BYTE_ORDER_CHAR) {
            self.text.drain(..files::BYTE_ORDER_CHAR.len_utf8());
        }
        self.number += 1;
        Ok(length > 0)
    }

    /// Advances to the next line that is neither empty nor a comment.
    fn advance_to_record(&mut self) -> Result<bool, IoError> {
        while self.advance()? {
            if self.line().is_record() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Returns the line read last.
    fn line(&self) -> Line<'_> {
        Line { path: self.path, number: self.number, rest: self.text.trim() }
    }
}

impl<'a> Line<'a> {
    fn is_record(&self) -> bool {
        !self.rest.is_empty() && !self.rest.starts_with('#')
    }

    fn is_at_end(&self) -> bool {
        self.rest.is_empty()
    }

    fn error(&self, field: &str, problem: impl Into<String>) -> IoError {
        IoError::line(self.path, self.number, field, problem)
    }

    fn word(&mut self, field: &str) -> Result<&'a str, IoError> {
        let (word, rest) = self.rest.split_once(char::is_whitespace).unwrap_or((self.rest, ""));
        if word.is_empty() {
            return Err(self.error(field, "the line ends here"));
        }
        self.rest = rest.trim_start();
        Ok(word)
    }

    fn number<T: FromStr>(&mut self, field: &str) -> Result<T, IoError> {
        let word = self.word(field)?;
        word.parse().map_err(|_| self.error(field, format!("'{word}' is not a number in the valid range")))
    }

    fn finite(&mut self, field: &str) -> Result<f64, IoError> {
        let value: f64 = self.number(field)?;
        if value.is_finite() { Ok(value) } else { Err(self.error(field, format!("{value} is not a finite number"))) }
    }

    /// Reads the rest of the line, which must not be empty.
    fn rest(&mut self, field: &str) -> Result<String, IoError> {
        let rest = std::mem::take(&mut self.rest);
        if rest.is_empty() { Err(self.error(field, "the line ends here")) } else { Ok(rest.into()) }
    }

    fn end(&self) -> Result<(), IoError> {
        if self.is_at_end() { Ok(()) } else { Err(self.error("end of line", format!("unexpected '{}'", self.rest))) }
    }
}
