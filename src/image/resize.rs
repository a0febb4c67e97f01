//! Resizing, warping and conversion to gray.

use ::image::{GrayImage, RgbImage};
use nalgebra::{Matrix2x3, Matrix3, Vector2};
use opencv::core::{BORDER_CONSTANT, BORDER_REPLICATE, Mat, MatTraitConst, Scalar, Size, ToInputArray};
use opencv::imgproc;

use super::opencv_mat::mat_from_matrix;
use super::{ImageError, borrowed_gray, borrowed_rgb, gray_from_mat, rgb_from_mat};

/// Luma of a color image, with OpenCV's weights (0.299 R + 0.587 G + 0.114 B).
pub fn gray_from_rgb(image: &RgbImage) -> Result<GrayImage, ImageError> {
    if image.is_empty() {
        return Ok(GrayImage::new(image.width(), image.height()));
    }
    let mut gray = Mat::default();
    imgproc::cvt_color(&borrowed_rgb(image)?, &mut gray, imgproc::COLOR_RGB2GRAY, 0)?;
    gray_from_mat(&gray)
}

/// A color image at another size: averaged over areas when it shrinks, linearly interpolated when it grows. Pixel
/// corners map to pixel corners, so that (0, 0) stays (0, 0).
pub fn resize_rgb(image: &RgbImage, width: u32, height: u32) -> Result<RgbImage, ImageError> {
    if (width, height) == image.dimensions() {
        return Ok(image.clone());
    }
    rgb_from_mat(&resized(&borrowed_rgb(image)?, width, height)?)
}

/// As [`resize_rgb`], at a tenth of the cost for slight shrinking.
///
/// It interpolates linearly, which skips no pixel until the sides are less than two thirds.
pub fn resize_rgb_quickly(image: &RgbImage, width: u32, height: u32) -> Result<RgbImage, ImageError> {
    let shrinks_much = 3 * width < 2 * image.width() || 3 * height < 2 * image.height();
    if shrinks_much || (width, height) == image.dimensions() {
        return resize_rgb(image, width, height);
    }
    rgb_from_mat(&resized_by(&borrowed_rgb(image)?, width, height, imgproc::INTER_LINEAR)?)
}

/// A gray image at another size; as [`resize_rgb`].
pub fn resize_gray(image: &GrayImage, width: u32, height: u32) -> Result<GrayImage, ImageError> {
    if (width, height) == image.dimensions() {
        return Ok(image.clone());
    }
    gray_from_mat(&resized(&borrowed_gray(image)?, width, height)?)
}

/// A gray image under an affine map, linearly interpolated; its border is replicated outside.
///
/// * `source_from_target` – 2 × 3, pixels whose corner is at (0, 0) in both.
pub fn warp_gray(
    image: &GrayImage,
    source_from_target: &Matrix2x3<f64>,
    width: u32,
    height: u32,
) -> Result<GrayImage, ImageError> {
    let size = Size::new(i32::try_from(width)?, i32::try_from(height)?);
    // OpenCV counts from the middle of the first pixel.
    let middle = Vector2::repeat(0.5);
    let mut map = *source_from_target;
    map.set_column(2, &(source_from_target * middle.push(1.0) - middle));
    let (flags, mut out) = (imgproc::INTER_LINEAR | imgproc::WARP_INVERSE_MAP, Mat::default());
    let map = mat_from_matrix(&map)?;
    imgproc::warp_affine(&borrowed_gray(image)?, &mut out, &map, size, flags, BORDER_REPLICATE, Scalar::default())?;
    gray_from_mat(&out)
}

/// A color image under a homography, linearly interpolated, of the same size; black outside.
///
/// * `target_from_source` – pixels whose corner is at (0, 0) in both.
pub fn warp_rgb(image: &RgbImage, target_from_source: &Matrix3<f64>) -> Result<RgbImage, ImageError> {
    let size = Size::new(i32::try_from(image.width())?, i32::try_from(image.height())?);
    // OpenCV counts from the middle of the first pixel.
    let to_middle = Matrix3::new_translation(&Vector2::repeat(-0.5));
    let map = to_middle * target_from_source * Matrix3::new_translation(&Vector2::repeat(0.5));
    let map = mat_from_matrix(&map)?;
    let (flags, black, mut out) = (imgproc::INTER_LINEAR, Scalar::default(), Mat::default());
    imgproc::warp_perspective(&borrowed_rgb(image)?, &mut out, &map, size, flags, BORDER_CONSTANT, black)?;
    rgb_from_mat(&out)
}

