//! Pinhole camera with radial and tangential distortion, and its derivatives.
//!
//! With x = X/Z, y = Y/Z, r² = x² + y² and the factor d = 1 + k₁ r² + k₂ r⁴, a point (X, Y, Z) in camera coordinates
//! (x right, y down, z forward) projects to
//!
//! ```text
//! u = fx (d x + a) + cx,    v = fy (d y + b) + cy.
//! ```
//!
//! (a, b) are the [`HigherTerms`] of k₃, p₁ and p₂, zero for most lenses. They are constant in every adjustment of a
//! camera: `docs/decisions/011-fixed-distortion-terms.md`. Pixels follow COLMAP: the corner of the image is (0, 0), the
//! center of the first pixel is (0.5, 0.5). [`Model`] lists the camera models of files and those covered by this one.

mod higher;
mod model;

use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

pub use higher::HigherTerms;
pub use model::Model;

/// Number of intrinsic parameters that can be adjusted: fx, fy, cx, cy, k1, k2, in this order.
pub const NUM_INTRINSICS: usize = 6;

/// Maximum inclination of a camera below the horizon, radians: straight down, over a slope. Beyond it the image is
/// upside down.
pub const MAX_INCLINATION: f64 = 1.65;
/// Minimum sine of a ray's angle below the horizon: below it, beyond 33 camera heights, the ground plane is too far
/// away.
pub const LEAST_DIP: f64 = 0.03;

/// Standard deviation of the horizon's roll if no sensor measures the vertical, radians: gimbals keep the roll within
/// one degree, poles within some degrees.
pub const ROLL_STD: f64 = 0.035;
/// Standard deviation of the longitudinal slope of roads, radians: half of the 4.5 to 8 % that guidelines allow for
/// country roads (FGSV, *Richtlinien für die Anlage von Landstraßen*, 2012).
pub const SLOPE_STD: f64 = 0.035;
/// Standard deviation of the logarithm of a guessed focal length that the images do not determine: cameras on poles and
/// bridges may have long focal lengths. Of six real ones three were within a factor of 1.5 of the guess, three several
/// times as long.
pub const GUESSED_FOCAL_STD: f64 = 0.75;
/// Standard deviation of the tilt beyond which the ground below a camera is unknown, radians.
pub const MAX_TILT_STD: f64 = 0.15;

/// Up direction in the camera frame, with a parametrization that is regular for a camera looking straight down, too.
///
/// * `angles` – inclination below the horizon, and tilt to the right, radians.
pub fn up_in_cam(angles: Vector2<f64>) -> Vector3<f64> {
    let [pitch, tilt] = [angles.x, angles.y];
    Vector3::new(tilt.sin(), -tilt.cos() * pitch.cos(), -tilt.cos() * pitch.sin())
}

/// Intrinsic parameters of one camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal lengths, pixels.
    pub focal: [f64; 2],
    /// Principal point, pixels.
    pub principal: [f64; 2],
    /// Radial distortion k₁, k₂.
    pub radial: [f64; 2],
    /// Distortion beyond k₁ and k₂; constant in adjustments.
    #[serde(default, skip_serializing_if = "HigherTerms::are_zero")]
    pub higher: HigherTerms,
}

/// Image position and its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    /// Pixel position.
    pub pixel: Point2<f64>,
    /// ∂pixel / ∂point in camera coordinates.
    pub d_point: Matrix2x3<f64>,
    /// ∂pixel / ∂(fx, fy, cx, cy, k1, k2).
    pub d_intrinsics: Matrix2x6<f64>,
}

impl Camera {
    /// Camera without distortion, principal point at the image center.
    pub fn with_focal(width: u32, height: u32, focal_px: f64) -> Self {
        Self {
            width,
            height,
            focal: [focal_px; 2],
            principal: [f64::from(width) / 2.0, f64::from(height) / 2.0],
            radial: [0.0; 2],
            higher: HigherTerms::ZERO,
        }
    }

