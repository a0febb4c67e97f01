//! From one frame to the next: where the points that live are predicted, and aligned.

use nalgebra::{Point2, Vector2};

use super::tracked_point::Live;
use super::{FirstLook, VideoFrontEnd};
use crate::image::{LucasKanade, Pyramid, Returned};
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
        let max_round_trip_px = self.options.max_round_trip_px;
        let (mut moves, mut lost) = (Vec::new(), Vec::new());
        for (mut point, followed) in std::mem::take(&mut self.live).into_iter().zip(followed) {
            let start = point.warp.center;
            let returned = followed.filter(|f| f.round_trip_px <= max_round_trip_px);
            if returned.is_some_and(|f| point.align(f.position, gray, self.options.min_correlation)) {
                moves.push([start, point.warp.center]);
                self.live.push(point);
            } else {
                lost.push(point);
            }
        }
        let motion = Motion::new(&moves);
        for mut point in lost {
            if point.align(motion.carry(point.warp.center), gray, self.options.min_found_again) {
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

    /// Where Lucas-Kanade finds the points that live: first those that have moved before, where their last step leads,
    /// or those of a small target, where its mask has gone; and through the whole pyramid what is new or lost so.
    fn looked_for(&self, previous: &Pyramid, pyramid: &Pyramid) -> Vec<Option<Returned>> {
        let tracker = LucasKanade {
            window_radius_px: self.reach.window_radius_px.max(1) as usize,
            num_smaller: self.options.pyramid_levels.max(0) as usize,
            max_steps: 20,
            converged_px: 0.03,
            min_eigenvalue: 1e-4,
        };
        let starts = |chosen: &[usize]| chosen.iter().map(|&k| self.live[k].warp.center).collect::<Vec<_>>();
        let mut found: Vec<Option<Returned>> = vec![None; self.live.len()];
        let prediction = |live: &Live| match self.options.first_look {
            FirstLook::Predicted => live.predicted(),
            FirstLook::Pyramid => self.shift.map(|shift| live.warp.center + shift),
        };
        let (moving, predicted): (Vec<usize>, Vec<Point2<f32>>) =
            self.live.iter().enumerate().filter_map(|(k, live)| Some((k, prediction(live)?))).unzip();
        let is_back = |f: &Returned| f.round_trip_px <= self.options.max_round_trip_px;
        let near = tracker.near().there_and_back(previous, pyramid, &starts(&moving), &predicted);
        let num_back = near.iter().flatten().filter(|f| is_back(f)).count();
        if num_back as f64 >= MIN_NEAR * moving.len() as f64 {
            moving.into_iter().zip(near).for_each(|(k, followed)| found[k] = followed);
        }
        let open: Vec<usize> = (0..found.len()).filter(|&k| !found[k].as_ref().is_some_and(is_back)).collect();
        let starts = starts(&open);
        let anywhere = tracker.there_and_back(previous, pyramid, &starts, &starts);
        open.into_iter().zip(anywhere).for_each(|(k, followed)| found[k] = followed);
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
        // Odd, for a median; few enough to lie on the same surface.
        const NUM_NEIGHBOURS: usize = 9;
        let near = self.tree.as_ref().map(|tree| tree.nearest(&from.coords.cast::<f64>().into(), NUM_NEIGHBOURS));
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
