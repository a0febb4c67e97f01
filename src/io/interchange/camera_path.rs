//! Camera trajectories without images: text files of TUM, EuRoC and KITTI, read for a comparison.
//!
//! All store `world_from_camera`, with this program's camera axes (EuRoC: of the body).
//!
//! * TUM (J. Sturm et al., *A Benchmark for the Evaluation of RGB-D SLAM Systems*, IROS 2012; its "File Formats" page):
//!   per line the time, the position, and the quaternion with its scalar *last*: `t tx ty tz qx qy qz qw`.
//! * EuRoC (M. Burri et al., *The EuRoC Micro Aerial Vehicle Datasets*, IJRR 2016): per line, separated by commas, the
//!   time in nanoseconds, the position, and the quaternion with its scalar *first*; further columns are ignored.
//! * KITTI (A. Geiger et al., *Are we ready for Autonomous Driving?*, CVPR 2012; odometry development kit): per line
//!   the upper 3 × 4 of the matrix, row by row.
//!
//! There are no names. An image is named by its time in seconds ([`time_of`]), in whatever unit the file has it, or for
//! KITTI by its line from 0 with six digits, as that benchmark's images are named. The intrinsics are unknown, so
//! nothing can be projected.

use std::path::Path;

use nalgebra::{Matrix3, Point3, Quaternion, UnitQuaternion};

use super::assembly::{rotation, unit_quaternion};
use super::words::Text;
use crate::camera::Camera;
use crate::io::IoError;
use crate::math::Rigid3;
use crate::scene::{CameraForm, CameraId, Image, ImageId, Reconstruction, clock_in_seconds};

const CAMERA: CameraId = CameraId(1);

/// Reads a trajectory in TUM's or EuRoC's format.
///
/// # Errors
/// A missing file, or a line without eight numbers, or with an invalid quaternion.
pub fn read_tum(path: &Path) -> Result<Reconstruction, IoError> {
    let is_euroc = Text::read_file(path)?.records().next().is_some_and(|(_, first)| first.contains(','));
    read(path, |_, values: &[f64; 8]| {
        let [time, x, y, z, a, b, c, d] = *values;
        let quaternion = if is_euroc { Quaternion::new(a, b, c, d) } else { Quaternion::new(d, a, b, c) };
        let rotation = unit_quaternion(quaternion)?;
        Some((name_of(clock_in_seconds(time)), rotation, Point3::new(x, y, z)))
    })
}

/// Name of an image by its time: seconds, to a microsecond, the resolution of a double of this size.
pub fn name_of(time_s: f64) -> String {
    format!("{time_s:.6}")
}

/// Time in seconds of an image of a trajectory in TUM's or EuRoC's format.
pub fn time_of(image: &Image) -> Option<f64> {
    image.name.parse().ok()
}

/// Reads a trajectory in KITTI's format.
///
/// # Errors
/// A missing file, or a line without twelve numbers, or whose matrix is not a rigid motion.
pub fn read_kitti(path: &Path) -> Result<Reconstruction, IoError> {
    read(path, |index, v: &[f64; 12]| {
        let matrix = Matrix3::new(v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10]);
        // KITTI's own files have six digits, and matrices that are rotations to as many.
        let rotation = rotation(&matrix)?;
        Some((format!("{index:06}"), rotation, Point3::new(v[3], v[7], v[11])))
    })
}

