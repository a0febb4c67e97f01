//! Refinement of the feature positions of a track by patch alignment.
//!
//! A SIFT keypoint is an extremum of a difference of Gaussians, which shifts when the surface is viewed from another
//! direction. So one view of every track is its template, and the patch around the feature is aligned with the other
//! views ([`super::patch`]), starting from the positions, scales and directions of the keypoints. Where that does not
//! converge nearby with a high correlation, the keypoint's own position stays.

use nalgebra::{Matrix2, Point2};
use rayon::prelude::*;

use super::patch::{Patch, Warp};
use super::tracks::{Feature, TrackTable};
use crate::features::FeatureError;
use crate::image::{GrayImage, resize_gray};

/// Size and direction of a feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Standard deviation of the Gaussian at which it was found, pixels.
    pub scale: f32,
    /// Dominant gradient direction, radians.
    pub angle: f32,
}

/// Half the side of a template, pixels of its level.
const RADIUS: i32 = 7;
/// Minimum correlation of two views of a patch.
const MIN_CORRELATION: f32 = 0.97;
/// Maximum shift of a feature, in units of its scale.
const MAX_SHIFT_SCALES: f32 = 0.8;
/// Scale of a feature whose template is cut from the image itself, pixels; larger ones use smaller levels.
const SCALE_OF_FIRST_LEVEL: f32 = 2.3;
/// Maximum number of levels of a pyramid, the image itself included.
const NUM_LEVELS: usize = 4;

/// Image at full, half, quarter size and so on.
pub struct Pyramid(Vec<GrayImage>);

impl Pyramid {
    /// Builds as many levels as features may need.
    ///
    /// # Errors
    /// [`FeatureError::Image`] if OpenCV cannot resize it.
    pub fn new(image: GrayImage) -> Result<Self, FeatureError> {
        let mut levels = vec![image];
        for level in 1..NUM_LEVELS {
            let (width, height) = (levels[level - 1].width() / 2, levels[level - 1].height() / 2);
            if width.min(height) < 4 * RADIUS as u32 {
                break;
            }
            levels.push(resize_gray(&levels[level - 1], width, height)?);
        }
        Ok(Self(levels))
    }

    /// Level at which a feature of some scale has the size of the templates.
    fn level(&self, scale: f32) -> usize {
        let level = (scale / SCALE_OF_FIRST_LEVEL).log2().round().max(0.0) as usize;
        level.min(self.0.len() - 1)
    }

    /// Full pixels per pixel of a level, along x and y (sizes are rounded down).
    fn step(&self, level: usize) -> (f32, f32) {
        let (full, small) = (&self.0[0], &self.0[level]);
        (full.width() as f32 / small.width() as f32, full.height() as f32 / small.height() as f32)
    }

    fn at_level(&self, pixel: Point2<f64>, level: usize) -> Point2<f32> {
        let (sx, sy) = self.step(level);
        Point2::new(pixel.x as f32 / sx, pixel.y as f32 / sy)
    }

    fn in_image(&self, pixel: Point2<f32>, level: usize) -> Point2<f64> {
        let (sx, sy) = self.step(level);
        Point2::new(f64::from(pixel.x) * f64::from(sx), f64::from(pixel.y) * f64::from(sy))
    }
}

/// Refines the features of all tracks; returns the number of refined positions.
///
/// * `shapes` – by view and feature, as in the table.
/// * `pyramids` – by view.
pub fn refine(table: &mut TrackTable, shapes: &[Vec<Shape>], pyramids: &[Pyramid]) -> usize {
    let moved: Vec<(Feature, Point2<f64>)> =
        table.tracks.par_iter().flat_map_iter(|track| refined(table, track, shapes, pyramids)).collect();
    for (feature, pixel) in &moved {
        table.views[feature.view as usize].pixels[feature.feature as usize] = *pixel;
    }
    moved.len()
}

