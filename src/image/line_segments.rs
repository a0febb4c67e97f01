//! Straight line segments.

use ::image::GrayImage;
use nalgebra::Point2;
use opencv::core::{Vec4f, Vector};
use opencv::imgproc::{self, LineSegmentDetectorTrait as _};

use super::{ImageError, borrowed_gray};

/// Straight edges of an image (R. Grompone von Gioi et al., *LSD: a Line Segment Detector*, IPOL 2012).
///
/// * returns – both endpoints of each, pixels, the corner of the first pixel at (0, 0).
///
/// # Errors
/// [`ImageError::OpenCv`], also where OpenCV was built without the detector (versions 4.1 to 4.5.3).
pub fn line_segments(image: &GrayImage, min_length_px: f64) -> Result<Vec<[Point2<f64>; 2]>, ImageError> {
    let mut found = Vector::<Vec4f>::new();
    if !image.is_empty() {
        imgproc::create_line_segment_detector_def()?.detect_def(&borrowed_gray(image)?, &mut found)?;
    }
    let ends = |segment: Vec4f| {
        let [x0, y0, x1, y1] = segment.0.map(|at| f64::from(at) + 0.5);
        [Point2::new(x0, y0), Point2::new(x1, y1)]
    };
    Ok(found.iter().map(ends).filter(|[from, to]| (to - from).norm() >= min_length_px).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_of_a_bright_square_are_found() {
        let mut image = GrayImage::from_pixel(200, 160, ::image::Luma([40]));
        for (x, y) in (50..150).flat_map(|x| (30..130).map(move |y| (x, y))) {
            image.put_pixel(x, y, ::image::Luma([200]));
        }
        let found = line_segments(&image, 60.0).unwrap();
        assert_eq!(found.len(), 4, "{found:?}");
        let (mut across, mut down): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
        for [from, to] in &found {
            let middle = nalgebra::center(from, to);
            if (from.x - to.x).abs() < 1.0 { across.push(middle.x) } else { down.push(middle.y) }
        }
        across.sort_by(f64::total_cmp);
        down.sort_by(f64::total_cmp);
        let off = across.iter().chain(&down).zip([50.0, 150.0, 30.0, 130.0]).map(|(at, edge)| (at - edge).abs());
        assert!(off.fold(0.0, f64::max) < 0.6, "{across:?} {down:?}");
        assert!(line_segments(&GrayImage::new(0, 0), 1.0).unwrap().is_empty());
        assert!(line_segments(&GrayImage::new(60, 60), 1.0).unwrap().is_empty());
    }
}
