//! Properties of the images that explain why no background, or none with points, was reconstructed.

use std::collections::BTreeSet;

use crate::features::FeatureError;
use crate::image::{GrayImage, gray_from_rgb};
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::features::masking::Masking;
use crate::pipeline::{Instances, PipelineError};

/// Frames that are examined, evenly over the input.
const NUM_EXAMINED: usize = 5;
/// Mean gray level below which an image is dark: night streets under lamps have 40 to 60.
const DARK: f64 = 40.0;
/// Standard deviation of noise, gray levels, from which corners drown in a dark image; a clean recording has 1 to 2.
const NOISY: f64 = 4.0;
/// Share of an image that vehicles do not cover together, but their surroundings do.
const MOSTLY_MASKED: f64 = 0.6;

/// Properties of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Properties {
    /// Mean gray level.
    mean: f64,
    /// Standard deviation of the noise, gray levels.
    noise: f64,
    /// Share that the masks cover.
    masked: f64,
}

/// Reasons to add to the failure of a background: dark and noisy images, masks that cover nearly all. Empty if the
/// images explain nothing.
///
/// # Errors
/// Those of decoding the input again.
pub(in crate::pipeline) fn reasons(run: &Run) -> Result<String, PipelineError> {
    let frames = run.frames()?;
    let examined = (0..NUM_EXAMINED).filter_map(|k| frames.get(frames.len() * (2 * k + 1) / (2 * NUM_EXAMINED)));
    let ids: BTreeSet<_> = examined.map(|frame| frame.id).collect();
    let masking = Masking::new(run)?;
    let mut found = Vec::new();
    for (frame, image) in run.source.frames_at(ids)?.flatten() {
        let gray = gray_from_rgb(&image).map_err(FeatureError::from)?;
        let background = masking.background(&frame, image.dimensions())?;
        let num_pixels = f64::from(image.width()) * f64::from(image.height());
        let masked = 1.0 - background.area_px2() as f64 / num_pixels.max(1.0);
        found.push(Properties { mean: mean(&gray), noise: noise(&gray), masked });
    }
    Ok(in_words(&found, matches!(run.options.instances, Instances::Masks(_))))
}

fn in_words(found: &[Properties], has_given_masks: bool) -> String {
    let median = |of: fn(&Properties) -> f64| {
        let mut values: Vec<f64> = found.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let (Some(mean), Some(noise), Some(masked)) = (median(|p| p.mean), median(|p| p.noise), median(|p| p.masked))
    else {
        return String::new();
    };
    let mut words = String::new();
    if mean < DARK {
        let noisy = if noise > NOISY { format!(" and noisy (standard deviation {noise:.0})") } else { String::new() };
        words += &format!(
            "; the images are dark (mean gray level {mean:.0} of 255){noisy}: record with more light, or denoise and \
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

/// Standard deviation of the noise by the mean absolute response of a second difference in both directions, which edges
/// and slopes hardly excite (Immerkær, Fast Noise Variance Estimation, CVIU 64, 1996).
fn noise(gray: &GrayImage) -> f64 {
    let (width, height) = (gray.width() as usize, gray.height() as usize);
    if width < 3 || height < 3 {
        return 0.0;
    }
    let rows: Vec<&[u8]> = gray.as_raw().chunks_exact(width).collect();
    let second = |row: &[u8], x: usize| i32::from(row[x - 1]) - 2 * i32::from(row[x]) + i32::from(row[x + 1]);
    let mut sum = 0.0;
    for triple in rows.windows(3) {
        for x in 1..width - 1 {
            let response = second(triple[0], x) - 2 * second(triple[1], x) + second(triple[2], x);
            sum += f64::from(response.abs());
        }
    }
    // The weights have a norm of 6, the mean of an absolute normal deviate is sqrt(2/π).
    sum / ((width - 2) * (height - 2)) as f64 / 6.0 * (std::f64::consts::PI / 2.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{RgbImage, noisy};
    use crate::math::seeded_rng;

    #[test]
    fn noise_is_measured_in_gray_levels() {
        let slope = RgbImage::from_fn(120, 90, |x, y| ::image::Rgb([(60 + x / 2 + y / 3) as u8; 3]));
        let gray = |image: &RgbImage| GrayImage::from_fn(120, 90, |x, y| ::image::Luma([image.get_pixel(x, y)[0]]));
        assert!(noise(&gray(&slope)) < 0.7);
        let found = noise(&gray(&noisy(&slope, 8.0, &mut seeded_rng(3, 0))));
        assert!((found - 8.0).abs() < 0.8, "{found}");
        assert_eq!(noise(&GrayImage::new(2, 2)), 0.0);
    }

    #[test]
    fn dark_images_and_inverted_masks_are_named() {
        let all = |mean, noise, masked| [Properties { mean, noise, masked }; 3];
        assert_eq!(in_words(&all(100.0, 9.0, 0.1), true), "");
        assert!(in_words(&all(14.0, 9.0, 0.1), false).contains("dark (mean gray level 14 of 255) and noisy"));
        assert!(!in_words(&all(14.0, 1.0, 0.1), false).contains("noisy"));
        assert!(in_words(&all(100.0, 2.0, 0.98), true).contains("cover 98 %"));
        assert_eq!(in_words(&all(100.0, 2.0, 0.98), false), "");
        assert_eq!(in_words(&[], true), "");
    }
}
