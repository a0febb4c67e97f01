//! Memory layout: observations sorted by point, parameters grouped in blocks of the reduced system.
//!
//! A *view block* contains the six degrees of freedom of a free pose and, if a camera belongs to one pose only, that
//! camera's free intrinsics. A camera of several poses is a *shared camera* with a separate block in the border of the
//! reduced system. All view blocks have the same size; unused degrees of freedom are masked.

use super::options::{Behind, Gauge, Options};
use super::parallel::in_order;
use super::problem::{CameraBlock, PointPrior, Problem};
use super::ties::anchors;
use crate::camera::NUM_INTRINSICS;

/// Marks an absent index.
pub(super) const NONE: u32 = u32::MAX;
/// Minimum depth relative to the coordinates it is the difference of: below it, depth and projection are noise.
const SMALLEST_DEPTH: f64 = 1e-9;
/// Observations checked per task.
const CHUNK: usize = 8192;
/// Degrees of freedom of a pose.
pub(super) const POSE_DIM: usize = 6;

/// Free intrinsics of a camera as columns of a Jacobian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Columns {
    /// Number of parameters.
    pub len: usize,
    /// Index of each parameter among fx, fy, cx, cy, k1, k2.
    pub source: [usize; NUM_INTRINSICS],
    /// fy / fx for a single focal length; otherwise zero.
    pub aspect: f64,
}

impl Columns {
    fn of(block: &CameraBlock) -> Self {
        let mut columns = Self::default();
        for (k, free) in block.free.iter().enumerate() {
            if *free && !(block.tie_focal && k == 1) {
                columns.source[columns.len] = k;
                columns.len += 1;
            }
        }
        if block.tie_focal {
            columns.aspect = block.camera.focal[1] / block.camera.focal[0];
        }
        columns
    }
}

/// Role of a camera's free intrinsics in the reduced system.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum IntrinsicsUse {
    Fixed,
    /// In the view block of the only pose that uses them.
    Fused,
    /// In the border, at this index.
    Shared(u32),
}

/// Combined priors on one point: a position, and the sum of their weights 1/σ².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct KnownPoint {
    position: [f64; 3],
    pub weight: f64,
}

impl KnownPoint {
    fn add(&mut self, prior: &PointPrior) {
        let weight = prior.sigma.powi(-2);
        let total = self.weight + weight;
        for k in 0..3 {
            self.position[k] += (prior.position[k] - self.position[k]) * weight / total;
        }
        self.weight = total;
    }

    /// Offset of a position from the prior's.
    pub fn offset(&self, position: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| position[k] - self.position[k])
    }

    /// The sum of the squared residuals at a position.
    pub fn cost(&self, position: &[f64; 3]) -> f64 {
        self.weight * self.offset(position).iter().map(|v| v * v).sum::<f64>()
    }
}

/// The structure of a problem; see the module.
#[derive(Default)]
pub(super) struct Layout {
    /// Index in the problem of every point that is observed.
    pub points: Vec<u32>,
    /// First observation of each of these, and the end of the last.
    pub point_start: Vec<u32>,
    /// True for each constant point.
    pub point_fixed: Vec<bool>,
    /// Prior of each point; empty if no point has one.
    pub point_priors: Vec<KnownPoint>,
    /// Per observation: its index in the problem. Measurements are not copied.
    pub obs: Vec<u32>,
    /// Per observation: view block of its pose, or [`NONE`].
    pub obs_block: Vec<u32>,
    /// Per observation: its shared camera in [`Layout::slots`], or [`NONE`].
    pub obs_slot: Vec<u32>,
    /// First slot of each point, and the end of the last. A slot is a pair of a point and a shared camera observing it.
    pub slot_start: Vec<u32>,
    /// Shared camera of each slot.
    pub slots: Vec<u32>,
    /// Pose of each view block: ascending, anchors last ([`super::ties`]).
    pub pose_of_block: Vec<u32>,
    /// View block of each pose, or [`NONE`].
    pub block_of_pose: Vec<u32>,
    /// Free pose parameters of each block.
    pub pose_mask: Vec<[bool; POSE_DIM]>,
    /// Free intrinsics of each camera.
    pub columns: Vec<Columns>,
    /// Use of each camera's intrinsics.
    pub intrinsics_use: Vec<IntrinsicsUse>,
    /// Index in the problem of each shared camera.
    pub shared: Vec<u32>,
    /// Number of ignored observations.
    pub num_ignored: usize,
    /// Fixed pose, and the pose whose distance from it is fixed.
    pub scale_pair: Option<(usize, usize)>,
}

