//! Conversion of a reconstruction to the file.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::Point2;

use super::document::{Document, Entry, Extrinsic, Feature, Intrinsic, Landmark, Pointer, Polymorphic, Size, View};
use super::{FIRST_USE, PIXEL_OFFSET, SAME_TYPE};
use crate::camera::{Camera, HigherTerms, Model};
use crate::io::interchange::assembly::{Losses, Short, check_finite, written_camera};
use crate::io::{IoError, atomic};
use crate::scene::{CameraId, Image, ImageId, Point3d, Point3dId, Reconstruction};

/// Writes a reconstruction and returns the losses of the format.
///
/// # Errors
/// A system error, a number that is not finite, or a camera without an OpenMVG equivalent: two focal lengths, or
/// another distortion model.
pub fn write(path: &Path, model: &Reconstruction) -> Result<Losses, IoError> {
    check_finite(path, model)?;
    let keys = Keys::of(model);
    let mut pointers = Pointers::default();
    let document = Document {
        sfm_data_version: "0.3".to_owned(),
        root_path: String::new(),
        views: model.images.iter().map(|(id, image)| view(&keys, model, *id, image, &mut pointers)).collect(),
        intrinsics: intrinsics(path, &keys, model, &mut pointers)?,
        extrinsics: model.images.iter().map(|(id, image)| extrinsic(keys.images[id], image)).collect(),
        structure: model.points.iter().map(|(id, point)| landmark(&keys, model, *id, point)).collect(),
        control_points: [],
    };
    atomic::write_with(path, |out| Ok(serde_json::to_writer_pretty(out, &document)?))?;
    Ok(Losses::default().colors(model).unmatched_features(model))
}

/// Keys of ids: one less, or dense if that is not a valid key.
struct Keys {
    cameras: BTreeMap<CameraId, u32>,
    images: BTreeMap<ImageId, u32>,
    points: BTreeMap<Point3dId, u32>,
}

impl Keys {
    fn of(model: &Reconstruction) -> Self {
        Self {
            cameras: keys(model.cameras.keys(), |id| id.0.checked_sub(1)),
            images: keys(model.images.keys(), |id| id.0.checked_sub(1)),
            points: keys(model.points.keys(), |id| u32::try_from(id.0.checked_sub(1)?).ok().filter(|k| *k < u32::MAX)),
        }
    }
}

fn keys<'a, K: Ord + Copy + 'a>(
    ids: impl Iterator<Item = &'a K> + Clone,
    key: impl Fn(K) -> Option<u32>,
) -> BTreeMap<K, u32> {
    let own: Option<BTreeMap<K, u32>> = ids.clone().map(|id| Some((*id, key(*id)?))).collect();
    own.unwrap_or_else(|| ids.zip(0..).map(|(id, key)| (*id, key)).collect())
}

/// Numbers of cereal for pointers, and for types at their first occurrence.
#[derive(Default)]
struct Pointers {
    num_pointers: u32,
    types: Vec<&'static str>,
}

impl Pointers {
    fn wrap<T>(&mut self, data: T) -> Pointer<T> {
        self.num_pointers += 1;
        Pointer { id: FIRST_USE | self.num_pointers, data }
    }

    fn typed<T>(&mut self, name: &'static str, data: T) -> Polymorphic<T> {
        let ptr_wrapper = self.wrap(data);
        if let Some(place) = self.types.iter().position(|known| *known == name) {
            return Polymorphic { polymorphic_id: place as u32 + 1, polymorphic_name: None, ptr_wrapper };
        }
        self.types.push(name);
        let polymorphic_id = FIRST_USE | self.types.len() as u32;
        Polymorphic { polymorphic_id, polymorphic_name: Some(name.to_owned()), ptr_wrapper }
    }
}

fn view(
    keys: &Keys,
    model: &Reconstruction,
    id: ImageId,
    image: &Image,
    pointers: &mut Pointers,
) -> Entry<Polymorphic<View>> {
    let (folder, file) = image.name.rsplit_once('/').unwrap_or(("", &image.name));
    let camera = model.camera_of(image);
    let key = keys.images[&id];
    let data = View {
        local_path: folder.to_owned(),
        filename: file.to_owned(),
        width: camera.width,
        height: camera.height,
        id_view: key,
        id_intrinsic: keys.cameras[&image.camera],
        id_pose: key,
    };
    let ptr_wrapper = pointers.wrap(data);
    Entry { key, value: Polymorphic { polymorphic_id: SAME_TYPE, polymorphic_name: None, ptr_wrapper } }
}

