//! From a map to a bundle adjustment problem and back.

use std::ops::Range;

use nalgebra::Point2;

use super::map::Map;
use super::{Noise, Options, intrinsics_prior};
use crate::bundle::{self, CameraBlock, Observation, PointBlock, PoseBlock, Problem};
use crate::camera::{Camera, NUM_INTRINSICS};
use crate::mapper::MapperError;
use crate::math::bin;

/// Parameters that are adjusted.
#[derive(Clone, Debug)]
pub enum Scope {
    /// All views and points.
    Everything,
    /// All points; no view is free.
    Points,
    /// All views and points, as far as it takes to measure the noise and to tell which observations are wrong.
    Roughly,
    /// The same, but no view turns.
    Positions,
    /// All views, and in each about [`POINTS_PER_VIEW`] points: the longest tracks of every part of the image.
    Selected,
    /// A view, those that share most points with it, and the points that these see; the others are held.
    Around(usize),
    /// Some views of a long video, and the points that these see.
    Stretch(Stretch),
}

/// Views that are adjusted while the others are held.
#[derive(Clone, Debug)]
pub struct Stretch {
    /// Those that are free.
    pub views: Range<usize>,
    /// Views whose observations count, free or held; those of other views are excluded.
    pub counted: Range<usize>,
    /// Of the whole map: which points take part, whether views turn, and when the adjustment ends.
    pub scope: Box<Scope>,
}

impl Scope {
    /// Returns true if no view turns.
    fn holds_rotations(&self) -> bool {
        match self {
            Self::Stretch(stretch) => stretch.scope.holds_rotations(),
            _ => matches!(self, Self::Positions),
        }
    }

    /// When an adjustment ends: after so many iterations, or at so small a share of the cost.
    fn limits(&self, options: &Options) -> (usize, f64) {
        match self {
            Self::Stretch(stretch) => stretch.scope.limits(options),
            Self::Everything | Self::Points | Self::Selected => (30, 1e-6),
            Self::Roughly | Self::Positions => (30, options.coarse_tolerance),
            Self::Around(_) => (10, 1e-4),
        }
    }
}

/// Which intrinsics are adjusted.
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
    /// While a map grows.
    pub fn at_first(map: &Map<'_>) -> Self {
        if map.unknown_cameras().next().is_some() { Self::FocalAndRadial } else { Self::Nothing }
    }

    /// By camera: nothing of those that are given or see nothing, and of a camera next to others that sees few points
    /// at most a focal length and the first coefficient of distortion: the margin of its picture tells little.
    fn of_cameras(self, map: &Map<'_>) -> Vec<Self> {
        let num_seen = map.num_points_of_cameras();
        let mut all = vec![Self::Nothing; num_seen.len()];
        for camera in map.unknown_cameras().filter(|&camera| num_seen[camera] > 0) {
            let few = num_seen.len() > 1 && num_seen[camera] < 300;
            all[camera] = if few { self.min(Self::FocalAndFirstRadial) } else { self };
        }
        all
    }

    /// Which of fx, fy, cx, cy, k1, k2 are free.
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

/// Adjusts a map; returns for every track whether its point took part.
pub fn adjust(
    map: &mut Map<'_>,
    scope: &Scope,
    intrinsics: Freedom,
    noise: Noise,
    options: &Options,
) -> Result<Vec<bool>, MapperError> {
    let (tracks, free_views) = taking_part(map, scope);
    let mut freedom = intrinsics.of_cameras(map);
    let ties = Ties::of(scope, options);
    let (max_iterations, function_tolerance) = scope.limits(options);
    let loss = options.loss(noise);
    let hold_rotations = scope.holds_rotations();
    let bundle_options =
        bundle::Options { loss, max_iterations, function_tolerance, hold_rotations, ..bundle::Options::default() };
    loop {
        let (mut problem, parts) = build_with(map, &tracks, &free_views, &freedom, noise, &ties);
        bundle::adjust(&mut problem, &bundle_options)?;
        if !hold_odd_lenses(&mut freedom, &problem) {
            take_over(map, &problem, &parts);
            return Ok(tracks);
        }
        tracing::debug!("intrinsics are not determined by {} views; held", problem.poses.len());
    }
}

