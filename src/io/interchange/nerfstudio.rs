//! nerfstudio's `transforms.json`, also read by instant-ngp.
//!
//! Conventions are those of nerfstudio's documentation ("Data conventions") and of its `colmap_utils.py`.
//! `transform_matrix` is `world_from_camera` with OpenGL's camera axes, x right, y *up*, z *backwards*: its second and
//! third columns change their sign here. Pixels are counted from the corner, as here. If the program that wrote the
//! file has transformed the world, `applied_transform` (3 × 4, or 4 × 4) states the transform, which is undone.
//! Intrinsics are at the top level, or with a frame. A file without `camera_model` is read as OPENCV, with `is_fisheye`
//! as OPENCV_FISHEYE; k₄ exists with OPENCV_FISHEYE only. A missing `fl_x` follows from `camera_angle_x`, and a missing
//! size from the image file, if that is next to the file; its name may lack the ending `.png`, as in the scenes of
//! NeRF's paper.
//!
//! Ids of images are their indices in the list plus one, and their name is `file_path`. The format has no observations;
//! points are written to `sparse_pc.ply`, the value of `ply_file_path`, and are not read.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Matrix4, Point3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::assembly::{Losses, check_finite, foreign_camera, picture_size, rotation, written_camera};
use super::{model, ply};
use crate::camera::{Camera, HigherTerms, Model};
use crate::io::{IoError, atomic, json};
use crate::math::Rigid3;
use crate::scene::{CameraForm, CameraId, Image, ImageId, Reconstruction};

const POINTS: &str = "sparse_pc.ply";

#[derive(Deserialize, Serialize)]
struct Document {
    #[serde(flatten)]
    camera: Intrinsics,
    #[serde(skip_serializing_if = "Option::is_none")]
    applied_transform: Option<Vec<[f64; 4]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ply_file_path: Option<String>,
    frames: Vec<Frame>,
}

#[derive(Deserialize, Serialize)]
struct Frame {
    #[serde(flatten)]
    camera: Intrinsics,
    file_path: String,
    transform_matrix: [[f64; 4]; 4],
}

/// Intrinsics; a missing value is taken from the top level, or is zero.
#[derive(Clone, Default, PartialEq, Deserialize, Serialize)]
struct Intrinsics {
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_model: Option<String>,
    /// instant-ngp's mark of an OPENCV_FISHEYE if `camera_model` is missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    is_fisheye: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_angle_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    w: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    h: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cx: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cy: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k3: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k4: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p2: Option<f64>,
}