/// The size of an image of `width` × `height` whose longer side is at most `max_side`: never larger than it is, never a
/// side of zero.
pub fn scale_to_fit(width: u32, height: u32, max_side: u32) -> (u32, u32) {
    let longer = width.max(height);
    if longer <= max_side {
        return (width, height);
    }
    let scaled = |side: u32| {
        let exact = f64::from(side) * f64::from(max_side) / f64::from(longer);
        (exact.round() as u32).max(1)
    };
    (scaled(width), scaled(height))
}

fn resized(mat: &(impl MatTraitConst + ToInputArray), width: u32, height: u32) -> Result<Mat, ImageError> {
    let shrinks = i64::from(width) < i64::from(mat.cols()) && i64::from(height) < i64::from(mat.rows());
    resized_by(mat, width, height, if shrinks { imgproc::INTER_AREA } else { imgproc::INTER_LINEAR })
}

fn resized_by(
    mat: &(impl MatTraitConst + ToInputArray),
    width: u32,
    height: u32,
    method: i32,
) -> Result<Mat, ImageError> {
    let size = Size::new(i32::try_from(width)?, i32::try_from(height)?);
    let mut out = Mat::default();
    imgproc::resize(mat, &mut out, size, 0.0, 0.0, method)?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinking_averages_areas() {
        let image = GrayImage::from_fn(4, 2, |x, _| ::image::Luma([if x < 2 { 10 } else { 90 }]));
        assert_eq!(resize_gray(&image, 2, 1).unwrap().into_raw(), [10, 90]);
        assert_eq!(resize_gray(&image, 4, 2).unwrap(), image);
    }

    #[test]
    fn shrinking_a_little_keeps_places_and_passes_no_line_over() {
        // A ramp, and one bright column.
        let ramp = RgbImage::from_fn(120, 90, |x, _| ::image::Rgb([2 * x as u8; 3]));
        let small = resize_rgb_quickly(&ramp, 90, 68).unwrap();
        assert_eq!(small.dimensions(), (90, 68));
        let expected = |x: u32| 2.0 * ((f64::from(x) + 0.5) / 0.75 - 0.5);
        assert!((1..89).all(|x| (f64::from(small.get_pixel(x, 30).0[0]) - expected(x)).abs() <= 1.5));
        for column in 20..40 {
            let line = RgbImage::from_fn(120, 90, |x, _| ::image::Rgb([if x == column { 240 } else { 0 }; 3]));
            let small = resize_rgb_quickly(&line, 81, 61).unwrap();
            assert!((0..81).map(|x| u32::from(small.get_pixel(x, 30).0[0])).sum::<u32>() >= 40, "column {column}");
        }
        assert_eq!(resize_rgb_quickly(&ramp, 60, 45).unwrap(), resize_rgb(&ramp, 60, 45).unwrap());
    }

    #[test]
    fn a_quarter_turn_moves_every_pixel_to_its_place() {
        let image = GrayImage::from_raw(3, 2, vec![1, 2, 3, 4, 5, 6]).unwrap();
        // Target (x, y) shows source (y, 2 - x).
        let turn = Matrix2x3::new(0.0, 1.0, 0.0, -1.0, 0.0, 2.0);
        assert_eq!(warp_gray(&image, &turn, 2, 3).unwrap().into_raw(), [4, 1, 5, 2, 6, 3]);
    }

    #[test]
    fn grey_weighs_green_most() {
        let image = RgbImage::from_raw(3, 1, vec![255, 0, 0, 0, 255, 0, 0, 0, 255]).unwrap();
        assert_eq!(gray_from_rgb(&image).unwrap().into_raw(), [76, 150, 29]);
        assert_eq!(gray_from_rgb(&RgbImage::new(0, 0)).unwrap().dimensions(), (0, 0));
    }

    #[test]
    fn fitting_keeps_the_aspect_and_never_enlarges() {
        assert_eq!(scale_to_fit(1920, 1080, 960), (960, 540));
        assert_eq!(scale_to_fit(640, 480, 960), (640, 480));
        assert_eq!(scale_to_fit(5000, 2, 100), (100, 1));
    }

    #[test]
    fn a_size_of_zero_is_an_error() {
        assert!(resize_gray(&GrayImage::new(4, 4), 0, 3).is_err());
    }
}
