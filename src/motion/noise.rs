//! Noise of point tracking, measured from the image's own points (eq. 5 of `docs/maths/motion.md`).

use std::collections::BTreeMap;

use crate::math::{bin, upper_median};

/// Properties that the noise of a track depends on: its time, its length, and its position.
#[derive(Clone, Copy, Debug)]
pub(super) struct Circumstances {
    /// The middle of its life, seconds.
    pub time_s: f64,
    /// Frames of its life.
    pub num_frames: usize,
    /// Its place in the reference frame, as parts of width and height.
    pub place: [f64; 2],
}

/// Typical residuals by time and length, and by how much they are larger in a part of the picture.
#[derive(Default)]
pub(super) struct Noise {
    typical: BTreeMap<(i64, u32), f64>,
    of_length: BTreeMap<u32, f64>,
    of_place: BTreeMap<(i64, usize), f64>,
}

/// Smallest noise of a followed point, pixels.
const MIN_NOISE_PX: f64 = 0.1;
/// Fewest tracks that say something of the noise.
const MIN_SAMPLES: usize = 30;
/// Parts of the picture along its width and its height.
const PLACES: [usize; 2] = [4, 3];
/// A part of the picture may be filled by one vehicle: its residuals count as noise up to this factor.
const MAX_PLACE_FACTOR: f64 = 2.5;

impl Noise {
    /// From the residuals of all tracks, most of which stand still.
    pub fn measure(samples: &[(Circumstances, f64)]) -> Self {
        let of_length = medians(samples.iter().map(|(c, rms)| (length_class(c), *rms)), 1);
        let mut noise = Self { of_length, ..Self::default() };
        let nearby = samples.iter().flat_map(|(c, rms)| around(c).map(move |bin| ((bin, length_class(c)), *rms)));
        noise.typical = medians(nearby, MIN_SAMPLES);
        let relative = samples.iter().map(|(c, rms)| (c, rms / noise.usual(c)));
        let relative = relative.flat_map(|(c, ratio)| around(c).map(move |bin| ((bin, place(c)), ratio)));
        noise.of_place = medians(relative, MIN_SAMPLES);
        noise
    }

    /// Standard deviation of a followed point, pixels.
    pub fn of(&self, circumstances: &Circumstances) -> f64 {
        let factor = self.of_place.get(&(second(circumstances), place(circumstances))).copied().unwrap_or(1.0);
        self.usual(circumstances) * factor.clamp(1.0, MAX_PLACE_FACTOR)
    }

    fn usual(&self, circumstances: &Circumstances) -> f64 {
        let class = length_class(circumstances);
        let measured = self.typical.get(&(second(circumstances), class)).or_else(|| self.of_length.get(&class));
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

/// The second in which a track is in the middle of its life.
fn second(c: &Circumstances) -> i64 {
    c.time_s.floor() as i64
}

/// That second and its neighbours, in all of which a track counts.
fn around(c: &Circumstances) -> impl Iterator<Item = i64> + use<> {
    second(c).saturating_sub(1)..=second(c).saturating_add(1)
}

/// Powers of two: points drift, the longer the further.
fn length_class(c: &Circumstances) -> u32 {
    c.num_frames.max(1).ilog2()
}

fn place(c: &Circumstances) -> usize {
    bin(c.place[1], PLACES[1]) * PLACES[0] + bin(c.place[0], PLACES[0])
}