impl Intrinsics {
    /// Values of a frame, with those of the top level for missing ones.
    fn or(&self, top: &Self) -> Self {
        Self {
            camera_model: self.camera_model.clone().or_else(|| top.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(top.is_fisheye),
            camera_angle_x: self.camera_angle_x.or(top.camera_angle_x),
            w: self.w.or(top.w),
            h: self.h.or(top.h),
            fl_x: self.fl_x.or(top.fl_x),
            fl_y: self.fl_y.or(top.fl_y),
            cx: self.cx.or(top.cx),
            cy: self.cy.or(top.cy),
            k1: self.k1.or(top.k1),
            k2: self.k2.or(top.k2),
            k3: self.k3.or(top.k3),
            k4: self.k4.or(top.k4),
            p1: self.p1.or(top.p1),
            p2: self.p2.or(top.p2),
        }
    }

    /// Fills a missing size from the image at `name` next to the file at `path`.
    fn or_size_of(self, path: &Path, name: &str) -> Self {
        if self.w.is_some() && self.h.is_some() {
            return self;
        }
        let size = picture_size(path, name).or_else(|| picture_size(path, &format!("{name}.png")));
        size.map(|(w, h)| Self { w: Some(f64::from(w)), h: Some(f64::from(h)), ..self.clone() }).unwrap_or(self)
    }

    /// The camera, and its form if it cannot project.
    fn camera(&self) -> Result<(Camera, Option<CameraForm>), String> {
        let size = |side: Option<f64>| side.filter(|s| *s >= 1.0 && *s < 1e6).map(|s| s.round() as u32);
        let (width, height) =
            size(self.w).zip(size(self.h)).ok_or("no image size (w, h), and no image next to the file")?;
        let half = f64::from(width) / 2.0;
        let of_angle = || self.camera_angle_x.map(|angle| half / (angle / 2.0).tan());
        let fx = self.fl_x.or_else(of_angle).ok_or("no focal length (fl_x)")?;
        let fy = self.fl_y.unwrap_or(fx);
        let (cx, cy) = (self.cx.unwrap_or(half), self.cy.unwrap_or(f64::from(height) / 2.0));
        let [k1, k2, k3, k4] = [self.k1, self.k2, self.k3, self.k4].map(|k| k.unwrap_or(0.0));
        let [p1, p2] = [self.p1, self.p2].map(|p| p.unwrap_or(0.0));
        let all = [fx, fy, cx, cy, k1, k2, p1, p2, k3];
        if !(all.iter().all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0) {
            return Err("invalid camera parameters".to_owned());
        }
        let foreign = |model: Model, params: &[f64]| {
            let (camera, form) = foreign_camera(model, width, height, params);
            Ok((camera, Some(form)))
        };
        let usual = if self.is_fisheye == Some(true) { "OPENCV_FISHEYE" } else { "OPENCV" };
        match self.camera_model.as_deref().unwrap_or(usual) {
            "OPENCV_FISHEYE" => foreign(Model::OpenCvFisheye, &[fx, fy, cx, cy, k1, k2, k3, k4]),
            "EQUIRECTANGULAR" => foreign(Model::Equirectangular, &[f64::from(width), f64::from(height)]),
            "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" if k4 == 0.0 => {
                Ok((Camera::prior(width, height).with_parameters(&all).ok_or("invalid parameters")?, None))
            }
            "OPENCV" => Err("fourth radial coefficient (k4) not supported".to_owned()),
            other => Err(format!("camera_model {other} not supported")),
        }
    }

    fn of_covered(camera: &Camera) -> Self {
        let ([k1, k2], HigherTerms { k3, tangential: [p1, p2] }) = (camera.radial, camera.higher);
        let [k1, k2, k3, p1, p2] = [k1, k2, k3, p1, p2].map(Some);
        Self { camera_model: Some("OPENCV".to_owned()), k1, k2, k3, p1, p2, ..Self::of_pinhole(camera) }
    }

    fn of_foreign(form: Model, params: &[f64], camera: &Camera) -> Result<Self, String> {
        let plain = Self { camera_model: Some(form.name().to_owned()), ..Self::of_pinhole(camera) };
        match (form, params) {
            (Model::Equirectangular, _) => Ok(plain),
            (Model::OpenCvFisheye, &[_, _, _, _, k1, k2, k3, k4]) => {
                Ok(Self { k1: Some(k1), k2: Some(k2), k3: Some(k3), k4: Some(k4), ..plain })
            }
            _ => Err(format!("camera model {}", form.name())),
        }
    }

    fn of_pinhole(camera: &Camera) -> Self {
        let [w, h] = [camera.width, camera.height].map(|side| Some(f64::from(side)));
        let ([fl_x, fl_y], [cx, cy]) = (camera.focal.map(Some), camera.principal.map(Some));
        Self { w, h, fl_x, fl_y, cx, cy, ..Self::default() }
    }
}

/// Reads cameras and poses; equal intrinsics become one camera.
///
/// # Errors
/// A missing file, JSON of another structure, intrinsics that are missing or of an unknown kind, or a matrix that is
/// not rigid.
pub fn read(path: &Path) -> Result<Reconstruction, IoError> {
    read_with(path, model::Intrinsics::Required)
}

pub(super) fn read_with(path: &Path, wanted: model::Intrinsics) -> Result<Reconstruction, IoError> {
    let document: Document = json::read_model(path, "nerfstudio's transforms.json")?;
    let world_from_moved = world_from_moved(&document.applied_transform)
        .ok_or_else(|| IoError::content(path, "applied_transform is not a rigid transform"))?;
    let mut model = Reconstruction::default();
    let mut known: Vec<Intrinsics> = Vec::new();
    for (index, frame) in (1..).zip(&document.frames) {
        let problem = |what: String| IoError::content(path, format!("frame '{}': {what}", frame.file_path));
        let intrinsics = frame.camera.or(&document.camera).or_size_of(path, &frame.file_path);
        let place = known.iter().position(|other| *other == intrinsics).unwrap_or(known.len());
        let camera = CameraId(place as u32 + 1);
        if place == known.len() {
            let (values, form) = match intrinsics.camera() {
                Err(_) if wanted == model::Intrinsics::Optional => (Camera::prior(1, 1), Some(CameraForm::Unknown)),
                found => found.map_err(problem)?,
            };
            model.cameras.insert(camera, values);
            model.camera_forms.extend(form.map(|form| (camera, form)));
            known.push(intrinsics);
        }
        let moved_from_cam = rigid(&frame.transform_matrix)
            .ok_or_else(|| problem("transform_matrix is not a rigid transform".to_owned()))?;
        let cam_from_world = (world_from_moved * moved_from_cam * flip()).inverse();
        let name = frame.file_path.trim_start_matches("./").to_owned();
        model.images.insert(ImageId(index), Image { name, camera, cam_from_world, observations: Vec::new() });
    }
    if model.images.is_empty() {
        return Err(IoError::content(path, "no frame in the file"));
    }
    Ok(model)
}

/// Half a turn about the camera's x axis: from OpenGL's axes to ours, and back.
fn flip() -> Rigid3 {
    Rigid3::new(UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI), Vector3::zeros())
}

