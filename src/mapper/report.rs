//! Outcome of every view.

use std::fmt;

use super::motion::{ModelWeakness, Survey};
use crate::features::tracks::{TrackTable, View};
use crate::scene::ImageId;

/// Reason that a view is not registered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The target is not visible, or nothing on it is distinctive enough for a feature.
    NoFeatures,
    /// Features, but none is matched in another view.
    NoMatches {
        /// Number of features.
        features: usize,
    },
    /// Too few of its features belong to known points.
    TooFewPoints {
        /// Number of its features with a known point.
        visible: usize,
        /// Required number of them.
        needed: usize,
    },
    /// No pose with enough inliers.
    NoPose {
        /// Number of its features with a known point.
        visible: usize,
        /// Largest number of inliers of a pose.
        inliers: usize,
    },
    /// Every pose contradicts the two-view geometries of its pairs, as on repeated structure.
    Contradicted {
        /// Points of pairs that agree with its best pose.
        agreeing: usize,
        /// Points of pairs that contradict it.
        contradicting: usize,
    },
    /// Nothing was reconstructed.
    NoStart,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoFeatures => write!(f, "no features"),
            Self::NoMatches { features } => write!(f, "none of its {features} features is observed in another frame"),
            Self::TooFewPoints { visible, needed } => {
                write!(f, "too few 2D–3D matches: {visible}, at least {needed} needed")
            }
            Self::NoPose { visible, inliers } => {
                write!(f, "no pose: only {inliers} of {visible} 2D–3D matches agree")
            }
            Self::Contradicted { agreeing, contradicting } => write!(
                f,
                "its best pose contradicts {contradicting} points shared with other frames, and agrees with {agreeing}"
            ),
            Self::NoStart => write!(f, "no initial pair of frames found"),
        }
    }
}

/// Outcome of one view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// The image.
    pub image: ImageId,
    /// Its name.
    pub name: String,
    /// `None` when it is registered.
    pub failure: Option<Reason>,
}

/// Summary of a reconstruction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Every view, in the order of the table.
    pub views: Vec<Outcome>,
    /// Number of points.
    pub num_points: usize,
    /// Number of their observations.
    pub num_observations: usize,
    /// Number of points behind an observing camera or at infinity after the last adjustments, which were rejected.
    pub num_infinite_points: usize,
    /// Mean reprojection error, pixels.
    pub mean_error_px: Option<f64>,
    /// Standard deviation of the focal length with its prior, as a share of it, by camera.
    ///
    /// `None` where the focal length is fixed, where no registered view is of this camera, or where many cameras have
    /// more views.
    pub focal_deviations: Vec<Option<f64>>,
    /// Weaknesses of the map, in the motion and in the scene.
    pub remarks: Vec<ModelWeakness>,
    /// Reason that nothing was reconstructed, if nothing was.
    pub failure: Option<String>,
}

impl Report {
    /// Number of registered views.
    pub fn num_registered(&self) -> usize {
        self.views.iter().filter(|v| v.failure.is_none()).count()
    }

    /// Unregistered views, each with its reason.
    pub fn failures(&self) -> impl Iterator<Item = (&str, &Reason)> {
        self.views.iter().filter_map(|v| Some((v.name.as_str(), v.failure.as_ref()?)))
    }

    /// Standard deviation of the first camera's focal length with its prior, as a share of it.
    pub fn focal_deviation(&self) -> Option<f64> {
        self.focal_deviations.first().copied().flatten()
    }

    pub(super) fn of_views(views: &[View], failure: impl Fn(usize) -> Option<Reason>) -> Vec<Outcome> {
        let outcome =
            |(k, view): (usize, &View)| Outcome { image: view.image, name: view.name.clone(), failure: failure(k) };
        views.iter().enumerate().map(outcome).collect()
    }

    /// Report of a target without a usable initial pair.
    pub(super) fn without_start(table: &TrackTable, num_pairs: usize, num_starts: usize, survey: &Survey) -> Self {
        let num_seen = table.views.iter().filter(|view| !view.pixels.is_empty()).count();
        let failure = if num_seen < 2 {
            format!("features in {num_seen} of {} frames; a reconstruction needs at least two", table.views.len())
        } else if table.tracks.is_empty() {
            "no feature could be tracked from one frame to another".to_owned()
        } else if let Some(motion) = survey.failure() {
            motion
        } else if num_pairs == 0 {
            "no pair of frames has enough common points from different directions: the camera hardly moves around the \
             target, or the target is too small or lacks texture"
                .to_owned()
        } else {
            format!("{num_starts} initial pairs of frames tried, none gave a stable set of points")
        };
        let reason =
            |view: usize| Some(if table.views[view].pixels.is_empty() { Reason::NoFeatures } else { Reason::NoStart });
        Self { views: Self::of_views(&table.views, reason), failure: Some(failure), ..Self::default() }
    }
}
