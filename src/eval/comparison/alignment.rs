//! The similarity between two camera paths, such that a few lost cameras smear nothing.
//!
//! Every similarity that three camera centres, or two cameras with their directions, determine is a candidate (a fixed
//! number of them, drawn at random, where there are many); the one whose median distance between centres is smallest
//! wins (least median of squares: P. Rousseeuw, *Least median of squares regression*, JASA 1984). Cameras within
//! [`CUT`] of these medians are kept, the similarity is that of Umeyama over their centres, and both are repeated until
//! the same cameras are kept. Where the centres lie on a line, up and forward vectors take part as in an evaluation.

use std::collections::BTreeSet;

use nalgebra::Point3;
use rand::seq::index;
use serde::{Deserialize, Serialize};

use crate::eval::registration;
use crate::math::{Rigid3, Sim3, median, seeded_rng, symmetric_eigen, umeyama};

/// Cameras that lie further apart than this many median distances are lost ones. For normal errors the median is 1.54
/// deviations of a coordinate, so that this is more than nine.
const CUT: f64 = 6.0;

/// Distance below which centres agree whatever the median is, over the spread of the centres: the rounding of files
/// with six digits.
const LEAST_CUT: f64 = 1e-6;

/// Fewest cameras of which some may be called lost: of fewer, half and a bit always agree.
const MIN_TO_DOUBT: usize = 6;

/// Candidates that are tried.
const MAX_CANDIDATES: usize = 1_000;

/// Rounds in which cameras are chosen again.
const MAX_ROUNDS: usize = 20;

/// Extent across the line of the centres, over that along it, from which the centres alone tell the rotation.
const MIN_WIDTH: f64 = 1e-3;

/// The similarity between two reconstructions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Alignment {
    /// From the other's frame and unit to the reference's.
    pub reference_from_other: Sim3,
    /// Data it was computed from.
    pub basis: Basis,
    /// Common cameras that it was computed from.
    pub num_kept: usize,
    /// Names of the common images whose cameras lie elsewhere, and took no part.
    pub lost: Vec<String>,
}

/// Data that a similarity was computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Basis {
    /// Camera centres.
    Centers,
    /// Camera centres with up and forward vectors, since the centres lie on a line.
    CentersAndDirections,
}

/// Result of [`align`].
pub(super) struct Aligned {
    pub reference_from_other: Sim3,
    pub basis: Basis,
    /// Indices of the pairs that took part.
    pub kept: BTreeSet<usize>,
}

/// Aligns pairs of one image's (other, reference) `cam_from_world`.
///
/// # Errors
/// The reason, in words: too few cameras, or cameras that all stand in one place.
pub(super) fn align(pairs: &[(Rigid3, Rigid3)]) -> Result<Aligned, String> {
    let cameras = Cameras::new(pairs)?;
    if pairs.len() < MIN_TO_DOUBT {
        let kept = (0..pairs.len()).collect();
        let (reference_from_other, basis) = cameras.fitted(&kept)?;
        return Ok(Aligned { reference_from_other, basis, kept });
    }
    let mut best = cameras.best_candidate().ok_or("the camera positions do not determine the similarity transform")?;
    let mut basis = Basis::Centers;
    let mut kept = cameras.near(&best);
    for _ in 0..MAX_ROUNDS {
        (best, basis) = cameras.fitted(&kept)?;
        let next = cameras.near(&best);
        if next == kept {
            break;
        }
        kept = next;
    }
    Ok(Aligned { reference_from_other: best, basis, kept })
}

struct Cameras<'a> {
    pairs: &'a [(Rigid3, Rigid3)],
    source: Vec<Point3<f64>>,
    target: Vec<Point3<f64>>,
    /// Typical distance of the reference's centres from their median.
    extent: f64,
}

impl<'a> Cameras<'a> {
    fn new(pairs: &'a [(Rigid3, Rigid3)]) -> Result<Self, String> {
        if pairs.len() < registration::MIN_CAMERAS {
            let (few, least) = (pairs.len(), registration::MIN_CAMERAS);
            let images = if few == 1 { "image is" } else { "images are" };
            return Err(format!("{few} {images} registered in both, at least {least} needed"));
        }
        let (source, target): (Vec<_>, Vec<_>) = pairs.iter().map(|(s, t)| (s.center(), t.center())).unzip();
        let (from, extent) = (typical_extent(&source), typical_extent(&target));
        if !(from > 0.0 && extent > 0.0 && from.is_finite() && extent.is_finite()) {
            return Err("all cameras of one model coincide, so their scales cannot be compared".into());
        }
        Ok(Self { pairs, source, target, extent })
    }

