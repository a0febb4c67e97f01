//! Alignment of two maps, from points that both have or that one has and the other observes.
//!
//! LO-RANSAC over triples of points that both maps know (S. Umeyama, PAMI 1991), judged by what counts in the end: the
//! reprojection errors of each map's points in the other map's views. Refined by Gauss-Newton on these errors, on the
//! seven degrees of freedom of the similarity.

use nalgebra::{Matrix2x3, Point3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use crate::geometry::triangulation::View;
use crate::math::{Rng, Sim3, centroid, umeyama};
use crate::robust::{self, Estimator};

/// A turn, a shift in units of the points' spread, and the logarithm of the scale.
type Vector7 = SVector<f64, 7>;
type Matrix7 = SMatrix<f64, 7, 7>;

/// A track of which both maps see a part.
pub struct Tie<'a> {
    /// Index of the track.
    pub track: usize,
    /// Its point in the frame of the first map, and in that of the other one; at least one is known.
    pub in_first: Option<Point3<f64>>,
    pub in_other: Option<Point3<f64>>,
    /// Where the views of the first map see it, and those of the other one.
    pub seen_by_first: Vec<View<'a>>,
    pub seen_by_other: Vec<View<'a>>,
}

impl Tie<'_> {
    /// Mean squared reprojection error, whitened, of what one map knows in the views of the other one; infinite behind
    /// a camera.
    fn error_sq(&self, first_from_other: &Sim3) -> f64 {
        let other_from_first = first_from_other.inverse();
        let (mut sum, mut count) = (0.0, 0);
        let mut add = |views: &[View<'_>], point: Point3<f64>| {
            sum += views.iter().map(|view| view.error_sq(point)).sum::<f64>();
            count += views.len();
        };
        if let Some(point) = self.in_other {
            add(&self.seen_by_first, *first_from_other * point);
        }
        if let Some(point) = self.in_first {
            add(&self.seen_by_other, other_from_first * point);
        }
        if count == 0 { f64::INFINITY } else { sum / f64::from(count as u32) }
    }

    fn pair(&self) -> Option<[Point3<f64>; 2]> {
        Some([self.in_other?, self.in_first?])
    }
}

/// A similarity and what supports it.
pub struct Similarity {
    /// In the units of the two maps.
    pub first_from_other: Sim3,
    /// Indices of the ties within the threshold.
    pub inliers: Vec<usize>,
    /// Largest standard deviation of its turn (radians), its shift (in units of the spread of the points that tie) and
    /// of the logarithm of its scale.
    pub deviation: f64,
}

/// The similarity on which most ties agree; `None` where no triple of points that both maps know gives one that more
/// than itself agree on, or where the points leave a direction open.
///
/// * `max_error` – largest root mean square reprojection error of a tie, in units of the whitening.
pub fn estimate(ties: &[Tie<'_>], max_error: f64, rng: &mut Rng) -> Option<Similarity> {
    let known: Vec<usize> = (0..ties.len()).filter(|&i| ties[i].pair().is_some()).collect();
    let estimator = SimilarityEstimator { ties, known };
    let options = robust::Options { max_iterations: 2000, ..robust::Options::with_max_error(max_error) };
    let found = robust::ransac(&estimator, &options, rng)?;
    let system = System::new(ties, &found.inliers, &found.model)?;
    let deviation = system.deviation()?;
    Some(Similarity { first_from_other: found.model, inliers: found.inliers, deviation })
}

struct SimilarityEstimator<'a> {
    ties: &'a [Tie<'a>],
    /// Ties whose points both maps know.
    known: Vec<usize>,
}

