//! The reference scale ratio, by ray casting.
//!
//! For frame i, the points o_j of the object's model are taken into its camera's coordinates, and the true mesh, in the
//! pose of that frame, into those of the true camera. The ray from the camera through o_j meets the mesh first at m_j,
//! and
//!
//! ```text
//! r_(ov) = med_i med_j ‖m_j‖ / ‖o_j‖                (eq. scale_ratios_ov_gt)
//! r_ref  = r_(ov) / r_(bv)                          (eqs. scale_ratios_ov, scale_ratios_ob_ref)
//! ```
//!
//! with r_(bv), metres per unit of the background, from the registration. Rays that miss the mesh take no part.
//!
//! The paper casts a ray to *every* point. One on the far side of the vehicle is compared with the near side, which
//! pulls the ratio down a little; `ratio_from_seen` uses only the points observed in each frame and shows by how much.

use std::collections::BTreeMap;

use nalgebra::Point3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::input::{Model, TruthFrame};
use super::mesh::MeshIndex;
use crate::math::{Rigid3, median};
use crate::scene::FrameId;

/// The reference scale ratio and what it rests on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReferenceScale {
    /// r_ref: units of the background per unit of the object's model.
    pub ratio: f64,
    /// r_(ov): metres per unit of the object's model.
    pub metres_per_object_unit: f64,
    /// r_(bv): metres per unit of the background.
    pub metres_per_background_unit: f64,
    /// As `ratio`, from rays to points observed in their frame; `None` if none of those hits.
    pub ratio_from_seen: Option<f64>,
    /// Frames whose rays took part.
    pub num_frames: usize,
    /// Rays that met the mesh.
    pub num_hits: usize,
    /// Rays that did not.
    pub num_misses: usize,
}

/// The reference scale ratio of an object's model.
///
/// # Errors
/// The reason, in words, if no ray meets the mesh.
pub fn reference_scale(
    object: &Model,
    frames: &BTreeMap<FrameId, TruthFrame>,
    mesh: &MeshIndex,
    metres_per_background_unit: f64,
) -> Result<ReferenceScale, String> {
    let cameras: Vec<_> =
        object.cam_from_world.iter().filter_map(|(id, cam)| Some((id, cam, frames.get(id)?))).collect();
    let per_frame: Vec<_> =
        cameras.par_iter().map(|(id, cam, truth)| (**id, frame_ratios(&object.points, cam, truth, mesh))).collect();
    let all_rays = |_, ratios: &[Option<f64>]| ratios.iter().flatten().copied().collect();
    let seen = |id: FrameId, ratios: &[Option<f64>]| {
        let indices = object.seen.get(&id).map_or(&[][..], Vec::as_slice);
        indices.iter().filter_map(|j| *ratios.get(*j)?).collect()
    };
    let (all, num_frames) = median_of_medians(&per_frame, all_rays);
    let (from_seen, _) = median_of_medians(&per_frame, seen);
    let num_hits = per_frame.iter().map(|(_, ratios)| ratios.iter().flatten().count()).sum();
    let num_rays = per_frame.len() * object.points.len();
    let metres_per_object_unit =
        all.ok_or_else(|| format!("none of {num_rays} rays through object points intersects the true mesh"))?;
    Ok(ReferenceScale {
        ratio: metres_per_object_unit / metres_per_background_unit,
        metres_per_object_unit,
        metres_per_background_unit,
        ratio_from_seen: from_seen.map(|metres| metres / metres_per_background_unit),
        num_frames,
        num_hits,
        num_misses: num_rays - num_hits,
    })
}

/// The median over frames of the medians of the ratios that `choose` takes in each; and the number of frames with any.
fn median_of_medians(
    per_frame: &[(FrameId, Vec<Option<f64>>)],
    choose: impl Fn(FrameId, &[Option<f64>]) -> Vec<f64>,
) -> (Option<f64>, usize) {
    let medians: Vec<_> = per_frame.iter().filter_map(|(id, ratios)| median(choose(*id, ratios))).collect();
    let num_frames = medians.len();
    (median(medians), num_frames)
}

/// ‖m_j‖ / ‖o_j‖ of every point in one frame; `None` where the ray misses.
fn frame_ratios(
    points: &[Point3<f64>],
    cam_from_model: &Rigid3,
    truth: &TruthFrame,
    mesh: &MeshIndex,
) -> Vec<Option<f64>> {
    // The ray is taken into mesh coordinates, rather than the mesh into the camera's: lengths are the same.
    let mesh_from_cam = (truth.cam_from_world * truth.world_from_object).inverse();
    let origin = mesh_from_cam * Point3::origin();
    let ratio = |point: &Point3<f64>| {
        let point_in_cam = (*cam_from_model * *point).coords;
        let length = point_in_cam.norm();
        // A point in the camera's centre or behind it was not seen by this camera in any sense.
        if !(length > 0.0 && point_in_cam.z > 0.0) {
            return None;
        }
        mesh.first_hit(origin, mesh_from_cam.rotation * (point_in_cam / length)).map(|distance| distance / length)
    };
    points.iter().map(ratio).collect()
}
