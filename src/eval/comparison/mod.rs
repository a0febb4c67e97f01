//! Reconstructions of the same images, held against one another or against the truth.
//!
//! One of them is the reference, which sets frame and unit; each of the others is brought into its frame by a
//! similarity that a few lost cameras do not smear ([`Alignment`]), and compared image by image. What needs no
//! similarity stands next to it: relative poses, intrinsics, points, tracks, and reprojection errors recomputed from
//! the observations.

mod alignment;
mod coverage;
mod figures;
mod pairing;
mod relative;
mod table;

pub use alignment::{Alignment, Basis};
pub use coverage::Coverage;
pub use figures::{ERROR_BIN_PX, ModelFigures, NUM_ERROR_BINS, NUM_TRACK_BINS, Reprojection, error_of_image};
pub use pairing::MatchBy;
pub use relative::{LIMITS_DEG, RelativePoses};
pub use table::intrinsics_in_figures;

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::outcome::Outcome;
use crate::camera::Camera;
use crate::math::{Rigid3, Sim3, median};
use crate::scene::{ImageId, Reconstruction};
use pairing::Pairing;

/// One reconstruction that takes part.
#[derive(Clone, Debug)]
pub struct Side {
    /// Name.
    pub name: String,
    /// Reconstruction.
    pub model: Reconstruction,
    /// Cost, if known.
    pub cost: Option<Cost>,
}

/// Cost of a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Time of all processors together, seconds.
    pub cpu_s: f64,
    /// Elapsed time, seconds.
    pub wall_s: f64,
    /// Peak resident memory, MiB.
    pub peak_rss_mib: f64,
}

/// The unit of lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LengthUnit {
    /// Metres: the reference is a truth that is in metres.
    Metre,
    /// The arbitrary unit of the reference.
    Reference,
}

/// Several reconstructions held against one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Version of this format.
    pub version: u32,
    /// The unit of every length.
    pub unit: LengthUnit,
    /// Criterion by which images were matched.
    pub match_by: MatchBy,
    /// The one that sets frame and unit.
    pub reference: Subject,
    /// The others, in the order given.
    pub others: Vec<Against>,
}

/// One reconstruction and what is known of it alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    /// Name.
    pub name: String,
    /// Size and quality.
    pub figures: ModelFigures,
    /// Cost; null if it was not recorded.
    pub cost: Option<Cost>,
}

/// One reconstruction held against the reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Against {
    /// The reconstruction.
    pub subject: Subject,
    /// Images that are registered in both.
    pub num_common: usize,
    /// Names of images that are registered in the reference alone.
    pub only_in_reference: Vec<String>,
    /// Names of images that are registered here alone.
    pub only_in_other: Vec<String>,
    /// Alignment with the reference.
    pub alignment: Outcome<Alignment>,
    /// Differences between the common cameras, once aligned.
    pub cameras: Outcome<CameraDifferences>,
    /// Coverage of the standard deviations of the camera centers that follow from its own observations.
    pub coverage: Outcome<Coverage>,
    /// Relative poses.
    pub relative: Outcome<RelativePoses>,
    /// Intrinsics side by side, those of most images first; none of lenses that nothing can be projected with.
    pub intrinsics: Vec<IntrinsicsPair>,
    /// Every common image, the furthest off first.
    pub images: Vec<ImageDifference>,
}

/// Differences between aligned cameras. Lengths are in the comparison's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraDifferences {
    /// Root mean square distance of the centres that the similarity was computed from.
    pub center_rmse: f64,
    /// The same over all common images, lost ones too.
    pub center_rmse_of_all: f64,
    /// Median distance of all centres.
    pub center_median: f64,
    /// Largest distance of all centres.
    pub center_max: f64,
    /// `center_rmse` over the root mean square distance of the reference's kept centres from their mean: comparable
    /// between scenes of any unit.
    pub center_share_of_extent: f64,
    /// Mean angle between cameras that the similarity was computed from, degrees.
    pub rotation_mean_deg: f64,
    /// Median angle over all common images, degrees.
    pub rotation_median_deg: f64,
    /// Largest angle over all common images, degrees.
    pub rotation_max_deg: f64,
}

