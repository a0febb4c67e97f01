//! Noise of point tracking, measured from the image's own tracks (eq. 5 of `docs/maths/motion.md`).

use std::collections::BTreeMap;

use crate::math::{bin, upper_median};

/// Properties on which the noise of a track depends: its time, length and position.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrackContext {
    /// Time in the middle of its life, seconds.
    pub time_s: f64,
    /// Length of its life, frames.
    pub num_frames: usize,
    /// Position in the reference frame, as shares of width and height.
    pub position: [f64; 2],
}

/// Median residuals by time and length of a track, with factors by region of the image.
#[derive(Default)]
pub(super) struct Noise {
    by_second: BTreeMap<(i64, u32), f64>,
    by_length: BTreeMap<u32, f64>,
    by_region: BTreeMap<(i64, usize), f64>,
}

/// Minimum noise of a tracked point, pixels.
const MIN_NOISE_PX: f64 = 0.1;
/// Minimum number of tracks for a median.
const MIN_SAMPLES: usize = 30;
/// Number of image regions along width and height.
const REGIONS: [usize; 2] = [4, 3];
/// Maximum factor of a region: one vehicle may fill it, whose residuals are not noise.
const MAX_REGION_FACTOR: f64 = 2.5;

impl Noise {
    /// Measures the noise from the residuals of all tracks, most of which are static.
    pub fn measure(samples: &[(TrackContext, f64)]) -> Self {
        let by_length = medians(samples.iter().map(|(c, rms)| (length_class(c), *rms)), 1);
        let mut noise = Self { by_length, ..Self::default() };
        let nearby =
            samples.iter().flat_map(|(c, rms)| neighboring_seconds(c).map(move |bin| ((bin, length_class(c)), *rms)));
        noise.by_second = medians(nearby, MIN_SAMPLES);
        let relative = samples.iter().map(|(c, rms)| (c, rms / noise.without_region(c)));
        let relative = relative.flat_map(|(c, ratio)| neighboring_seconds(c).map(move |bin| ((bin, region(c)), ratio)));
        noise.by_region = medians(relative, MIN_SAMPLES);
        noise
    }

    /// Standard deviation of a tracked point, pixels.
    pub fn of(&self, context: &TrackContext) -> f64 {
        let factor = self.by_region.get(&(second(context), region(context))).copied().unwrap_or(1.0);
        self.without_region(context) * factor.clamp(1.0, MAX_REGION_FACTOR)
    }

    fn without_region(&self, context: &TrackContext) -> f64 {
        let class = length_class(context);
        let measured = self.by_second.get(&(second(context), class)).or_else(|| self.by_length.get(&class));
        measured.copied().unwrap_or(0.0).max(MIN_NOISE_PX)
    }
}

fn medians<K: Ord>(samples: impl Iterator<Item = (K, f64)>, least: usize) -> BTreeMap<K, f64> {
    let mut lists: BTreeMap<K, Vec<f64>> = BTreeMap::new();
    for (key, value) in samples {
        lists.entry(key).or_default().push(value);
    }
    let enough = lists.into_iter().filter(|(_, list)| list.len() >= least);
    enough.filter_map(|(key, list)| Some((key, upper_median(list)?))).collect()
}

/// Second of the middle of a track's life.
fn second(c: &TrackContext) -> i64 {
    c.time_s.floor() as i64
}

/// This second and its neighbors, in all of which a track is a sample.
fn neighboring_seconds(c: &TrackContext) -> impl Iterator<Item = i64> + use<> {
    second(c).saturating_sub(1)..=second(c).saturating_add(1)
}

/// Power of two of the length: the drift of a point increases with its track's length.
fn length_class(c: &TrackContext) -> u32 {
    c.num_frames.max(1).ilog2()
}

fn region(c: &TrackContext) -> usize {
    bin(c.position[1], REGIONS[1]) * REGIONS[0] + bin(c.position[0], REGIONS[0])
}
