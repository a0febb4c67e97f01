//! SIFT features inside a mask, as RootSIFT descriptors.
//!
//! [`super::sift`] detects and describes keypoints; R. Arandjelović, A. Zisserman, *Three Things Everyone Should Know
//! to Improve Object Retrieval*, CVPR 2012 for the square root. Keypoints outside the mask are rejected; the image
//! itself is not masked, which would create edges.

use nalgebra::Point2;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::refinement::Shape;
use super::sift::{self, Plane};
use crate::checks::{Checked, within};
use crate::features::FeatureError;
use crate::image::{GrayImage, RgbImage, gray_from_rgb, resize_gray};
use crate::scene::{BoundingBox, Mask};

pub use super::sift::DESCRIPTOR_LEN;

/// Length of a descriptor as a vector. Rounding adds at most half to each of its 128 entries, so that no product of two
/// descriptors is beyond sixteen bits: (175² + √128 · 175 + 32) < 2¹⁵.
pub const DESCRIPTOR_NORM: f32 = 175.0;

/// Options of feature detection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FeatureOptions {
    /// Maximum number of features per image, the strongest first; no more than 60,000.
    #[schemars(extend("unit" = "features"))]
    pub max_features: usize,
    /// Lowe's contrast threshold over the three layers of an octave; lower finds more on plain surfaces.
    #[schemars(extend("unit" = "share of the range of grey"))]
    pub contrast_threshold: f64,
    /// True to begin at twice the image's size: more and smaller features, at several times the cost.
    pub doubled: bool,
    /// Masks whose box is shorter than this on its longer side are enlarged before detection, up to four times: small
    /// objects have too few features at their own size.
    pub enlarge_below_px: u32,
    /// Minimum distance of a feature from the mask's border: features on an outline belong to no surface.
    pub border_px: u32,
}

/// Margin around a mask for descriptors that extend beyond it, pixels.
pub(super) const MARGIN_PX: u32 = 24;
/// Maximum number of features: their indices have sixteen bits in matching.
const MAX_FEATURES: usize = 60_000;

impl FeatureOptions {
    /// Rejects options that are out of range; the limit of enlargement bounds the memory of the enlarged image.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("max_features", self.max_features, 1..=MAX_FEATURES)?;
        within("contrast_threshold", self.contrast_threshold, 1e-6..=1.0)?;
        within("enlarge_below_px", self.enlarge_below_px, 0..=4000)?;
        within("border_px", self.border_px, 0..=1000)
    }

    /// Options for whole frames.
    pub fn background() -> Self {
        Self { max_features: 4000, contrast_threshold: 0.03, doubled: false, enlarge_below_px: 0, border_px: 0 }
    }

    /// Options for one object: more features from less surface.
    pub fn object() -> Self {
        Self { max_features: 3000, contrast_threshold: 0.015, doubled: true, enlarge_below_px: 400, border_px: 1 }
    }
}

/// Features of one image, the strongest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Positions, pixels, first pixel center at (0.5, 0.5).
    pub pixels: Vec<Point2<f64>>,
    /// Colors at the positions; empty if the image is gray.
    pub rgb: Vec<[u8; 3]>,
    /// Their sizes and directions.
    pub shapes: Vec<Shape>,
    /// Row-major, [`DESCRIPTOR_LEN`] per feature, of length [`DESCRIPTOR_NORM`].
    pub descriptors: Vec<u8>,
}

impl Features {
    /// Number of features.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Returns true if there is none.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }
}

/// Detects features at the set pixels of a mask, which has the image's size; none for an empty mask.
///
/// # Errors
/// [`FeatureError::OpenCv`] if OpenCV fails, for example on an image side beyond its limits.
pub fn extract(image: &RgbImage, mask: &Mask, options: &FeatureOptions) -> Result<Features, FeatureError> {
    let mut features = extract_gray(&gray_from_rgb(image)?, mask, options)?;
    let color = |p: &Point2<f64>| image.get_pixel_checked(p.x.max(0.0) as u32, p.y.max(0.0) as u32);
    features.rgb = features.pixels.iter().map(|pixel| color(pixel).map_or([0; 3], |c| c.0)).collect();
    Ok(features)
}