/// The intrinsics that some images have in the reference and in the other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IntrinsicsPair {
    /// Common images with these two.
    pub num_images: usize,
    /// In the reference.
    pub reference: Camera,
    /// In the other.
    pub other: Camera,
    /// By what share the other's mean focal length is larger, pictures brought to one width.
    pub focal_difference: f64,
}

/// One common image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageDifference {
    /// Its name in the reference.
    pub name: String,
    /// Distance of the centres, in the comparison's unit; null where the two could not be aligned.
    pub center: Option<f64>,
    /// Angle between the cameras, degrees; null where the two could not be aligned.
    pub rotation_deg: Option<f64>,
    /// True if the similarity was computed without it, as an outlier.
    pub lost: bool,
    /// Observations of points, in the reference and in the other.
    pub num_observations: [usize; 2],
    /// Mean reprojection error, pixels, in the reference and in the other; null without points.
    pub error_px: [Option<f64>; 2],
}

impl Comparison {
    /// Returns true if at least one of the others could be aligned.
    pub fn has_result(&self) -> bool {
        self.others.iter().any(|other| other.alignment.as_ref().is_ok())
    }
}

/// Holds every one of `others` against `reference`.
pub fn compare(reference: &Side, others: &[Side], unit: LengthUnit, match_by: MatchBy) -> Comparison {
    Comparison {
        version: 2,
        unit,
        match_by,
        reference: Subject::new(reference),
        others: others.iter().map(|other| against(reference, other, match_by)).collect(),
    }
}

impl Subject {
    fn new(side: &Side) -> Self {
        Self { name: side.name.clone(), figures: ModelFigures::new(&side.model), cost: side.cost }
    }
}

fn against(reference: &Side, other: &Side, match_by: MatchBy) -> Against {
    let Pairing { common, only_in_reference, only_in_other } = Pairing::new(&reference.model, &other.model, match_by);
    let both = Both { reference: &reference.model, other: &other.model, common: &common };
    let pairs = both.cameras();
    let aligned = alignment::align(&pairs);
    let extent = alignment::typical_extent(&pairs.iter().map(|(_, camera)| camera.center()).collect::<Vec<_>>());
    let images = both.images(aligned.as_ref().ok());
    let alignment = aligned.as_ref().map(|found| Alignment {
        reference_from_other: found.reference_from_other,
        basis: found.basis,
        num_kept: found.kept.len(),
        lost: both.names_without(&found.kept),
    });
    Against {
        subject: Subject::new(other),
        num_common: common.len(),
        alignment: alignment.map_err(Clone::clone).into(),
        cameras: aligned.map(|found| differences(&pairs, &found)).into(),
        coverage: coverage::coverage(&both).into(),
        relative: relative::relative_poses(&pairs, reference.model.images.len(), extent).into(),
        intrinsics: both.intrinsics(),
        images,
        only_in_reference,
        only_in_other,
    }
}

/// Two reconstructions and their common images, as (reference, other).
struct Both<'a> {
    reference: &'a Reconstruction,
    other: &'a Reconstruction,
    common: &'a [(ImageId, ImageId)],
}

