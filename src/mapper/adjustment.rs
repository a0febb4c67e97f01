//! Conversion of a map to a bundle adjustment problem and back.

use std::ops::Range;

use nalgebra::Point2;

use super::map::Map;
use super::{Noise, Options, intrinsics_prior};
use crate::bundle::{self, CameraBlock, Observation, PointBlock, PoseBlock, Problem};
use crate::camera::{Camera, NUM_INTRINSICS};
use crate::mapper::MapperError;
use crate::math::bin;

/// Parameters that an adjustment changes.
#[derive(Clone, Debug)]
pub enum Scope {
    /// All views and points.
    Everything,
    /// All points; all poses are fixed.
    Points,
    /// All views and points, to a coarse tolerance: enough to measure the noise and to reject outliers.
    Coarse,
    /// As [`Self::Coarse`], with fixed rotations.
    Positions,
    /// All views and about [`POINTS_PER_VIEW`] points per view: the longest tracks in every part of the image.
    Selected,
    /// A view, the views that share most points with it, and the points that these observe; other views are fixed.
    Local(usize),
    /// Some views of a long video and the points that these observe.
    Segment(Segment),
}

/// Views that are adjusted while the others are fixed.
#[derive(Clone, Debug)]
pub struct Segment {
    /// Free views.
    pub views: Range<usize>,
    /// Views whose observations count, free or fixed.
    pub counted: Range<usize>,
    /// Scope for the whole map: it determines the points, fixed rotations and the convergence limits.
    pub scope: Box<Scope>,
}

impl Scope {
    /// Returns true if all rotations are fixed.
    fn fixes_rotations(&self) -> bool {
        match self {
            Self::Segment(segment) => segment.scope.fixes_rotations(),
            _ => matches!(self, Self::Positions),
        }
    }

    /// Maximum number of iterations, and tolerance of the cost as a share of it.
    fn limits(&self, options: &Options) -> (usize, f64) {
        match self {
            Self::Segment(segment) => segment.scope.limits(options),
            Self::Everything | Self::Points | Self::Selected => (30, 1e-6),
            Self::Coarse | Self::Positions => (30, options.coarse_tolerance),
            Self::Local(_) => (10, 1e-4),
        }
    }
}

/// Intrinsics that are adjusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Freedom {
    /// None.
    Nothing,
    /// One focal length.
    Focal,
    /// One focal length, and the first coefficient of radial distortion.
    FocalAndFirstRadial,
    /// One focal length, and radial distortion.
    FocalAndRadial,
    /// These and the principal point.
    WithPrincipalPoint,
}

impl Freedom {
    /// Intrinsics that are adjusted while a map grows.
    pub fn initial(map: &Map<'_>) -> Self {
        if map.unknown_cameras().next().is_some() { Self::FocalAndRadial } else { Self::Nothing }
    }

    /// Intrinsics that are adjusted, by camera.
    ///
    /// Those of a camera that is calibrated or observes no point are fixed. Of one of several cameras that observes few
    /// points at most the focal length and the first distortion coefficient are adjusted: the margin of its images
    /// constrains little.
    fn by_camera(self, map: &Map<'_>) -> Vec<Self> {
        let num_seen = map.num_points_of_cameras();
        let mut all = vec![Self::Nothing; num_seen.len()];
        for camera in map.unknown_cameras().filter(|&camera| num_seen[camera] > 0) {
            let few = num_seen.len() > 1 && num_seen[camera] < 300;
            all[camera] = if few { self.min(Self::FocalAndFirstRadial) } else { self };
        }
        all
    }

    /// Free parameters among fx, fy, cx, cy, k1, k2.
    fn mask(self) -> [bool; NUM_INTRINSICS] {
        match self {
            Self::Nothing => [false; NUM_INTRINSICS],
            Self::Focal => [true, true, false, false, false, false],
            Self::FocalAndFirstRadial => [true, true, false, false, true, false],
            Self::FocalAndRadial => [true, true, false, false, true, true],
            Self::WithPrincipalPoint => [true; NUM_INTRINSICS],
        }
    }
}

