//! Absolute pose from three rays and three points.
//!
//! Grunert's quartic in the ratio of two distances, as given by Haralick et al., *Review and Analysis of Solutions of
//! the Three Point Perspective Pose Estimation Problem*, IJCV 1994, section "Grunert's solution". The cosines are those
//! between the rays, a, b, c the sides of the triangle opposite to points 1, 2, 3.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::math::{Rigid3, polynomial::real_roots};

/// Poses `cam_from_world` under which three points lie on three unit rays of the camera, in front of it: zero to four.
pub fn p3p(rays_in_cam: &[Vector3<f64>; 3], points_in_world: &[Point3<f64>; 3]) -> Vec<Rigid3> {
    let [p1, p2, p3] = points_in_world;
    let (a2, b2, c2) = ((p2 - p3).norm_squared(), (p1 - p3).norm_squared(), (p1 - p2).norm_squared());
    let normal = (p2 - p1).cross(&(p3 - p1));
    if normal.norm_squared() < 1e-12 * b2 * c2 || b2 <= 0.0 {
        return Vec::new();
    }
    let [r1, r2, r3] = rays_in_cam;
    let (cos_alpha, cos_beta, cos_gamma) = (r2.dot(r3), r1.dot(r3), r1.dot(r2));
    let coefficients = grunert_quartic(a2 / b2, c2 / b2, cos_alpha, cos_beta, cos_gamma);
    let mut poses = Vec::new();
    for v in real_roots(&coefficients) {
        let q = (a2 - c2) / b2;
        let denominator = 2.0 * (cos_gamma - v * cos_alpha);
        if v <= 0.0 || denominator.abs() < 1e-12 {
            continue;
        }
        let u = ((q - 1.0) * v * v - 2.0 * q * cos_beta * v + 1.0 + q) / denominator;
        let s1_sq = b2 / (1.0 + v * v - 2.0 * v * cos_beta);
        if u <= 0.0 || !(s1_sq > 0.0) {
            continue;
        }
        let s1 = s1_sq.sqrt();
        let in_cam = [r1 * s1, r2 * (u * s1), r3 * (v * s1)];
        poses.extend(pose_from_triangle(&in_cam, points_in_world));
    }
    poses
}

/// Coefficients A0..A4 of the quartic in v = s3 / s1, with a = a²/b² and c = c²/b².
fn grunert_quartic(a: f64, c: f64, cos_alpha: f64, cos_beta: f64, cos_gamma: f64) -> [f64; 5] {
    let (q, p) = (a - c, a + c);
    let (ca2, cb2, cg2) = (cos_alpha * cos_alpha, cos_beta * cos_beta, cos_gamma * cos_gamma);
    let mixed = cos_alpha * cos_gamma;
    [
        (1.0 + q) * (1.0 + q) - 4.0 * a * cg2,
        4.0 * (-q * (1.0 + q) * cos_beta + 2.0 * a * cg2 * cos_beta - (1.0 - p) * mixed),
        2.0 * (q * q - 1.0 + 2.0 * q * q * cb2 + 2.0 * (1.0 - c) * ca2 - 4.0 * p * mixed * cos_beta
            + 2.0 * (1.0 - a) * cg2),
        4.0 * (q * (1.0 - q) * cos_beta - (1.0 - p) * mixed + 2.0 * c * ca2 * cos_beta),
        (q - 1.0) * (q - 1.0) - 4.0 * c * ca2,
    ]
}

/// Rigid motion mapping a triangle onto a congruent one, from orthonormal frames on both.
fn pose_from_triangle(in_cam: &[Vector3<f64>; 3], in_world: &[Point3<f64>; 3]) -> Option<Rigid3> {
    let frame = |o: Vector3<f64>, a: Vector3<f64>, b: Vector3<f64>| {
        let x = (a - o).try_normalize(0.0)?;
        let z = x.cross(&(b - o)).try_normalize(0.0)?;
        Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
    };
    let cam = frame(in_cam[0], in_cam[1], in_cam[2])?;
    let world = frame(in_world[0].coords, in_world[1].coords, in_world[2].coords)?;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(cam * world.transpose()));
    let center = |points: [Vector3<f64>; 3]| (points[0] + points[1] + points[2]) / 3.0;
    let world_center = center([in_world[0].coords, in_world[1].coords, in_world[2].coords]);
    let translation = center(*in_cam) - rotation * world_center;
    let pose = Rigid3::new(rotation, translation);
    pose.translation.iter().all(|t| t.is_finite()).then_some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use rand::Rng as _;

    #[test]
    fn the_true_pose_is_among_the_solutions() {
        let mut rng = seeded_rng(7, 0);
        let mut found = 0;
        const TRIALS: usize = 1000;
        for _ in 0..TRIALS {
            let mut draw = |scale: f64| Vector3::from_fn(|_, _| rng.random_range(-scale..scale));
            let truth = Rigid3::new(UnitQuaternion::from_scaled_axis(draw(2.0)), draw(3.0));
            let in_cam = [(); 3].map(|()| draw(2.0) + Vector3::new(0.0, 0.0, 6.0));
            let world = in_cam.map(|p| truth.inverse() * Point3::from(p));
            let poses = p3p(&in_cam.map(|p| p.normalize()), &world);
            assert!(poses.len() <= 4);
            let near = |p: &Rigid3| p.angle_to(&truth) < 1e-5 && (p.center() - truth.center()).norm() < 1e-4;
            found += usize::from(poses.iter().any(near));
        }
        // Triangles viewed edge-on or on the danger cylinder lose precision; a sampling loop only needs the rest.
        assert!(found >= TRIALS * 99 / 100, "{found} of {TRIALS}");
    }

    #[test]
    fn points_on_a_line_have_no_pose() {
        let line = [0.0, 1.0, 2.0].map(|t| Point3::new(t, 0.0, 5.0));
        assert!(p3p(&line.map(|p| p.coords.normalize()), &line).is_empty());
    }
}
