//! Test whether images are consecutive frames of a video.

use nalgebra::Point2;
use opencv::core::{Mat, Point2f, Vector};

use crate::features::FeatureError;
use crate::image::{GrayImage, LucasKanade, Pyramid, Returned, borrowed_gray, resize_gray, scale_to_fit};

/// Share of the corners of one image that pyramidal Lucas-Kanade tracks to the next; 0 where there are no corners.
///
/// A tracked corner moves by at most a twentieth of the longer side, and returns within a pixel at 480 pixels.
///
/// Points of a video move by less from frame to frame: the median pair of rendered drives and drone clips at five to
/// ten frames per second has 0.68 to 0.97, that of photographs (Strecha's two scenes, the flight over Brighton) 0 to
/// 0.48. At a fortieth of the side the drives would have 0.16 to 0.79, at a thirteenth one set of photographs 0.59.
///
/// # Errors
/// [`FeatureError::OpenCv`] if OpenCV fails.
pub fn followed_share(first: &GrayImage, second: &GrayImage) -> Result<f64, FeatureError> {
    // Longer side of the resized images, pixels: the size to which the limits of tracking refer.
    const LONGER_SIDE_PX: u32 = 480;
    let small = |image: &GrayImage| {
        let (width, height) = scale_to_fit(image.width(), image.height(), LONGER_SIDE_PX);
        resize_gray(image, width, height)
    };
    let (first, second) = (small(first)?, small(second)?);
    if first.dimensions() != second.dimensions() {
        return Ok(0.0);
    }
    let mut corners = Vector::<Point2f>::new();
    // Three hundred corners determine a share to a few percent, and cost little.
    opencv::imgproc::good_features_to_track(
        &borrowed_gray(&first)?,
        &mut corners,
        300,
        0.01,
        8.0,
        &Mat::default(),
        3,
        false,
        0.04,
    )?;
    if corners.is_empty() {
        return Ok(0.0);
    }
    // The origin of OpenCV is the center of the first pixel.
    let corners: Vec<Point2<f32>> = corners.iter().map(|corner| Point2::new(corner.x + 0.5, corner.y + 0.5)).collect();
    let tracker =
        LucasKanade { window_radius_px: 7, num_smaller: 3, max_steps: 20, converged_px: 0.03, min_eigenvalue: 1e-3 };
    let pyramids = (Pyramid::new(first, tracker.num_smaller)?, Pyramid::new(second, tracker.num_smaller)?);
    let followed = tracker.there_and_back(&pyramids.0, &pyramids.1, &corners, &corners);
    let is_near = |(start, followed): &(&Point2<f32>, Option<Returned>)| {
        let max_motion_px = LONGER_SIDE_PX as f32 / 20.0;
        // Tracked to a pixel there and back.
        followed.is_some_and(|f| f.round_trip_px <= 1.0 && (f.position - *start).norm() <= max_motion_px)
    };
    let count = corners.iter().zip(followed).filter(is_near).count();
    Ok(count as f64 / corners.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use rand::Rng as _;

    /// A smooth random texture.
    fn texture(seed: u64) -> GrayImage {
        let mut rng = seeded_rng(seed, 0);
        let coarse = GrayImage::from_fn(80, 60, |_, _| ::image::Luma([rng.random()]));
        resize_gray(&coarse, 640, 480).unwrap()
    }

    #[test]
    fn a_small_shift_is_tracked_and_another_image_is_not() {
        let whole = texture(1);
        let crop = |x: u32, y: u32| ::image::imageops::crop_imm(&whole, x, y, 560, 420).to_image();
        let share = followed_share(&crop(10, 10), &crop(22, 16)).unwrap();
        assert!(share > 0.7, "{share}");
        let other = ::image::imageops::crop_imm(&texture(2), 10, 10, 560, 420).to_image();
        let share = followed_share(&crop(10, 10), &other).unwrap();
        assert!(share < 0.2, "{share}");
        let plain = GrayImage::from_pixel(560, 420, ::image::Luma([90]));
        assert_eq!(followed_share(&plain, &plain).unwrap(), 0.0);
    }
}
