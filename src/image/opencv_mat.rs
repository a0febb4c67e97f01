//! Conversions between the `image` crate's buffers and OpenCV's matrices.

use ::image::{GrayImage, ImageBuffer, Pixel, RgbImage};
use nalgebra::SMatrix;
use opencv::boxed_ref::BoxedRef;
use opencv::core::{CV_8UC1, CV_8UC3, Mat, MatTraitConst, MatTraitConstManual, Vec3b};

use super::ImageError;

/// A one-channel 8-bit matrix over the pixels of `image`, without a copy.
pub fn borrowed_gray(image: &GrayImage) -> Result<BoxedRef<'_, Mat>, ImageError> {
    let (rows, cols) = (i32::try_from(image.height())?, i32::try_from(image.width())?);
    Ok(Mat::new_rows_cols_with_bytes::<u8>(rows, cols, image.as_raw())?)
}

/// A three-channel 8-bit matrix (red, green, blue) over the pixels of `image`, without a copy.
pub fn borrowed_rgb(image: &RgbImage) -> Result<BoxedRef<'_, Mat>, ImageError> {
    let (rows, cols) = (i32::try_from(image.height())?, i32::try_from(image.width())?);
    Ok(Mat::new_rows_cols_with_bytes::<Vec3b>(rows, cols, image.as_raw())?)
}

/// A one-channel 8-bit matrix with the pixels of `image`.
pub fn mat_from_gray(image: &GrayImage) -> Result<Mat, ImageError> {
    Ok(borrowed_gray(image)?.try_clone()?)
}

/// A three-channel 8-bit matrix (red, green, blue) with the pixels of `image`.
pub fn mat_from_rgb(image: &RgbImage) -> Result<Mat, ImageError> {
    Ok(borrowed_rgb(image)?.try_clone()?)
}

/// A matrix as OpenCV takes affine maps (2 × 3) and homographies (3 × 3).
pub(super) fn mat_from_matrix<const R: usize, const C: usize>(map: &SMatrix<f64, R, C>) -> Result<Mat, ImageError> {
    let rows: Vec<f64> = map.transpose().iter().copied().collect();
    Ok(Mat::new_rows_cols_with_data::<f64>(R as i32, C as i32, &rows)?.try_clone()?)
}

/// A gray image from a one-channel 8-bit matrix.
///
/// # Errors
/// [`ImageError::PixelType`] for any other kind of matrix.
pub fn gray_from_mat(mat: &impl MatTraitConst) -> Result<GrayImage, ImageError> {
    image_from_mat(mat, CV_8UC1)
}

/// A color image from a three-channel 8-bit matrix in the order red, green, blue.
///
/// # Errors
/// [`ImageError::PixelType`] for any other kind of matrix.
pub fn rgb_from_mat(mat: &impl MatTraitConst) -> Result<RgbImage, ImageError> {
    image_from_mat(mat, CV_8UC3)
}

/// An image from a matrix of the expected type, which may be a view into a larger one.
fn image_from_mat<P: Pixel<Subpixel = u8>>(
    mat: &impl MatTraitConst,
    expected: i32,
) -> Result<ImageBuffer<P, Vec<u8>>, ImageError> {
    let found = mat.typ();
    if found != expected {
        return Err(ImageError::PixelType { expected, found });
    }
    let (width, height) = (u32::try_from(mat.cols())?, u32::try_from(mat.rows())?);
    let bytes = if mat.is_continuous() { mat.data_bytes()?.to_vec() } else { mat.try_clone()?.data_bytes()?.to_vec() };
    let (channels, found) = (u32::from(P::CHANNEL_COUNT), bytes.len());
    ImageBuffer::from_raw(width, height, bytes).ok_or(ImageError::BufferSize { width, height, channels, found })
}

#[cfg(test)]
mod tests {
    use opencv::core::Rect;

    use super::*;

    fn gradient() -> RgbImage {
        RgbImage::from_fn(7, 5, |x, y| ::image::Rgb([x as u8 * 30, y as u8 * 40, 200 - x as u8]))
    }

    #[test]
    fn colour_survives_both_ways() {
        let image = gradient();
        let mat = mat_from_rgb(&image).unwrap();
        assert_eq!((mat.cols(), mat.rows()), (7, 5));
        assert_eq!(rgb_from_mat(&mat).unwrap(), image);
    }

    #[test]
    fn grey_survives_and_a_view_is_copied_row_by_row() {
        let image = GrayImage::from_fn(6, 4, |x, y| ::image::Luma([(y * 6 + x) as u8]));
        let mat = mat_from_gray(&image).unwrap();
        assert_eq!(gray_from_mat(&mat).unwrap(), image);
        let view = Mat::roi(&mat, Rect::new(2, 1, 3, 2)).unwrap();
        assert_eq!(gray_from_mat(&view).unwrap().into_raw(), [8, 9, 10, 14, 15, 16]);
    }

    #[test]
    fn a_wrong_type_is_an_error() {
        let mat = mat_from_rgb(&gradient()).unwrap();
        assert!(matches!(gray_from_mat(&mat), Err(ImageError::PixelType { .. })));
    }
}
