//! Non-square pixels.
//!
//! DV, HDV, DVD and many analogue recorders store fewer columns than are displayed: `SAR` is the width of a pixel over
//! its height. Cameras are modeled with square pixels, and users draw masks on the image that players display. Frames
//! therefore get their display size.

use crate::scene::{Topic, Warning};

/// Largest plausible `SAR`, or its inverse.
///
/// Anamorphic lenses and half-width 3D have 2; damaged headers have arbitrary values.
const MAX_ASPECT: f64 = 4.0;

/// Size of a frame with square pixels.
///
/// The side along which pixels are longer grows, which loses no detail. It becomes even, as video encoders need it. The
/// size does not change if it would grow by less than a pixel, or if the aspect is implausible.
///
/// * `aspect` – width of a pixel over its height, as a fraction; `None` is square.
pub(super) fn squared((width, height): (u32, u32), aspect: Option<(u32, u32)>) -> (u32, u32) {
    let aspect = aspect.map_or(1.0, |(num, den)| f64::from(num) / f64::from(den));
    if !(1.0 / MAX_ASPECT..=MAX_ASPECT).contains(&aspect) {
        return (width, height);
    }
    (longer(width, aspect), longer(height, 1.0 / aspect))
}

fn longer(side: u32, factor: f64) -> u32 {
    let exact = f64::from(side) * factor;
    if exact - f64::from(side) < 1.0 { side } else { 2 * (exact / 2.0).round() as u32 }
}

/// Warning about frames whose display size is not the stored size.
///
/// * `stored`, `shown` – sizes, upright.
pub(super) fn remark(stored: (u32, u32), shown: (u32, u32)) -> Option<Warning> {
    (stored != shown).then(|| {
        Topic::NonSquarePixels.warning(format!(
            "non-square pixels: frames of {}x{} pixels are stretched to {}x{}, as players show them; --intrinsics and \
             all results refer to that size",
            stored.0, stored.1, shown.0, shown.1
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_side_of_longer_pixels_grows() {
        let cases = [
            ((720, 576), (64, 45), (1024, 576)),
            ((1440, 1080), (4, 3), (1920, 1080)),
            ((704, 480), (40, 33), (854, 480)),
            ((720, 480), (8, 9), (720, 540)),
            ((1920, 1080), (1, 1), (1920, 1080)),
            // Rounded by the writer of the file: 16:9 of 854x480.
            ((854, 480), (1280, 1281), (854, 480)),
            ((640, 480), (1, 65535), (640, 480)),
            ((641, 481), (1, 1), (641, 481)),
        ];
        for (stored, aspect, shown) in cases {
            assert_eq!(squared(stored, Some(aspect)), shown, "{stored:?} {aspect:?}");
        }
        assert_eq!(squared((641, 481), None), (641, 481));
        assert_eq!(remark((640, 480), (640, 480)), None);
    }
}