/// Holds cameras that were adjusted to a lens that nobody builds: the motion does not determine them (yet), and the
/// guess is better. Returns whether there were any.
fn hold_odd_lenses(freedom: &mut [Freedom], problem: &Problem) -> bool {
    let is_odd = |(freedom, block): &(&mut Freedom, &CameraBlock)| {
        **freedom != Freedom::Nothing && !intrinsics_prior::is_plausible(&block.camera)
    };
    let odd = freedom.iter_mut().zip(&problem.cameras).filter(is_odd);
    odd.map(|(freedom, _)| *freedom = Freedom::Nothing).count() > 0
}

/// Which points take part in a scope, by track, and which views are free.
fn taking_part(map: &Map<'_>, scope: &Scope) -> (Vec<bool>, Vec<bool>) {
    let mut tracks = vec![false; map.tracks.len()];
    let mut free_views = vec![true; map.poses.len()];
    match scope {
        Scope::Everything | Scope::Roughly | Scope::Positions | Scope::Points => {
            tracks.iter_mut().enumerate().for_each(|(t, used)| *used = map.point(t).is_some());
            free_views.fill(!matches!(scope, Scope::Points));
        }
        Scope::Selected => select_tracks(map, map.registered(), &mut tracks),
        Scope::Stretch(stretch) => {
            free_views = (0..map.poses.len()).map(|view| stretch.views.contains(&view)).collect();
            select_of_stretch(map, stretch, &mut tracks);
        }
        Scope::Around(view) => {
            free_views = neighbourhood(map, *view);
            for v in (0..free_views.len()).filter(|&v| free_views[v]) {
                map.visible(v).iter().for_each(|s| tracks[s.track as usize] = true);
            }
        }
    }
    (tracks, free_views)
}

/// Which view and track each block of a problem represents.
struct Parts {
    views: Vec<usize>,
    tracks: Vec<usize>,
}

/// Which observations of points count.
enum Ties {
    /// All.
    All,
    /// In views that are free all, in those that are held [`MOST_HELD`] of each point at the most, evenly spread.
    FewHeld,
    /// A part of what was seen before, where they were lost for more than so many views ([`Problem::thin_ties`]).
    Thinned {
        /// Views.
        gap: usize,
    },
    /// Those in some views.
    Counted(Range<usize>),
}

impl Ties {
    fn of(scope: &Scope, options: &Options) -> Self {
        match (scope, options.ordered) {
            (Scope::Around(_), _) => Self::FewHeld,
            (Scope::Stretch(stretch), _) => Self::Counted(stretch.counted.clone()),
            (_, true) => Self::Thinned { gap: options.max_track_views },
            (_, false) => Self::All,
        }
    }

    fn counts(&self, view: usize) -> bool {
        !matches!(self, Self::Counted(views) if !views.contains(&view))
    }
}

/// Free views of a local adjustment.
const LOCAL_VIEWS: usize = 6;
/// Points per view in global adjustments of the growing map; the last ones use all.
const POINTS_PER_VIEW: usize = 250;
/// Views that hold a point in a local adjustment. More would hold it no better, and take most of the time.
const MOST_HELD: usize = 8;

/// The problem of an adjustment.
pub(super) fn build(map: &Map<'_>, scope: &Scope, intrinsics: Freedom, noise: Noise, options: &Options) -> Problem {
    let (tracks, free_views) = taking_part(map, scope);
    build_with(map, &tracks, &free_views, &intrinsics.of_cameras(map), noise, &Ties::of(scope, options)).0
}

