//! Appearance of an object: a histogram of its colors.

use ::image::RgbImage;

use super::region::Region;

/// Number of bins of hue, saturation and value.
const BINS: [usize; 3] = [8, 3, 4];
/// Number of bins of a histogram.
const NUM_BINS: usize = BINS[0] * BINS[1] * BINS[2];
/// Minimum number of pixels of a histogram.
const MIN_PIXELS: usize = 25;

/// Color histogram with sum 1.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Appearance {
    shares: [f32; NUM_BINS],
}

impl Appearance {
    /// Histogram of a region; `None` if it is too small.
    pub(super) fn of(image: &RgbImage, region: &Region) -> Option<Self> {
        if region.area() < MIN_PIXELS {
            return None;
        }
        let mut shares = [0.0; NUM_BINS];
        for (x, y) in region.iter() {
            shares[bin(image.get_pixel(x, y).0)] += 1.0 / region.area() as f32;
        }
        Some(Self { shares })
    }

    /// Bhattacharyya coefficient: 1 for equal histograms, 0 for disjoint ones.
    pub(super) fn similarity(&self, other: &Self) -> f64 {
        self.shares.iter().zip(&other.shares).map(|(&a, &b)| f64::from((a * b).sqrt())).sum()
    }

    /// Blends in a newer histogram with weight `share`.
    pub(super) fn blend(&mut self, newer: &Self, share: f32) {
        for (old, &new) in self.shares.iter_mut().zip(&newer.shares) {
            *old += share * (new - *old);
        }
    }
}

/// Bin of a color. Gray has no hue: below a saturation of one fifth all hues share a bin.
fn bin([r, g, b]: [u8; 3]) -> usize {
    let (r, g, b) = (f32::from(r), f32::from(g), f32::from(b));
    let (max, min) = (r.max(g).max(b), r.min(g).min(b));
    let (chroma, value) = (max - min, (max / 256.0 * BINS[2] as f32) as usize);
    let saturation = if max > 0.0 { chroma / max } else { 0.0 };
    if saturation < 0.2 || max < 32.0 {
        return value;
    }
    let hue = if max == r {
        ((g - b) / chroma).rem_euclid(6.0)
    } else if max == g {
        (b - r) / chroma + 2.0
    } else {
        (r - g) / chroma + 4.0
    };
    let hue = ((hue / 6.0 * BINS[0] as f32) as usize).min(BINS[0] - 1);
    let saturation = if saturation < 0.55 { 1 } else { 2 };
    (hue * BINS[1] + saturation) * BINS[2] + value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mask;

    fn painted(color: [u8; 3]) -> Appearance {
        let image = RgbImage::from_pixel(8, 8, ::image::Rgb(color));
        let region = Region::from_mask(&Mask::from_fn(8, 8, |_, _| true)).unwrap();
        Appearance::of(&image, &region).unwrap()
    }

    #[test]
    fn different_colors_are_separated_and_shades_of_one_are_not() {
        let red = painted([200, 20, 20]);
        assert!(red.similarity(&painted([205, 25, 18])) > 0.99);
        assert!(red.similarity(&painted([20, 20, 200])) < 0.01);
        assert!(painted([128, 128, 128]).similarity(&painted([10, 10, 10])) < 0.01);
    }

    #[test]
    fn every_color_has_a_bin() {
        for r in (0..=255).step_by(15) {
            for g in (0..=255).step_by(15) {
                for b in (0..=255).step_by(15) {
                    assert!(bin([r as u8, g as u8, b as u8]) < NUM_BINS);
                }
            }
        }
    }

    #[test]
    fn blending_interpolates() {
        let mut appearance = painted([200, 20, 20]);
        let blue = painted([20, 20, 200]);
        appearance.blend(&blue, 0.25);
        assert!((appearance.similarity(&blue) - 0.5).abs() < 1e-6);
        assert!((appearance.shares.iter().sum::<f32>() - 1.0).abs() < 1e-5);
    }
}
