//! From a map to a bundle adjustment problem and back.

use std::collections::BTreeMap;

use super::map::Map;
use super::{Intrinsics, Noise, Options};
use crate::bundle::{self, CameraBlock, IntrinsicsPrior, Observation, PointBlock, PoseBlock, Problem};
use crate::camera::{Camera, NUM_INTRINSICS};
use crate::sfm::SfmError;

/// What is adjusted.
pub enum Scope {
    /// All views and points.
    Everything,
    /// All views, and in each about so many points: the longest tracks of every part of the image.
    Selected {
        /// Points per view.
        per_view: usize,
    },
    /// A view, those that share most points with it, and the points that these see; the others are held.
    Around(usize),
}

/// Which intrinsics are adjusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

impl From<Intrinsics> for Freedom {
    fn from(intrinsics: Intrinsics) -> Self {
        match intrinsics {
            Intrinsics::Fixed => Self::Nothing,
            Intrinsics::Refined => Self::FocalAndRadial,
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
) -> Result<Vec<bool>, SfmError> {
    let (tracks, free_views) = taking_part(map, scope, options);
    let (mut problem, mut parts) = build(map, &tracks, &free_views, intrinsics, noise);
    let local = matches!(scope, Scope::Around(_));
    let bundle_options = bundle::Options {
        loss: options.loss(noise),
        max_iterations: if local { 10 } else { 30 },
        function_tolerance: if local { 1e-4 } else { 1e-6 },
        ..bundle::Options::default()
    };
    let mut summary = bundle::adjust(&mut problem, &bundle_options)?;
    if intrinsics != Freedom::Nothing && !problem.cameras.iter().all(|block| is_plausible(&block.camera)) {
        // The motion does not determine them (yet): better the guess than a lens that nobody builds.
        (problem, parts) = build(map, &tracks, &free_views, Freedom::Nothing, noise);
        summary = bundle::adjust(&mut problem, &bundle_options)?;
        tracing::debug!("intrinsics are not determined by {} views; held", problem.poses.len());
    }
    tracing::trace!(
        views = problem.poses.len(),
        points = problem.points.len(),
        observations = problem.observations.len(),
        iterations = summary.iterations,
        cost = summary.final_cost,
        linearize_s = summary.linearize_s,
        solve_s = summary.solve_s,
        total_s = summary.total_s,
        local,
        "adjusted"
    );
    take_over(map, &problem, &parts);
    Ok(tracks)
}

/// Which points take part in a scope, by track, and which views are free.
fn taking_part(map: &Map<'_>, scope: &Scope, options: &Options) -> (Vec<bool>, Vec<bool>) {
    let mut tracks = vec![false; map.table.tracks.len()];
    let mut free_views = vec![true; map.poses.len()];
    match scope {
        Scope::Everything => tracks.iter_mut().enumerate().for_each(|(t, used)| *used = map.point(t).is_some()),
        Scope::Selected { per_view } => select_tracks(map, *per_view, &mut tracks),
        Scope::Around(view) => {
            free_views = neighbourhood(map, *view, options.local_views);
            for v in (0..free_views.len()).filter(|&v| free_views[v]) {
                map.visible(v).iter().for_each(|s| tracks[s.track as usize] = true);
            }
        }
    }
    (tracks, free_views)
}

/// Standard deviation of the focal length as a share of it, if observations are as wrong together as
/// [`COMMON_ERROR_FACTOR`] says; infinite where the motion leaves it open.
///
/// A focal length that is some percent off is held, and everything else is adjusted to it: what that costs, in units of
/// the common errors, is (change / deviation)².
pub fn focal_deviation(map: &Map<'_>, sigma_px: f64, options: &Options) -> Result<f64, SfmError> {
    const CHANGE: f64 = 0.03;
    let probe = Probe::new(map, sigma_px, options);
    let best = probe.cost(map, Freedom::FocalAndRadial, |_| ())?;
    let held = probe.cost(map, Freedom::FocalAndRadial, |block| {
        block.camera.focal = block.camera.focal.map(|f| f * (1.0 + CHANGE));
        (block.free[0], block.free[1]) = (false, false);
    })?;
    let rise = held - best;
    Ok(if rise > 0.0 { CHANGE / rise.sqrt() } else { f64::INFINITY })
}

/// How much the first coefficient of distortion explains, in units of the common errors squared, where it is the only
/// one.
pub fn first_radial_gain(map: &Map<'_>, sigma_px: f64, options: &Options) -> Result<f64, SfmError> {
    let probe = Probe::new(map, sigma_px, options);
    let straight = |block: &mut CameraBlock| block.camera.radial = [0.0; 2];
    Ok(probe.cost(map, Freedom::Focal, straight)? - probe.cost(map, Freedom::FocalAndFirstRadial, straight)?)
}

/// Adjustments on trial, of some points in every part of every view.
struct Probe<'a> {
    tracks: Vec<bool>,
    free_views: Vec<bool>,
    noise: Noise,
    /// Standard deviation of the common errors, in units of the observations'.
    common_sigma: f64,
    options: &'a Options,
}

impl<'a> Probe<'a> {
    fn new(map: &Map<'_>, sigma_px: f64, options: &'a Options) -> Self {
        let scope = Scope::Selected { per_view: options.growth_points_per_view };
        let (tracks, free_views) = taking_part(map, &scope, options);
        let noise = Noise::Measured { sigma_px };
        Self { tracks, free_views, noise, common_sigma: COMMON_ERROR_FACTOR * sigma_px, options }
    }

