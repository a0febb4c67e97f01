//! Temporal order of the images, and the front end that follows from it.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::features::{self, FrontEndKind, Target};
use crate::image::gray_from_rgb;
use crate::math::upper_median;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::options::{FeatureKind, FrameOrder};
use crate::pipeline::{Options, Result};
use crate::scene::{Frame, FrameId};
use crate::sfm;
use crate::video::Kind;

/// File name of the order, in the folder for the run's state.
const STATE: &str = "frames-order.json";

/// Share of tracked corners from which images count as frames of a video.
const TRACKED_SHARE: f64 = 0.6;

/// Temporal order of the images.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::pipeline) struct Order {
    /// True if the images are in time order.
    pub(in crate::pipeline) in_time: bool,
    /// Median share of corners tracked from an image to the next, if it was measured.
    pub(in crate::pipeline) followed_share: Option<f64>,
}

impl Order {
    /// Remark on the order and the option that changes it, where it was detected from the images.
    pub(in crate::pipeline) fn remark(&self) -> Option<String> {
        let percent = 100.0 * self.followed_share?;
        let seen = format!("{percent:.0} % of the corners are tracked into the next image");
        Some(match self.in_time {
            true => {
                format!("images treated as frames of a video, since {seen}; --order none treats them as photographs")
            }
            false => format!(
                "images treated as unordered photographs, since only {seen}; --order time treats them as frames of a \
                 video, which is much faster"
            ),
        })
    }
}

/// Order stated by options and input; `None` if it has to be measured.
pub(in crate::pipeline) fn stated(run: &Run) -> Option<bool> {
    of_options(run.options).or_else(|| (run.info().kind == Kind::Video).then_some(true))
}

/// Order of a folder, if the options state it.
pub(in crate::pipeline) fn of_options(options: &Options) -> Option<bool> {
    match (options.order, options.features) {
        (FrameOrder::Time, _) | (FrameOrder::Auto, FeatureKind::Video) => Some(true),
        (FrameOrder::None, _) => Some(false),
        (FrameOrder::Auto, _) => options.video.fps.is_some().then_some(true),
    }
}

/// Determines the order and stores it for later stages.
pub(in crate::pipeline) fn find(run: &Run, frames: &[Frame], outcome: &mut Outcome) -> Result<Order> {
    let order = match stated(run) {
        Some(in_time) => Order { in_time, followed_share: None },
        None => measured(run, frames)?,
    };
    run.keep(STATE, &order, outcome)?;
    Ok(order)
}

/// Tracks corners from some images to their successors, evenly distributed over the folder.
fn measured(run: &Run, frames: &[Frame]) -> Result<Order> {
    // Number of image pairs: odd, for a median; takes a fraction of a second.
    const NUM_PAIRS: usize = 7;
    let last = frames.len().saturating_sub(1);
    let firsts: BTreeSet<usize> = (0..NUM_PAIRS).map(|k| last * (2 * k + 1) / (2 * NUM_PAIRS)).collect();
    let firsts: Vec<usize> = firsts.into_iter().filter(|&first| first < last).collect();
    let ids: BTreeSet<FrameId> = firsts.iter().flat_map(|&k| [frames[k].id, frames[k + 1].id]).collect();
    let mut pictures = std::collections::BTreeMap::new();
    for (frame, picture) in run.source.frames_at(ids)?.flatten() {
        pictures.insert(frame.id, gray_from_rgb(&picture).map_err(crate::features::FeatureError::from)?);
    }
    let mut shares = Vec::new();
    for k in firsts {
        if let (Some(a), Some(b)) = (pictures.get(&frames[k].id), pictures.get(&frames[k + 1].id)) {
            // The size of a video's frames does not change.
            let is_alike = a.dimensions() == b.dimensions();
            shares.push(if is_alike { features::order::followed_share(a, b)? } else { 0.0 });
        }
    }
    let share = upper_median(shares);
    Ok(Order { in_time: share.is_some_and(|share| share >= TRACKED_SHARE), followed_share: share })
}

/// The stored order; the stage `frames` must be done.
pub(in crate::pipeline) fn found(run: &Run) -> Result<Order> {
    run.workspace.read_state(STATE)
}

/// Options of structure from motion of background and objects, by options, input and order. The stage `frames` must be
/// done.
pub(in crate::pipeline) fn sfm_options(run: &Run) -> Result<(sfm::Options, sfm::Options)> {
    Ok(resolved(run.options, found(run)?.in_time))
}

fn resolved(options: &Options, in_time: bool) -> (sfm::Options, sfm::Options) {
    let (mut background, mut objects) = (options.background.clone(), options.objects.clone());
    if !in_time {
        return (background.without_order(Target::Background), objects.without_order(Target::Object));
    }
    let kind = match options.features {
        FeatureKind::Auto => return (background, objects),
        FeatureKind::Video => FrontEndKind::Video,
        FeatureKind::Sift => FrontEndKind::Sift,
    };
    background.front_end.kind = kind;
    objects.front_end.kind = kind;
    (background, objects)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::sift_front_end::Pairing;

    #[test]
    fn features_and_order_choose_the_front_end() {
        let with = |features| Options { features, ..Options::default() };
        let (background, objects) = resolved(&with(FeatureKind::Auto), true);
        assert!(background.front_end.kind == FrontEndKind::Video && background.mapper.ordered);
        assert_eq!(objects.front_end.kind, FrontEndKind::Video);
        let (background, objects) = resolved(&with(FeatureKind::Sift), true);
        for found in [&background, &objects] {
            assert_eq!(found.front_end.kind, FrontEndKind::Sift);
            assert!(matches!(found.front_end.sift.pairing, Pairing::Sequential { .. }) && found.mapper.ordered);
        }
        for features in [FeatureKind::Auto, FeatureKind::Sift] {
            let (background, _) = resolved(&with(features), false);
            assert_eq!(background.front_end.kind, FrontEndKind::Sift);
            assert!(background.front_end.sift.pairing == Pairing::UNORDERED && !background.mapper.ordered);
        }
    }
}
