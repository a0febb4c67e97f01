//! Structure from motion of a row of pictures in one call.

use super::{Options, SfmError};
use crate::camera::Camera;
use crate::features::FrontEnd;
use crate::image::{Picture, RgbImage};
use crate::mapper::{Intrinsics, Report, cut_long_tracks, reconstruct};
use crate::scene::{Frame, Mask, Reconstruction};

/// Reconstructs what one camera took: tracks of image points, then cameras and points that explain them.
///
/// * `pictures` – frames in order of time, or photographs in any order ([`Options::unordered`]), each with a mask of
///   its size outside of which nothing is looked at; `None` is the whole picture.
/// * `camera` – intrinsics of all pictures; [`Camera::prior`], or [`Camera::prior_of_photograph`], where they are not
///   known.
///
/// Returns the model in a unit of its own, frame k as image k + 1, and what became of every picture. Pictures that do
/// not fit are left out of the model, and the report says why.
///
/// # Errors
/// [`SfmError::Failed`] where nothing could be reconstructed, [`SfmError::Features`], [`SfmError::Mapper`].
pub fn reconstruct_pictures(
    pictures: impl IntoIterator<Item = (Frame, RgbImage, Option<Mask>)>,
    camera: Camera,
    intrinsics: Intrinsics,
    options: &Options,
    seed: u64,
) -> Result<(Reconstruction, Report), SfmError> {
    let mut front_end = FrontEnd::new(&options.front_end, camera);
    for (frame, picture, mask) in pictures {
        let mask = mask.unwrap_or_else(|| Mask::full(picture.width(), picture.height()));
        front_end.push(&frame, &Picture::new(&picture), &mask)?;
    }
    let mut tracks = front_end.finish(seed)?;
    cut_long_tracks(&mut tracks, &[camera], intrinsics, &options.mapper, seed);
    let (model, report) = reconstruct(&tracks, &[camera], intrinsics, &options.mapper, seed)?;
    match report.failure {
        Some(reason) => Err(SfmError::Failed { reason }),
        None if model.is_empty() => Err(SfmError::Failed { reason: "no image is registered".to_owned() }),
        None => Ok((model, report)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::GrayImage;
    use crate::math::seeded_rng;
    use crate::scene::FrameId;
    use rand::Rng as _;

    fn frame(index: u32) -> Frame {
        Frame { id: FrameId(index), name: format!("{index:06}.jpg"), time_s: f64::from(index) }
    }

    /// A wall of random squares at two depths, of which the nearer half moves twice as fast.
    fn wall(index: u32) -> RgbImage {
        let mut rng = seeded_rng(3, 0);
        let blocks = GrayImage::from_fn(80, 60, |_, _| image::Luma([rng.random_range(20..235)]));
        RgbImage::from_fn(320, 240, |x, y| {
            let shift = if y < 120 { 2 * index } else { 4 * index };
            image::Rgb([blocks.get_pixel((x + shift) / 6 % 80, y / 6).0[0]; 3])
        })
    }

    #[test]
    fn pictures_that_show_nothing_are_an_error_with_a_reason() {
        let black = (0..4).map(|index| (frame(index), RgbImage::new(320, 240), None));
        let found = reconstruct_pictures(black, Camera::prior(320, 240), Intrinsics::FIXED, &Options::background(), 0);
        let said = found.unwrap_err().to_string();
        assert!(said.starts_with("nothing reconstructed: "), "{said}");
    }

    #[test]
    fn a_mask_of_another_size_is_refused_by_the_pictures_name() {
        let pictures = [(frame(7), wall(0), Some(Mask::full(10, 10)))];
        let found =
            reconstruct_pictures(pictures, Camera::prior(320, 240), Intrinsics::FIXED, &Options::background(), 0);
        assert!(found.unwrap_err().to_string().contains("000007.jpg"));
    }

    #[test]
    fn whole_pictures_and_full_masks_are_the_same() {
        let reconstruct = |mask: Option<Mask>| {
            let pictures = (0..12).map(|index| (frame(index), wall(index), mask.clone()));
            let camera = Camera::with_focal(320, 240, 300.0);
            reconstruct_pictures(pictures, camera, Intrinsics::FIXED, &Options::background(), 0).unwrap()
        };
        let (model, report) = reconstruct(None);
        assert!(report.num_registered() >= 10 && model.points.len() > 100, "{report:?}");
        assert_eq!(reconstruct(Some(Mask::full(320, 240))).0, model);
    }
}