    /// χ² after adjustment with cameras that are changed first, in units of the common errors.
    fn cost(&self, map: &Map<'_>, freedom: Freedom, change: impl Fn(&mut CameraBlock)) -> Result<f64, SfmError> {
        let (mut problem, _) = build(map, &self.tracks, &self.free_views, freedom, self.noise);
        problem.priors.intrinsics.clear();
        problem.cameras.iter_mut().for_each(change);
        let bundle_options = bundle::Options {
            loss: self.options.loss(self.noise),
            max_iterations: 20,
            function_tolerance: 1e-5,
            ..bundle::Options::default()
        };
        let cost = bundle::adjust(&mut problem, &bundle_options)?.final_cost;
        Ok(2.0 * cost / (self.common_sigma * self.common_sigma))
    }
}

/// Whether a lens like this is built: a field of view between 9 and 157 degrees over the longer side, and distortion
/// that keeps the picture's order from the middle to the corner.
fn is_plausible(camera: &Camera) -> bool {
    let side = f64::from(camera.width.max(camera.height));
    let focal_ok = (0.1 * side..=6.0 * side).contains(&camera.mean_focal());
    let corner = 0.5 * f64::from(camera.width).hypot(f64::from(camera.height)) / camera.mean_focal();
    let [k1, k2] = camera.radial;
    let r2 = corner * corner;
    let monotonic = 1.0 + 3.0 * k1 * r2 + 5.0 * k2 * r2 * r2 > 0.0 && 1.0 + k1 * r2 + k2 * r2 * r2 < 2.0;
    focal_ok && monotonic
}

/// How much worse than their residuals say observations are believed to be, where something may be wrong with all of
/// them together: what the model of the lens or of the shutter leaves out, points that slide with the view. Such errors
/// do not average out.
const COMMON_ERROR_FACTOR: f64 = 5.0;

/// A weak pull towards the guess, for motion that leaves a parameter open: within the spread of real lenses it weighs
/// as much as one observation.
///
/// The principal point is held to the middle as lenses are built, within a hundredth of the picture, against
/// observations with common errors ([`COMMON_ERROR_FACTOR`]). Where views turn and spread it moves freely; on a single
/// flight looking straight down, where it could take up such errors, it stays.
fn intrinsics_prior(camera_idx: usize, camera: &Camera, noise: Noise) -> IntrinsicsPrior {
    const SIGMA_PRINCIPAL: f64 = 0.01;
    let side = f64::from(camera.width.max(camera.height));
    let focal = 1.2 * side;
    let mut values = camera.intrinsics();
    (values[0], values[1], values[4], values[5]) = (focal, focal, 0.0, 0.0);
    (values[2], values[3]) = (0.5 * f64::from(camera.width), 0.5 * f64::from(camera.height));
    // Observations count with a standard deviation of one pixel, so that of the prior is in units of their true one.
    let sigma_principal = match noise {
        Noise::Measured { sigma_px } if sigma_px > 0.0 => SIGMA_PRINCIPAL * side / (COMMON_ERROR_FACTOR * sigma_px),
        _ => SIGMA_PRINCIPAL * side,
    };
    let (sigma_focal, sigma_radial) = (0.4 * side, 0.2);
    let sigma = [sigma_focal, sigma_focal, sigma_principal, sigma_principal, sigma_radial, sigma_radial];
    IntrinsicsPrior { camera: camera_idx, values, sigma }
}

/// Which view and track each block of a problem stands for.
struct Parts {
    views: Vec<usize>,
    tracks: Vec<usize>,
}

fn build(map: &Map<'_>, tracks: &[bool], free_views: &[bool], intrinsics: Freedom, noise: Noise) -> (Problem, Parts) {
    let mut problem = Problem::default();
    let free_intrinsics = match intrinsics {
        Freedom::Nothing => [false; NUM_INTRINSICS],
        Freedom::Focal => [true, true, false, false, false, false],
        Freedom::FocalAndFirstRadial => [true, true, false, false, true, false],
        Freedom::FocalAndRadial => [true, true, false, false, true, true],
        Freedom::WithPrincipalPoint => [true; NUM_INTRINSICS],
    };
    problem.cameras =
        map.cameras.iter().map(|&camera| CameraBlock { camera, free: free_intrinsics, tie_focal: true }).collect();
    if intrinsics != Freedom::Nothing {
        problem.priors.intrinsics =
            map.cameras.iter().enumerate().map(|(i, c)| intrinsics_prior(i, c, noise)).collect();
    }
    let mut parts = Parts { views: Vec::new(), tracks: Vec::new() };
    let mut pose_of_view = BTreeMap::new();
    for track in (0..tracks.len()).filter(|&t| tracks[t]) {
        let Some(point) = map.point(track) else { continue };
        let point_index = problem.points.len() as u32;
        problem.points.push(PointBlock { position: point.position, fixed: false });
        parts.tracks.push(track);
        for (slot, view, pixel) in map.observations(track) {
            let Some(cam_from_world) = map.poses[view] else { continue };
            let pose = *pose_of_view.entry(view).or_insert_with(|| {
                let camera = map.table.views[view].camera;
                problem.poses.push(PoseBlock { cam_from_world, camera, fixed: !free_views[view] });
                parts.views.push(view);
                problem.poses.len() - 1
            });
            let whitening = map.table.whitening(map.table.tracks[track][slot]);
            let seen = Observation::new(pose as u32, point_index, pixel);
            problem.observations.push(Observation { whitening, ..seen });
        }
    }
    (problem, parts)
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
fn neighbourhood(map: &Map<'_>, view: usize, count: usize) -> Vec<bool> {
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
    order.into_iter().take(count.saturating_sub(1)).for_each(|v| chosen[v] = true);
    chosen
}

/// Marks, for every registered view, the longest tracks in each cell of a grid over its image, until it has enough.
fn select_tracks(map: &Map<'_>, per_view: usize, selected: &mut [bool]) {
    const GRID: [usize; 2] = [8, 6];
    let per_cell = (per_view / (GRID[0] * GRID[1])).max(1);
    let length: Vec<usize> = (0..selected.len()).map(|track| map.observations(track).count()).collect();
    let registered: Vec<usize> = map.registered().collect();
    for view in registered {
        let camera = map.camera_of(view);
        let mut cells: Vec<Vec<usize>> = vec![Vec::new(); GRID[0] * GRID[1]];
        for s in map.visible(view) {
            let (_, pixel) = map.feature(s.track as usize, s.slot as usize);
            let cell = |at: f64, side: u32, n: usize| ((at / f64::from(side) * n as f64) as usize).min(n - 1);
            let index = cell(pixel.y, camera.height, GRID[1]) * GRID[0] + cell(pixel.x, camera.width, GRID[0]);
            cells[index].push(s.track as usize);
        }
        for mut cell in cells {
            cell.sort_by_key(|&track| (!selected[track], usize::MAX - length[track], track));
            cell.into_iter().take(per_cell).for_each(|track| selected[track] = true);
        }
    }
    // An object fills a few cells of the grid: below this number of points selection saves nothing worth having.
    const FEW_POINTS: usize = 1500;
    if map.num_points() <= FEW_POINTS {
        selected.iter_mut().enumerate().for_each(|(track, used)| *used = map.point(track).is_some());
    }
}