/// The same with a freedom for each camera.
fn build_with(
    map: &Map<'_>,
    tracks: &[bool],
    free_views: &[bool],
    freedom: &[Freedom],
    noise: Noise,
    ties: &Ties,
) -> (Problem, Parts) {
    let mut problem = Problem::default();
    let block = |(idx, (&camera, freedom)): (usize, (&Camera, &Freedom))| {
        let may_change = map.known.of(idx).may_change();
        let free = freedom.mask();
        CameraBlock { camera, free: std::array::from_fn(|k| free[k] && may_change[k]), tie_focal: true }
    };
    problem.cameras = map.cameras.iter().zip(freedom).enumerate().map(block).collect();
    let adjusted = (0..freedom.len()).filter(|&camera| freedom[camera] != Freedom::Nothing);
    problem.priors.intrinsics = adjusted.map(|camera| intrinsics_prior::prior(camera, map, noise)).collect();
    let parts = parts(map, tracks, ties);
    let mut pose_of_view = vec![0; free_views.len()];
    for (pose, &view) in (0..).zip(&parts.views) {
        let Some(cam_from_world) = map.poses[view] else { continue };
        let camera = map.table.views[view].camera;
        problem.poses.push(PoseBlock { cam_from_world, camera, fixed: !free_views[view] });
        pose_of_view[view] = pose;
    }
    for &track in &parts.tracks {
        let Some(point) = map.point(track) else { continue };
        let point_index = problem.points.len() as u32;
        problem.points.push(PointBlock { position: point.position, fixed: false });
        let counts = |view: usize| map.poses[view].is_some() && ties.counts(view);
        let seen = || map.observations(track).filter(|(_, view, _)| counts(*view));
        let one_in = match ties {
            Ties::FewHeld => seen().filter(|(_, view, _)| !free_views[*view]).count().div_ceil(MOST_HELD).max(1),
            Ties::All | Ties::Thinned { .. } | Ties::Counted(_) => 1,
        };
        let mut num_held = 0;
        for (slot, view, pixel) in seen() {
            num_held += usize::from(!free_views[view]);
            if !free_views[view] && num_held % one_in != 0 {
                continue;
            }
            let whitening = map.table.whitening(map.tracks[track][slot]);
            let seen = Observation::new(pose_of_view[view], point_index, pixel);
            problem.observations.push(Observation { whitening, ..seen });
        }
    }
    if let Ties::Thinned { gap } = ties {
        problem.thin_ties(*gap);
    }
    (problem, parts)
}

/// The known points among some tracks, and the registered views that see them, both ascending.
fn parts(map: &Map<'_>, tracks: &[bool], ties: &Ties) -> Parts {
    let tracks: Vec<usize> = (0..tracks.len()).filter(|&t| tracks[t] && map.point(t).is_some()).collect();
    let mut seen = vec![false; map.poses.len()];
    tracks.iter().flat_map(|&track| map.observations(track)).for_each(|(_, view, _)| seen[view] = true);
    Parts { views: map.registered().filter(|&view| seen[view] && ties.counts(view)).collect(), tracks }
}

fn take_over(map: &mut Map<'_>, problem: &Problem, parts: &Parts) {
    for (camera, block) in map.cameras.iter_mut().zip(&problem.cameras) {
        *camera = block.camera;
    }
    for (&view, block) in parts.views.iter().zip(&problem.poses) {
        map.poses[view] = Some(block.cam_from_world);
    }
    for (&track, block) in parts.tracks.iter().zip(&problem.points) {
        map.move_point(track, block.position);
    }
}

/// A view and the others that share most points with it.
fn neighbourhood(map: &Map<'_>, view: usize) -> Vec<bool> {
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

/// Marks the points that a stretch sees, and that count at least twice.
fn select_of_stretch(map: &Map<'_>, stretch: &Stretch, tracks: &mut [bool]) {
    let views: Vec<usize> = map.registered().filter(|view| stretch.views.contains(view)).collect();
    match *stretch.scope {
        Scope::Selected => select_tracks(map, views.into_iter(), tracks),
        _ => views.iter().for_each(|&v| map.visible(v).iter().for_each(|s| tracks[s.track as usize] = true)),
    }
    let counted = |track: usize| map.observations(track).filter(|(_, view, _)| stretch.counted.contains(view));
    for (track, used) in tracks.iter_mut().enumerate().filter(|(_, used)| **used) {
        *used = counted(track).nth(1).is_some() && counted(track).any(|(_, view, _)| stretch.views.contains(&view));
    }
}

/// Cells of a grid over an image: of about the same shape in frames of 4:3 and 16:9.
const GRID: [usize; 2] = [8, 6];
/// Number of cells of the grid.
const NUM_CELLS: usize = GRID[0] * GRID[1];

/// The cell of a pixel.
pub(super) fn cell_of(pixel: Point2<f64>, camera: &Camera) -> usize {
    let [width, height] = [camera.width, camera.height].map(f64::from);
    bin(pixel.y / height, GRID[1]) * GRID[0] + bin(pixel.x / width, GRID[0])
}

/// Marks, for every one of some registered views, the longest tracks in each cell of a grid over its image, until it
/// has enough.
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
    // An object fills a few cells of the grid: below this number of points selection saves nothing worth having.
    if map.num_points() <= 1500 {
        selected.iter_mut().enumerate().for_each(|(track, used)| *used = map.point(track).is_some());
    }
}