/// Adjusts a map; returns true for every track whose point was adjusted.
pub fn adjust(
    map: &mut Map<'_>,
    scope: &Scope,
    intrinsics: Freedom,
    noise: Noise,
    options: &Options,
) -> Result<Vec<bool>, MapperError> {
    let (tracks, free_views) = points_and_free_views(map, scope);
    let mut freedom = intrinsics.by_camera(map);
    let selection = ObservationSelection::of(scope, options);
    let (max_iterations, function_tolerance) = scope.limits(options);
    let loss = options.loss(noise);
    let hold_rotations = scope.fixes_rotations();
    let bundle_options =
        bundle::Options { loss, max_iterations, function_tolerance, hold_rotations, ..bundle::Options::default() };
    loop {
        let (mut problem, block_sources) = build_with(map, &tracks, &free_views, &freedom, noise, &selection);
        bundle::adjust(&mut problem, &bundle_options)?;
        if !fix_implausible_intrinsics(&mut freedom, &problem) {
            write_back(map, &problem, &block_sources);
            return Ok(tracks);
        }
        tracing::debug!("intrinsics are not determined by {} views; held", problem.poses.len());
    }
}

/// Fixes cameras whose adjusted intrinsics are implausible; returns true if there were any.
///
/// The motion does not determine them (yet), and their values before the adjustment are better.
fn fix_implausible_intrinsics(freedom: &mut [Freedom], problem: &Problem) -> bool {
    let is_implausible = |(freedom, block): &(&mut Freedom, &CameraBlock)| {
        **freedom != Freedom::Nothing && !intrinsics_prior::is_plausible(&block.camera)
    };
    let implausible = freedom.iter_mut().zip(&problem.cameras).filter(is_implausible);
    implausible.map(|(freedom, _)| *freedom = Freedom::Nothing).count() > 0
}

/// Points of a scope, by track, and its free views.
fn points_and_free_views(map: &Map<'_>, scope: &Scope) -> (Vec<bool>, Vec<bool>) {
    let mut tracks = vec![false; map.tracks.len()];
    let mut free_views = vec![true; map.poses.len()];
    match scope {
        Scope::Everything | Scope::Coarse | Scope::Positions | Scope::Points => {
            tracks.iter_mut().enumerate().for_each(|(t, used)| *used = map.point(t).is_some());
            free_views.fill(!matches!(scope, Scope::Points));
        }
        Scope::Selected => select_tracks(map, map.registered(), &mut tracks),
        Scope::Segment(segment) => {
            free_views = (0..map.poses.len()).map(|view| segment.views.contains(&view)).collect();
            select_in_segment(map, segment, &mut tracks);
        }
        Scope::Local(view) => {
            free_views = local_views(map, *view);
            for v in (0..free_views.len()).filter(|&v| free_views[v]) {
                map.visible(v).iter().for_each(|s| tracks[s.track as usize] = true);
            }
        }
    }
    (tracks, free_views)
}

/// View of each pose block and track of each point block of a problem.
struct BlockSources {
    views: Vec<usize>,
    tracks: Vec<usize>,
}

/// Observations of the points that count.
enum ObservationSelection {
    /// All.
    All,
    /// All in free views, and at most [`MAX_FIXED_VIEWS`] of each point in fixed views, evenly spaced.
    FewFixed,
    /// A part of the earlier observations, of points that were lost for more than some views ([`Problem::thin_ties`]).
    Thinned {
        /// Maximum number of views between observations of one visit.
        gap: usize,
    },
    /// Those in some views.
    InViews(Range<usize>),
}

impl ObservationSelection {
    fn of(scope: &Scope, options: &Options) -> Self {
        match (scope, options.ordered) {
            (Scope::Local(_), _) => Self::FewFixed,
            (Scope::Segment(segment), _) => Self::InViews(segment.counted.clone()),
            (_, true) => Self::Thinned { gap: options.max_track_views },
            (_, false) => Self::All,
        }
    }