impl Estimator for SimilarityEstimator<'_> {
    type Model = Sim3;
    // Three points determine a similarity.
    const SAMPLE_SIZE: usize = 3;

    fn num_data(&self) -> usize {
        self.ties.len()
    }

    /// Samples are drawn of all ties; each represents one of those whose points both maps know.
    fn fit(&self, sample: &[usize], models: &mut Vec<Sim3>) {
        if self.known.is_empty() {
            return;
        }
        let (other, first): (Vec<_>, Vec<_>) = sample
            .iter()
            .filter_map(|i| self.ties[self.known[i % self.known.len()]].pair())
            .map(|[other, first]| (other, first))
            .unzip();
        models.extend(umeyama(&other, &first).filter(is_finite));
    }

    fn error_sq(&self, first_from_other: &Sim3, tie: usize) -> f64 {
        self.ties[tie].error_sq(first_from_other)
    }

    fn refine(&self, first_from_other: &Sim3, inliers: &[usize]) -> Option<Sim3> {
        let mut refined = *first_from_other;
        // Gauss–Newton converges quadratically from a RANSAC result.
        for _ in 0..5 {
            refined = System::new(self.ties, inliers, &refined)?.solved(&refined)?;
        }
        Some(refined)
    }
}

fn is_finite(similarity: &Sim3) -> bool {
    similarity.scale > f64::MIN_POSITIVE
        && similarity.scale.is_finite()
        && similarity.translation.iter().all(|t| t.is_finite())
}

/// The normal equations of the reprojection errors at a similarity.
///
/// A small change moves a point p of the first map's frame by ω × (p − c) + ρ t + σ (p − c), with the centre c and the
/// spread ρ of the points; seen from the other map, a point q = S⁻¹ p moves by −Rᵀ/s times the same.
struct System {
    center: Point3<f64>,
    spread: f64,
    normal: Matrix7,
    right: Vector7,
    sum_sq: f64,
    num_residuals: usize,
}