impl Layout {
    /// Sorts a checked problem; linear in the number of observations.
    pub fn new(problem: &Problem, options: &Options, parallel: bool) -> Self {
        let used = usable_observations(problem, options.behind, parallel);
        let num_ignored = problem.observations.len() - used.len();
        let gauge = GaugeChoice::new(problem, &used, options);
        let mut layout = Self::cameras_and_blocks(problem, &used, &gauge);
        layout.num_ignored = num_ignored;
        layout.scale_pair = gauge.scale_pair;
        layout.sort_observations(problem, used);
        layout.place_priors(problem);
        layout.index_slots(problem);
        layout
    }

    /// Number of observations used.
    pub fn num_obs(&self) -> usize {
        self.obs.len()
    }

    /// Number of view blocks.
    pub fn num_blocks(&self) -> usize {
        self.pose_of_block.len()
    }

    /// Observations of a point, by its index in [`Layout::points`].
    pub fn obs_of_point(&self, point: usize) -> std::ops::Range<usize> {
        self.point_start[point] as usize..self.point_start[point + 1] as usize
    }

    /// View blocks of a point's observations, ascending; observations without a view block are omitted.
    pub fn blocks_of_point(&self, point: usize) -> &[u32] {
        let blocks = &self.obs_block[self.obs_of_point(point)];
        &blocks[..blocks.partition_point(|block| *block != NONE)]
    }

    /// Per view block: the first view block that observes a common point, or the block itself.
    pub fn first_rows(&self) -> Vec<u32> {
        let mut first_rows: Vec<u32> = (0..self.num_blocks() as u32).collect();
        for point in 0..self.points.len() {
            let blocks = self.blocks_of_point(point);
            for block in blocks {
                let row = &mut first_rows[*block as usize];
                *row = (*row).min(blocks[0]);
            }
        }
        first_rows
    }

    /// View block containing the intrinsics of a camera that belongs to one pose only.
    pub fn block_of_camera(&self, problem: &Problem, camera: usize) -> Option<usize> {
        self.pose_of_block.iter().position(|pose| problem.poses[*pose as usize].camera == camera)
    }

    /// Slots of a point.
    pub fn slots_of_point(&self, point: usize) -> std::ops::Range<usize> {
        self.slot_start[point] as usize..self.slot_start[point + 1] as usize
    }

    /// Largest number of degrees of freedom in a view block.
    pub fn largest_block(&self) -> usize {
        let fused = self.columns.iter().zip(&self.intrinsics_use).filter(|(_, usage)| **usage == IntrinsicsUse::Fused);
        POSE_DIM + fused.map(|(columns, _)| columns.len).max().unwrap_or(0)
    }

    /// Returns true if any parameter can change.
    pub fn has_freedom(&self) -> bool {
        self.num_obs() > 0
            && (self.num_blocks() > 0 || !self.shared.is_empty() || self.point_fixed.iter().any(|fixed| !fixed))
    }