    fn distances(&self, similarity: &Sim3) -> Vec<f64> {
        self.source.iter().zip(&self.target).map(|(s, t)| (*similarity * *s - t).norm()).collect()
    }

    /// Cameras that are where they should be.
    fn near(&self, similarity: &Sim3) -> BTreeSet<usize> {
        let distances = self.distances(similarity);
        let typical = median(distances.clone()).unwrap_or(0.0);
        let cut = (CUT * typical).max(LEAST_CUT * self.extent);
        let near = distances.iter().enumerate().filter(|(_, distance)| **distance <= cut);
        near.map(|(k, _)| k).collect()
    }

    fn best_candidate(&self) -> Option<Sim3> {
        let spread = |similarity: &Sim3| median(self.distances(similarity)).filter(|m| m.is_finite());
        let scored = self.candidates().into_iter().filter_map(|s| Some((spread(&s)?, s)));
        scored.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, similarity)| similarity)
    }

    fn candidates(&self) -> Vec<Sim3> {
        let n = self.pairs.len();
        let mut rng = seeded_rng(0, n as u64);
        let mut candidates = Vec::new();
        for _ in 0..MAX_CANDIDATES {
            let chosen = index::sample(&mut rng, n, 3);
            let [i, j, k] = [0, 1, 2].map(|place| chosen.index(place));
            let pick = |points: &[Point3<f64>]| [points[i], points[j], points[k]];
            candidates.extend(umeyama(&pick(&self.source), &pick(&self.target)));
            candidates.extend(self.by_two(i, j));
        }
        candidates
    }

    /// The similarity that two cameras determine: the rotation of the first, the distance between both.
    fn by_two(&self, i: usize, j: usize) -> Option<Sim3> {
        let (source, target) = (self.source[j] - self.source[i], self.target[j] - self.target[i]);
        let scale = target.norm() / source.norm();
        let (other, reference) = &self.pairs[i];
        let rotation = reference.rotation.inverse() * other.rotation;
        let translation = self.target[i].coords - rotation * self.source[i].coords * scale;
        (scale > 0.0 && scale.is_finite()).then(|| Sim3::new(scale, rotation, translation))
    }

    /// Least squares over some of the cameras.
    fn fitted(&self, kept: &BTreeSet<usize>) -> Result<(Sim3, Basis), String> {
        let of = |points: &[Point3<f64>]| kept.iter().map(|&k| points[k]).collect::<Vec<_>>();
        let (source, target) = (of(&self.source), of(&self.target));
        if width(&source).min(width(&target)) > MIN_WIDTH
            && let Some(similarity) = umeyama(&source, &target)
        {
            return Ok((similarity, Basis::Centers));
        }
        let pairs: Vec<_> = kept.iter().map(|&k| self.pairs[k]).collect();
        let registered = registration::register_with(&pairs, registration::spread(&target))?;
        Ok((registered.world_from_background, Basis::CentersAndDirections))
    }
}

/// Median distance from the median point: a few lost cameras do not change it.
pub(super) fn typical_extent(points: &[Point3<f64>]) -> f64 {
    let axis = |k: usize| median(points.iter().map(|p| p[k]).collect()).unwrap_or(f64::NAN);
    let middle = Point3::new(axis(0), axis(1), axis(2));
    median(points.iter().map(|p| (p - middle).norm()).collect()).unwrap_or(f64::NAN)
}

/// Extent across the line that fits points best, over that along it.
fn width(points: &[Point3<f64>]) -> f64 {
    let n = points.len() as f64;
    let middle = points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / n;
    let spread: nalgebra::Matrix3<f64> =
        points.iter().map(|p| (p.coords - middle) * (p.coords - middle).transpose()).sum();
    let Some(eigen) = symmetric_eigen(spread) else { return 0.0 };
    let mut sizes: Vec<f64> = eigen.eigenvalues.iter().map(|v| v.max(0.0).sqrt()).collect();
    sizes.sort_by(f64::total_cmp);
    sizes[1] / sizes[2]
}
