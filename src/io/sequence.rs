//! Ground-truth sequences: `scene.json` with poses, images or a video, label maps, and the vehicle's mesh.
//!
//! `docs/formats.md` describes the folder. Poses in `scene.json` are `T_world_camera` and `T_world_object`, 4 × 4,
//! row-major; here they become `cam_from_world` and `world_from_object`.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::extent::is_sensible;
use super::interchange::ply;
use super::{IoError, json, masks};
use crate::camera::Camera;
use crate::math::Rigid3;
use crate::scene::{FrameId, LabelMap, Mask, TriangleMesh};

/// Label of the target vehicle in a sequence's masks.
pub const TARGET_LABEL: u8 = 1;

/// Label of the ground in a sequence's semantic maps.
pub const GROUND_LABEL: u8 = 3;

/// Sequence with ground truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// Its folder.
    pub folder: PathBuf,
    /// Its name.
    pub name: String,
    /// Type of the target vehicle, if stated.
    pub vehicle: Option<String>,
    /// Type of its trajectory, if stated.
    pub trajectory: Option<String>,
    /// Frames per second.
    pub fps: f64,
    /// Camera of all frames, without distortion.
    pub camera: Camera,
    /// Its frames, ascending by index.
    pub frames: Vec<SequenceFrame>,
}

/// Frame with its ground truth.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceFrame {
    /// Index: frame k of the video.
    pub id: FrameId,
    /// File name of its image, without folder.
    pub name: String,
    /// Its image, which need not exist if the video does.
    pub image: PathBuf,
    /// Its label map: 0 background, 1 the target, others moving objects.
    pub mask: PathBuf,
    /// Its semantic map; 3 is ground.
    pub semantic: Option<PathBuf>,
    /// Time, seconds.
    pub time_s: f64,
    /// Pose of the camera; the world is in meters.
    pub cam_from_world: Rigid3,
    /// Pose of the target.
    pub world_from_object: Rigid3,
    /// Visible share of the target's silhouette, 0 to 1, if stated.
    pub visible_share: Option<f64>,
}

#[derive(Deserialize)]
struct Document {
    name: Option<String>,
    vehicle: Option<String>,
    trajectory: Option<String>,
    units: String,
    fps: f64,
    width: u32,
    height: u32,
    #[serde(rename = "K")]
    k: [[f64; 3]; 3],
    frames: Vec<FrameDocument>,
}

#[derive(Deserialize)]
struct FrameDocument {
    index: u32,
    image: PathBuf,
    mask: PathBuf,
    semantic: Option<PathBuf>,
    time_s: f64,
    #[serde(rename = "T_world_camera")]
    world_from_cam: [[f64; 4]; 4],
    #[serde(rename = "T_world_object")]
    world_from_object: [[f64; 4]; 4],
    visible_share: Option<f64>,
}

impl Sequence {
    /// Reads `scene.json` of a folder; images, masks and mesh are read on demand.
    ///
    /// # Errors
    /// A missing file, JSON of another structure, units other than meters, a matrix K with skew, a pose that is not
    /// rigid, or frames out of order.
    pub fn open(folder: &Path) -> Result<Self, IoError> {
        let path = folder.join("scene.json");
        let mut document: Document = json::read(&path)?;
        if document.units != "metre" {
            return Err(IoError::unsupported(&path, format!("unit '{}'", document.units), "give lengths in 'metre'"));
        }
        let camera = camera(&path, &document)?;
        if !(document.fps > 0.0 && document.fps.is_finite()) {
            return Err(IoError::content(&path, format!("fps {}: not positive", document.fps)));
        }
        let frames: Vec<_> =
            std::mem::take(&mut document.frames).into_iter().map(|f| frame(&path, f)).collect::<Result<_, _>>()?;
        if let Some(pair) = frames.windows(2).find(|pair| pair[0].id >= pair[1].id) {
            return Err(IoError::content(&path, format!("frame {} is out of order", pair[1].id.0)));
        }
        let Document { name, vehicle, trajectory, fps, .. } = document;
        let name = name.unwrap_or_else(|| folder_name(folder));
        Ok(Self { folder: folder.to_path_buf(), name, vehicle, trajectory, fps, camera, frames })
    }

    /// Width and height of every frame, pixels.
    pub fn frame_size(&self) -> (u32, u32) {
        (self.camera.width, self.camera.height)
    }

    /// The video, if there is one.
    pub fn video(&self) -> Option<PathBuf> {
        Some(self.folder.join("video.mp4")).filter(|path| path.is_file())
    }

    /// Input of a run: the image folder if it exists, otherwise the video.
    ///
    /// # Errors
    /// A sequence without frames, or with neither images nor video.
    pub fn input(&self) -> Result<PathBuf, IoError> {
        let scene = self.folder.join("scene.json");
        let first = self.frames.first().ok_or_else(|| IoError::content(&scene, "no frames in the sequence"))?;
        let pictures = self.folder.join(first.image.parent().unwrap_or(Path::new("")));
        if self.folder.join(&first.image).is_file() {
            return Ok(pictures);
        }
        self.video().ok_or_else(|| {
            let name = first.image.display();
            IoError::content(
                &scene,
                format!("neither {name} nor video.mp4 found; render the sequence, or copy it completely"),
            )
        })
    }

