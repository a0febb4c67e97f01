//! SIFT front end: features in every frame, matches between frames near in time or similar, verified by geometry.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point3, Vector2};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Target;
use super::matching::{MatchOptions, match_features};
use super::refinement::{self, Pyramid};
use super::retrieval;
use super::rootsift::{FeatureOptions, Features, extract};
use super::tracks::{PairMatches, TrackTable, View, tracks_from_matches};
use crate::camera::Camera;
use crate::checks::{Checked, under, within};
use crate::features::FeatureError;
use crate::geometry::two_view::{self, Correspondences};
use crate::image::{GrayImage, RgbImage, gray_from_rgb};
use crate::scene::{Frame, Mask};

/// Which pairs of views are matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Pairing {
    /// Each with the next ones, and with those 2, 4, 8, … beyond: for frames of a video.
    Sequential {
        /// Number of following frames.
        #[schemars(extend("unit" = "views"))]
        window: usize,
    },
    /// All with all. The cost grows with the square of their number.
    Exhaustive,
    /// All with all of a small set, otherwise each with those most similar to it: for photographs in no order.
    Retrieval {
        /// Largest set of which all pairs are matched.
        #[schemars(extend("unit" = "views"))]
        exhaustive_up_to: usize,
        /// Number of most similar views, and of nearest ones where positions are known.
        #[schemars(extend("unit" = "views"))]
        neighbors: usize,
    },
}

impl Pairing {
    /// Pairing of unordered photographs.
    pub const UNORDERED: Self = Self::Retrieval { exhaustive_up_to: EXHAUSTIVE_UP_TO, neighbors: NEIGHBORS };
}

/// Number of most similar views with which a view is matched: 0.98 of the pairs with common points on four clips, 15
/// have 0.89 (docs/decisions/033-image-retrieval.md).
const NEIGHBORS: usize = 30;

/// Maximum number of views of which all pairs are matched: about four times those of retrieval, and none is missed.
const EXHAUSTIVE_UP_TO: usize = 200;

/// Options of the SIFT front end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SiftOptions {
    /// Features of a frame.
    pub features: FeatureOptions,
    /// Descriptor matching.
    pub matching: MatchOptions,
    /// Pairs of views that are matched.
    pub pairing: Pairing,
    /// Maximum distance of a verified match from its epipolar line.
    pub max_epipolar_error_px: f64,
    /// Minimum number of verified matches of a pair: fewer agree by chance.
    #[schemars(extend("unit" = "matches"))]
    pub min_pair_matches: usize,
    /// Maximum number of pixels of all images together up to which positions are refined by patch alignment, for which
    /// the images are kept. 0 disables refinement.
    #[schemars(extend("unit" = "million pixels"))]
    pub max_refined_mpx: f64,
    /// Minimum length of a track, where there are as many views.
    #[schemars(extend("unit" = "views"))]
    pub min_track_length: usize,
}

impl SiftOptions {
    /// Options for a target.
    pub fn of(target: Target) -> Self {
        match target {
            Target::Background => Self::background(),
            Target::Object => Self::object(),
        }
    }

    /// Rejects options that are out of range.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        under("features", self.features.check())?;
        under("matching", self.matching.check())?;
        match self.pairing {
            Pairing::Sequential { window } => within("pairing.sequential.window", window, 1..=10_000)?,
            Pairing::Retrieval { exhaustive_up_to, neighbors } => {
                within("pairing.retrieval.exhaustive_up_to", exhaustive_up_to, 0..=100_000)?;
                within("pairing.retrieval.neighbors", neighbors, 1..=10_000)?;
            }
            Pairing::Exhaustive => {}
        }
        within("max_epipolar_error_px", self.max_epipolar_error_px, 0.01..=1000.0)?;
        within("min_pair_matches", self.min_pair_matches, 5..=60_000)?;
        within("max_refined_mpx", self.max_refined_mpx, 0.0..=100_000.0)?;
        within("min_track_length", self.min_track_length, 2..=1_000_000)
    }

    /// Options for the background of a video.
    pub fn background() -> Self {
        Self {
            features: FeatureOptions::background(),
            matching: MatchOptions::default(),
            pairing: Pairing::Sequential { window: 5 },
            max_epipolar_error_px: 3.0,
            min_pair_matches: 15,
            max_refined_mpx: 400.0,
            min_track_length: 3,
        }
    }

    /// Options for the background of unordered photographs.
    pub fn unordered() -> Self {
        Self {
            features: FeatureOptions { max_features: 5000, contrast_threshold: 0.02, ..FeatureOptions::background() },
            pairing: Pairing::UNORDERED,
            // With refined positions points of two views help more than they harm.
            min_track_length: 2,
            ..Self::background()
        }
    }

    /// Options for one object of a video.
    pub fn object() -> Self {
        Self {
            features: FeatureOptions::object(),
            pairing: Pairing::Sequential { window: 8 },
            max_epipolar_error_px: 2.0,
            min_pair_matches: 8,
            ..Self::background()
        }
    }
}

