//! The binary files: little-endian, no padding, counts as 64-bit numbers.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use nalgebra::{Point2, Point3, Vector3};

use super::{Cameras, camera_model, unit_quaternion};
use crate::camera::Model;
use crate::io::IoError;
use crate::io::interchange::bytes::Bytes;
use crate::math::Rigid3;
use crate::scene::{CameraId, Image, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

/// Mark in a binary file of an observation without a point.
const NO_POINT: u64 = u64::MAX;

/// Minimum bytes of one camera, image, observation, point or track element.
const MIN_BYTES: [usize; 5] = [24 + 2 * 8, 64 + 8 + 1, 24, 43 + 8, 8];

pub fn read_cameras(path: &Path) -> Result<Cameras, IoError> {
    let content = Bytes::read_file(path)?;
    let mut bytes = content.cursor();
    let count = bytes.count("number of cameras", MIN_BYTES[0])?;
    let (mut cameras, mut forms) = Cameras::default();
    for _ in 0..count {
        let id = CameraId(bytes.u32("camera id")?);
        let model_id = bytes.i32("camera model")?;
        let (width, height) = (bytes.u64("width")?, bytes.u64("height")?);
        let unknown = || camera_model::unknown(path, id, &model_id.to_string());
        let model = Model::by_id(model_id).ok_or_else(unknown)?;
        let params =
            (0..model.num_params()).map(|_| bytes.finite("camera parameter")).collect::<Result<Vec<_>, _>>()?;
        let [width, height] = [width, height].map(|v| u32::try_from(v).ok().filter(|v| *v > 0));
        let (Some(width), Some(height)) = (width, height) else {
            return Err(bytes.error("image size", "expected 1 to 2³² − 1"));
        };
        let (camera, form) = camera_model::camera(model, width, height, params);
        forms.insert(id, form);
        if cameras.insert(id, camera).is_some() {
            return Err(bytes.error("camera id", format!("{} occurs twice", id.0)));
        }
    }
    bytes.end()?;
    Ok((cameras, forms))
}

pub fn read_images(path: &Path) -> Result<BTreeMap<ImageId, Image>, IoError> {
    let content = Bytes::read_file(path)?;
    let mut bytes = content.cursor();
    let count = bytes.count("number of images", MIN_BYTES[1])?;
    let mut images = BTreeMap::new();
    for _ in 0..count {
        let id = ImageId(bytes.u32("image id")?);
        let mut pose = [0.0; 7];
        for value in &mut pose {
            *value = bytes.finite("pose")?;
        }
        let [qw, qx, qy, qz, tx, ty, tz] = pose;
        let rotation = unit_quaternion([qw, qx, qy, qz]).map_err(|problem| bytes.error("pose", problem))?;
        let cam_from_world = Rigid3::new(rotation, Vector3::new(tx, ty, tz));
        let camera = CameraId(bytes.u32("camera id")?);
        let name = bytes.c_string("image name")?;
        let num_observations = bytes.count("number of observations", MIN_BYTES[2])?;
        let mut observations = Vec::with_capacity(num_observations);
        for _ in 0..num_observations {
            let pixel = Point2::new(bytes.finite("x")?, bytes.finite("y")?);
            let point = bytes.u64("point id")?;
            observations.push(Observation { pixel, point: (point != NO_POINT).then_some(Point3dId(point)) });
        }
        if images.insert(id, Image { name, camera, cam_from_world, observations }).is_some() {
            return Err(bytes.error("image id", format!("{} occurs twice", id.0)));
        }
    }
    bytes.end()?;
    Ok(images)
}

pub fn read_points(path: &Path) -> Result<BTreeMap<Point3dId, Point3d>, IoError> {
    let content = Bytes::read_file(path)?;
    let mut bytes = content.cursor();
    let count = bytes.count("number of points", MIN_BYTES[3])?;
    let mut points = BTreeMap::new();
    for _ in 0..count {
        let id = Point3dId(bytes.u64("point id")?);
        let position = Point3::new(bytes.finite("x")?, bytes.finite("y")?, bytes.finite("z")?);
        let rgb = [bytes.u8("red")?, bytes.u8("green")?, bytes.u8("blue")?];
        let error_px = bytes.finite("error")?;
        let length = bytes.count("track length", MIN_BYTES[4])?;
        let mut track = Vec::with_capacity(length);
        for _ in 0..length {
            let image = ImageId(bytes.u32("image id of a track")?);
            track.push(TrackElement { image, observation_idx: bytes.u32("observation index of a track")? });
        }
        if points.insert(id, Point3d { position, rgb, error_px, track }).is_some() {
            return Err(bytes.error("point id", format!("{} occurs twice", id.0)));
        }
    }
    bytes.end()?;
    Ok(points)
}

pub fn write_cameras(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    out.write_all(&(model.cameras.len() as u64).to_le_bytes())?;
    for (id, camera) in &model.cameras {
        let (kind, params) = camera_model::written(model, *id, camera);
        out.write_all(&id.0.to_le_bytes())?;
        out.write_all(&kind.id().to_le_bytes())?;
        out.write_all(&u64::from(camera.width).to_le_bytes())?;
        out.write_all(&u64::from(camera.height).to_le_bytes())?;
        write_doubles(out, &params)?;
    }
    Ok(())
}

pub fn write_images(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    out.write_all(&(model.images.len() as u64).to_le_bytes())?;
    for (id, image) in &model.images {
        let (q, t) = (image.cam_from_world.rotation, image.cam_from_world.translation);
        out.write_all(&id.0.to_le_bytes())?;
        write_doubles(out, &[q.w, q.i, q.j, q.k, t.x, t.y, t.z])?;
        out.write_all(&image.camera.0.to_le_bytes())?;
        out.write_all(image.name.as_bytes())?;
        out.write_all(&[0])?;
        out.write_all(&(image.observations.len() as u64).to_le_bytes())?;
        for observation in &image.observations {
            write_doubles(out, &[observation.pixel.x, observation.pixel.y])?;
            out.write_all(&observation.point.map_or(NO_POINT, |p| p.0).to_le_bytes())?;
        }
    }
    Ok(())
}

pub fn write_points(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    out.write_all(&(model.points.len() as u64).to_le_bytes())?;
    for (id, point) in &model.points {
        out.write_all(&id.0.to_le_bytes())?;
        write_doubles(out, point.position.coords.as_slice())?;
        out.write_all(&point.rgb)?;
        write_doubles(out, &[point.error_px])?;
        out.write_all(&(point.track.len() as u64).to_le_bytes())?;
        for element in &point.track {
            out.write_all(&element.image.0.to_le_bytes())?;
            out.write_all(&element.observation_idx.to_le_bytes())?;
        }
    }
    Ok(())
}

pub fn write_doubles(out: &mut dyn Write, values: &[f64]) -> std::io::Result<()> {
    values.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}
