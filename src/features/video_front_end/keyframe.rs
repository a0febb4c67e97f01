//! A view that is remembered: its features, and small pictures of its points.

use nalgebra::{Point2, Vector2};

use super::affine_views::AffineViews;
use crate::features::patch::Patch;
use crate::image::GrayImage;

/// Minimum number of common points that tie views together.
pub const FEW_POINTS: usize = 8;

/// Maximum number of points of a keyframe whose image patch is kept: more tie no better.
const MAX_PATCHES: usize = 300;

/// A point as a view showed it.
pub struct PointAppearance {
    pub track: usize,
    /// Where it was, pixels.
    pub center: Point2<f32>,
    /// The picture round it.
    picture: GrayImage,
    /// Where the picture's corner lay.
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

    /// The patch round the point as the view showed it.
    pub fn patch(&self, radius: i32) -> Option<Patch> {
        Patch::cut(&self.picture, self.center - self.corner, radius)
    }
}

/// A view that is remembered.
pub struct Keyframe {
    pub view: usize,
    pub looks: AffineViews,
    pub sights: Vec<PointAppearance>,
    /// Points that it showed; not all of them have a sight.
    pub num_points: usize,
}

impl Keyframe {
    /// * `points` – tracks and where they are, pixels; `radius` – half the side of a point's picture, pixels.
    pub fn new(
        view: usize,
        looks: AffineViews,
        gray: &GrayImage,
        points: &[(usize, Point2<f32>)],
        radius: u32,
    ) -> Self {
        let step = points.len().div_ceil(MAX_PATCHES).max(1);
        let seen = points.iter().step_by(step);
        let sights = seen.filter_map(|(track, center)| PointAppearance::new(gray, *track, *center, radius)).collect();
        Self { view, looks, sights, num_points: points.len() }
    }
}