impl System {
    fn new(ties: &[Tie<'_>], used: &[usize], first_from_other: &Sim3) -> Option<Self> {
        let other_from_first = first_from_other.inverse();
        let in_first = |tie: &Tie<'_>| tie.in_first.or_else(|| tie.in_other.map(|point| *first_from_other * point));
        let points: Vec<Point3<f64>> = used.iter().filter_map(|&i| in_first(&ties[i])).collect();
        let (center, spread) = center_and_spread(&points)?;
        let (normal, right) = (Matrix7::zeros(), Vector7::zeros());
        let mut system = Self { center, spread, normal, right, sum_sq: 0.0, num_residuals: 0 };
        let turned_back = other_from_first.rotation.to_rotation_matrix().into_inner() * other_from_first.scale;
        for tie in used.iter().map(|&i| &ties[i]) {
            if let Some(point) = tie.in_other.map(|point| *first_from_other * point) {
                let moved = system.moved_by(point);
                tie.seen_by_first.iter().for_each(|view| system.add(view, point, &moved));
            }
            if let Some(point) = tie.in_first {
                let moved = -turned_back * system.moved_by(point);
                tie.seen_by_other.iter().for_each(|view| system.add(view, other_from_first * point, &moved));
            }
        }
        Some(system)
    }

    /// Derivative of a point of the first map's frame by the seven parameters.
    fn moved_by(&self, point: Point3<f64>) -> SMatrix<f64, 3, 7> {
        let offset = point - self.center;
        let mut moved = SMatrix::<f64, 3, 7>::zeros();
        moved.fixed_view_mut::<3, 3>(0, 0).copy_from(&-offset.cross_matrix());
        moved.fixed_view_mut::<3, 3>(0, 3).fill_diagonal(self.spread);
        moved.set_column(6, &offset);
        moved
    }

    fn add(&mut self, view: &View<'_>, point: Point3<f64>, moved: &SMatrix<f64, 3, 7>) {
        let in_cam = *view.cam_from_world * point;
        if in_cam.z <= f64::EPSILON {
            return;
        }
        let projection = view.camera.project(in_cam);
        let whiten = |v: Vector2<f64>| Vector2::from(view.whitening.apply([v.x, v.y]));
        let residual = whiten(projection.pixel - view.pixel);
        let d_point: Matrix2x3<f64> =
            projection.d_point * view.cam_from_world.rotation.to_rotation_matrix().into_inner();
        let mut jacobian = d_point * moved;
        jacobian.column_iter_mut().for_each(|mut column| column.copy_from(&whiten(column.clone_owned())));
        self.normal += jacobian.transpose() * jacobian;
        self.right += jacobian.transpose() * residual;
        self.sum_sq += residual.norm_squared();
        self.num_residuals += 2;
    }

    /// The similarity after one step; `None` where the points leave something open.
    fn solved(&self, first_from_other: &Sim3) -> Option<Sim3> {
        let step = -self.normal.cholesky()?.solve(&self.right);
        let rotation = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        let scale = step[6].exp();
        let shift: Vector3<f64> = self.spread * step.fixed_rows::<3>(3);
        let c = self.center.coords;
        let moved = Sim3::new(scale, rotation, c + shift - rotation * c * scale) * *first_from_other;
        is_finite(&moved).then_some(moved)
    }

    /// Largest standard deviation of a parameter, by the residuals that are left.
    fn deviation(&self) -> Option<f64> {
        let variance = self.sum_sq / self.num_residuals.checked_sub(7).filter(|&n| n > 0)? as f64;
        let inverse = self.normal.cholesky()?.inverse();
        let largest = inverse.diagonal().max();
        Some((largest * variance).sqrt()).filter(|deviation| deviation.is_finite())
    }
}

/// The mean of points and their root mean square distance from it; `None` for fewer than three, or all in one place.
fn center_and_spread(points: &[Point3<f64>]) -> Option<(Point3<f64>, f64)> {
    if points.len() < 3 {
        return None;
    }
    let center = centroid(points);
    let spread = (points.iter().map(|p| (p - center).norm_squared()).sum::<f64>() / points.len() as f64).sqrt();
    (spread > f64::MIN_POSITIVE && spread.is_finite()).then_some((center, spread))
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;
    use crate::bundle::Whitening;
    use crate::camera::Camera;
    use crate::math::{Rigid3, seeded_rng};

    #[test]
    fn the_similarity_comes_back_through_wrong_ties() {
        let camera = Camera::with_focal(960, 540, 800.0);
        let truth = Sim3::new(0.4, UnitQuaternion::from_euler_angles(0.3, -0.8, 0.1), Vector3::new(2.0, -1.0, 0.5));
        let at = |x: f64, z: f64| Rigid3::from_rotation_and_center(UnitQuaternion::identity(), Point3::new(x, 0.0, z));
        let (first_views, of_other) = ([at(-1.0, -9.0), at(1.0, -9.0)], [at(-1.0, -12.0), at(2.0, -12.0)]);
        let other_views = of_other.map(|pose| truth.inverse().transform_camera(&pose));
        let mut rng = seeded_rng(3, 0);
        let mut ties = Vec::new();
        for track in 0..30 {
            let point = Point3::from(Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0)));
            let seen = |pose: &'_ Rigid3, p: Point3<f64>| camera.pixel_from_cam(*pose * p).unwrap();
            let view =
                |pose, pixel| View { camera: &camera, cam_from_world: pose, pixel, whitening: Whitening::IDENTITY };
            // Every fifth is another point in the other map; every fourth is known to the first map alone.
            let elsewhere = if track % 5 == 0 { Vector3::new(0.5, 0.4, 0.0) } else { Vector3::zeros() };
            let in_other = truth.inverse() * (point + elsewhere);
            ties.push(Tie {
                track,
                in_first: Some(point),
                in_other: (track % 4 != 0).then_some(in_other),
                seen_by_first: first_views.iter().map(|pose| view(pose, seen(pose, point))).collect(),
                seen_by_other: other_views.iter().map(|pose| view(pose, seen(pose, in_other))).collect(),
            });
        }
        let found = estimate(&ties, 2.0, &mut seeded_rng(1, 0)).unwrap();
        assert_eq!(found.inliers.len(), 24);
        assert!((found.first_from_other.scale / truth.scale - 1.0).abs() < 1e-9);
        assert!(found.first_from_other.rotation.angle_to(&truth.rotation) < 1e-9);
        assert!((found.first_from_other.translation - truth.translation).norm() < 1e-8);
        assert!(estimate(&ties[..2], 2.0, &mut seeded_rng(1, 0)).is_none());
    }
}
