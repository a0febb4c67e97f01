//! Conversion of reconstructions to problems and back.

use std::collections::BTreeMap;

use super::problem::{CameraBlock, Observation, PointBlock, PoseBlock, Problem};
use crate::camera::Camera;
use crate::scene::{CameraId, Reconstruction};

impl Problem {
    /// Problem of a whole reconstruction: all poses and points free, intrinsics as given by `camera_block`.
    ///
    /// Blocks are in the order of their ids, as [`Problem::store`] requires; observations without a point are omitted.
    pub fn from_reconstruction(
        model: &Reconstruction,
        camera_block: impl Fn(CameraId, &Camera) -> CameraBlock,
    ) -> Self {
        Self::from_images(model, camera_block, 1)
    }

    /// Problem of every n-th image only, with all points.
    pub(super) fn from_images(
        model: &Reconstruction,
        camera_block: impl Fn(CameraId, &Camera) -> CameraBlock,
        one_in: usize,
    ) -> Self {
        let camera_idx = places(model.cameras.keys());
        let point_idx = places(model.points.keys());
        let cameras = model.cameras.iter().map(|(id, camera)| camera_block(*id, camera)).collect();
        let points = model.points.values().map(|p| PointBlock { position: p.position, fixed: false }).collect();
        let (mut poses, mut observations) = (Vec::new(), Vec::new());
        for image in model.images.values().step_by(one_in) {
            let camera = camera_idx.get(&image.camera).map_or(usize::MAX, |idx| *idx as usize);
            let seen = image.observations.iter().filter_map(|o| Some((point_idx.get(&o.point?)?, o.pixel)));
            observations.extend(seen.map(|(point, pixel)| Observation::new(poses.len() as u32, *point, pixel)));
            poses.push(PoseBlock { cam_from_world: image.cam_from_world, camera, fixed: false });
        }
        Self { cameras, poses, points, observations, ..Self::default() }
    }

    /// Writes poses, intrinsics and points back to the reconstruction that the problem was made from.
    pub fn store(&self, model: &mut Reconstruction) {
        for (camera, block) in model.cameras.values_mut().zip(&self.cameras) {
            *camera = block.camera;
        }
        for (image, block) in model.images.values_mut().zip(&self.poses) {
            image.cam_from_world = block.cam_from_world;
        }
        for (point, block) in model.points.values_mut().zip(&self.points) {
            point.position = block.position;
        }
    }
}

fn places<'a, K: Ord + Copy + 'a>(keys: impl Iterator<Item = &'a K>) -> BTreeMap<K, u32> {
    keys.enumerate().map(|(idx, key)| (*key, idx as u32)).collect()
}