fn world_from_moved(applied: &Option<Vec<[f64; 4]>>) -> Option<Rigid3> {
    let Some(rows) = applied else { return Some(Rigid3::identity()) };
    let [a, b, c, ..] = rows[..] else { return None };
    Some(rigid(&[a, b, c, [0.0, 0.0, 0.0, 1.0]])?.inverse())
}

fn rigid(rows: &[[f64; 4]; 4]) -> Option<Rigid3> {
    let matrix = Matrix4::from_fn(|i, j| rows[i][j]);
    let turn: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into();
    let translation: Vector3<f64> = matrix.fixed_view::<3, 1>(0, 3).into();
    let is_affine = rows[3] == [0.0, 0.0, 0.0, 1.0] && translation.iter().all(|v| v.is_finite());
    rotation(&turn).filter(|_| is_affine).map(|rotation| Rigid3::new(rotation, translation))
}

/// The files that are written: cameras, and points.
pub fn files(path: &Path) -> [PathBuf; 2] {
    [path.to_path_buf(), path.with_file_name(POINTS)]
}

/// Writes cameras, poses and points, and returns the losses of the format.
///
/// # Errors
/// A system error, a number that is not finite, or a camera model that nerfstudio does not have.
pub fn write(path: &Path, model: &Reconstruction) -> Result<Losses, IoError> {
    check_finite(path, model)?;
    let cameras = model
        .cameras
        .iter()
        .map(|(id, camera)| {
            let covered = || Ok(Intrinsics::of_covered(camera));
            let foreign = |form: Model, params: &[f64]| Intrinsics::of_foreign(form, params, camera);
            Ok((*id, written_camera(path, model, *id, "nerfstudio's format", covered, foreign)?))
        })
        .collect::<Result<std::collections::BTreeMap<CameraId, Intrinsics>, IoError>>()?;
    let used: std::collections::BTreeSet<_> = model.images.values().map(|image| image.camera).collect();
    let only = used.first().filter(|_| used.len() == 1).map(|id| cameras[id].clone());
    let frame = |image: &Image| Frame {
        camera: if only.is_some() { Intrinsics::default() } else { cameras[&image.camera].clone() },
        file_path: image.name.clone(),
        transform_matrix: matrix(&(image.cam_from_world.inverse() * flip())),
    };
    let frames = model.images.values().map(frame).collect();
    let [json, cloud] = files(path);
    let points: Vec<(Point3<f64>, [u8; 3])> = model.points.values().map(|p| (p.position, p.rgb)).collect();
    ply::write_points(&cloud, &points)?;
    let ply_file_path = Some(POINTS.to_owned());
    let document = Document { camera: only.unwrap_or_default(), applied_transform: None, ply_file_path, frames };
    atomic::write_json(&json, &document)?;
    let num_features = model.images.values().map(|image| image.observations.len()).sum();
    Ok(Losses::default().counted(
        num_features,
        "feature skipped: the format stores none",
        "features skipped: the format stores none",
    ))
}

