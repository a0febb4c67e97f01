//! Positions on the ground of a vehicle from its masks alone.
//!
//! The lower edge of a mask is the contact line of the vehicle with the ground on the camera's side. With u the ray
//! through it, n the normal of the local ground plane towards the camera, and h the camera's height over that plane,
//! the contact point is
//!
//! ```text
//! x = c + u h / s,    s = −nᵀ u = sin ε                                                                            (1)
//! ```
//!
//! for the ray's angle ε below the horizon. The position is the center of the footprint, half of its depth farther
//! away; the depth follows from the extents of the mask (`footprint`). A pixel moves x by J = ∂x/∂p, which grows with 1
//! / s²; a plane that is higher by δ moves it by −u δ / s. Both diverge at the horizon: a frame whose distance has a
//! standard deviation of more than a third has no position, since three standard deviations reach infinity. The terms
//! of the error are in docs/maths/ground-track.md.

mod contact_point;
mod footprint;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use nalgebra::{Point2, Vector3};

use self::contact_point::ContactPoint;
use super::extents::{BodyOnGround, GroundView};
use super::{Body, ObjectDescription, Silhouette};
use crate::math::median;
use crate::scene::{
    Frame, FrameId, GroundPlane, GroundPosition, GroundTrack, Image, NoContact, ObjectId, PlaneBasis, Reconstruction,
};

/// Minimum number of positions of a track: fewer have no smooth path that would reveal outliers.
const MIN_POSITIONS: usize = 6;

/// Outlines of objects by frame.
pub type Outlines = BTreeMap<ObjectId, BTreeMap<FrameId, Silhouette>>;

/// Input for one vehicle and the scene around it.
#[derive(Clone, Copy, Debug)]
pub struct ContactEvidence<'a> {
    /// The background's reconstruction.
    pub background: &'a Reconstruction,
    /// The local plane of each frame, in the background's frame; frames without one are absent.
    pub planes: &'a BTreeMap<FrameId, GroundPlane>,
    /// Outlines of all vehicles: that of the vehicle itself, and those that may occlude it.
    pub outlines: &'a Outlines,
    /// Frames in which the vehicle has a mask, in order.
    pub frames: &'a [&'a Frame],
    /// Error of the focal length.
    pub focal: FocalError,
}

/// Error of the focal length, and its effect on the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FocalError {
    /// Standard deviation as a share of the focal length; 0 where it is given.
    pub std: f64,
    /// Change of the ground's normal by one standard deviation, below a camera that does not translate; its height is
    /// unchanged. `None` where the ground is part of a map, whose distances have the relative error of the focal
    /// length.
    pub turns: Option<Vector3<f64>>,
}

/// Pixels around which the plane of each frame is needed: the corners of an object's outlines.
pub fn outline_pixels(outlines: &BTreeMap<FrameId, Silhouette>) -> BTreeMap<FrameId, Vec<Point2<f64>>> {
    outlines.iter().map(|(frame, outline)| (*frame, outline.hull.clone())).collect()
}

/// Contact points of a vehicle with the ground.
#[derive(Clone, Debug, Default)]
pub struct Contacts {
    /// Ascending in time, in units of the background, without meters.
    pub positions: Vec<GroundPosition>,
    /// Number of frames by the basis of their ground plane.
    pub ground: BTreeMap<PlaneBasis, usize>,
    /// Frames without a contact point, by reason.
    pub omitted: BTreeMap<NoContact, usize>,
    /// Widths and heights of the mask at the distance of the contact points, units of the background.
    pub apparent_sizes: [Vec<f64>; 2],
}

/// Finds the contact points of a vehicle, each from its frame alone.
pub fn contacts(id: ObjectId, evidence: &ContactEvidence) -> Contacts {
    let by_name: BTreeMap<&str, &Image> =
        evidence.background.images.values().map(|image| (image.name.as_str(), image)).collect();
    let mut contacts = Contacts::default();
    for frame in evidence.frames {
        match evidence.contact(id, frame, by_name.get(frame.name.as_str()).copied()) {
            Err(why) => *contacts.omitted.entry(why).or_default() += 1,
            Ok((plane, found)) => {
                *contacts.ground.entry(plane.basis).or_default() += 1;
                contacts.apparent_sizes.iter_mut().zip(found.apparent_size).for_each(|(all, size)| all.push(size));
                contacts.positions.push(GroundPosition {
                    frame: frame.id,
                    name: frame.name.clone(),
                    time_s: frame.time_s,
                    position: found.position.coords.into(),
                    error: found.error,
                    metric: None,
                });
            }
        }
    }
    contacts
}

/// Estimates the track of a vehicle on the ground, in units of the background, without verdict and meters, and its
/// body.
///
/// * `reason` – reason why its 3D model cannot be used.
///
/// # Errors
/// Too few frames have a contact point: their number, and the reasons of the others.
pub fn ground_track(
    description: ObjectDescription,
    evidence: &ContactEvidence,
    reason: String,
) -> Result<(GroundTrack, Option<BodyOnGround>), String> {
    let ObjectDescription { id, class, confidence } = description;
    let found = contacts(id, evidence);
    let body = BodyOnGround::of(&evidence.views(id, &found), Body::of_class(&class));
    let Contacts { positions, ground, omitted, apparent_sizes } = found;
    let track = GroundTrack {
        reason,
        ground,
        omitted,
        apparent_size: apparent_sizes.map(|all| median(all).unwrap_or_default()),
        positions,
        ..GroundTrack::new(id, class, confidence)
    };
    if track.positions.len() < MIN_POSITIONS {
        let found = track.positions.len();
        let others = track.omissions().map(|reasons| format!(" ({reasons})")).unwrap_or_default();
        return Err(format!("contact with the ground in {found} frames only, at least {MIN_POSITIONS} needed{others}"));
    }
    Ok((track, body))
}

impl ContactEvidence<'_> {
    /// Views of the vehicle in the frames with a contact point.
    fn views(&self, id: ObjectId, found: &Contacts) -> Vec<GroundView<'_>> {
        let sizes = found.apparent_sizes[0].iter().zip(&found.apparent_sizes[1]);
        let view = |(at, (width, height)): (&GroundPosition, (&f64, &f64))| {
            let image = self.background.images.get(&at.frame.into())?;
            Some(GroundView {
                camera: self.background.camera_of(image),
                cam_from_world: &image.cam_from_world,
                ground: self.planes.get(&at.frame)?,
                position: at.position.into(),
                outline: self.outlines.get(&id)?.get(&at.frame)?,
                apparent_size: width.max(*height),
            })
        };
        found.positions.iter().zip(sizes).filter_map(view).collect()
    }

    /// Contact point in one frame, and its ground plane.
    fn contact(
        &self,
        id: ObjectId,
        frame: &Frame,
        image: Option<&Image>,
    ) -> Result<(&GroundPlane, ContactPoint), NoContact> {
        let image = image.ok_or(NoContact::NoCamera)?;
        let own = self.outlines.get(&id).and_then(|outlines| outlines.get(&frame.id)).ok_or(NoContact::Truncated)?;
        let plane = self.planes.get(&frame.id).ok_or(NoContact::NoGroundPlane)?;
        let others = self.outlines.iter().filter(|(other, _)| **other != id);
        let occluders: Vec<&Silhouette> = others.filter_map(|(_, outlines)| outlines.get(&frame.id)).collect();
        let camera = self.background.camera_of(image);
        Ok((plane, ContactPoint::find((camera, &image.cam_from_world), plane, own, &occluders, &self.focal)?))
    }
}
