//! From one frame to the next: where the points that live are predicted, and aligned.

use nalgebra::{Point2, Vector2};

use super::tracked_point::Live;
use super::{FirstLook, VideoFrontEnd};
use crate::features::patch::Aligned;
use crate::image::{LucasKanade, Pyramid};
use crate::math::Neighbors;
use crate::scene::Mask;

/// Where fewer of the points are found near where their last steps lead, the picture shows another place or moves
/// otherwise than before, and what is found there is chance.
const MIN_NEAR: f64 = 0.5;

impl VideoFrontEnd {
    /// Follows the points that live into the next frame, and forgets those that are not seen there.
    pub(super) fn follow(&mut self, previous: &Pyramid, pyramid: &Pyramid, mask: &Mask) {
        let gray = pyramid.picture();
        let followed = self.looked_for(previous, pyramid);
        let (mut moves, mut lost) = (Vec::new(), Vec::new());
        for (mut point, found) in std::mem::take(&mut self.live).into_iter().zip(followed) {
            match found {
                Some(found) => {
                    moves.push([point.warp.center, found.warp.center]);
                    point.go_on(&found);
                    self.live.push(point);
                }
                None => lost.push(point),
            }
        }
        let motion = Motion::new(&moves);
        for mut point in lost {
            let carried = motion.carry(point.warp.center);
            if let Some(found) = point.aligned(carried, gray, self.options.min_found_again) {
                point.go_on(&found);
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

    /// The points that live, where Lucas-Kanade leads and their patches are seen: first those that have moved before,
    /// from where their last step leads, or those of a small target, from where its mask has gone; and through the
    /// whole pyramid what is new or lost so. The patch is the check, so that nothing is followed back.
    fn looked_for(&self, previous: &Pyramid, pyramid: &Pyramid) -> Vec<Option<Aligned>> {
        let tracker = LucasKanade {
            window_radius_px: self.reach.window_radius_px.max(1) as usize,
            num_smaller: self.options.pyramid_levels.max(0) as usize,
            max_steps: 20,
            converged_px: 0.03,
            min_eigenvalue: 1e-4,
        };
        let prediction = |live: &Live| match self.options.first_look {
            FirstLook::Predicted => live.predicted(),
            FirstLook::Pyramid => self.shift.map(|shift| live.warp.center + shift),
        };
        let look = |tracker: LucasKanade, chosen: &[usize], guesses: &[Point2<f32>]| -> Vec<Option<Aligned>> {
            let starts: Vec<_> = chosen.iter().map(|&k| self.live[k].warp.center).collect();
            let followed = tracker.follow(previous, pyramid, &starts, guesses).into_iter().zip(chosen);
            let aligned =
                |position, k: usize| self.live[k].aligned(position, pyramid.picture(), self.options.min_correlation);
            followed.map(|(followed, &k)| aligned(followed?.position, k)).collect()
        };
        let mut found: Vec<Option<Aligned>> = vec![None; self.live.len()];
        let (moving, predicted): (Vec<usize>, Vec<Point2<f32>>) =
            self.live.iter().enumerate().filter_map(|(k, live)| Some((k, prediction(live)?))).unzip();
        let near = look(tracker.near(), &moving, &predicted);
        if near.iter().flatten().count() as f64 >= MIN_NEAR * moving.len() as f64 {
            moving.into_iter().zip(near).for_each(|(k, aligned)| found[k] = aligned);
        }
        let open: Vec<usize> = (0..found.len()).filter(|&k| found[k].is_none()).collect();
        let places: Vec<_> = open.iter().map(|&k| self.live[k].warp.center).collect();
        let anywhere = look(tracker, &open, &places);
        open.into_iter().zip(anywhere).for_each(|(k, aligned)| found[k] = aligned);
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

    /// Where a point goes if it moves like its neighbours: by the median of their shifts.
    fn carry(&self, from: Point2<f32>) -> Point2<f32> {
        // Nine: odd, for a median; few enough to lie on the same surface.
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