fn matrix(pose: &Rigid3) -> [[f64; 4]; 4] {
    let r = pose.rotation.to_rotation_matrix();
    let t = pose.translation;
    let row = |i: usize| [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::testing::{damaged_text_never_panics, odd_model};

    const GOLDEN: &str = r#"{"camera_model": "OPENCV", "fl_x": 500.0, "fl_y": 510.0, "cx": 320.0, "cy": 240.0, "w": 640,
        "h": 480, "k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4, "aabb_scale": 16,
        "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]],
        "frames": [{"file_path": "./images/a.jpg", "colmap_im_id": 1, "transform_matrix":
        [[1, 0, 0, 1], [0, 0, -1, 3], [0, 1, 0, -2], [0, 0, 0, 1]]}]}"#;

    fn read_text(text: &str) -> Result<Reconstruction, IoError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        std::fs::write(&path, text).unwrap();
        read(&path)
    }

    /// COLMAP's camera at (1, 2, 3) whose axes are the world's: nerfstudio turns y and z of the camera, then exchanges
    /// y and z of the world and turns the latter's sign, which `applied_transform` says.
    #[test]
    fn axes_of_camera_and_world_are_converted_to_our_conventions() {
        let model = read_text(GOLDEN).unwrap();
        let image = &model.images[&ImageId(1)];
        assert_eq!(image.name, "images/a.jpg");
        assert!((image.cam_from_world.center() - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-12, "{image:?}");
        assert!(image.cam_from_world.rotation.angle() < 1e-7, "{image:?}");
        let expected = [500.0, 510.0, 320.0, 240.0, 0.1, 0.2, 0.3, 0.4, 0.0];
        assert_eq!(model.cameras[&CameraId(1)].parameters(), expected);
    }

    #[test]
    fn cameras_and_poses_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        let model = odd_model();
        assert_eq!(write(&path, &model).unwrap().sentences().len(), 1);
        assert!(folder.path().join(POINTS).is_file());
        let found = read(&path).unwrap();
        for (a, b) in found.images.values().zip(model.images.values()) {
            let apart = a.cam_from_world * b.cam_from_world.inverse();
            assert!(a.name == b.name && apart.rotation.angle() < 1e-7 && apart.translation.norm() < 1e-12);
            assert_eq!(found.camera_of(a), model.camera_of(b));
        }
    }

    #[test]
    fn missing_values_are_reported() {
        let says = |from: &str, to: &str| read_text(&GOLDEN.replace(from, to)).unwrap_err().to_string();
        assert!(says("\"w\": 640,", "").contains("frame './images/a.jpg': no image size (w, h)"));
        assert!(says("\"k2\"", "\"k4\"").contains("fourth radial"));
        assert!(says("\"OPENCV\"", "\"FISHEYE624\"").contains("camera_model FISHEYE624"));
        let sizeless = GOLDEN.replace("\"w\": 640,", "");
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.json"), sizeless).unwrap();
        let poses = model::read_poses(&folder.path().join("a.json")).unwrap().0;
        assert!(poses.images.len() == 1 && !poses.can_project(CameraId(1)));
        let fisheye = GOLDEN.replace("\"camera_model\": \"OPENCV\"", "\"is_fisheye\": true");
        let form = CameraForm::Foreign(Model::OpenCvFisheye, vec![500.0, 510.0, 320.0, 240.0, 0.1, 0.2, 0.0, 0.0]);
        assert_eq!(read_text(&fisheye).unwrap().camera_forms[&CameraId(1)], form);
        assert!(says("[[1, 0, 0, 1]", "[[2, 0, 0, 1]").contains("transform_matrix is not a rigid transform"));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        let sizeless = GOLDEN.replace("\"w\": 640,", "").replace("\"h\": 480,", "").replace("a.jpg", "a");
        std::fs::write(&path, sizeless).unwrap();
        std::fs::create_dir(folder.path().join("images")).unwrap();
        image::GrayImage::new(64, 48).save(folder.path().join("images/a.png")).unwrap();
        let found = read(&path).unwrap();
        assert_eq!((found.cameras[&CameraId(1)].width, found.cameras[&CameraId(1)].height), (64, 48));
        let angle = GOLDEN.replace("\"fl_x\": 500.0, \"fl_y\": 510.0", "\"camera_angle_x\": 1.5707963267948966");
        assert!((read_text(&angle).unwrap().cameras[&CameraId(1)].focal[1] - 320.0).abs() < 1e-9);
        damaged_text_never_panics(GOLDEN, |text| read_text(text).is_ok());
    }
}