    /// Initial guess for an unknown video camera: focal length 0.75 × the longer side, a field of view of 67°.
    ///
    /// The middle of typical focal lengths, in longer sides: phones 0.65 to 0.85, drones 0.65 to 0.8, cameras of
    /// driving data sets 0.55 to 0.95, dashcams and action cameras 0.4 to 0.6.
    pub fn prior(width: u32, height: u32) -> Self {
        Self::with_focal(width, height, 0.75 * f64::from(width.max(height)))
    }

    /// Initial guess for photographs: focal length equal to the longer side, 36 mm of a full frame.
    ///
    /// They are taken with phones and drones as well, but also with zoom lenses of 24 to 85 mm.
    pub fn prior_of_photograph(width: u32, height: u32) -> Self {
        Self::with_focal(width, height, f64::from(width.max(height)))
    }

    /// The same with another focal length.
    pub fn zoomed(&self, factor: f64) -> Self {
        Self { focal: self.focal.map(|focal| focal * factor), ..*self }
    }

    /// Parameters in the order fx, fy, cx, cy, k1, k2.
    pub fn intrinsics(&self) -> [f64; NUM_INTRINSICS] {
        let ([fx, fy], [cx, cy], [k1, k2]) = (self.focal, self.principal, self.radial);
        [fx, fy, cx, cy, k1, k2]
    }

    /// The same image size with other parameters, in the order of [`Camera::intrinsics`].
    pub fn with_intrinsics(&self, [fx, fy, cx, cy, k1, k2]: [f64; NUM_INTRINSICS]) -> Self {
        Self { focal: [fx, fy], principal: [cx, cy], radial: [k1, k2], ..*self }
    }

    /// All parameters in OpenCV's order: fx, fy, cx, cy, k1, k2, p1, p2, k3.
    pub fn parameters(&self) -> [f64; 9] {
        let ([fx, fy], [cx, cy], [k1, k2]) = (self.focal, self.principal, self.radial);
        let HigherTerms { k3, tangential: [p1, p2] } = self.higher;
        [fx, fy, cx, cy, k1, k2, p1, p2, k3]
    }

    /// The same image size with the first parameters in the order of [`Camera::parameters`], the others zero: four,
    /// five, six, eight or nine numbers; `None` for any other count.
    pub fn with_parameters(&self, first: &[f64]) -> Option<Self> {
        let at = |k: usize| first.get(k).copied().unwrap_or(0.0);
        let higher = HigherTerms { k3: at(8), tangential: [at(6), at(7)] };
        let camera = self.with_intrinsics(std::array::from_fn(at));
        matches!(first.len(), 4..=6 | 8 | 9).then_some(Self { higher, ..camera })
    }