    fn cameras_and_blocks(problem: &Problem, used: &[u32], gauge: &GaugeChoice) -> Self {
        let observed = observed_poses(problem, used);
        let mut users = vec![0usize; problem.cameras.len()];
        for (pose, _) in problem.poses.iter().zip(&observed).filter(|(_, seen)| **seen) {
            users[pose.camera] += 1;
        }
        let columns: Vec<_> = problem.cameras.iter().map(Columns::of).collect();
        let mut shared = Vec::new();
        let intrinsics_use: Vec<_> = (0..problem.cameras.len())
            .map(|camera| match (columns[camera].len, users[camera]) {
                (0, _) | (_, 0) => IntrinsicsUse::Fixed,
                (_, 1) => IntrinsicsUse::Fused,
                _ => {
                    shared.push(camera as u32);
                    IntrinsicsUse::Shared(shared.len() as u32 - 1)
                }
            })
            .collect();
        let mut block_of_pose = vec![NONE; problem.poses.len()];
        let (mut pose_of_block, mut pose_mask) = (Vec::new(), Vec::new());
        let anchors = anchors(problem, used);
        let in_order = (0..problem.poses.len()).filter(|index| observed[*index]);
        let (last, first): (Vec<usize>, Vec<usize>) = in_order.partition(|index| anchors[*index]);
        for index in first.into_iter().chain(last) {
            let pose = &problem.poses[index];
            let mask = gauge.mask(index, pose.fixed);
            if mask != [false; POSE_DIM] || intrinsics_use[pose.camera] == IntrinsicsUse::Fused {
                block_of_pose[index] = pose_of_block.len() as u32;
                pose_of_block.push(index as u32);
                pose_mask.push(mask);
            }
        }
        Self { pose_of_block, block_of_pose, pose_mask, columns, intrinsics_use, shared, ..Self::default() }
    }

    /// Sorts observations by point, and within a point by block, observations without a block last.
    ///
    /// Points are ordered by the first block observing them, so that the data of one block are close in memory.
    fn sort_observations(&mut self, problem: &Problem, used: Vec<u32>) {
        let num_poses = problem.poses.len();
        let rank = |o: u32| {
            let pose = problem.observations[o as usize].pose as usize;
            match self.block_of_pose[pose] {
                NONE => self.num_blocks() + pose,
                block => block as usize,
            }
        };
        let (by_block, _) = counting_sort(used.iter().map(|o| (rank(*o), *o)), self.num_blocks() + num_poses);
        let point_of = |o: u32| problem.observations[o as usize].point as usize;
        let (by_point, start) = counting_sort(by_block.iter().map(|o| (point_of(*o), *o)), problem.points.len());
        let obs_of = |p: u32| &by_point[start[p as usize] as usize..start[p as usize + 1] as usize];
        let observed = (0..problem.points.len() as u32).filter_map(|p| Some((rank(*obs_of(p).first()?), p)));
        (self.points, _) = counting_sort(observed, self.num_blocks() + num_poses);
        self.point_start = std::iter::once(0)
            .chain(self.points.iter().scan(0, |end, p| {
                *end += obs_of(*p).len() as u32;
                Some(*end)
            }))
            .collect();
        self.obs = self.points.iter().flat_map(|p| obs_of(*p)).copied().collect();
        self.point_fixed = self.points.iter().map(|p| problem.points[*p as usize].fixed).collect();
        let pose_of = |o: &u32| problem.observations[*o as usize].pose as usize;
        self.obs_block = self.obs.iter().map(|o| self.block_of_pose[pose_of(o)]).collect();
    }

    fn place_priors(&mut self, problem: &Problem) {
        if problem.priors.points.is_empty() {
            return;
        }
        let mut known = vec![KnownPoint::default(); problem.points.len()];
        for prior in &problem.priors.points {
            known[prior.point].add(prior);
        }
        self.point_priors = self.points.iter().map(|point| known[*point as usize]).collect();
    }

    fn index_slots(&mut self, problem: &Problem) {
        self.obs_slot = vec![NONE; if self.shared.is_empty() { 0 } else { self.num_obs() }];
        self.slot_start = vec![0; self.points.len() + 1];
        if self.shared.is_empty() {
            return;
        }
        for point in 0..self.points.len() {
            let first = self.slots.len();
            for o in self.obs_of_point(point) {
                let camera = problem.poses[problem.observations[self.obs[o] as usize].pose as usize].camera;
                if let IntrinsicsUse::Shared(shared) = self.intrinsics_use[camera] {
                    let place = self.slots[first..].iter().position(|s| *s == shared).unwrap_or_else(|| {
                        self.slots.push(shared);
                        self.slots.len() - 1 - first
                    });
                    self.obs_slot[o] = (first + place) as u32;
                }
            }
            self.slot_start[point + 1] = self.slots.len() as u32;
        }
    }
}