fn refined(
    table: &TrackTable,
    track: &[Feature],
    shapes: &[Vec<Shape>],
    pyramids: &[Pyramid],
) -> Vec<(Feature, Point2<f64>)> {
    let shape = |f: &Feature| shapes[f.view as usize][f.feature as usize];
    let Some(template) = template_of(track, shape) else { return Vec::new() };
    let pyramid = &pyramids[template.view as usize];
    let of_template = shape(&template);
    let level = pyramid.level(of_template.scale);
    let center = pyramid.at_level(table.pixel(template), level);
    let Some(patch) = Patch::cut(&pyramid.0[level], center, RADIUS) else { return Vec::new() };
    let others = track.iter().filter(|f| **f != template);
    others
        .filter_map(|&feature| {
            let pyramid = &pyramids[feature.view as usize];
            let of_other = shape(&feature);
            let ratio = of_other.scale / of_template.scale;
            // Level whose resolution is nearest to that of the template.
            let other = (level as f32 + ratio.log2()).round().clamp(0.0, pyramid.0.len() as f32 - 1.0) as usize;
            let size = ratio * (level as f32 - other as f32).exp2();
            let (sin, cos) = (of_other.angle - of_template.angle).sin_cos();
            let start = Warp {
                shape: Matrix2::new(cos, -sin, sin, cos) * size,
                center: pyramid.at_level(table.pixel(feature), other),
            };
            let found = patch.align(&pyramid.0[other], &start)?;
            let pixel = pyramid.in_image(found.warp.center, other);
            let shift = (pixel - table.pixel(feature)).norm() as f32;
            let good = found.correlation >= MIN_CORRELATION && shift <= MAX_SHIFT_SCALES * of_other.scale;
            good.then_some((feature, pixel))
        })
        .collect()
}

/// Feature of the median scale: the others are neither much finer nor much coarser.
fn template_of(track: &[Feature], shape: impl Fn(&Feature) -> Shape) -> Option<Feature> {
    let mut by_scale: Vec<Feature> = track.to_vec();
    by_scale.sort_by(|a, b| shape(a).scale.total_cmp(&shape(b).scale).then(a.cmp(b)));
    by_scale.get(by_scale.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::tracks::View;
    use crate::scene::ImageId;

    /// A smooth texture under an affine map.
    fn picture(map: &Matrix2<f32>, shift: f32) -> GrayImage {
        GrayImage::from_fn(200, 160, |x, y| {
            let p = map * nalgebra::Vector2::new(x as f32 + 0.5, y as f32 + 0.5);
            let (u, v) = (p.x + shift, p.y);
            let value = 40.0 * ((u * 0.31).sin() + (v * 0.23 + 0.1 * u).cos() + (0.17 * (u + v)).sin());
            ::image::Luma([(0.6 * value + 128.0).clamp(0.0, 255.0) as u8])
        })
    }

    #[test]
    fn errors_of_some_tenths_of_a_pixel_are_corrected() {
        let maps = [Matrix2::identity(), Matrix2::new(1.05, 0.08, -0.06, 0.97)];
        let pyramids: Vec<Pyramid> = maps.iter().map(|map| Pyramid::new(picture(map, 0.0)).unwrap()).collect();
        let truth: Vec<Point2<f64>> = (0..20).map(|k| Point2::new(50.0 + 5.0 * f64::from(k), 80.0)).collect();
        // The second image at q corresponds to the first at map · q.
        let inverse = maps[1].try_inverse().unwrap().cast::<f64>();
        let view = |name: &str, pixels: Vec<Point2<f64>>| View {
            image: ImageId(1),
            name: name.to_owned(),
            camera: 0,
            rgb: vec![[0; 3]; pixels.len()],
            whitening: Vec::new(),
            pixels,
        };
        let off = nalgebra::Vector2::new(0.5, -0.4);
        let second: Vec<_> = truth.iter().map(|p| inverse * p + off).collect();
        let track = |k: u32| vec![Feature { view: 0, feature: k }, Feature { view: 1, feature: k }];
        let mut table = TrackTable {
            views: vec![view("a", truth.clone()), view("b", second)],
            tracks: (0..20).map(track).collect(),
        };
        let shape = |scale| vec![Shape { scale, angle: 0.0 }; 20];
        let moved = refine(&mut table, &[shape(2.0), shape(1.9)], &pyramids);
        assert!(moved >= 18, "{moved}");
        let errors: Vec<f64> =
            truth.iter().zip(&table.views[1].pixels).map(|(p, q)| (inverse * p - q).norm()).collect();
        // The errors were 0.64 px; the rest comes from the rounding of gray values.
        let good = errors.iter().filter(|e| **e < 0.1).count();
        assert!(good >= 18 && errors.iter().all(|e| *e < 0.2), "{errors:?}");
    }
}