impl Both<'_> {
    /// (other, reference) `cam_from_world` of each common image.
    fn cameras(&self) -> Vec<(Rigid3, Rigid3)> {
        let pair = |(a, b): &(ImageId, ImageId)| {
            (self.other.images[b].cam_from_world, self.reference.images[a].cam_from_world)
        };
        self.common.iter().map(pair).collect()
    }

    fn names_without(&self, kept: &std::collections::BTreeSet<usize>) -> Vec<String> {
        let lost = self.common.iter().enumerate().filter(|(k, _)| !kept.contains(k));
        lost.map(|(_, (a, _))| self.reference.images[a].name.clone()).collect()
    }

    /// The furthest off first.
    fn images(&self, aligned: Option<&alignment::Aligned>) -> Vec<ImageDifference> {
        let difference = |(k, (a, b)): (usize, &(ImageId, ImageId))| {
            let (ours, theirs) = (&self.reference.images[a], &self.other.images[b]);
            let moved = aligned.map(|found| found.reference_from_other.transform_camera(&theirs.cam_from_world));
            let count = |image: &crate::scene::Image| image.observations.iter().filter(|o| o.point.is_some()).count();
            ImageDifference {
                name: ours.name.clone(),
                center: moved.map(|camera| (camera.center() - ours.cam_from_world.center()).norm()),
                rotation_deg: moved.map(|camera| camera.angle_to(&ours.cam_from_world).to_degrees()),
                lost: aligned.is_some_and(|found| !found.kept.contains(&k)),
                num_observations: [count(ours), count(theirs)],
                error_px: [figures::error_of_image(self.reference, ours), figures::error_of_image(self.other, theirs)],
            }
        };
        let mut images: Vec<_> = self.common.iter().enumerate().map(difference).collect();
        images.sort_by(|a, b| b.center.unwrap_or(0.0).total_cmp(&a.center.unwrap_or(0.0)));
        images
    }

    fn intrinsics(&self) -> Vec<IntrinsicsPair> {
        let mut counts = BTreeMap::new();
        for (a, b) in self.common {
            let cameras = (self.reference.images[a].camera, self.other.images[b].camera);
            *counts.entry(cameras).or_insert(0) += 1;
        }
        let pair = |((a, b), num_images): ((_, _), usize)| {
            (self.reference.can_project(a) && self.other.can_project(b)).then_some(())?;
            let (reference, other) = (*self.reference.cameras.get(&a)?, *self.other.cameras.get(&b)?);
            let widths = f64::from(reference.width) / f64::from(other.width);
            let focal_difference = other.mean_focal() * widths / reference.mean_focal() - 1.0;
            focal_difference.is_finite().then_some(IntrinsicsPair { num_images, reference, other, focal_difference })
        };
        let mut pairs: Vec<_> = counts.into_iter().filter_map(pair).collect();
        pairs.sort_by_key(|pair| std::cmp::Reverse(pair.num_images));
        pairs
    }
}

fn differences(pairs: &[(Rigid3, Rigid3)], found: &alignment::Aligned) -> CameraDifferences {
    let moved = |similarity: &Sim3, camera: &Rigid3| similarity.transform_camera(camera);
    let of_pair = |(other, reference): &(Rigid3, Rigid3)| {
        let camera = moved(&found.reference_from_other, other);
        ((camera.center() - reference.center()).norm(), camera.angle_to(reference).to_degrees())
    };
    let (centers, angles): (Vec<f64>, Vec<f64>) = pairs.iter().map(of_pair).unzip();
    let of_kept = |values: &[f64]| found.kept.iter().map(|&k| values[k]).collect::<Vec<_>>();
    let kept_centers: Vec<Point3<f64>> = found.kept.iter().map(|&k| pairs[k].1.center()).collect();
    let (rmse, kept_angles) = (rms(&of_kept(&centers)), of_kept(&angles));
    let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    CameraDifferences {
        center_rmse: rmse,
        center_rmse_of_all: rms(&centers),
        center_max: largest(&centers),
        center_share_of_extent: rmse / super::registration::spread(&kept_centers),
        rotation_mean_deg: kept_angles.iter().sum::<f64>() / kept_angles.len() as f64,
        rotation_max_deg: largest(&angles),
        center_median: median(centers).unwrap_or(0.0),
        rotation_median_deg: median(angles).unwrap_or(0.0),
    }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[cfg(test)]
mod tests;