/// Sorts items by their keys, which come before them; stable. Returns the items, and where each key starts (one more
/// entry than keys).
pub(super) fn counting_sort(
    items: impl Iterator<Item = (usize, u32)> + Clone,
    num_keys: usize,
) -> (Vec<u32>, Vec<u32>) {
    let mut start = vec![0u32; num_keys + 1];
    items.clone().for_each(|(key, _)| start[key + 1] += 1);
    for k in 0..num_keys {
        start[k + 1] += start[k];
    }
    let mut next = start.clone();
    let mut sorted = vec![0; start[num_keys] as usize];
    for (key, item) in items {
        sorted[next[key] as usize] = item;
        next[key] += 1;
    }
    (sorted, start)
}

/// Observations with a well-defined projection and, if required, a point in front of the camera.
fn usable_observations(problem: &Problem, behind: Behind, parallel: bool) -> Vec<u32> {
    let usable = |o: &super::Observation| {
        let pose = &problem.poses[o.pose as usize];
        let point = problem.points[o.point as usize].position;
        let point_in_cam = pose.cam_from_world * point;
        let rounding = SMALLEST_DEPTH * (point.coords.norm() + pose.cam_from_world.translation.norm());
        if point_in_cam.z.abs() <= rounding || (behind == Behind::Ignore && point_in_cam.z < 0.0) {
            return false;
        }
        let residual = problem.cameras[pose.camera].camera.project(point_in_cam).pixel - o.pixel;
        o.whitening.norm_sq(residual).is_finite()
    };
    let starts: Vec<usize> = (0..problem.observations.len()).step_by(CHUNK).collect();
    let of_chunk = |start: usize| -> Vec<u32> {
        let end = problem.observations.len().min(start + CHUNK);
        (start as u32..end as u32).filter(|o| usable(&problem.observations[*o as usize])).collect()
    };
    in_order(parallel, starts, of_chunk).concat()
}

fn observed_poses(problem: &Problem, used: &[u32]) -> Vec<bool> {
    let mut observed = vec![false; problem.poses.len()];
    for o in used {
        observed[problem.observations[*o as usize].pose as usize] = true;
    }
    observed
}

/// Parameters fixed by [`Gauge::Auto`].
struct GaugeChoice {
    held_pose: Option<usize>,
    scale_pair: Option<(usize, usize)>,
    /// Pose, and the fixed axis of its translation.
    held_axis: Option<(usize, usize)>,
    /// True if all rotations are fixed.
    hold_rotations: bool,
}

impl GaugeChoice {
    fn new(problem: &Problem, used: &[u32], options: &Options) -> Self {
        let hold_rotations = options.hold_rotations;
        let nothing = Self { held_pose: None, scale_pair: None, held_axis: None, hold_rotations };
        let points_fixed = problem.points.iter().any(|p| p.fixed);
        if options.gauge == Gauge::Free || points_fixed || problem.priors.hold_gauge() {
            return nothing;
        }
        let observed = observed_poses(problem, used);
        let mut fixed = (0..problem.poses.len()).filter(|p| observed[*p] && problem.poses[*p].fixed);
        let (first_fixed, second_fixed) = (fixed.next(), fixed.next());
        if second_fixed.is_some() {
            return nothing;
        }
        let Some(held) = first_fixed.or_else(|| observed.iter().position(|seen| *seen)) else { return nothing };
        let center = |p: usize| problem.poses[p].cam_from_world.center();
        let distance = |p: usize| (center(p) - center(held)).norm();
        let farthest = (0..problem.poses.len())
            .filter(|p| observed[*p] && *p != held)
            .max_by(|a, b| distance(*a).total_cmp(&distance(*b)).then(b.cmp(a)))
            .filter(|p| distance(*p) > 0.0);
        let axis_of = |p: usize| (p, (problem.poses[p].cam_from_world * center(held)).coords.iamax());
        let (scale_pair, held_axis) = (farthest.map(|far| (held, far)), farthest.map(axis_of));
        Self { held_pose: Some(held), scale_pair, held_axis, ..nothing }
    }

    fn mask(&self, pose: usize, fixed: bool) -> [bool; POSE_DIM] {
        let mut mask = [!fixed && self.held_pose != Some(pose); POSE_DIM];
        if let Some((_, axis)) = self.held_axis.filter(|(held, _)| *held == pose) {
            mask[3 + axis] = false;
        }
        if self.hold_rotations {
            mask[..3].fill(false);
        }
        mask
    }
}
