//! Camera paths without pictures: TUM's and KITTI's text files, read as sides of a comparison.
//!
//! Both hold `world_from_camera`, with this program's camera axes.
//!
//! * TUM (J. Sturm et al., *A Benchmark for the Evaluation of RGB-D SLAM Systems*, IROS 2012; its "File Formats" page):
//!   per line the time, the position, and the quaternion with its scalar *last*: `t tx ty tz qx qy qz qw`.
//! * KITTI (A. Geiger et al., *Are we ready for Autonomous Driving?*, CVPR 2012; odometry development kit): per line
//!   the upper 3 × 4 of the matrix, row by row.
//!
//! There are no names. An image is called what the file says of it: its time as it is written, or for KITTI its line
//! from 0 with six digits, as that benchmark's pictures are called. Nothing is known of a lens, so nothing can be
//! projected.

use std::path::Path;

use nalgebra::{Matrix3, Point3, Quaternion, UnitQuaternion};

use super::assembly::{rotation, unit_quaternion};
use super::words::Text;
use crate::camera::Camera;
use crate::io::IoError;
use crate::math::Rigid3;
use crate::scene::{CameraForm, CameraId, Image, ImageId, Reconstruction};

const CAMERA: CameraId = CameraId(1);

/// Reads a path in TUM's form.
///
/// # Errors
/// A missing file, or a line that is not of eight numbers, or whose quaternion is no rotation.
pub fn read_tum(path: &Path) -> Result<Reconstruction, IoError> {
    read(path, |_, fields, values: &[f64; 8]| {
        let [_, x, y, z, qx, qy, qz, qw] = *values;
        let quaternion = Quaternion::new(qw, qx, qy, qz);
        let rotation = unit_quaternion(quaternion)?;
        Some((fields[0].to_owned(), rotation, Point3::new(x, y, z)))
    })
}

/// Reads a path in KITTI's form.
///
/// # Errors
/// A missing file, or a line that is not of twelve numbers, or whose matrix is no rigid motion.
pub fn read_kitti(path: &Path) -> Result<Reconstruction, IoError> {
    read(path, |index, _, v: &[f64; 12]| {
        let matrix = Matrix3::new(v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10]);
        // KITTI's own files have six digits, and matrices that are rotations to as many.
        let rotation = rotation(&matrix)?;
        Some((format!("{index:06}"), rotation, Point3::new(v[3], v[7], v[11])))
    })
}

/// Reads lines of `N` numbers, each of which `pose` turns into a name, `world_from_camera`'s rotation, and a centre.
fn read<const N: usize>(
    path: &Path,
    pose: impl Fn(u32, &[&str], &[f64; N]) -> Option<(String, UnitQuaternion<f64>, Point3<f64>)>,
) -> Result<Reconstruction, IoError> {
    let text = Text::read_file(path)?;
    let mut model = Reconstruction::default();
    for (index, (line, record)) in (0..).zip(text.records()) {
        let fields: Vec<&str> = record.split_whitespace().collect();
        let values: Vec<f64> =
            fields.iter().filter_map(|word| word.parse().ok()).filter(|value: &f64| value.is_finite()).collect();
        let Ok(values) = <[f64; N]>::try_from(values) else {
            return Err(text.error(line, "pose", format!("expected {N} finite numbers")));
        };
        let (name, rotation, center) =
            pose(index, &fields, &values).ok_or_else(|| text.error(line, "pose", "invalid rotation"))?;
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
    fn both_hold_the_camera_in_the_world() {
        let tum = in_file(TUM, read_tum).unwrap();
        assert_eq!(tum.images[&ImageId(1)].name, "1305031102.1758");
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
    fn a_broken_line_is_named() {
        let error = in_file(&TUM.replace(" 0 0 0 1", " 0 0 0 0"), read_tum).unwrap_err().to_string();
        assert!(error.contains("line 3: pose: invalid rotation"), "{error}");
        let error = in_file(&KITTI.replace("1 6", "6"), read_kitti).unwrap_err().to_string();
        assert!(error.contains("line 2: pose: expected 12 finite numbers"), "{error}");
        damaged_text_never_panics(TUM, |text| in_file(text, |path| read_tum(path).is_ok()));
        damaged_text_never_panics(KITTI, |text| in_file(text, |path| read_kitti(path).is_ok()));
    }
}