    fn counts(&self, view: usize) -> bool {
        !matches!(self, Self::InViews(views) if !views.contains(&view))
    }
}

/// Number of free views of a local adjustment.
const LOCAL_VIEWS: usize = 6;
/// Number of points per view in global adjustments of a growing map; the last adjustments use all points.
const POINTS_PER_VIEW: usize = 250;
/// Maximum number of fixed views that constrain a point in a local adjustment: more would constrain it no better, and
/// take most of the time.
const MAX_FIXED_VIEWS: usize = 8;

/// Bundle adjustment problem of a scope.
pub(super) fn build(map: &Map<'_>, scope: &Scope, intrinsics: Freedom, noise: Noise, options: &Options) -> Problem {
    let (tracks, free_views) = points_and_free_views(map, scope);
    build_with(map, &tracks, &free_views, &intrinsics.by_camera(map), noise, &ObservationSelection::of(scope, options))
        .0
}

/// Bundle adjustment problem with the free intrinsics of each camera.
fn build_with(
    map: &Map<'_>,
    tracks: &[bool],
    free_views: &[bool],
    freedom: &[Freedom],
    noise: Noise,
    selection: &ObservationSelection,
) -> (Problem, BlockSources) {
    let mut problem = Problem::default();
    let block = |(idx, (&camera, freedom)): (usize, (&Camera, &Freedom))| {
        let may_change = map.known.of(idx).may_change();
        let free = freedom.mask();
        CameraBlock { camera, free: std::array::from_fn(|k| free[k] && may_change[k]), tie_focal: true }
    };
    problem.cameras = map.cameras.iter().zip(freedom).enumerate().map(block).collect();
    let adjusted = (0..freedom.len()).filter(|&camera| freedom[camera] != Freedom::Nothing);
    problem.priors.intrinsics = adjusted.map(|camera| intrinsics_prior::prior(camera, map, noise)).collect();
    let block_sources = block_sources(map, tracks, selection);
    let mut pose_of_view = vec![0; free_views.len()];
    for (pose, &view) in (0..).zip(&block_sources.views) {
        let Some(cam_from_world) = map.poses[view] else { continue };
        let camera = map.table.views[view].camera;
        problem.poses.push(PoseBlock { cam_from_world, camera, fixed: !free_views[view] });
        pose_of_view[view] = pose;
    }
    for &track in &block_sources.tracks {
        let Some(point) = map.point(track) else { continue };
        let point_index = problem.points.len() as u32;
        problem.points.push(PointBlock { position: point.position, fixed: false });
        let counts = |view: usize| map.poses[view].is_some() && selection.counts(view);
        let seen = || map.observations(track).filter(|(_, view, _)| counts(*view));
        let one_in = match selection {
            ObservationSelection::FewFixed => {
                seen().filter(|(_, view, _)| !free_views[*view]).count().div_ceil(MAX_FIXED_VIEWS).max(1)
            }
            ObservationSelection::All | ObservationSelection::Thinned { .. } | ObservationSelection::InViews(_) => 1,
        };
        let mut num_fixed = 0;
        for (slot, view, pixel) in seen() {
            num_fixed += usize::from(!free_views[view]);
            if !free_views[view] && num_fixed % one_in != 0 {
                continue;
            }
            let whitening = map.table.whitening(map.tracks[track][slot]);
            let seen = Observation::new(pose_of_view[view], point_index, pixel);
            problem.observations.push(Observation { whitening, ..seen });
        }
    }
    if let ObservationSelection::Thinned { gap } = selection {
        problem.thin_ties(*gap);
    }
    (problem, block_sources)
}

/// Known points among some tracks and the registered views that observe them, both ascending.
fn block_sources(map: &Map<'_>, tracks: &[bool], selection: &ObservationSelection) -> BlockSources {
    let tracks: Vec<usize> = (0..tracks.len()).filter(|&t| tracks[t] && map.point(t).is_some()).collect();
    let mut seen = vec![false; map.poses.len()];
    tracks.iter().flat_map(|&track| map.observations(track)).for_each(|(_, view, _)| seen[view] = true);
    BlockSources { views: map.registered().filter(|&view| seen[view] && selection.counts(view)).collect(), tracks }
}