    /// The frame with this index.
    pub fn frame(&self, id: FrameId) -> Option<&SequenceFrame> {
        self.frames.binary_search_by_key(&id, |frame| frame.id).ok().map(|index| &self.frames[index])
    }

    /// Frame of an image name of an output: the name of its image file, or the six digits of its index, which name the
    /// frames of a video.
    pub fn frame_named(&self, image_name: &str) -> Option<&SequenceFrame> {
        let by_name = self.frames.iter().find(|frame| frame.name == image_name);
        by_name.or_else(|| {
            let digits = image_name.strip_suffix(".jpg").filter(|stem| stem.len() == 6)?;
            self.frame(FrameId(digits.parse().ok()?))
        })
    }

    /// Labels of a frame's pixels: 0 background, 1 the target, others moving objects.
    pub fn labels(&self, frame: &SequenceFrame) -> Result<LabelMap, IoError> {
        masks::read_label_map(&self.folder.join(&frame.mask), self.frame_size())
    }

    /// Mask of the target in a frame.
    pub fn target_mask(&self, frame: &SequenceFrame) -> Result<Mask, IoError> {
        Ok(self.labels(frame)?.mask(TARGET_LABEL))
    }

    /// Mask of the ground in a frame; `None` if the sequence has no semantic map for it.
    pub fn ground_mask(&self, frame: &SequenceFrame) -> Result<Option<Mask>, IoError> {
        let read = |path| masks::read_label_map(&self.folder.join(path), self.frame_size());
        Ok(frame.semantic.as_ref().map(read).transpose()?.map(|map| map.mask(GROUND_LABEL)))
    }

    /// Mesh of the target, in object coordinates, meters.
    pub fn mesh(&self) -> Result<TriangleMesh, IoError> {
        ply::read_mesh(&self.folder.join("object_mesh.ply"))
    }
}

/// The name of a folder, also of one given as `.`.
fn folder_name(folder: &Path) -> String {
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    name(folder).or_else(|| name(&folder.canonicalize().ok()?)).unwrap_or_else(|| "sequence".into())
}

fn camera(path: &Path, document: &Document) -> Result<Camera, IoError> {
    let [[fx, skew, cx], [zero, fy, cy], last] = document.k;
    if document.width == 0 || document.height == 0 {
        return Err(IoError::content(path, "width and height must not be zero"));
    }
    let is_k = skew == 0.0 && zero == 0.0 && last == [0.0, 0.0, 1.0] && fx > 0.0 && fy > 0.0;
    if !is_k || [fx, fy, cx, cy].iter().any(|v| !v.is_finite()) {
        return Err(IoError::content(path, format!("K {:?}: not a pinhole camera without skew", document.k)));
    }
    let (width, height) = (document.width, document.height);
    Ok(Camera { focal: [fx, fy], principal: [cx, cy], ..Camera::prior(width, height) })
}

fn frame(path: &Path, frame: FrameDocument) -> Result<SequenceFrame, IoError> {
    let wrong = |what: &str| IoError::content(path, format!("frame {}: {what}", frame.index));
    let world_from_cam = rigid(frame.world_from_cam).ok_or_else(|| wrong("T_world_camera is not a rigid transform"))?;
    let world_from_object =
        rigid(frame.world_from_object).ok_or_else(|| wrong("T_world_object is not a rigid transform"))?;
    let name = frame.image.file_name().ok_or_else(|| wrong("image without a name"))?.to_string_lossy().into_owned();
    if !frame.time_s.is_finite() {
        return Err(wrong("the time is not finite"));
    }
    if frame.visible_share.is_some_and(|share| !(0.0..=1.0).contains(&share)) {
        return Err(wrong("visible_share: not within 0 and 1"));
    }
    Ok(SequenceFrame {
        id: FrameId(frame.index),
        name,
        image: frame.image,
        mask: frame.mask,
        semantic: frame.semantic,
        time_s: frame.time_s,
        cam_from_world: world_from_cam.inverse(),
        world_from_object,
        visible_share: frame.visible_share,
    })
}