    /// Camera of the same image resized to `width` × `height`.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self {
            width,
            height,
            focal: [self.focal[0] * sx, self.focal[1] * sy],
            principal: [self.principal[0] * sx, self.principal[1] * sy],
            ..*self
        }
    }

    /// K, without distortion.
    pub fn matrix(&self) -> Matrix3<f64> {
        let ([fx, fy], [cx, cy]) = (self.focal, self.principal);
        Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    }

    /// Geometric mean of the focal lengths, pixels.
    pub fn mean_focal(&self) -> f64 {
        (self.focal[0] * self.focal[1]).sqrt()
    }

    /// Projects a point in camera coordinates; `None` if it is not in front of the camera.
    #[inline]
    pub fn pixel_from_cam(&self, point_in_cam: Point3<f64>) -> Option<Point2<f64>> {
        if !(point_in_cam.z > f64::EPSILON) {
            return None;
        }
        let normalized = Vector2::new(point_in_cam.x, point_in_cam.y) / point_in_cam.z;
        Some(self.pixel_from_normalized(normalized))
    }

    /// Pixel of a direction given by its undistorted coordinates (x, y) on the plane z = 1.
    #[inline]
    pub fn pixel_from_normalized(&self, normalized: Vector2<f64>) -> Point2<f64> {
        let mut distorted = normalized * self.distortion_factor(normalized.norm_squared());
        if !self.higher.are_zero() {
            distorted += self.higher.offset(normalized);
        }
        Point2::new(self.focal[0] * distorted.x + self.principal[0], self.focal[1] * distorted.y + self.principal[1])
    }

    /// As [`Camera::pixel_from_cam`], with derivatives. `point_in_cam.z` must not be zero; its sign is ignored.
    #[inline(always)]
    pub fn project(&self, point_in_cam: Point3<f64>) -> Projection {
        let ([fx, fy], [k1, k2]) = (self.focal, self.radial);
        let inverse_z = 1.0 / point_in_cam.z;
        let (x, y) = (point_in_cam.x * inverse_z, point_in_cam.y * inverse_z);
        let r2 = x * x + y * y;
        let d = self.distortion_factor(r2);
        // dd/d(r²), times two for d(r²)/dx = 2x.
        let slope = 2.0 * (k1 + 2.0 * k2 * r2);
        let d_normalized =
            Matrix2::new(fx * (d + slope * x * x), fx * slope * x * y, fy * slope * x * y, fy * (d + slope * y * y));
        let normalized_d_point = Matrix2x3::new(inverse_z, 0.0, -x * inverse_z, 0.0, inverse_z, -y * inverse_z);
        let d_intrinsics = Matrix2x6::new(
            d * x,
            0.0,
            1.0,
            0.0,
            fx * x * r2,
            fx * x * r2 * r2,
            0.0,
            d * y,
            0.0,
            1.0,
            fy * y * r2,
            fy * y * r2 * r2,
        );
        let mut projection = Projection {
            pixel: self.pixel_from_normalized(Vector2::new(x, y)),
            d_point: d_normalized * normalized_d_point,
            d_intrinsics,
        };
        if !self.higher.are_zero() {
            self.add_higher(&mut projection, Vector2::new(x, y), &normalized_d_point);
        }
        projection
    }

    /// Adds the derivatives of the higher terms. Separate function, to keep the common case short.
    #[cold]
    #[inline(never)]
    fn add_higher(&self, projection: &mut Projection, normalized: Vector2<f64>, d_point: &Matrix2x3<f64>) {
        let focal = Matrix2::from_diagonal(&self.focal.into());
        let offset = self.higher.offset(normalized);
        projection.d_point += focal * self.higher.jacobian(normalized) * d_point;
        projection.d_intrinsics[(0, 0)] += offset.x;
        projection.d_intrinsics[(1, 1)] += offset.y;
    }

    /// Undistorted coordinates (x, y) on the plane z = 1 of the ray through a pixel.
    pub fn normalized_from_pixel(&self, pixel: Point2<f64>) -> Vector2<f64> {
        let distorted =
            Vector2::new((pixel.x - self.principal[0]) / self.focal[0], (pixel.y - self.principal[1]) / self.focal[1]);
        if !self.higher.are_zero() {
            return self.undistorted(distorted);
        }
        if self.radial == [0.0; 2] {
            return distorted;
        }
        // Newton on the radius alone: r (1 + k1 r² + k2 r⁴) = r_d, started at r_d.
        let target = distorted.norm();
        let [k1, k2] = self.radial;
        let mut radius = target;
        for _ in 0..20 {
            let r2 = radius * radius;
            let slope = 1.0 + 3.0 * k1 * r2 + 5.0 * k2 * r2 * r2;
            if slope <= 0.1 {
                // Past the radius at which the model turns back on itself there is no inverse.
                break;
            }
            let step = (radius * self.distortion_factor(r2) - target) / slope;
            radius -= step;
            if step.abs() < 1e-14 {
                break;
            }
        }
        if target > 0.0 { distorted * (radius / target) } else { distorted }
    }

    /// Inverse of the complete distortion on the plane z = 1: Newton's method in both coordinates, started at the
    /// distorted position.
    fn undistorted(&self, distorted: Vector2<f64>) -> Vector2<f64> {
        let [k1, k2] = self.radial;
        let mut place = distorted;
        for _ in 0..30 {
            let r2 = place.norm_squared();
            let factor = self.distortion_factor(r2);
            let radial = Matrix2::identity() * factor + place * place.transpose() * (2.0 * (k1 + 2.0 * k2 * r2));
            let jacobian = radial + self.higher.jacobian(place);
            let error = place * factor + self.higher.offset(place) - distorted;
            // Past the radius at which the model turns back on itself there is no inverse.
            let Some(inverse) = jacobian.try_inverse().filter(|_| jacobian.determinant() > 0.01) else { break };
            let step = inverse * error;
            place -= step;
            if step.norm() < 1e-14 {
                break;
            }
        }
        place
    }

    /// Unit direction, in camera coordinates, of the ray through a pixel.
    pub fn ray_from_pixel(&self, pixel: Point2<f64>) -> Vector3<f64> {
        let normalized = self.normalized_from_pixel(pixel);
        Vector3::new(normalized.x, normalized.y, 1.0).normalize()
    }

    /// Returns true if a pixel position lies in the image.
    pub fn contains(&self, pixel: Point2<f64>) -> bool {
        pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < f64::from(self.width) && pixel.y < f64::from(self.height)
    }

    #[inline]
    fn distortion_factor(&self, r2: f64) -> f64 {
        1.0 + r2 * (self.radial[0] + r2 * self.radial[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera with k₁ and k₂ only, and one with all terms.
    fn cameras() -> [Camera; 2] {
        let all = [800.0, 810.0, 470.0, 280.0, -0.12, 0.03, 0.004, -0.003, 0.02];
        [6, 9].map(|count| Camera::prior(960, 540).with_parameters(&all[..count]).unwrap())
    }

    #[test]
    fn pixel_and_ray_are_inverse() {
        for camera in cameras() {
            for (x, y) in [(0.5, 0.5), (480.0, 270.0), (955.0, 12.0), (470.0, 280.0)] {
                let ray = camera.ray_from_pixel(Point2::new(x, y));
                let back = camera.pixel_from_cam(Point3::from(ray * 7.0)).unwrap();
                assert!((back - Point2::new(x, y)).norm() < 1e-9);
            }
            assert!(camera.pixel_from_cam(Point3::new(0.0, 0.0, -1.0)).is_none());
        }
    }

    #[test]
    fn derivatives_match_finite_differences() {
        let point = Point3::new(0.9, -0.6, 2.3);
        let h = 1e-6;
        for camera in cameras() {
            let projection = camera.project(point);
            for k in 0..3 {
                let mut step = Vector3::zeros();
                step[k] = h;
                let numeric = (camera.project(point + step).pixel - camera.project(point - step).pixel) / (2.0 * h);
                assert!((projection.d_point.column(k) - numeric).norm() < 1e-5);
            }
            for k in 0..NUM_INTRINSICS {
                let at = |delta: f64| {
                    let mut p = camera.intrinsics();
                    p[k] += delta;
                    camera.with_intrinsics(p).project(point).pixel
                };
                assert!((projection.d_intrinsics.column(k) - (at(h) - at(-h)) / (2.0 * h)).norm() < 1e-5);
            }
        }
    }

    /// OpenCV's published formula, by hand.
    #[test]
    fn all_terms_are_those_of_opencv() {
        let [_, camera] = cameras();
        // x = 0.5, y = -0.25: r² = 0.3125, d = 1 - 0.0375 + 0.0029296875 + 0.02 · 0.030517578125 = 0.9660400390625;
        // x' = 0.48302001953125 + 2 p₁ x y - 0.003 · 0.8125 = 0.47958251953125;
        // y' = -0.241510009765625 + 0.004 · 0.4375 + 2 p₂ x y = -0.239010009765625.
        let pixel = camera.pixel_from_cam(Point3::new(1.0, -0.5, 2.0)).unwrap();
        let expected = Point2::new(800.0 * 0.47958251953125 + 470.0, 810.0 * -0.239010009765625 + 280.0);
        assert!((pixel - expected).norm() < 1e-10, "{pixel} {expected}");
    }

    #[test]
    fn parameters_come_back_and_odd_counts_are_refused() {
        for camera in cameras() {
            assert_eq!(camera.with_parameters(&camera.parameters()), Some(camera));
        }
        assert!([0, 3, 7, 10].iter().all(|count| Camera::prior(8, 6).with_parameters(&[1.0; 10][..*count]).is_none()));
    }
}