/// SIFT front end: collects features frame by frame.
pub struct SiftFrontEnd {
    options: SiftOptions,
    cameras: Vec<Camera>,
    views: Vec<View>,
    features: Vec<Features>,
    /// Positions of frames by name, meters in any Cartesian frame, as far as known.
    positions: BTreeMap<String, Point3<f64>>,
    pending: Vec<PendingFrame>,
    /// Gray images for refinement, unless they are too many.
    pictures: Vec<GrayImage>,
    num_pixels: f64,
}

/// Frame whose features are not extracted yet.
struct PendingFrame {
    frame: Frame,
    camera: usize,
    image: RgbImage,
    mask: Mask,
}

impl SiftFrontEnd {
    /// Front end without frames; `cameras` serve to verify matches, and guesses suffice.
    pub fn new(options: SiftOptions, cameras: Vec<Camera>) -> Self {
        Self {
            options,
            cameras,
            views: Vec::new(),
            features: Vec::new(),
            positions: BTreeMap::new(),
            pending: Vec::new(),
            pictures: Vec::new(),
            num_pixels: 0.0,
        }
    }

    /// Sets positions of frames by name, meters in any Cartesian frame: near frames are matched, too.
    pub fn know_positions(&mut self, positions: BTreeMap<String, Point3<f64>>) {
        self.positions = positions;
    }

    /// Number of cameras of the frames.
    pub fn num_cameras(&self) -> usize {
        self.cameras.len()
    }

    /// Adds a frame of one of the cameras; features are detected only where the mask is set.
    ///
    /// [`FeatureError::OpenCv`] if OpenCV fails, on this frame or on one before it: as many frames are processed at a
    /// time as there are threads.
    pub fn push(&mut self, frame: &Frame, camera: usize, image: &RgbImage, mask: &Mask) -> Result<(), FeatureError> {
        self.pending.push(PendingFrame { frame: frame.clone(), camera, image: image.clone(), mask: mask.clone() });
        if self.pending.len() < rayon::current_num_threads() { Ok(()) } else { self.extract_pending() }
    }

    fn extract_pending(&mut self) -> Result<(), FeatureError> {
        let pending = std::mem::take(&mut self.pending);
        let found: Result<Vec<Features>, FeatureError> =
            pending.par_iter().map(|w| extract(&w.image, &w.mask, &self.options.features)).collect();
        for (PendingFrame { frame, camera, image, .. }, mut features) in pending.into_iter().zip(found?) {
            self.keep_picture(&image)?;
            let (pixels, rgb) = (features.pixels.clone(), std::mem::take(&mut features.rgb));
            self.views.push(View { pixels, rgb, ..View::new(&frame, camera) });
            self.features.push(features);
        }
        Ok(())
    }

    fn keep_picture(&mut self, image: &RgbImage) -> Result<(), FeatureError> {
        self.num_pixels += f64::from(image.width()) * f64::from(image.height());
        if self.num_pixels > 1e6 * self.options.max_refined_mpx {
            self.pictures.clear();
        } else {
            self.pictures.push(gray_from_rgb(image)?);
        }
        Ok(())
    }

