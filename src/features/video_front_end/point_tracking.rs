//! Tracking from one frame to the next: prediction and alignment of the live points.

use nalgebra::{Point2, Vector2};

use super::tracked_point::TrackedPoint;
use super::{FirstLook, VideoFrontEnd};
use crate::features::patch::Aligned;
use crate::image::{LucasKanade, Pyramid};
use crate::math::Neighbors;
use crate::scene::Mask;

/// Minimum share of the predicted points that are found near their predictions. With fewer, the image shows another
/// scene or moves otherwise than before, and what is found there is chance.
const MIN_NEAR: f64 = 0.5;

impl VideoFrontEnd {
    /// Tracks the live points into the next frame, and drops those that are lost.
    pub(super) fn follow(&mut self, previous: &Pyramid, pyramid: &Pyramid, mask: &Mask) {
        let gray = pyramid.picture();
        let followed = self.aligned_points(previous, pyramid);
        let (mut moves, mut lost) = (Vec::new(), Vec::new());
        for (mut point, found) in std::mem::take(&mut self.live).into_iter().zip(followed) {
            match found {
                Some(found) => {
                    moves.push([point.warp.center, found.warp.center]);
                    point.update(&found);
                    self.live.push(point);
                }
                None => lost.push(point),
            }
        }
        let motion = Motion::new(&moves);
        for mut point in lost {
            let predicted = motion.predict(point.warp.center);
            if let Some(found) = point.aligned(predicted, gray, self.options.min_found_again) {
                point.update(&found);
                self.live.push(point);
            }
        }
        self.live.retain_mut(|point| {
            let center = point.warp.center.cast::<f64>();
            let is_over = point.views_left.as_mut().is_some_and(|left| {
                *left = left.saturating_sub(1);
                *left == 0
            });
            !is_over && mask.contains(center.x, center.y)
        });
    }

    /// Aligns the live points in the next frame, at the positions that Lucas-Kanade finds.
    ///
    /// Points with a predicted position, or those of a small target with its mask's displacement, are searched there
    /// first. New points and those lost there are searched through the whole pyramid. The patch verifies them, so there
    /// is no backward tracking.
    fn aligned_points(&self, previous: &Pyramid, pyramid: &Pyramid) -> Vec<Option<Aligned>> {
        let tracker = LucasKanade {
            window_radius_px: self.reach.window_radius_px.max(1) as usize,
            num_smaller: self.options.pyramid_levels.max(0) as usize,
            max_steps: 20,
            converged_px: 0.03,
            min_eigenvalue: 1e-4,
        };
        let prediction = |live: &TrackedPoint| match self.options.first_look {
            FirstLook::Predicted => live.predicted(),
            FirstLook::Pyramid => self.shift.map(|shift| live.warp.center + shift),
        };
        let track_and_align =
            |tracker: LucasKanade, chosen: &[usize], guesses: &[Point2<f32>]| -> Vec<Option<Aligned>> {
                let starts: Vec<_> = chosen.iter().map(|&k| self.live[k].warp.center).collect();
                let followed = tracker.follow(previous, pyramid, &starts, guesses).into_iter().zip(chosen);
                let aligned = |position, k: usize| {
                    self.live[k].aligned(position, pyramid.picture(), self.options.min_correlation)
                };
                followed.map(|(followed, &k)| aligned(followed?.position, k)).collect()
            };
        let mut found: Vec<Option<Aligned>> = vec![None; self.live.len()];
        let (moving, predicted): (Vec<usize>, Vec<Point2<f32>>) =
            self.live.iter().enumerate().filter_map(|(k, live)| Some((k, prediction(live)?))).unzip();
        let near = track_and_align(tracker.near(), &moving, &predicted);
        if near.iter().flatten().count() as f64 >= MIN_NEAR * moving.len() as f64 {
            moving.into_iter().zip(near).for_each(|(k, aligned)| found[k] = aligned);
        }
        let open: Vec<usize> = (0..found.len()).filter(|&k| found[k].is_none()).collect();
        let positions: Vec<_> = open.iter().map(|&k| self.live[k].warp.center).collect();
        let remaining = track_and_align(tracker, &open, &positions);
        open.into_iter().zip(remaining).for_each(|(k, aligned)| found[k] = aligned);
        found
    }
}

/// Image motion between two frames, from tracked points.
struct Motion {
    shifts: Vec<Vector2<f32>>,
    tree: Option<Neighbors<2>>,
}

impl Motion {
    /// From the positions of points in both frames.
    fn new(moves: &[[Point2<f32>; 2]]) -> Self {
        let starts: Vec<[f64; 2]> = moves.iter().map(|[from, _]| from.coords.cast::<f64>().into()).collect();
        Self { shifts: moves.iter().map(|[from, to]| to - from).collect(), tree: Neighbors::new(&starts) }
    }

    /// Predicts a point by the median displacement of its neighbors.
    fn predict(&self, from: Point2<f32>) -> Point2<f32> {
        // Nine: odd, for a median; few enough to be on the same surface.
        let near = self.tree.as_ref().map(|tree| tree.nearest(&from.coords.cast::<f64>().into(), 9));
        let near = near.unwrap_or_default();
        if near.is_empty() {
            return from;
        }
        let median = |axis: usize| {
            let mut values: Vec<f32> = near.iter().map(|&i| self.shifts[i][axis]).collect();
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        from + Vector2::new(median(0), median(1))
    }
}