/// Rigid transform of a 4 × 4 matrix; `None` if its rotation deviates by more than rounding, or its translation exceeds
/// the coordinate limit.
fn rigid([r0, r1, r2, last]: [[f64; 4]; 4]) -> Option<Rigid3> {
    let rotation = Matrix3::new(r0[0], r0[1], r0[2], r1[0], r1[1], r1[2], r2[0], r2[1], r2[2]);
    let error = (rotation * rotation.transpose() - Matrix3::identity()).norm();
    // JSON files carefully written by hand have six digits.
    let is_rigid = error < 1e-5 && rotation.determinant() > 0.0 && last == [0.0, 0.0, 0.0, 1.0];
    let translation = Vector3::new(r0[3], r1[3], r2[3]);
    if !is_rigid || !translation.iter().all(is_sensible) {
        return None;
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Some(Rigid3::new(rotation, translation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn document() -> Value {
        let pose = [[0.0, -1.0, 0.0, 4.0], [1.0, 0.0, 0.0, 5.0], [0.0, 0.0, 1.0, 6.0], [0.0, 0.0, 0.0, 1.0]];
        let frame = |index: u32| {
            json!({"index": index, "image": format!("images/{index:05}.jpg"), "mask": format!("masks/{index:05}.png"),
                   "semantic": format!("semantic/{index:05}.png"), "time_s": 0.08 * f64::from(index),
                   "T_world_camera": pose, "T_world_object": pose})
        };
        json!({"name": "test", "units": "metre", "fps": 12.5, "n_frames": 2, "width": 4, "height": 3,
               "K": [[8.0, 0, 2.0], [0, 8.0, 1.5], [0, 0, 1]], "frames": [frame(0), frame(3)], "others": []})
    }

    fn open(document: &Value) -> Result<Sequence, IoError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scene.json"), document.to_string()).unwrap();
        Sequence::open(folder.path())
    }

    #[test]
    fn poses_and_names_are_read() {
        let sequence = open(&document()).unwrap();
        assert_eq!(sequence.camera, Camera { principal: [2.0, 1.5], ..Camera::with_focal(4, 3, 8.0) });
        let frame = sequence.frame_named("00003.jpg").unwrap();
        assert_eq!(frame.id, FrameId(3));
        assert_eq!(sequence.frame_named("000003.jpg"), Some(frame));
        assert_eq!(sequence.frame_named("000001.jpg"), None);
        assert!((frame.cam_from_world.center() - nalgebra::Point3::new(4.0, 5.0, 6.0)).norm() < 1e-12);
        let forward = frame.world_from_object.rotation * Vector3::x();
        assert!((forward - Vector3::y()).norm() < 1e-12);
    }

    #[test]
    fn names_may_be_missing_and_images_replaced_by_a_video() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("left_curves_van");
        std::fs::create_dir(&place).unwrap();
        let mut document = document();
        document.as_object_mut().unwrap().remove("name");
        document["trajectory"] = json!("left_curves");
        std::fs::write(place.join("scene.json"), document.to_string()).unwrap();
        let sequence = Sequence::open(&place).unwrap();
        assert_eq!((sequence.name.as_str(), sequence.vehicle.as_ref()), ("left_curves_van", None));
        assert_eq!(sequence.trajectory.as_deref(), Some("left_curves"));
        let said = sequence.input().unwrap_err().to_string();
        assert!(said.contains("00000.jpg") && said.contains("video.mp4"), "{said}");
        std::fs::write(place.join("video.mp4"), b"").unwrap();
        assert_eq!(sequence.input().unwrap(), place.join("video.mp4"));
        std::fs::create_dir(place.join("images")).unwrap();
        std::fs::write(place.join("images/00000.jpg"), b"").unwrap();
        assert_eq!(sequence.input().unwrap(), place.join("images"));
    }

    #[test]
    fn invalid_ground_truth_is_refused() {
        let refused = |change: fn(&mut Value)| {
            let mut document = document();
            change(&mut document);
            open(&document).unwrap_err().to_string()
        };
        assert!(refused(|d| d["units"] = json!("foot")).contains("'foot'"));
        assert!(refused(|d| d["K"][0][1] = json!(0.5)).contains("without skew"));
        assert!(refused(|d| d["width"] = json!(0)).contains("zero"));
        assert!(refused(|d| d["fps"] = json!(-1)).contains("fps"));
        assert!(refused(|d| d["frames"][1]["index"] = json!(0)).contains("out of order"));
        assert!(refused(|d| d["frames"][1]["T_world_object"][0][0] = json!(0.1)).contains("frame 3: T_world_object"));
        assert!(refused(|d| d["frames"][0]["T_world_camera"][2][2] = json!(-1)).contains("T_world_camera"));
        assert!(refused(|d| d["frames"][1]["visible_share"] = json!(1.5)).contains("frame 3: visible_share"));
        assert!(refused(|d| d["frames"][0]["mask"] = json!(null)).contains("scene.json, line 1"));
    }

    #[test]
    fn the_bundled_sequence_is_read() {
        let sequence = Sequence::open(&crate::io::testing::in_repository("dataset/demo")).unwrap();
        assert_eq!((sequence.frames.len(), sequence.frame_size()), (60, (960, 540)));
        assert!(sequence.video().is_some());
        // The posed and projected mesh covers the target's mask.
        let (mesh, frame) = (sequence.mesh().unwrap(), &sequence.frames[30]);
        let mask = sequence.target_mask(frame).unwrap().dilated(2);
        let pixels = mesh
            .vertices
            .iter()
            .map(|v| sequence.camera.pixel_from_cam(frame.cam_from_world * (frame.world_from_object * *v)).unwrap());
        let inside = pixels.filter(|p| mask.contains(p.x, p.y)).count();
        assert!(inside as f64 > 0.95 * mesh.vertices.len() as f64, "{inside} of {}", mesh.vertices.len());
        assert!(sequence.ground_mask(frame).unwrap().unwrap().area_px2() > 10_000);
    }
}