    /// Matches features, verifies the matches and links them to tracks.
    ///
    /// # Errors
    /// As [`SiftFrontEnd::push`].
    pub fn finish(mut self, seed: u64) -> Result<TrackTable, FeatureError> {
        self.extract_pending()?;
        let normalized: Vec<Vec<Vector2<f64>>> = self
            .features
            .par_iter()
            .enumerate()
            .map(|(v, f)| f.pixels.iter().map(|&p| self.camera_of(v).normalized_from_pixel(p)).collect())
            .collect();
        let candidates = self.candidates(seed);
        tracing::debug!("{} pairs of {} views are matched", candidates.len(), self.features.len());
        let pairs: Vec<PairMatches> =
            candidates.into_par_iter().filter_map(|views| self.verified(views, &normalized, seed)).collect();
        let counts: Vec<usize> = self.features.iter().map(Features::len).collect();
        let num_seen = counts.iter().filter(|&&n| n > 0).count();
        let min_length = self.options.min_track_length.min(num_seen);
        let mut table = TrackTable { tracks: tracks_from_matches(&counts, &pairs, min_length), views: self.views };
        if self.pictures.len() == table.views.len() {
            let pyramids: Result<Vec<Pyramid>, FeatureError> =
                self.pictures.into_par_iter().map(Pyramid::new).collect();
            let shapes: Vec<_> = self.features.into_iter().map(|f| f.shapes).collect();
            let moved = refinement::refine(&mut table, &shapes, &pyramids?);
            tracing::debug!("{moved} of {} positions refined", table.num_observations());
        }
        Ok(table)
    }

    /// The pairs to match, ascending.
    fn candidates(&self, seed: u64) -> Vec<[usize; 2]> {
        let n = self.features.len();
        match self.options.pairing {
            Pairing::Retrieval { exhaustive_up_to, neighbors } if n > exhaustive_up_to => {
                let position = |view: &View| self.positions.get(&view.name).copied();
                let positions: Vec<_> = self.views.iter().map(position).collect();
                let mut pairs = retrieval::similar_pairs(&self.features, neighbors, seed);
                pairs.extend(retrieval::near_pairs(&positions, neighbors));
                pairs.into_iter().collect()
            }
            Pairing::Sequential { window } => sequential_pairs(n, window),
            Pairing::Exhaustive | Pairing::Retrieval { .. } => all_pairs(n),
        }
    }

    fn camera_of(&self, view: usize) -> &Camera {
        &self.cameras[self.views[view].camera]
    }

    fn verified(&self, views: [usize; 2], normalized: &[Vec<Vector2<f64>>], seed: u64) -> Option<PairMatches> {
        let matches = match_features(&self.features[views[0]], &self.features[views[1]], &self.options.matching);
        if matches.len() < self.options.min_pair_matches {
            return None;
        }
        let side = |s: usize| matches.iter().map(|m| normalized[views[s]][m[s] as usize]).collect::<Vec<_>>();
        let pairs = Correspondences { first: side(0), second: side(1) };
        let mean_focal = two_view::mean_focal(views.map(|v| self.camera_of(v)));
        let of_two_cameras = self.views[views[0]].camera != self.views[views[1]].camera;
        let verify = if of_two_cameras { two_view::verify_of_two_cameras } else { two_view::verify };
        let max_error = self.options.max_epipolar_error_px / mean_focal;
        let inliers = verify(&pairs, max_error, &mut two_view::pair_rng(seed, views));
        (inliers.len() >= self.options.min_pair_matches).then(|| PairMatches {
            views: views.map(|v| v as u32),
            matches: inliers.into_iter().map(|i| matches[i]).collect(),
        })
    }
}

fn all_pairs(n: usize) -> Vec<[usize; 2]> {
    (0..n).flat_map(|i| (i + 1..n).map(move |j| [i, j])).collect()
}

/// Pairs of each view with the next ones, and with those 2, 4, 8, … beyond; ascending.
fn sequential_pairs(n: usize, window: usize) -> Vec<[usize; 2]> {
    let mut pairs = BTreeSet::new();
    for i in 0..n {
        pairs.extend((i + 1..=i + window).filter(|&j| j < n).map(|j| [i, j]));
        let powers = (1..).map(|k| i + window + (1 << k)).take_while(|&j| j < n);
        pairs.extend(powers.map(|j| [i, j]));
    }
    pairs.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_reach_near_and_far() {
        let pairs = sequential_pairs(20, 2);
        assert!(pairs.contains(&[0, 1]) && pairs.contains(&[0, 2]) && pairs.contains(&[0, 4]));
        assert!(pairs.contains(&[0, 18]) && !pairs.contains(&[0, 3]));
        assert_eq!(all_pairs(5).len(), 10);
        assert!(all_pairs(1).is_empty());
    }
}
