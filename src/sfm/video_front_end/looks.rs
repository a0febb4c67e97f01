//! SIFT features of a view, as it is and as it would look from further aside.
//!
//! A descriptor bears turns of the view up to about thirty degrees. A vehicle that was hidden for a second in a bend
//! has turned more, about the vertical mostly, so that the picture is narrower or wider than before. Squeezed pictures
//! stand for that (J.-M. Morel, G. Yu, *ASIFT*, SIAM Journal on Imaging Sciences 2009, with one tilt).

use nalgebra::{Matrix2, Point2, Vector2};

use super::SfmError;
use crate::image::{GrayImage, resize_gray};
use crate::scene::Mask;
use crate::sfm::features::{FeatureOptions, Features, extract_gray};

/// Width of a squeezed picture, as a share.
const SQUEEZE: f64 = 0.6;

/// Features of a picture of some width and height, as shares of the view's.
pub struct Look {
    /// Positions in pixels of the view.
    pub features: Features,
    share: Vector2<f64>,
}

impl Look {
    /// From the feature's own axes to the view's: how it is turned and how large it is.
    pub fn frame(&self, feature: usize) -> Matrix2<f32> {
        let shape = self.features.shapes[feature];
        let (sin, cos) = shape.angle.sin_cos();
        let share = self.share.cast::<f32>();
        Matrix2::from_diagonal(&share.map(|s| 1.0 / s)) * Matrix2::new(cos, -sin, sin, cos) * shape.scale
    }
}

/// What a view looks like.
pub struct Looks {
    pub plain: Look,
    pub squeezed: Option<Look>,
}

impl Looks {
    /// Features inside a mask. They only lead to where points are looked for, so that large views are made smaller.
    ///
    /// # Errors
    /// [`SfmError::OpenCv`].
    pub fn new(gray: &GrayImage, mask: &Mask) -> Result<Self, SfmError> {
        const LARGEST_PX: u32 = 640;
        let side = mask.bounding_box().map_or(0, |window| window.width().max(window.height()));
        let share = 1.0 / f64::from(side.div_ceil(LARGEST_PX).max(1));
        let is_small = 2 * side <= LARGEST_PX;
        Ok(Self { plain: look(gray, mask, Vector2::new(share, share), is_small)?, squeezed: None })
    }

    /// Adds the squeezed picture.
    ///
    /// # Errors
    /// [`SfmError::OpenCv`].
    pub fn squeeze(&mut self, gray: &GrayImage, mask: &Mask) -> Result<(), SfmError> {
        let share = self.plain.share.component_mul(&Vector2::new(SQUEEZE, 1.0));
        self.squeezed = Some(look(gray, mask, share, true)?);
        Ok(())
    }

    /// Which looks are compared with which.
    pub fn pairs_with<'a>(&'a self, other: &'a Self) -> Vec<(&'a Look, &'a Look)> {
        let narrower = self.squeezed.iter().map(|squeezed| (squeezed, &other.plain));
        let wider = other.squeezed.iter().map(|squeezed| (&self.plain, squeezed));
        std::iter::once((&self.plain, &other.plain)).chain(narrower).chain(wider).collect()
    }
}

fn look(gray: &GrayImage, mask: &Mask, share: Vector2<f64>, doubled: bool) -> Result<Look, SfmError> {
    const MAX_FEATURES: usize = 1500;
    const BORDER_PX: u32 = 1;
    const ENLARGE_BELOW_PX: u32 = 200;
    let options = FeatureOptions {
        max_features: MAX_FEATURES,
        border_px: BORDER_PX,
        enlarge_below_px: ENLARGE_BELOW_PX,
        doubled,
        ..FeatureOptions::object()
    };
    if share == Vector2::new(1.0, 1.0) {
        return Ok(Look { features: extract_gray(gray, mask, &options)?, share });
    }
    let side = |full: u32, share: f64| ((f64::from(full) * share) as u32).max(1);
    let (width, height) = (side(gray.width(), share.x), side(gray.height(), share.y));
    let small = resize_gray(gray, width, height)?;
    let share = Vector2::new(f64::from(width) / f64::from(gray.width()), f64::from(height) / f64::from(gray.height()));
    let in_view = |x: u32, y: u32| ((f64::from(x) + 0.5) / share.x, (f64::from(y) + 0.5) / share.y);
    let small_mask = Mask::from_fn(width, height, |x, y| {
        let (x, y) = in_view(x, y);
        mask.contains(x, y)
    });
    let mut features = extract_gray(&small, &small_mask, &options)?;
    features.pixels.iter_mut().for_each(|p| *p = Point2::from(p.coords.component_div(&share)));
    Ok(Look { features, share })
}
