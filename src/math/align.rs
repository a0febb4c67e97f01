//! Least-squares similarity between two point sets.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::{Sim3, centroid, svd3};

/// The similarity `target_from_source` that minimizes the summed squared distance over pairs.
///
/// S. Umeyama, *Least-squares estimation of transformation parameters between two point patterns*, PAMI 1991, eqs.
/// 34–43.
///
/// Returns `None` for fewer than three pairs, for lists of unequal length, and where the source or target points lie on
/// one line or in one place: the rotation is then not determined.
pub fn umeyama(source: &[Point3<f64>], target: &[Point3<f64>]) -> Option<Sim3> {
    if source.len() != target.len() || source.len() < 3 {
        return None;
    }
    let n = source.len() as f64;
    let (source_mean, target_mean) = (centroid(source).coords, centroid(target).coords);
    let mut covariance = Matrix3::zeros();
    let mut source_variance = 0.0;
    for (s, t) in source.iter().zip(target) {
        let (s, t) = (s.coords - source_mean, t.coords - target_mean);
        covariance += t * s.transpose() / n;
        source_variance += s.norm_squared() / n;
    }
    let svd = svd3(covariance)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let singular = svd.singular_values;
    // Rank 2 is enough: the determinant fixes the third axis (Umeyama's condition rank(Σ) ≥ m − 1).
    if !(singular[1] > 1e-12 * singular[0]) || source_variance <= 0.0 {
        return None;
    }
    let mut sign = Vector3::new(1.0, 1.0, 1.0);
    if u.determinant() * v_t.determinant() < 0.0 {
        sign[2] = -1.0;
    }
    let rotation = u * Matrix3::from_diagonal(&sign) * v_t;
    let scale = singular.dot(&sign) / source_variance;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Some(Sim3::new(scale, rotation, target_mean - rotation * source_mean * scale))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_points_give_the_exact_similarity() {
        let truth = Sim3::new(0.3, UnitQuaternion::from_euler_angles(1.0, -0.2, 0.6), Vector3::new(3.0, 1.0, -7.0));
        let source: Vec<_> = (0..9)
            .map(|i| {
                let t = f64::from(i);
                Point3::new(t.sin() * 4.0, t.cos() * 2.0, (0.7 * t).sin())
            })
            .collect();
        let target: Vec<_> = source.iter().map(|p| truth * *p).collect();
        let found = umeyama(&source, &target).unwrap();
        assert!((found.scale - truth.scale).abs() < 1e-12);
        assert!(found.rotation.angle_to(&truth.rotation) < 1e-10);
        assert!((found.translation - truth.translation).norm() < 1e-10);
    }

    #[test]
    fn points_on_a_line_or_in_one_place_have_no_answer() {
        let line: Vec<_> = (0..5).map(|i| Point3::new(f64::from(i), 2.0 * f64::from(i), 0.0)).collect();
        assert!(umeyama(&line, &line).is_none());
        assert!(umeyama(&[Point3::origin(); 4], &[Point3::origin(); 4]).is_none());
        assert!(umeyama(&line[..2], &line[..2]).is_none());
    }
}
