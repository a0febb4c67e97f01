//! Re-detection of points of an earlier view in a view that shares no track with it.
//!
//! SIFT features of both views are matched and verified by one epipolar geometry. They predict each point: by the
//! affine map of the matches around it, or by the displacement, rotation and scale of the nearest of them. There the
//! patch of the point in the earlier view is aligned ([`crate::features::patch`]), so that the positions are as
//! accurate as those of any track, except for the error of the point in the earlier view. Re-detected points count if
//! one epipolar geometry explains them.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Point2, Vector2, Vector3};

use super::affine_views::{AffineView, AffineViews};
use super::keyframe::{FEW_POINTS, Keyframe};
use super::tracked_point::{TrackedPoint, whitening};
use crate::camera::Camera;
use crate::features::matching::{MatchOptions, match_features, match_where};
use crate::features::patch::{Aligned, Patch, Warp};
use crate::geometry::two_view::{self, Correspondences};
use crate::image::GrayImage;
use crate::math::{Neighbors, Rigid3, Rng, seeded_rng};
use crate::scene::Mask;

/// Maximum distance of a match from its epipolar line, pixels.
const MAX_MATCH_ERROR_PX: f64 = 3.0;
/// Maximum distance of a re-detected point from its epipolar line, pixels.
const MAX_POINT_ERROR_PX: f64 = 1.5;
/// Number of matches, the nearest, that determine the affine map around a point.
const NUM_AFFINE: usize = 8;
/// Number of matches, the nearest, whose own motion predicts a point.
const NUM_SINGLE: usize = 2;
/// Minimum correlation of a point with its earlier appearance.
const MIN_CORRELATION: f32 = 0.8;
/// Maximum distance of a re-detected point from its prediction, pixels.
const MAX_CORRECTION_PX: f32 = 3.0;
/// Minimum number of re-detected points that one epipolar geometry explains: fewer agree by chance.
const MIN_AGREEING: usize = 10;
/// Minimum share of the aligned points that one epipolar geometry explains: fewer agree by chance.
const MIN_AGREEING_SHARE: f64 = 0.6;
/// Minimum inlier ratio of the matches under one epipolar geometry.
const MIN_INLIER_RATIO: f64 = 0.3;
/// Maximum distance of a guided match from its epipolar line, pixels.
const MAX_GUIDED_ERROR_PX: f64 = 2.0;
/// Limits of the descriptors of guided matches, which the epipolar line restricts.
const GUIDED: MatchOptions = MatchOptions { max_ratio: 0.85, max_distance: 0.65 };

/// Current view.
pub struct CurrentView<'a> {
    pub camera: &'a Camera,
    pub matching: &'a MatchOptions,
    pub affine_views: &'a AffineViews,
    pub gray: &'a GrayImage,
    pub mask: &'a Mask,
}

/// Re-detects the points of an earlier view that are not known in the current one; none if too few agree.
///
/// * `patch_radius` – half the side of a patch, pixels.
/// * `max_views` – number of views in which they are tracked; `None` for as long as they are visible.
pub fn find(
    key: &Keyframe,
    current: &CurrentView<'_>,
    patch_radius: i32,
    is_known: impl Fn(usize) -> bool,
    max_views: Option<usize>,
) -> Vec<TrackedPoint> {
    let moves = moves_between(&key.affine_views, current);
    let Some(field) = Field::new(&moves) else { return Vec::new() };
    let mut found: Vec<(Point2<f32>, TrackedPoint)> = Vec::new();
    for appearance in key.appearances.iter().filter(|appearance| !is_known(appearance.track)) {
        let Some(patch) = appearance.patch(patch_radius) else { continue };
        let Some(best) = best_alignment(&patch, &field.predictions(appearance.center), current) else { continue };
        let whitening = whitening(best.covariance);
        let point = TrackedPoint {
            track: appearance.track,
            patch,
            warp: best.warp,
            whitening,
            step: None,
            views_left: max_views,
        };
        found.push((appearance.center, point));
    }
    let ends: Vec<[Point2<f64>; 2]> = found.iter().map(|(from, to)| [from.cast(), to.warp.center.cast()]).collect();
    let (pairs, mut rng) = correspondences(current.camera, &ends);
    let agreeing = two_view::verify(&pairs, MAX_POINT_ERROR_PX / current.camera.mean_focal(), &mut rng);
    tracing::trace!(moves = moves.len(), found = found.len(), agreeing = agreeing.len(), "aligned");
    if agreeing.len() < MIN_AGREEING || (agreeing.len() as f64) < MIN_AGREEING_SHARE * found.len() as f64 {
        return Vec::new();
    }
    let mut agrees = vec![false; found.len()];
    agreeing.into_iter().for_each(|i| agrees[i] = true);
    found.into_iter().zip(agrees).filter(|(_, agrees)| *agrees).map(|((_, point), _)| point).collect()
}

/// Displacement, rotation and change of scale of a feature.
struct Move {
    from: Point2<f32>,
    to: Point2<f32>,
    shape: Matrix2<f32>,
}

