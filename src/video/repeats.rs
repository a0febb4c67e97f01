//! Frames that repeat their predecessor.
//!
//! A video of 10 frames per second in a file of 30 contains each of them three times. Encoders do not copy exactly, and
//! a stationary camera gives equal frames, too. Therefore a frame counts as repeated if its difference from its
//! predecessor is small in the whole image, compared with differences both before and after it that affect most of the
//! image. During a longer halt the neighboring differences are as small; with a stationary camera they are local.

use std::ops::Range;

use crate::ffi::ffmpeg::Luma;
use crate::math::quantile;

/// Step between compared rows: every fourth row gives the mean difference of a frame to a few percent.
pub(super) const ROW_STEP: usize = 4;
/// Number of frames on each side among which there must be a change.
///
/// Each frame of a video of 10 frames per second is shown 6 times in a file of 60.
const REACH: usize = 6;
/// Maximum difference of a repeated frame, as a share of the change near it.
///
/// Repeats coded by six encoders had 0.0005 to 0.1, their keyframes up to 0.27; the 970 frames of five real videos had
/// none below 0.33.
const MAX_SHARE: f64 = 0.25;
/// Side of a block, pixels: a macroblock of most encoders.
const BLOCK: usize = 16;
/// Share of the blocks that a local change does not affect; the quantile of [`Change::typical`].
const TYPICAL: f64 = 0.75;
/// Minimum change of most of the image that indicates a moving camera, gray levels.
///
/// Repeats and keyframes of five encoders had up to 1.1 on average.
const MIN_MOTION: f64 = 2.0;
/// Upper limit of the change of a block in a repeated frame, gray levels.
///
/// 99 % of the repeats of five encoders had less, down to 300 kbit/s, and moving objects of ordinary contrast have
/// more.
const MAX_LOCAL: f64 = 16.0;

/// Difference of two frames, gray levels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Change {
    /// Upper quartile over the blocks.
    pub(super) typical: f64,
    /// Maximum over the blocks.
    pub(super) local: f64,
}

/// Compares two frames; `None` for frames of different sizes.
pub(super) fn change(from: &Luma, to: &Luma) -> Option<Change> {
    let count = to.samples.len();
    if (from.width, from.samples.len()) != (to.width, count) || count == 0 {
        return None;
    }
    let rows = BLOCK / ROW_STEP * to.width;
    let mut blocks = Vec::new();
    for (from, to_rows) in from.samples.chunks(rows).zip(to.samples.chunks(rows)) {
        let mut sums = vec![[0_u32; 2]; to.width.div_ceil(BLOCK)];
        for (from, to) in from.chunks(to.width).zip(to_rows.chunks(to.width)) {
            for ([sum, count], (a, b)) in sums.iter_mut().zip(from.chunks(BLOCK).zip(to.chunks(BLOCK))) {
                *sum += a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>();
                *count += b.len() as u32;
            }
        }
        blocks.extend(sums.into_iter().map(|[sum, count]| f64::from(sum) / f64::from(count.max(1))));
    }
    let local = blocks.iter().copied().fold(0.0, f64::max);
    Some(Change { typical: quantile(&mut blocks, TYPICAL)?, local })
}

/// Marks the frames that repeat their predecessor.
///
/// * `changes` – difference of each frame from its predecessor; `None` if it has none or they cannot be compared.
pub(super) fn repeated(changes: &[Option<Change>]) -> Vec<bool> {
    let is_repeated = |k: usize| {
        let change = changes[k]?;
        let typical = change_near(changes, k, |change| change.typical);
        let local = change_near(changes, k, |change| change.local);
        let is_small = change.typical < MAX_SHARE * typical && change.local < MAX_LOCAL.min(MAX_SHARE * local);
        Some(typical >= MIN_MOTION && is_small)
    };
    (0..changes.len()).map(|k| is_repeated(k).unwrap_or(false)).collect()
}

