//! Camera paths by time: images of a model get the names of the images of the reference that are nearest in time.

use std::collections::BTreeMap;

use crate::io::interchange::camera_path::time_of;
use crate::io::interchange::model::Format;
use crate::math::{Rigid3, median};
use crate::pipeline;
use crate::scene::{Image, ImageId, Reconstruction};

/// Start of the name of an image that is near none of the reference's.
pub(super) const UNPAIRED: &str = "unpaired ";

/// Times of a model's images, seconds, ascending.
pub(super) type Times = Vec<(f64, ImageId)>;

/// Times of a model's images: of a path those in its file, of an output folder those of its frames.
pub(super) fn times(path: &std::path::Path, format: Format, model: &Reconstruction) -> Option<Times> {
    let mut times: Times = match format {
        Format::Tum => model.images.iter().filter_map(|(id, image)| Some((time_of(image)?, *id))).collect(),
        _ => {
            let frames = pipeline::known_frames(path)?;
            let by_name: BTreeMap<&str, f64> = frames.iter().map(|frame| (frame.name.as_str(), frame.time_s)).collect();
            model.images.iter().filter_map(|(id, image)| Some((*by_name.get(image.name.as_str())?, *id))).collect()
        }
    };
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    (!times.is_empty()).then_some(times)
}

/// Names every image of a model as the reference's image nearest in time, at most half of the longer frame interval
/// away, and interpolates its pose to that time. Others keep a name that no image of the reference has.
///
/// * `offset_s` – time of the reference minus that of the model.
pub(super) fn rename(reference: (&Reconstruction, &Times), model: &mut Reconstruction, times: &Times, offset_s: f64) {
    let (reference, reference_times) = reference;
    let limit_s = 0.5 * interval_s(reference_times).max(interval_s(times));
    // The nearest image of the model for each of the reference's: one image is used once.
    let mut nearest: BTreeMap<ImageId, (f64, usize, f64)> = BTreeMap::new();
    for (index, (time_s, _)) in times.iter().enumerate() {
        let time_s = time_s + offset_s;
        let after = reference_times.partition_point(|(at, _)| *at < time_s);
        let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| reference_times.get(i));
        let Some((at, id)) = around.min_by(|a, b| (a.0 - time_s).abs().total_cmp(&(b.0 - time_s).abs())) else {
            continue;
        };
        let apart_s = (at - time_s).abs();
        if apart_s <= limit_s && nearest.get(id).is_none_or(|(least, ..)| apart_s < *least) {
            nearest.insert(*id, (apart_s, index, at - offset_s));
        }
    }
    let poses: Vec<(f64, Rigid3)> =
        times.iter().map(|(time_s, id)| (*time_s, model.images[id].cam_from_world)).collect();
    for image in model.images.values_mut() {
        image.name.insert_str(0, UNPAIRED);
    }
    for (id, (_, index, time_s)) in nearest {
        let image = model.images.get_mut(&times[index].1);
        let (Some(image), Some(named)) = (image, reference.images.get(&id)) else { continue };
        *image = Image { name: named.name.clone(), cam_from_world: at(&poses, index, time_s), ..image.clone() };
    }
}

/// Median time between images, seconds.
fn interval_s(times: &Times) -> f64 {
    median(times.windows(2).map(|pair| pair[1].0 - pair[0].0).collect()).unwrap_or(0.0)
}

/// Pose at a time near that of the pose at `index`: linear between the two poses around it, otherwise that pose.
fn at(poses: &[(f64, Rigid3)], index: usize, time_s: f64) -> Rigid3 {
    let (here_s, here) = poses[index];
    let neighbor = if time_s < here_s { index.checked_sub(1) } else { Some(index + 1) };
    let Some((there_s, there)) = neighbor.and_then(|neighbor| poses.get(neighbor)) else { return here };
    let share = (time_s - here_s) / (there_s - here_s);
    if !(share > 0.0 && share <= 1.0) {
        return here;
    }
    let center = here.center() + (there.center() - here.center()) * share;
    let turn = (there.rotation * here.rotation.inverse()).scaled_axis() * share;
    let rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * here.rotation;
    Rigid3::from_rotation_and_center(rotation, center)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion};

    use super::*;
    use crate::scene::CameraId;

    /// Moves along x by a unit per second.
    fn path(times: &[f64]) -> (Reconstruction, Times) {
        let mut model = Reconstruction::default();
        for (id, time_s) in (1..).map(ImageId).zip(times) {
            let center = Point3::new(*time_s, 0.0, 0.0);
            let cam_from_world = Rigid3::from_rotation_and_center(UnitQuaternion::identity(), center);
            let image =
                Image { name: time_s.to_string(), camera: CameraId(1), cam_from_world, observations: Vec::new() };
            model.images.insert(id, image);
        }
        let times = times.iter().copied().zip((1..).map(ImageId)).collect();
        (model, times)
    }

    #[test]
    fn images_are_paired_by_the_nearest_time_and_their_poses_interpolated() {
        let (reference, reference_times) = path(&[0.0, 0.1, 0.2, 0.3, 0.4, 5.0]);
        let (mut model, times) = path(&[10.04, 10.13, 10.22, 10.31, 12.0]);
        rename((&reference, &reference_times), &mut model, &times, -10.0);
        let found: BTreeMap<&str, f64> =
            model.images.values().map(|image| (image.name.as_str(), image.cam_from_world.center().x)).collect();
        let names: Vec<&str> = found.keys().copied().collect();
        assert_eq!(names, ["0", "0.1", "0.2", "0.3", "unpaired 12"]);
        for (name, x) in [("0.1", 10.1), ("0.2", 10.2), ("0.3", 10.3), ("0", 10.04)] {
            assert!((found[name] - x).abs() < 1e-9, "{name}: {found:?}");
        }
    }
}
