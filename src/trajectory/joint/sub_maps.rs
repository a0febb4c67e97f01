//! Alignment of an object's sub-maps, which share hardly any points.
//!
//! After an occlusion a vehicle shows another side, and hardly any track connects the frames before and after. Each
//! sub-map is adjusted with the ground separately, which determines its height, inclination and size. Relative position
//! on the ground and heading follow from the outlines, which are those of one body: the body of the sub-map with the
//! smallest standard deviation of the length is fitted to the outlines of the others ([`PlacedFit`]). The joined map is
//! then adjusted as a whole. Derivation: docs/maths/scale.md; evidence: decision 35.

use nalgebra::{UnitQuaternion, Vector3};

use super::spread::without_images;
use crate::math::Sim3;
use crate::scene::{ImageId, ObjectId, Point3dId, Reconstruction, ScaleEstimate, ScaleMethod};
use crate::trajectory::assemble::{ObjectDescription, assemble};
use crate::trajectory::extents::{PlacedFit, Subject};
use crate::trajectory::{Body, Evidence, Options};

/// Sub-maps of an object, in the order of their images; the object itself if there is no gap.
pub(super) fn split(object: &Reconstruction) -> Vec<Reconstruction> {
    let gaps = object.gaps();
    let of = |id: &ImageId| gaps.partition_point(|gap| gap <= id);
    let others = |k: usize| object.images.keys().filter(|id| of(id) != k).copied().collect::<Vec<_>>();
    (0..=gaps.len()).map(|k| without_images(object, &others(k))).collect()
}

/// Joins sub-maps whose ground is z = 0, in the background's unit.
///
/// A sub-map to which no body can be fitted keeps its poses.
pub(super) fn join(mut sub_maps: Vec<Reconstruction>, evidence: &Evidence, options: &Options) -> Reconstruction {
    let of_known_size = |sub_map: &Reconstruction, known| fitted_body(sub_map, known, evidence, options);
    let bodies = sub_maps.iter().map(|sub_map| of_known_size(sub_map, None));
    let best = bodies.flatten().min_by(|a, b| a.length_std().total_cmp(&b.length_std()));
    let mut joined = Reconstruction::default();
    for sub_map in &mut sub_maps {
        if let Some(best) = &best
            && let Some(body) = of_known_size(sub_map, Some(best))
        {
            let best_from_this = best.object_from_body() * body.object_from_body().inverse();
            let forward = best_from_this.rotation * Vector3::x();
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), forward.y.atan2(forward.x));
            let shift = best_from_this.translation;
            tracing::debug!("sub-map of {} images: by {shift:?}, turned by {:?}", sub_map.images.len(), turn.angle());
            sub_map.transform(&Sim3::new(1.0, turn, Vector3::new(shift.x, shift.y, 0.0)));
        }
        // A point that several sub-maps observe has a position in each.
        let known: Vec<Point3dId> =
            sub_map.points.keys().filter(|id| joined.points.contains_key(id)).copied().collect();
        sub_map.remove_points(&known);
        joined.cameras.append(&mut sub_map.cameras);
        joined.camera_forms.append(&mut sub_map.camera_forms);
        joined.images.append(&mut sub_map.images);
        joined.points.append(&mut sub_map.points);
    }
    joined
}

/// Body fitted to the outlines of a sub-map, with the size of `known` if given.
fn fitted_body(
    sub_map: &Reconstruction,
    known: Option<&PlacedFit>,
    evidence: &Evidence,
    options: &Options,
) -> Option<PlacedFit> {
    let Evidence { background, planes, silhouettes, frames, .. } = *evidence;
    let body = Body::of_class(&evidence.description.class);
    let anonymous = ObjectDescription { id: ObjectId(0), class: String::new(), confidence: 1.0 };
    let scale = ScaleEstimate::new(1.0, ScaleMethod::Joint);
    let trajectory = &assemble(anonymous, background, sub_map, scale, frames);
    PlacedFit::of(&Subject { trajectory, object: sub_map, background, planes, silhouettes, options }, body, known)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::FrameId;
    use crate::synthetic::drive::{Options, drive};

    #[test]
    fn a_map_is_split_at_missing_frames_with_few_connecting_tracks() {
        let mut object = drive(&Options { num_frames: 40, ..Options::default() }, 1).object;
        let hidden: Vec<ImageId> = (15..22).map(|frame| FrameId(frame).into()).collect();
        object = without_images(&object, &hidden);
        assert_eq!(split(&object), [object.clone()]);
        let is_before = |image: ImageId| image < ImageId::from(FrameId(15));
        let across = object.points.iter().filter(|(_, point)| {
            point.track.iter().any(|e| is_before(e.image)) && point.track.iter().any(|e| !is_before(e.image))
        });
        // Eleven tracks remain, one fewer than a map needs.
        let across: Vec<_> = across.map(|(id, _)| *id).skip(11).collect();
        object.remove_points(&across);
        let parts = split(&object);
        assert_eq!(parts.iter().map(|part| part.images.len()).collect::<Vec<_>>(), [15, 18]);
        assert!(parts[0].images.keys().all(|id| is_before(*id)));
    }
}
