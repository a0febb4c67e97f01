//! Artificial degradation of images, for robustness tests.

use ::image::RgbImage;
use opencv::core::{Mat, Size};
use opencv::imgproc;
use rand::Rng as _;
use rand_distr::StandardNormal;

use super::{ImageError, borrowed_rgb, rgb_from_mat};
use crate::math::Rng;

/// Image blurred by a Gaussian of this standard deviation, pixels.
///
/// # Errors
/// [`ImageError`] if OpenCV fails.
pub fn blurred(image: &RgbImage, sigma_px: f64) -> Result<RgbImage, ImageError> {
    let mut result = Mat::default();
    let size_by_sigma = Size::new(0, 0);
    imgproc::gaussian_blur_def(&borrowed_rgb(image)?, &mut result, size_by_sigma, sigma_px)?;
    rgb_from_mat(&result)
}

/// Image with Gaussian noise of this standard deviation, gray levels, in every channel of every pixel.
pub fn noisy(image: &RgbImage, sigma: f64, rng: &mut Rng) -> RgbImage {
    let mut result = image.clone();
    for value in result.iter_mut() {
        let noise: f64 = rng.sample(StandardNormal);
        *value = (f64::from(*value) + sigma * noise).round().clamp(0.0, 255.0) as u8;
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use ::image::Rgb;

    #[test]
    fn blur_spreads_and_noise_scatters() {
        let point = RgbImage::from_fn(41, 41, |x, y| Rgb([if (x, y) == (20, 20) { 255 } else { 0 }; 3]));
        let soft = blurred(&point, 1.0).unwrap();
        assert!(soft.get_pixel(20, 20)[0] < 60 && soft.get_pixel(21, 20)[0] > 10);
        let grey = RgbImage::from_pixel(64, 64, Rgb([128; 3]));
        let mut rng = seeded_rng(1, 2);
        let rough = noisy(&grey, 8.0, &mut rng);
        let mean = rough.iter().map(|v| f64::from(*v)).sum::<f64>() / rough.len() as f64;
        let variance = rough.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / rough.len() as f64;
        assert!((mean - 128.0).abs() < 0.5 && (variance.sqrt() - 8.0).abs() < 0.3, "{mean} {variance}");
    }
}
