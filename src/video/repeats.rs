//! Frames that repeat the one before.
//!
//! A video of 10 frames per second in a file of 30 contains each of them three times. Encoders do not copy exactly, and
//! a stationary camera gives equal frames, too. Therefore a frame is repeated if its difference from its predecessor is
//! small compared with differences both before and after it. In a longer halt the neighboring differences are as small.

use std::ops::Range;

use crate::ffi::ffmpeg::Luma;

/// Rows that are compared: every fourth, which gives the mean difference of a frame to a few percent.
pub(super) const ROW_STEP: usize = 4;
/// Frames on each side among which there must be a change: 10 frames per second in a file of 60 are shown 6 times.
const REACH: usize = 6;
/// A repeated frame differs by less than this share of the change near it. Repeats coded by six encoders had 0.0005 to
/// 0.1, their key frames up to 0.27; the 970 frames of five real videos had none below 0.33.
const MAX_SHARE: f64 = 0.25;

/// Mean difference of two frames, gray levels; `None` if they cannot be compared.
pub(super) fn change(from: &Luma, to: &Luma) -> Option<f64> {
    let count = to.samples.len();
    if (from.width, from.samples.len()) != (to.width, count) || count == 0 {
        return None;
    }
    let rows = from.rows().zip(to.rows());
    let sum: u64 =
        rows.map(|(a, b)| u64::from(a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>())).sum();
    Some(sum as f64 / count as f64)
}

/// Which frames repeat the one before.
///
/// * `changes` – of each frame its difference from the one before; `None` where there is none, or no telling.
pub(super) fn repeated(changes: &[Option<f64>]) -> Vec<bool> {
    let largest = |range: Range<usize>| changes[range].iter().flatten().copied().fold(0.0, f64::max);
    let is_repeated = |k: usize| {
        let change = changes[k]?;
        let (from, to) = (k.saturating_sub(REACH), (k + 1 + REACH).min(changes.len()));
        // The first frame has no change and the last ones have no successors: one side has to do.
        let before = (k > REACH).then(|| largest(from..k));
        let after = (k + REACH < changes.len()).then(|| largest(k + 1..to));
        let beside = match (before, after) {
            (Some(before), Some(after)) => before.min(after),
            (Some(one), None) | (None, Some(one)) => one,
            (None, None) => largest(1..k).max(largest(k + 1..to)),
        };
        Some(change < MAX_SHARE * beside)
    };
    (0..changes.len()).map(|k| is_repeated(k).unwrap_or(false)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(changes: &[f64]) -> Vec<usize> {
        let changes: Vec<Option<f64>> = std::iter::once(None).chain(changes.iter().copied().map(Some)).collect();
        let repeated = repeated(&changes);
        (0..repeated.len()).filter(|&k| repeated[k]).collect()
    }

    #[test]
    fn repeats_are_told_from_motion_and_from_halts() {
        let thrice: Vec<f64> = (1..30).map(|k| if k % 3 == 0 { 17.0 } else { 0.2 }).collect();
        assert_eq!(found(&thrice), (0..30).filter(|k| k % 3 != 0).collect::<Vec<_>>());
        let sixth: Vec<f64> = (1..40).map(|k| if k % 6 == 5 { 0.5 } else { 9.0 }).collect();
        assert_eq!(found(&sixth), [5, 11, 17, 23, 29, 35]);
        // Ten in sixty.
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
    fn change_is_the_mean_difference() {
        let luma = |value: u8| Luma { width: 4, samples: vec![value; 12] };
        assert_eq!(change(&luma(10), &luma(13)), Some(3.0));
        assert_eq!(change(&luma(10), &Luma { width: 3, samples: vec![0; 12] }), None);
        assert_eq!(change(&Luma::default(), &Luma::default()), None);
    }
}
