//! Maps of a video that are folded at one place.
//!
//! Where an object turns fast, few points are seen both before and after, all on a narrow piece of it, which fits two
//! poses as in [`super::pose_outliers`]. Where all that comes later grows from the wrong one, both parts of the map are
//! right by themselves, and turned against one another about the piece that they share, as about a hinge. Nearly as
//! much is explained as in the right map; but between two frames there lies a turn that is many times those round it.

use super::{IncrementalMapper, PosePriors};

/// A turn between two views that is so many times the largest round it is a fold.
const FOLD: f64 = 4.0;
/// No smaller turn per frame is, radians.
const LEAST_TURN: f64 = 0.17;
/// Turns on each side that it is compared with.
const ROUND_IT: usize = 5;

/// Where a map is folded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hinge {
    /// Two registered views, one after the other.
    pub views: [usize; 2],
    /// Rotation of the camera between them, radians per frame.
    pub turn: f64,
}

impl IncrementalMapper<'_> {
    /// The sharpest fold of a video's map.
    pub fn discontinuity(&self) -> Option<Hinge> {
        let views: Vec<usize> = if self.options.ordered { self.map.registered().collect() } else { Vec::new() };
        let turns = self.turns(&views);
        let place = sharpest_fold(&turns)?;
        Some(Hinge { views: [views[place], views[place + 1]], turn: turns[place] })
    }

    /// Rotations of the camera from each registered view to the next, radians per frame.
    fn turns(&self, views: &[usize]) -> Vec<f64> {
        let turn = |pair: &[usize]| {
            let (from, to) = (self.map.poses[pair[0]]?, self.map.poses[pair[1]]?);
            Some(from.rotation.angle_to(&to.rotation) / (pair[1] - pair[0]) as f64)
        };
        views.windows(2).filter_map(turn).collect()
    }

    /// The poses on the side of a fold that has more views; what lies on the other is to be grown again.
    pub fn longer_side(&self, discontinuity: &Hinge) -> PosePriors {
        let [before, after] = discontinuity.views;
        let num_before = self.map.registered().filter(|view| *view <= before).count();
        let is_before = 2 * num_before >= self.map.num_registered();
        let is_kept = |view: usize| if is_before { view <= before } else { view >= after };
        let poses = (0..self.map.poses.len()).map(|view| self.map.poses[view].filter(|_| is_kept(view)));
        PosePriors { poses: poses.collect(), error_px: 0.0 }
    }
}

/// The place of the largest turn that is a fold.
fn sharpest_fold(turns: &[f64]) -> Option<usize> {
    let is_fold = |&k: &usize| {
        let round_it = turns[k.saturating_sub(ROUND_IT)..k].iter().chain(turns[k + 1..].iter().take(ROUND_IT));
        turns[k] > LEAST_TURN.max(FOLD * round_it.copied().fold(0.0, f64::max))
    };
    (0..turns.len()).filter(is_fold).max_by(|&a, &b| turns[a].total_cmp(&turns[b]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fold_stands_out_from_the_turns_round_it() {
        // Radians per frame of a car that turned over, where another map of it has 0.10 and 0.03.
        let turns = [0.01, 0.01, 0.05, 0.01, 0.01, 0.58, 0.09, 0.10, 0.09, 0.08, 0.07];
        assert_eq!(sharpest_fold(&turns), Some(5));
        assert_eq!(sharpest_fold(&turns[..5]), None);
        // A fast pan begins and ends gently, and one that is shaken is shaken all along.
        assert_eq!(sharpest_fold(&[0.0, 0.1, 0.3, 0.5, 0.5, 0.3, 0.1, 0.0]), None);
        assert_eq!(sharpest_fold(&[0.3, 0.02, 0.4, 0.01, 0.3, 0.1, 0.35]), None);
        assert_eq!(sharpest_fold(&[]), None);
    }
}