/// Detects features at the set pixels of a mask in a gray image; they have no colors.
///
/// # Errors
/// As [`extract`].
pub fn extract_gray(image: &GrayImage, mask: &Mask, options: &FeatureOptions) -> Result<Features, FeatureError> {
    let mask = mask.eroded(options.border_px);
    let Some(bounds) = mask.bounding_box() else { return Ok(Features::default()) };
    let window = bounds.grown(MARGIN_PX, image.dimensions());
    let crop = ::image::imageops::crop_imm(image, window.x0, window.y0, window.width(), window.height()).to_image();
    let scale = enlargement(window, options.enlarge_below_px);
    let (width, height) = (crop.width() * scale, crop.height() * scale);
    let crop = if scale > 1 { resize_gray(&crop, width, height)? } else { crop };
    let values = crop.as_raw().iter().map(|&v| f32::from(v) / 255.0).collect();
    let picture = Plane { width: width as usize, height: height as usize, values };
    let wanted = sift::Options {
        max_keypoints: options.max_features.min(MAX_FEATURES),
        min_contrast: (options.contrast_threshold / 3.0) as f32,
        doubled: options.doubled,
    };
    let found = sift::detect(&picture, &wanted, |x, y| {
        let (x, y) = (x as u32 / scale, y as u32 / scale);
        mask.get((window.x0 + x).into(), (window.y0 + y).into())
    });
    Ok(collected(window, f64::from(scale), &found))
}

fn enlargement(window: BoundingBox, enlarge_below_px: u32) -> u32 {
    let side = window.width().max(window.height()).max(1);
    enlarge_below_px.div_ceil(side).clamp(1, 4)
}

fn collected(window: BoundingBox, scale: f64, found: &sift::Keypoints) -> Features {
    let mut features = Features::default();
    for (keypoint, descriptor) in found.keypoints.iter().zip(found.descriptors.chunks_exact(DESCRIPTOR_LEN)) {
        let (x, y) = (f64::from(keypoint.x) / scale, f64::from(keypoint.y) / scale);
        features.pixels.push(Point2::new(x + f64::from(window.x0), y + f64::from(window.y0)));
        features.shapes.push(Shape { scale: keypoint.scale / scale as f32, angle: keypoint.angle });
        features.descriptors.extend(root_sift(descriptor));
    }
    features
}

/// Square root of the descriptor scaled to unit sum: its Euclidean distance is the Hellinger distance of the original.
fn root_sift(descriptor: &[f32]) -> impl Iterator<Item = u8> + '_ {
    let sum: f32 = descriptor.iter().sum::<f32>().max(f32::MIN_POSITIVE);
    descriptor.iter().map(move |v| ((v / sum).max(0.0).sqrt() * DESCRIPTOR_NORM).round().min(127.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blobs(width: u32, height: u32, centers: &[(f64, f64)]) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let value: f64 = centers
                .iter()
                .map(|(cx, cy)| {
                    let (dx, dy) = (f64::from(x) + 0.5 - cx, f64::from(y) + 0.5 - cy);
                    180.0 * (-(dx * dx + dy * dy) / (2.0 * 16.0)).exp()
                })
                .sum();
            ::image::Rgb([(30.0 + value) as u8; 3])
        })
    }

    #[test]
    fn positions_keep_the_pixel_convention_at_every_enlargement() {
        let centers = [(60.3, 50.8), (150.0, 70.25)];
        let image = blobs(220, 120, &centers);
        let all = Mask::from_fn(220, 120, |_, _| true);
        for enlarge_below_px in [0, 400, 800] {
            let options = FeatureOptions { enlarge_below_px, ..FeatureOptions::object() };
            let found = extract(&image, &all, &options).unwrap();
            for (x, y) in centers {
                let near = found.pixels.iter().map(|p| (p - Point2::new(x, y)).norm()).fold(f64::INFINITY, f64::min);
                assert!(near < 0.1, "nearest feature {near} px from the blob at enlargement {enlarge_below_px}");
            }
        }
    }

    #[test]
    fn features_stay_inside_the_mask_and_an_empty_mask_has_none() {
        let image = blobs(220, 120, &[(60.3, 50.8), (150.0, 70.25)]);
        let left = Mask::from_fn(220, 120, |x, _| x < 110);
        let found = extract(&image, &left, &FeatureOptions::object()).unwrap();
        assert!(!found.is_empty() && found.pixels.iter().all(|p| p.x < 110.0));
        assert_eq!(found.descriptors.len(), found.len() * DESCRIPTOR_LEN);
        assert!(extract(&image, &Mask::empty(220, 120), &FeatureOptions::object()).unwrap().is_empty());
    }
}