fn write_back(map: &mut Map<'_>, problem: &Problem, block_sources: &BlockSources) {
    for (camera, block) in map.cameras.iter_mut().zip(&problem.cameras) {
        *camera = block.camera;
    }
    for (&view, block) in block_sources.views.iter().zip(&problem.poses) {
        map.poses[view] = Some(block.cam_from_world);
    }
    for (&track, block) in block_sources.tracks.iter().zip(&problem.points) {
        map.move_point(track, block.position);
    }
}

/// Marks a view and the views that share most points with it.
fn local_views(map: &Map<'_>, view: usize) -> Vec<bool> {
    let mut shared = vec![0usize; map.poses.len()];
    for s in map.visible(view) {
        for (_, other, _) in map.observations(s.track as usize) {
            shared[other] += 1;
        }
    }
    let mut order: Vec<usize> = (0..shared.len()).filter(|&v| v != view && shared[v] > 0).collect();
    order.sort_by_key(|&v| (usize::MAX - shared[v], v));
    let mut chosen = vec![false; shared.len()];
    chosen[view] = true;
    order.into_iter().take(LOCAL_VIEWS - 1).for_each(|v| chosen[v] = true);
    chosen
}

/// Marks the points that a segment observes and that have at least two counted observations.
fn select_in_segment(map: &Map<'_>, segment: &Segment, tracks: &mut [bool]) {
    let views: Vec<usize> = map.registered().filter(|view| segment.views.contains(view)).collect();
    match *segment.scope {
        Scope::Selected => select_tracks(map, views.into_iter(), tracks),
        _ => views.iter().for_each(|&v| map.visible(v).iter().for_each(|s| tracks[s.track as usize] = true)),
    }
    let counted = |track: usize| map.observations(track).filter(|(_, view, _)| segment.counted.contains(view));
    for (track, used) in tracks.iter_mut().enumerate().filter(|(_, used)| **used) {
        *used = counted(track).nth(1).is_some() && counted(track).any(|(_, view, _)| segment.views.contains(&view));
    }
}

/// Columns and rows of a grid over an image: cells of about the same shape in frames of 4:3 and 16:9.
const GRID: [usize; 2] = [8, 6];
/// Number of cells of the grid.
const NUM_CELLS: usize = GRID[0] * GRID[1];

/// Grid cell of a pixel.
pub(super) fn cell_of(pixel: Point2<f64>, camera: &Camera) -> usize {
    let [width, height] = [camera.width, camera.height].map(f64::from);
    bin(pixel.y / height, GRID[1]) * GRID[0] + bin(pixel.x / width, GRID[0])
}

/// Marks the longest tracks in each grid cell of some registered views, up to [`POINTS_PER_VIEW`] per view.
fn select_tracks(map: &Map<'_>, views: impl Iterator<Item = usize>, selected: &mut [bool]) {
    let length: Vec<usize> = (0..selected.len()).map(|track| map.observations(track).count()).collect();
    for view in views {
        let camera = map.camera_of(view);
        let mut cells: Vec<Vec<usize>> = vec![Vec::new(); NUM_CELLS];
        for s in map.visible(view) {
            let (_, pixel) = map.feature(s.track as usize, s.slot as usize);
            cells[cell_of(pixel, camera)].push(s.track as usize);
        }
        for mut cell in cells {
            cell.sort_by_key(|&track| (!selected[track], usize::MAX - length[track], track));
            cell.into_iter().take(POINTS_PER_VIEW / NUM_CELLS).for_each(|track| selected[track] = true);
        }
    }
    // An object fills few cells of the grid: up to this number of points a selection saves too little.
    if map.num_points() <= 1500 {
        selected.iter_mut().enumerate().for_each(|(track, used)| *used = map.point(track).is_some());
    }
}
