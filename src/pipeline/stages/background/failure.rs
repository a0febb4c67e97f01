//! Image properties that explain why no background, or none with points, was reconstructed.

use std::collections::BTreeSet;

use crate::features::FeatureError;
use crate::image::{GrayImage, gray_from_rgb};
use crate::math::upper_median;
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::features::masking::Masking;
use crate::pipeline::{Instances, Result};

/// Number of examined frames, evenly distributed over the input.
const NUM_EXAMINED: usize = 5;
/// Mean gray level below which an image is dark: night streets under lamps have 40 to 60.
const DARK: f64 = 40.0;
/// Masked share of an image above which given masks are probably inverted: vehicles together do not cover as much, but
/// their surroundings do.
const MOSTLY_MASKED: f64 = 0.6;

/// Reasons to add to the failure of a background: dark images, masks that cover nearly the whole image. Empty if the
/// images explain nothing.
///
/// # Errors
/// Those of decoding the input again.
pub(in crate::pipeline) fn reasons(run: &Run) -> Result<String> {
    let frames = run.frames()?;
    let examined = (0..NUM_EXAMINED).filter_map(|k| frames.get(frames.len() * (2 * k + 1) / (2 * NUM_EXAMINED)));
    let ids: BTreeSet<_> = examined.map(|frame| frame.id).collect();
    let masking = Masking::new(run)?;
    let (mut levels, mut shares) = (Vec::new(), Vec::new());
    for (frame, image) in run.source.frames_at(ids)?.flatten() {
        let gray = gray_from_rgb(&image).map_err(FeatureError::from)?;
        let background = masking.background(&frame, image.dimensions())?;
        let num_pixels = f64::from(image.width()) * f64::from(image.height());
        shares.push(1.0 - background.area_px2() as f64 / num_pixels.max(1.0));
        levels.push(mean(&gray));
    }
    Ok(in_words(levels, shares, matches!(run.options.instances, Instances::Masks(_))))
}

/// * `levels`, `shares` – mean gray level and masked share of each image.
fn in_words(levels: Vec<f64>, shares: Vec<f64>, has_given_masks: bool) -> String {
    let (Some(mean), Some(masked)) = (upper_median(levels), upper_median(shares)) else { return String::new() };
    let mut words = String::new();
    if mean < DARK {
        words += &format!(
            "; the images are dark (mean gray level {mean:.0} of 255): record with more light, or denoise and \
             brighten them (`ffmpeg -i FILE -vf hqdn3d,eq=gamma=2 OUT`)"
        );
    }
    if has_given_masks && masked > MOSTLY_MASKED {
        words += &format!(
            "; the masks of --masks cover {:.0} % of the images: if 0 marks the vehicles in them, invert them (here 0 \
             is background)",
            100.0 * masked
        );
    }
    words
}

fn mean(gray: &GrayImage) -> f64 {
    gray.as_raw().iter().map(|&value| f64::from(value)).sum::<f64>() / gray.as_raw().len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dark_images_and_inverted_masks_are_named() {
        let said = |level, share, given| in_words(vec![level; 3], vec![share; 3], given);
        assert_eq!(said(100.0, 0.1, true), "");
        assert!(said(14.0, 0.1, false).contains("dark (mean gray level 14 of 255)"));
        assert!(said(100.0, 0.98, true).contains("cover 98 %"));
        assert_eq!(said(100.0, 0.98, false), "");
        assert_eq!(in_words(vec![], vec![], true), "");
    }
}