/// Displacements of features from an earlier view: matches under one epipolar geometry, and then all along its lines.
fn moves_between(before: &AffineViews, current: &CurrentView<'_>) -> Vec<Move> {
    let pairs = before.pairs_with(current.affine_views);
    let matched = |(a, b): &(&AffineView, &AffineView)| match_features(&a.features, &b.features, current.matching);
    let matches: Vec<Vec<[u32; 2]>> = pairs.iter().map(matched).collect();
    let ends: Vec<[Point2<f64>; 2]> = pairs.iter().zip(&matches).flat_map(|(pair, m)| ends_of(pair, m)).collect();
    let (pairs_of_ends, mut rng) = correspondences(current.camera, &ends);
    let max_error = MAX_MATCH_ERROR_PX / current.camera.mean_focal();
    let Some(geometry) = two_view::estimate(&pairs_of_ends, max_error, &mut rng) else { return Vec::new() };
    let enough =
        geometry.inliers.len() >= FEW_POINTS && geometry.inliers.len() as f64 >= MIN_INLIER_RATIO * ends.len() as f64;
    if !enough {
        return Vec::new();
    }
    let max_error = MAX_GUIDED_ERROR_PX / current.camera.mean_focal();
    let Rigid3 { rotation, translation } = geometry.cam2_from_cam1;
    let essential = translation.cross_matrix() * rotation.to_rotation_matrix().matrix();
    let guided = |(a, b): &(&AffineView, &AffineView)| {
        let normalized = |view: &AffineView| {
            view.features.pixels.iter().map(|&p| current.camera.normalized_from_pixel(p)).collect::<Vec<_>>()
        };
        let (first, second) = (normalized(a), normalized(b));
        let distance = |i: usize, j: usize| two_view::sampson_distance(&essential, &first[i], &second[j]).abs();
        match_where(&a.features, &b.features, |i, j| distance(i, j) <= max_error, &GUIDED)
    };
    let mut moves: Vec<Move> = Vec::new();
    for pair in &pairs {
        for [i, j] in guided(pair) {
            let found = Move::new(pair, i as usize, j as usize);
            let is_same = |other: &Move| (other.from - found.from).norm() < 1.0 && (other.to - found.to).norm() < 1.0;
            if !moves.iter().any(is_same) {
                moves.push(found);
            }
        }
    }
    moves
}

impl Move {
    fn new((a, b): &(&AffineView, &AffineView), i: usize, j: usize) -> Self {
        let shape = a.frame(i).try_inverse().map_or_else(Matrix2::identity, |inverse| b.frame(j) * inverse);
        Self { from: a.features.pixels[i].cast(), to: b.features.pixels[j].cast(), shape }
    }
}

fn ends_of((a, b): &(&AffineView, &AffineView), matches: &[[u32; 2]]) -> Vec<[Point2<f64>; 2]> {
    matches.iter().map(|m| [a.features.pixels[m[0] as usize], b.features.pixels[m[1] as usize]]).collect()
}

/// Correspondences of two views of one camera, and a random number generator.
fn correspondences(camera: &Camera, ends: &[[Point2<f64>; 2]]) -> (Correspondences, Rng) {
    (Correspondences::new([camera; 2], ends.iter().copied()), seeded_rng(0, ends.len() as u64))
}

/// Best alignment by correlation of those that start at the predictions.
fn best_alignment(patch: &Patch, predictions: &[Warp], current: &CurrentView<'_>) -> Option<Aligned> {
    let mut best: Option<Aligned> = None;
    for start in predictions {
        let Some(found) = patch.align(current.gray, start) else { continue };
        let center = found.warp.center;
        let counts = found.correlation >= MIN_CORRELATION
            && (center - start.center).norm() <= MAX_CORRECTION_PX
            && current.mask.contains(center.x.into(), center.y.into());
        if counts && best.as_ref().is_none_or(|b| found.correlation > b.correlation) {
            best = Some(found);
        }
    }
    best
}

/// Image motion between two views, from matches.
struct Field<'a> {
    moves: &'a [Move],
    tree: Neighbors<2>,
}

impl<'a> Field<'a> {
    fn new(moves: &'a [Move]) -> Option<Self> {
        if moves.is_empty() {
            return None;
        }
        let starts: Vec<[f64; 2]> = moves.iter().map(|m| m.from.coords.cast::<f64>().into()).collect();
        Some(Self { moves, tree: Neighbors::new(&starts)? })
    }

    /// Predicted warps of a point.
    fn predictions(&self, from: Point2<f32>) -> Vec<Warp> {
        let near = self.tree.nearest(&from.coords.cast::<f64>().into(), NUM_AFFINE);
        let round: Vec<&Move> = near.iter().map(|&i| &self.moves[i]).collect();
        let single =
            round.iter().take(NUM_SINGLE).map(|m| Warp { shape: m.shape, center: m.to + m.shape * (from - m.from) });
        affine(&round, from).into_iter().chain(single).collect()
    }
}

/// Affine map of the displacements, at a point; `None` if they are collinear or it is implausible.
fn affine(moves: &[&Move], at: Point2<f32>) -> Option<Warp> {
    let (mut normal, mut right) = (Matrix3::<f32>::zeros(), Matrix3x2::<f32>::zeros());
    for m in moves {
        let offset: Vector2<f32> = m.from - at;
        let row = Vector3::new(offset.x, offset.y, 1.0);
        normal += row * row.transpose();
        right += row * m.to.coords.transpose();
    }
    let solution = normal.cholesky()?.solve(&right);
    let shape: Matrix2<f32> = solution.fixed_view::<2, 2>(0, 0).transpose();
    let center = Point2::new(solution[(2, 0)], solution[(2, 1)]);
    let sane = (0.1..10.0).contains(&shape.determinant()) && center.coords.iter().all(|v| v.is_finite());
    sane.then_some(Warp { shape, center })
}