/// Largest change near a frame: the smaller of those before and after it.
fn change_near(changes: &[Option<Change>], k: usize, of: impl Fn(&Change) -> f64) -> f64 {
    let largest = |range: Range<usize>| changes[range].iter().flatten().map(&of).fold(0.0, f64::max);
    let (from, to) = (k.saturating_sub(REACH), (k + 1 + REACH).min(changes.len()));
    // The first frame has no change and the last ones have no successors: one side has to suffice.
    let before = (k > REACH).then(|| largest(from..k));
    let after = (k + REACH < changes.len()).then(|| largest(k + 1..to));
    match (before, after) {
        (Some(before), Some(after)) => before.min(after),
        (Some(one), None) | (None, Some(one)) => one,
        (None, None) => largest(1..k).max(largest(k + 1..to)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(changes: &[f64]) -> Vec<usize> {
        let whole = |c: &f64| Some(Change { typical: *c, local: 4.0 * c });
        let changes: Vec<Option<Change>> = std::iter::once(None).chain(changes.iter().map(whole)).collect();
        let repeated = repeated(&changes);
        (0..repeated.len()).filter(|&k| repeated[k]).collect()
    }

    #[test]
    fn repeats_are_distinguished_from_motion_and_halts() {
        let thrice: Vec<f64> = (1..30).map(|k| if k % 3 == 0 { 17.0 } else { 0.2 }).collect();
        assert_eq!(found(&thrice), (0..30).filter(|k| k % 3 != 0).collect::<Vec<_>>());
        let sixth: Vec<f64> = (1..40).map(|k| if k % 6 == 5 { 0.5 } else { 9.0 }).collect();
        assert_eq!(found(&sixth), [5, 11, 17, 23, 29, 35]);
        // 10 frames per second in a file of 60.
        let six_times: Vec<f64> = (1..60).map(|k| if k % 6 == 0 { 5.0 } else { 0.1 }).collect();
        assert_eq!(found(&six_times).len(), 50);
        assert_eq!(found(&[3.0, 5.0, 2.0, 4.0, 6.0, 3.0, 2.5, 4.0, 5.0, 3.0, 2.0, 4.0, 5.0, 6.0]), [0; 0], "motion");
        // A halt of a second: the camera slows down, stops, and starts again.
        let halt: Vec<f64> = [9.0; 20]
            .into_iter()
            .chain([6.0, 4.0, 2.0, 1.0])
            .chain([0.4; 30])
            .chain([1.0, 2.0, 4.0, 6.0])
            .chain([9.0; 20])
            .collect();
        assert_eq!(found(&halt), [0; 0], "halt");
        assert_eq!(found(&[0.0; 30]), [0; 0], "one image all along");
        assert_eq!(found(&[0.0; 5]), [0; 0], "a short one");
        assert_eq!(found(&[8.0, 0.0, 7.0]), [2]);
        assert_eq!(found(&[]), [0; 0]);
    }

    #[test]
    fn still_frames_between_local_changes_are_not_repeated() {
        let still = Some(Change { typical: 0.2, local: 3.0 });
        let jump = Some(Change { typical: 0.2, local: 90.0 });
        let flash = Some(Change { typical: 50.0, local: 60.0 });
        let object = Some(Change { typical: 0.2, local: 18.0 });
        for (sudden, other) in [(jump, still), (flash, object)] {
            let changes: Vec<_> = (0..40).map(|k| if k % 5 == 0 { sudden } else { other }).collect();
            assert!(!repeated(&changes).contains(&true), "{other:?}");
        }
    }

    #[test]
    fn change_is_that_of_most_blocks_and_of_one() {
        let luma = |value: u8| Luma { width: 4, samples: vec![value; 12] };
        assert_eq!(change(&luma(10), &luma(13)), Some(Change { typical: 3.0, local: 3.0 }));
        let (mut one, other) =
            (Luma { width: 80, samples: vec![9; 80 * 20] }, Luma { width: 80, samples: vec![8; 80 * 20] });
        (0..4).for_each(|row| one.samples[row * 80 + 32..row * 80 + 48].fill(108));
        assert_eq!(change(&one, &other), Some(Change { typical: 1.0, local: 100.0 }));
        assert_eq!(change(&luma(10), &Luma { width: 3, samples: vec![0; 12] }), None);
        assert_eq!(change(&Luma::default(), &Luma::default()), None);
    }
}
