//! Keyframe: the features of a view, and small patches of its points.

use nalgebra::{Point2, Vector2};

use super::affine_views::AffineViews;
use crate::features::patch::Patch;
use crate::image::GrayImage;

/// Minimum number of common points that tie views together.
pub const FEW_POINTS: usize = 8;

/// Maximum number of points of a keyframe whose image patch is kept: more tie no better.
const MAX_PATCHES: usize = 300;

/// Appearance of a point in a view.
pub struct PointAppearance {
    pub track: usize,
    /// Its position, pixels.
    pub center: Point2<f32>,
    /// Image around it.
    picture: GrayImage,
    /// Position of the image's corner.
    corner: Vector2<f32>,
}

impl PointAppearance {
    /// `None` for a point too near to the image's border.
    fn new(gray: &GrayImage, track: usize, center: Point2<f32>, radius: u32) -> Option<Self> {
        let (x, y) = (center.x.floor() as i64 - i64::from(radius), center.y.floor() as i64 - i64::from(radius));
        let (x, y, side) = (u32::try_from(x).ok()?, u32::try_from(y).ok()?, 2 * radius + 1);
        let fits = x + side <= gray.width() && y + side <= gray.height();
        let picture = || ::image::imageops::crop_imm(gray, x, y, side, side).to_image();
        fits.then(|| Self { track, center, picture: picture(), corner: Vector2::new(x as f32, y as f32) })
    }

    /// Patch around the point in the view.
    pub fn patch(&self, radius: i32) -> Option<Patch> {
        Patch::cut(&self.picture, self.center - self.corner, radius)
    }
}

/// View that is kept for re-detection.
pub struct Keyframe {
    pub view: usize,
    pub affine_views: AffineViews,
    pub appearances: Vec<PointAppearance>,
    /// Number of its points; not all of them have an appearance.
    pub num_points: usize,
}

impl Keyframe {
    /// * `points` – tracks and their positions, pixels; `radius` – half the side of a point's image, pixels.
    pub fn new(
        view: usize,
        affine_views: AffineViews,
        gray: &GrayImage,
        points: &[(usize, Point2<f32>)],
        radius: u32,
    ) -> Self {
        let step = points.len().div_ceil(MAX_PATCHES).max(1);
        let seen = points.iter().step_by(step);
        let appearances =
            seen.filter_map(|(track, center)| PointAppearance::new(gray, *track, *center, radius)).collect();
        Self { view, affine_views, appearances, num_points: points.len() }
    }
}
