//! SIFT features of a view and of affine views synthesized from it.
//!
//! A descriptor tolerates rotations of the viewpoint up to about thirty degrees. A vehicle that was occluded for a
//! second in a bend has rotated more. So the image is also tilted: rotated, and then compressed across, as a plane
//! appears from a more oblique view (J.-M. Morel, G. Yu, *ASIFT*, SIAM Journal on Imaging Sciences 2009, with the first
//! two of their tilts).

use std::f64::consts::{PI, SQRT_2};

use nalgebra::{Matrix2, Matrix2x3, Point2, Rotation2, Vector2};

use super::FeatureError;
use crate::features::rootsift::{FeatureOptions, Features, MARGIN_PX, extract_gray};
use crate::image::{GrayImage, resize_gray, warp_gray};
use crate::scene::{BoundingBox, Mask};

/// Maximum side of an image in which features are detected, pixels: they only predict the positions of points.
const LARGEST_PX: u32 = 640;
/// Factors by which an image is compressed across.
const TILTS: [f64; 2] = [SQRT_2, 2.0];
/// Step from one direction of a tilt to the next, over the tilt.
const DIRECTION_STEP: f64 = 0.4 * PI;

/// Features of one affine view, or of the view itself.
pub struct AffineView {
    /// Positions in pixels of the view.
    pub features: Features,
    /// From the axes of the synthesized image to those of the view.
    view_from_image: Matrix2<f64>,
}

impl AffineView {
    /// From the feature's own axes to the view's: its rotation and scale.
    pub fn frame(&self, feature: usize) -> Matrix2<f32> {
        let shape = self.features.shapes[feature];
        let (sin, cos) = shape.angle.sin_cos();
        self.view_from_image.cast::<f32>() * Matrix2::new(cos, -sin, sin, cos) * shape.scale
    }
}

/// Features of a view and of its affine views.
pub struct AffineViews {
    pub plain: AffineView,
    tilted: Vec<AffineView>,
    /// Present until affine views are synthesized.
    window: Option<Window>,
}

impl AffineViews {
    /// Detects the features of the view inside a mask.
    ///
    /// # Errors
    /// [`FeatureError::OpenCv`].
    pub fn new(gray: &GrayImage, mask: &Mask) -> Result<Self, FeatureError> {
        let window = Window::new(gray, mask)?;
        Ok(Self { plain: window.plain()?, tilted: Vec::new(), window: Some(window) })
    }

    /// Synthesizes the affine views, once.
    ///
    /// # Errors
    /// [`FeatureError::OpenCv`].
    pub fn tilt(&mut self) -> Result<(), FeatureError> {
        let Some(window) = self.window.take() else { return Ok(()) };
        let directions = |tilt: f64| (0..).map(move |k| f64::from(k) * DIRECTION_STEP / tilt).take_while(|d| *d < PI);
        let all = TILTS.into_iter().flat_map(|tilt| directions(tilt).map(move |direction| (tilt, direction)));
        self.tilted = all.map(|(tilt, direction)| window.tilted(tilt, direction)).collect::<Result<_, _>>()?;
        Ok(())
    }

    /// Drops the affine views and their source: the view is too old to be tilted again.
    pub fn drop_tilted(&mut self) {
        self.window = None;
        self.tilted = Vec::new();
    }

    /// Pairs of views whose features are compared: plain with plain, and plain with tilted.
    pub fn pairs_with<'a>(&'a self, other: &'a Self) -> Vec<(&'a AffineView, &'a AffineView)> {
        let before = self.tilted.iter().map(|tilted| (tilted, &other.plain));
        let now = other.tilted.iter().map(|tilted| (&self.plain, tilted));
        std::iter::once((&self.plain, &other.plain)).chain(before).chain(now).collect()
    }
}

/// Part of a view that contains its mask, with a margin for descriptors.
struct Window {
    gray: GrayImage,
    mask: Mask,
    /// Its corner in the view, pixels.
    corner: Vector2<f64>,
    /// Its scale relative to the view, along both axes.
    share: Vector2<f64>,
}

impl Window {
    fn new(gray: &GrayImage, mask: &Mask) -> Result<Self, FeatureError> {
        let bounds = mask
            .bounding_box()
            .map_or(BoundingBox { x0: 0, y0: 0, x1: 1, y1: 1 }, |b| b.grown(MARGIN_PX, gray.dimensions()));
        let side = bounds.width().max(bounds.height());
        let divisor = side.div_ceil(LARGEST_PX).max(1);
        let (width, height) = ((bounds.width() / divisor).max(1), (bounds.height() / divisor).max(1));
        let crop = ::image::imageops::crop_imm(gray, bounds.x0, bounds.y0, bounds.width(), bounds.height()).to_image();
        let corner = Vector2::new(bounds.x0, bounds.y0).cast::<f64>();
        let sides = Vector2::new(bounds.width(), bounds.height()).cast::<f64>();
        let share = Vector2::new(width, height).cast::<f64>().component_div(&sides);
        let in_view = |p: Vector2<f64>| corner + p.component_div(&share);
        let mask = Mask::from_fn(width, height, |x, y| {
            let p = in_view(middle(x, y));
            mask.contains(p.x, p.y)
        });
        Ok(Self { gray: resize_gray(&crop, width, height)?, mask, corner, share })
    }

