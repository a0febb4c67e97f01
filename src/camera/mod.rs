//! The pinhole camera with radial distortion, and its derivatives.
//!
//! With x = X/Z, y = Y/Z, r² = x² + y² and the factor d = 1 + k₁ r² + k₂ r⁴, a point (X, Y, Z) in camera coordinates
//! (x right, y down, z forward) is seen at
//!
//! ```text
//! u = fx d x + cx,    v = fy d y + cy.
//! ```
//!
//! Pixels follow COLMAP: the corner of the image is (0, 0), the centre of the first pixel is (0.5, 0.5). The model is
//! COLMAP's PINHOLE (k₁ = k₂ = 0), RADIAL (fx = fy), or OPENCV (p₁ = p₂ = 0).

use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Number of intrinsic parameters: fx, fy, cx, cy, k1, k2, in this order.
pub const NUM_INTRINSICS: usize = 6;

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
    /// A camera without distortion, principal point in the middle.
    pub fn with_focal(width: u32, height: u32, focal_px: f64) -> Self {
        Self {
            width,
            height,
            focal: [focal_px; 2],
            principal: [f64::from(width) / 2.0, f64::from(height) / 2.0],
            radial: [0.0; 2],
        }
    }

    /// The guess for the unknown camera of a video: focal length 0.75 × the longer side, a field of view of 67°.
    ///
    /// The middle of what videos are taken with, in longer sides: phones 0.65 to 0.85, drones 0.65 to 0.8, cameras of
    /// driving data sets 0.55 to 0.95, dashcams and action cameras 0.4 to 0.6; docs/sfm.md has the sources.
    pub fn prior(width: u32, height: u32) -> Self {
        Self::with_focal(width, height, 0.75 * f64::from(width.max(height)))
    }

    /// The same for photographs: focal length once the longer side, 36 mm of a full frame. They are taken with phones
    /// and drones as well, but also with zoom lenses of 24 to 85 mm.
    pub fn prior_of_photograph(width: u32, height: u32) -> Self {
        Self::with_focal(width, height, f64::from(width.max(height)))
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

    /// The camera of the same picture resized to `width` × `height`.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self {
            width,
            height,
            focal: [self.focal[0] * sx, self.focal[1] * sy],
            principal: [self.principal[0] * sx, self.principal[1] * sy],
            radial: self.radial,
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

    /// Pixel at which a point in camera coordinates is seen; `None` if it does not lie in front of the camera.
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
        let distorted = normalized * self.distortion_factor(normalized.norm_squared());
        Point2::new(self.focal[0] * distorted.x + self.principal[0], self.focal[1] * distorted.y + self.principal[1])
    }

    /// As [`Camera::pixel_from_cam`], with derivatives. `point_in_cam.z` must not be zero; its sign is not looked at.
    #[inline]
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
        Projection {
            pixel: self.pixel_from_normalized(Vector2::new(x, y)),
            d_point: d_normalized * normalized_d_point,
            d_intrinsics,
        }
    }

    /// Undistorted coordinates (x, y) on the plane z = 1 of the ray through a pixel.
    pub fn normalized_from_pixel(&self, pixel: Point2<f64>) -> Vector2<f64> {
        let distorted =
            Vector2::new((pixel.x - self.principal[0]) / self.focal[0], (pixel.y - self.principal[1]) / self.focal[1]);
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

    /// Unit direction, in camera coordinates, of the ray through a pixel.
    pub fn ray_from_pixel(&self, pixel: Point2<f64>) -> Vector3<f64> {
        let normalized = self.normalized_from_pixel(pixel);
        Vector3::new(normalized.x, normalized.y, 1.0).normalize()
    }

    /// Whether a pixel position lies in the image.
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

    fn camera() -> Camera {
        Camera { width: 960, height: 540, focal: [800.0, 810.0], principal: [470.0, 280.0], radial: [-0.12, 0.03] }
    }

    #[test]
    fn pixel_and_ray_are_inverse() {
        for (x, y) in [(0.5, 0.5), (480.0, 270.0), (955.0, 12.0), (470.0, 280.0)] {
            let ray = camera().ray_from_pixel(Point2::new(x, y));
            let back = camera().pixel_from_cam(Point3::from(ray * 7.0)).unwrap();
            assert!((back - Point2::new(x, y)).norm() < 1e-9);
        }
        assert!(camera().pixel_from_cam(Point3::new(0.0, 0.0, -1.0)).is_none());
    }

    #[test]
    fn derivatives_match_finite_differences() {
        let point = Point3::new(0.9, -0.6, 2.3);
        let projection = camera().project(point);
        let h = 1e-6;
        for k in 0..3 {
            let mut step = Vector3::zeros();
            step[k] = h;
            let numeric = (camera().project(point + step).pixel - camera().project(point - step).pixel) / (2.0 * h);
            assert!((projection.d_point.column(k) - numeric).norm() < 1e-5);
        }
        for k in 0..NUM_INTRINSICS {
            let at = |delta: f64| {
                let mut p = camera().intrinsics();
                p[k] += delta;
                camera().with_intrinsics(p).project(point).pixel
            };
            assert!((projection.d_intrinsics.column(k) - (at(h) - at(-h)) / (2.0 * h)).norm() < 1e-5);
        }
    }
}
