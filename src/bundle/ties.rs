//! Points observed by views far apart in time, as in loop closures of a video.
//!
//! Such a point couples all views of one visit with all views of the other, and every further visit fills more of the
//! reduced system, until it is dense. Two measures keep it sparse:
//!
//! - *thinning* ([`Problem::thin_ties`]): a point ties its last visit to its first, of which only every sixteenth view
//!   is used, the same for all points. The other points of those views provide the rest of the information, and
//!   intermediate visits are tied by points without later observations;
//! - *ordering*: those few views, the [`anchors`], come last in the reduced system. The remaining system is a band, and
//!   its Cholesky factor has fill only in the rows of the anchors.

use super::layout::counting_sort;
use super::problem::Problem;

/// Power of two dividing the indices of the views used of the first visit: one view in sixteen.
const MOST_HALVINGS: u32 = 4;
/// Number of poses below which no special ordering pays.
const FEW_POSES: usize = 256;
/// Gap between observations, in poses, beyond which a point starts another visit.
pub(super) const FAR: u32 = 96;
/// Maximum fraction of anchors among all poses: more would no longer be a small border.
const MOST_ANCHORS: f64 = 0.2;

impl Problem {
    /// Removes redundant observations of points re-detected after more than `gap` poses.
    ///
    /// The last visit is kept, and of the first one view in sixteen, or, if it has none of these, one in eight, in
    /// four, or in two. Poses are in order of time.
    pub fn thin_ties(&mut self, gap: usize) {
        let used: Vec<u32> = (0..self.observations.len() as u32).collect();
        let mut kept = vec![true; used.len()];
        let pose = |o: u32| self.observations[o as usize].pose;
        for seen in Visits::of(self, &used).of_points() {
            let visits = earlier_visits(seen, pose, u32::try_from(gap).unwrap_or(u32::MAX));
            for (place, visit) in visits.enumerate() {
                let most = match place {
                    0 => visit.iter().map(|o| halvings(pose(*o))).max().unwrap_or(0),
                    _ => u32::MAX,
                };
                visit.iter().filter(|o| halvings(pose(**o)) < most).for_each(|o| kept[*o as usize] = false);
            }
        }
        let mut kept = kept.into_iter();
        self.observations.retain(|_| kept.next().unwrap_or(true));
    }
}

/// Number of times an index can be halved, up to [`MOST_HALVINGS`].
fn halvings(pose: u32) -> u32 {
    pose.trailing_zeros().min(MOST_HALVINGS)
}

/// True for each pose that is an anchor: one of the few that tie later poses to an earlier visit.
///
/// Small problems have none; neither have problems with too many anchors for a border.
pub(super) fn anchors(problem: &Problem, used: &[u32]) -> Vec<bool> {
    let mut anchors = vec![false; problem.poses.len()];
    if problem.poses.len() < FEW_POSES {
        return anchors;
    }
    let pose = |o: u32| problem.observations[o as usize].pose;
    for seen in Visits::of(problem, used).of_points() {
        for o in earlier_visits(seen, pose, FAR).flatten() {
            anchors[pose(*o) as usize] = true;
        }
    }
    let count = anchors.iter().filter(|is| **is).count();
    if count as f64 > MOST_ANCHORS * problem.poses.len() as f64 {
        anchors.fill(false);
    }
    anchors
}

/// The observations of every point, in the order of their poses.
struct Visits {
    sorted: Vec<u32>,
    start: Vec<u32>,
}

impl Visits {
    fn of(problem: &Problem, used: &[u32]) -> Self {
        let by_point = used.iter().map(|o| (problem.observations[*o as usize].point as usize, *o));
        let (mut sorted, start) = counting_sort(by_point, problem.points.len());
        for pair in start.windows(2) {
            sorted[pair[0] as usize..pair[1] as usize].sort_by_key(|o| problem.observations[*o as usize].pose);
        }
        Self { sorted, start }
    }

    fn of_points(&self) -> impl Iterator<Item = &[u32]> {
        self.start.windows(2).map(|pair| &self.sorted[pair[0] as usize..pair[1] as usize])
    }
}

/// All visits of a point except the last: runs of its observations, sorted by pose, without a gap wider than `gap`.
fn earlier_visits(seen: &[u32], pose: impl Fn(u32) -> u32 + Copy, gap: u32) -> impl Iterator<Item = &[u32]> {
    let mut visits = seen.chunk_by(move |a, b| pose(*b) - pose(*a) <= gap).peekable();
    std::iter::from_fn(move || visits.next().filter(|_| visits.peek().is_some()))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point2, Point3};

    use super::super::problem::{CameraBlock, Observation, PointBlock, PoseBlock};
    use super::*;
    use crate::camera::Camera;
    use crate::math::Rigid3;

    /// Problem of `num_poses` poses, with the observing poses of each point.
    fn seen(num_poses: usize, points: &[Vec<u32>]) -> Problem {
        let pose = PoseBlock { cam_from_world: Rigid3::identity(), camera: 0, fixed: false };
        let point = PointBlock { position: Point3::new(0.0, 0.0, 1.0), fixed: false };
        let observations = (0..).zip(points).flat_map(|(point, poses)| {
            poses.iter().rev().map(move |pose| Observation::new(*pose, point, Point2::origin()))
        });
        Problem {
            cameras: vec![CameraBlock::fixed(Camera::prior(960, 540))],
            poses: vec![pose; num_poses],
            points: vec![point; points.len()],
            observations: observations.collect(),
            ..Problem::default()
        }
    }

    fn poses_of(problem: &Problem, point: u32) -> Vec<u32> {
        let own = problem.observations.iter().filter(|o| o.point == point);
        own.map(|o| o.pose).rev().collect()
    }

    #[test]
    fn the_last_visit_is_left_and_one_view_in_sixteen_of_the_first() {
        let visits = [(20..60).collect::<Vec<u32>>(), (300..330).collect(), (500..540).collect()];
        let mut problem = seen(600, &[visits.concat(), (20..60).collect(), vec![6, 7, 300, 302]]);
        problem.thin_ties(100);
        let last: Vec<u32> = (500..540).collect();
        assert_eq!(poses_of(&problem, 0), [vec![32, 48], last].concat());
        assert_eq!(poses_of(&problem, 1).len(), 40);
        assert_eq!(poses_of(&problem, 2), [6, 300, 302]);
    }

    #[test]
    fn anchors_are_the_few_views_of_earlier_visits() {
        let mut problem = seen(600, &[(0..40).chain(300..340).collect(), (30..90).collect()]);
        let used = |problem: &Problem| (0..problem.observations.len() as u32).collect::<Vec<_>>();
        problem.thin_ties(96);
        let found = anchors(&problem, &used(&problem));
        assert_eq!((0..600).filter(|pose| found[*pose]).collect::<Vec<_>>(), [0, 16, 32]);
        // Problems with too many anchors, and small problems, keep their order.
        let many = seen(600, &[(0..200).chain(300..340).collect()]);
        assert!(!anchors(&many, &used(&many)).contains(&true));
        let small = seen(200, &[vec![0, 150]]);
        assert!(!anchors(&small, &used(&small)).contains(&true));
    }
}