    fn plain(&self) -> Result<AffineView, FeatureError> {
        let is_small = self.mask.bounding_box().is_none_or(|b| 2 * b.width().max(b.height()) <= LARGEST_PX);
        let features = features(&self.gray, &self.mask, is_small)?;
        Ok(self.affine_view(features, Matrix2x3::identity()))
    }

    /// Synthesizes the view rotated by an angle and compressed by a factor across.
    fn tilted(&self, tilt: f64, direction: f64) -> Result<AffineView, FeatureError> {
        let turn = *Rotation2::new(direction).matrix();
        let sides = Vector2::new(self.gray.width(), self.gray.height()).cast::<f64>();
        let turned_sides = (turn.abs() * sides).map(f64::ceil);
        let squeezed = Vector2::new((turned_sides.x / tilt).round().max(1.0), turned_sides.y);
        let back = turn.transpose();
        let window_from_turned = affine(back, sides / 2.0 - back * turned_sides / 2.0);
        let turned = warp_gray(&self.gray, &window_from_turned, turned_sides.x as u32, turned_sides.y as u32)?;
        let picture = resize_gray(&turned, squeezed.x as u32, squeezed.y as u32)?;
        let wider = Matrix2::from_diagonal(&turned_sides.component_div(&squeezed));
        let window_from_image = affine(back * wider, window_from_turned.column(2).into());
        let mask = Mask::from_fn(picture.width(), picture.height(), |x, y| {
            let p = window_from_image * middle(x, y).push(1.0);
            self.mask.contains(p.x, p.y)
        });
        Ok(self.affine_view(features(&picture, &mask, true)?, window_from_image))
    }

    /// Features with their positions in the view.
    fn affine_view(&self, mut features: Features, window_from_image: Matrix2x3<f64>) -> AffineView {
        let in_view = |p: &Point2<f64>| {
            let in_window = window_from_image * p.coords.push(1.0);
            Point2::from(self.corner + in_window.component_div(&self.share))
        };
        features.pixels.iter_mut().for_each(|p| *p = in_view(p));
        let view_from_window = Matrix2::from_diagonal(&self.share.map(|s| 1.0 / s));
        AffineView { features, view_from_image: view_from_window * window_from_image.fixed_view::<2, 2>(0, 0) }
    }
}

fn middle(x: u32, y: u32) -> Vector2<f64> {
    Vector2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)
}

fn affine(linear: Matrix2<f64>, shift: Vector2<f64>) -> Matrix2x3<f64> {
    Matrix2x3::from_columns(&[linear.column(0), linear.column(1), shift.column(0)])
}

fn features(picture: &GrayImage, mask: &Mask, doubled: bool) -> Result<Features, FeatureError> {
    let options =
        FeatureOptions { max_features: 1500, border_px: 1, enlarge_below_px: 200, doubled, ..FeatureOptions::object() };
    extract_gray(picture, mask, &options)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::image::Luma;

    /// Image with a bright blob around a point.
    fn blob(at: Point2<f64>) -> GrayImage {
        GrayImage::from_fn(200, 120, |x, y| {
            let d = (middle(x, y) - at.coords).norm_squared();
            Luma([(40.0 + 180.0 * (-d / 32.0).exp()) as u8])
        })
    }

    #[test]
    fn every_affine_view_has_a_point_at_its_position_in_the_view() {
        let at = Point2::new(81.3, 64.8);
        let mask = Mask::from_fn(200, 120, |x, y| (40..140).contains(&x) && (30..100).contains(&y));
        let mut views = AffineViews::new(&blob(at), &mask).unwrap();
        views.tilt().unwrap();
        assert_eq!(views.tilted.len(), 9);
        let nearest = |affine_view: &AffineView| {
            let distances = affine_view.features.pixels.iter().map(|p| (p - at).norm());
            distances.fold(f64::INFINITY, f64::min)
        };
        let num_exact = views.tilted.iter().filter(|affine_view| nearest(affine_view) < 0.1).count();
        assert!(num_exact >= 8, "{num_exact} of 9: one may find nothing in a blob that it squeezes");
    }

    #[test]
    fn an_affine_view_has_the_right_axes() {
        let mask = Mask::full(200, 120);
        let mut views = AffineViews::new(&blob(Point2::new(100.0, 60.0)), &mask).unwrap();
        views.tilt().unwrap();
        for affine_view in &views.tilted {
            let squeezed = affine_view.view_from_image.determinant();
            assert!(TILTS.iter().any(|tilt| (squeezed - tilt).abs() < 0.02 * tilt), "{squeezed}");
        }
    }
}