/// Reads lines of `N` numbers, each converted by `pose` to a name, `world_from_camera`'s rotation, and a center.
fn read<const N: usize>(
    path: &Path,
    pose: impl Fn(u32, &[f64; N]) -> Option<(String, UnitQuaternion<f64>, Point3<f64>)>,
) -> Result<Reconstruction, IoError> {
    let text = Text::read_file(path)?;
    let mut model = Reconstruction::default();
    for (index, (line, record)) in (0..).zip(text.records()) {
        let fields = record.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
        let values: Vec<f64> = match record.contains(',') {
            // EuRoC's ground truth continues with velocities and biases.
            true => fields.take(N).filter_map(|word| word.parse().ok()).collect(),
            false => fields.filter_map(|word| word.parse().ok()).collect(),
        };
        let values: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
        let Ok(values) = <[f64; N]>::try_from(values) else {
            return Err(text.error(line, "pose", format!("expected {N} finite numbers")));
        };
        let (name, rotation, center) =
            pose(index, &values).ok_or_else(|| text.error(line, "pose", "invalid rotation"))?;
        let cam_from_world = Rigid3::from_rotation_and_center(rotation.inverse(), center);
        let image = Image { name, camera: CAMERA, cam_from_world, observations: Vec::new() };
        model.images.insert(ImageId(index + 1), image);
    }
    if model.images.is_empty() {
        return Err(IoError::content(path, "no pose in the file"));
    }
    model.cameras.insert(CAMERA, Camera::prior(1, 1));
    model.camera_forms.insert(CAMERA, CameraForm::Unknown);
    Ok(model)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::testing::damaged_text_never_panics;

    const TUM: &str = "# timestamp tx ty tz qx qy qz qw\n1305031102.1758 1 2 3 0 0 0.70710678 0.70710678\n\
                       1305031102.2110 4 5 6 0 0 0 1\n";
    const KITTI: &str = "1 0 0 1 0 1 0 2 0 0 1 3\n0 -1 0 4 1 0 0 5 0 0 1 6\n";

    fn in_file<T>(text: &str, read: impl Fn(&Path) -> T) -> T {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses.txt");
        std::fs::write(&path, text).unwrap();
        read(&path)
    }

    #[test]
    fn both_store_world_from_camera() {
        let tum = in_file(TUM, read_tum).unwrap();
        assert_eq!(tum.images[&ImageId(1)].name, "1305031102.175800");
        let exponents =
            TUM.replace("1305031102.1758", "1.3050311021758e+09").replace("1305031102.2110", "1305031102211000000.0");
        let names = |model: &Reconstruction| model.images.values().map(|image| image.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&in_file(&exponents, read_tum).unwrap()), names(&tum));
        let euroc = "#timestamp, p_x, p_y\n1305031102175800064,1,2,3,0.70710678,0,0,0.70710678,0.1,0.2\n";
        let euroc = in_file(euroc, read_tum).unwrap();
        let (a, b) = (&euroc.images[&ImageId(1)], &tum.images[&ImageId(1)]);
        assert!((&a.name, a.cam_from_world) == (&b.name, b.cam_from_world), "{a:?} {b:?}");
        let kitti = in_file(KITTI, read_kitti).unwrap();
        assert_eq!(kitti.images[&ImageId(2)].name, "000001");
        // A quarter turn about z: the camera's x axis is the world's y axis.
        for (image, center) in
            [(&tum.images[&ImageId(1)], [1.0, 2.0, 3.0]), (&kitti.images[&ImageId(2)], [4.0, 5.0, 6.0])]
        {
            assert!((image.cam_from_world.center() - Point3::from(center)).norm() < 1e-12);
            let x = image.cam_from_world.rotation.inverse() * nalgebra::Vector3::x();
            assert!((x - nalgebra::Vector3::y()).norm() < 1e-7, "{x}");
        }
        assert!(!tum.can_project(CAMERA));
    }

    #[test]
    fn an_invalid_line_is_named() {
        let error = in_file(&TUM.replace(" 0 0 0 1", " 0 0 0 0"), read_tum).unwrap_err().to_string();
        assert!(error.contains("line 3: pose: invalid rotation"), "{error}");
        let error = in_file(&KITTI.replace("1 6", "6"), read_kitti).unwrap_err().to_string();
        assert!(error.contains("line 2: pose: expected 12 finite numbers"), "{error}");
        damaged_text_never_panics(TUM, |text| in_file(text, |path| read_tum(path).is_ok()));
        damaged_text_never_panics(KITTI, |text| in_file(text, |path| read_kitti(path).is_ok()));
    }
}