fn intrinsics(
    path: &Path,
    keys: &Keys,
    model: &Reconstruction,
    pointers: &mut Pointers,
) -> Result<Vec<Entry<Polymorphic<Intrinsic>>>, IoError> {
    let entry = |(id, camera): (&CameraId, &Camera)| {
        let foreign = |form: Model, params: &[f64]| foreign(form, params, camera);
        let (name, data) = written_camera(path, model, *id, "OpenMVG's format", || covered(camera), foreign)?;
        Ok(Entry { key: keys.cameras[id], value: pointers.typed(name, data) })
    };
    model.cameras.iter().map(entry).collect()
}

/// Smallest OpenMVG model that can represent a camera.
fn covered(camera: &Camera) -> Result<(&'static str, Intrinsic), String> {
    let [focal, fy] = camera.focal;
    if focal != fy {
        return Err(format!("focal lengths {} and {}", Short(focal), Short(fy)));
    }
    let mut data = pinhole(camera.width, camera.height, focal, camera.principal.into());
    let ([k1, k2], HigherTerms { k3, tangential }) = (camera.radial, camera.higher);
    let name = match (tangential, [k2, k3], k1) {
        ([0.0, 0.0], [0.0, 0.0], 0.0) => "pinhole",
        ([0.0, 0.0], [0.0, 0.0], _) => {
            data.disto_k1 = vec![k1];
            "pinhole_radial_k1"
        }
        ([0.0, 0.0], ..) => {
            data.disto_k3 = vec![k1, k2, k3];
            "pinhole_radial_k3"
        }
        ([p1, p2], ..) => {
            data.disto_t2 = vec![k1, k2, k3, p1, p2];
            "pinhole_brown_t2"
        }
    };
    Ok((name, data))
}

fn foreign(form: Model, params: &[f64], camera: &Camera) -> Result<(&'static str, Intrinsic), String> {
    let Camera { width, height, .. } = *camera;
    match (form, params) {
        (Model::Equirectangular, _) => {
            Ok(("spherical", Intrinsic { value0: Some(Size { width, height }), ..Intrinsic::default() }))
        }
        (Model::OpenCvFisheye, &[fx, fy, cx, cy, ref angles @ ..]) if fx == fy => {
            let data = pinhole(width, height, fx, Point2::new(cx, cy));
            Ok(("fisheye", Intrinsic { fisheye: angles.to_vec(), ..data }))
        }
        _ => Err(format!("camera model {}", form.name())),
    }
}

fn pinhole(width: u32, height: u32, focal: f64, principal: Point2<f64>) -> Intrinsic {
    Intrinsic {
        width: Some(width),
        height: Some(height),
        focal_length: Some(focal),
        principal_point: Some([principal.x - PIXEL_OFFSET, principal.y - PIXEL_OFFSET]),
        ..Intrinsic::default()
    }
}

fn extrinsic(key: u32, image: &Image) -> Entry<Extrinsic> {
    let r = image.cam_from_world.rotation.to_rotation_matrix();
    let row = |i: usize| [r[(i, 0)], r[(i, 1)], r[(i, 2)]];
    let value = Extrinsic { rotation: [row(0), row(1), row(2)], center: image.cam_from_world.center().coords.into() };
    Entry { key, value }
}

fn landmark(keys: &Keys, model: &Reconstruction, id: Point3dId, point: &Point3d) -> Entry<Landmark> {
    let seen = point.track.iter().filter_map(|element| {
        let pixel = model.images.get(&element.image)?.observations.get(element.observation_idx as usize)?.pixel;
        let x = [pixel.x - PIXEL_OFFSET, pixel.y - PIXEL_OFFSET];
        Some(Entry { key: keys.images[&element.image], value: Feature { id_feat: element.observation_idx, x } })
    });
    let value = Landmark { position: point.position.coords.into(), observations: seen.collect() };
    Entry { key: keys.points[&id], value }
}
