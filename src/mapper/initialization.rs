//! Which pair a map starts from, and which of several maps is taken.

use super::incremental_mapper::{self, IncrementalMapper, PosePriors};
use super::initial_pair::{self, InitialPair};
use super::map::Map;
use super::motion::Survey;
use super::{KnownIntrinsics, Options, Priors};
use crate::camera::Camera;
use crate::features::tracks::TrackTable;
use crate::mapper::MapperError;

/// Input of an initialization attempt.
#[derive(Clone, Copy)]
pub struct InitializationAttempt<'a> {
    pub table: &'a TrackTable,
    /// Indexed by [`crate::features::tracks::View::camera`].
    pub cameras: &'a [Camera],
    pub known: &'a KnownIntrinsics,
    pub options: &'a Options,
    pub beside: Priors<'a>,
}

/// Outcomes of the initial pairs.
pub struct Initializations<'a> {
    /// The map that explains the tracks best.
    pub best: Option<IncrementalMapper<'a>>,
    pub pairs: Vec<InitialPair>,
    pub tried: usize,
    pub survey: Survey,
}

/// Share of the views that a good map has.
const GOOD_SHARE: f64 = 0.95;

/// Share of the observations that a map explains with right tracks: maps of rendered vehicles explain this and more,
/// one that was bent by wheels of which the wrong ones were joined 0.2.
const HEALTHY_SHARE: f64 = 0.93;

/// Share of the observations below which a map of tracks without gaps is doubted: one that turned over where half of
/// the vehicle was hidden explains 0.73, those of two large cars in real footage 0.85 and 0.93.
const PLAUSIBLE_SHARE: f64 = 0.8;

/// Two starts whose worths differ by no more than this share of them gave the same map: bent ones are each bent in
/// another way.
const SAME_WORTH: f64 = 0.003;

/// Rounds of starts that are made at most.
const MAX_ROUNDS: u64 = 4;

/// Between the seeds of two rounds: far from those that people give.
const ROUND_STRIDE: u64 = 0x9E37_79B9_7F4A_7C15;

impl<'a> InitializationAttempt<'a> {
    /// Grows a map from one pair after the other, until one is good.
    pub fn grow_from_starts(&self, seed: u64, watch: &mut dyn FnMut(f64)) -> Result<Initializations<'a>, MapperError> {
        let mut best = self.grow_from_known_poses(seed)?;
        if let Some((_, growth)) = best.take_if(|(_, growth)| self.needs_no_other(growth)) {
            return Ok(Initializations { best: Some(growth), pairs: Vec::new(), tried: 1, survey: Survey::default() });
        }
        self.grow_from_pairs(best, seed, watch)
    }

    /// Grows a map from one pair after the other, until one is good, and takes the best of them and of one that is
    /// there.
    fn grow_from_pairs(
        &self,
        mut best: Option<(f64, IncrementalMapper<'a>)>,
        seed: u64,
        watch: &mut dyn FnMut(f64),
    ) -> Result<Initializations<'a>, MapperError> {
        // Of a start, growing takes about so much, the last adjustments the rest.
        const GROWTH_SHARE: f64 = 0.7;
        let Self { table, cameras, known, options, .. } = *self;
        let usable = self.num_usable();
        let (pairs, survey) = initial_pair::ranked(table, cameras, known, options, seed);
        let mut num_starts = 0;
        let mut worths: Vec<f64> = best.iter().map(|(score, _)| *score).collect();
        let apart = initial_pair::far_from_one_another(pairs.clone(), table.views.len());
        for pair in apart.iter().take(options.max_starts) {
            let all_starts = options.min_starts.max(num_starts + 1) as f64;
            let before = num_starts as f64;
            num_starts += 1;
            let mut growth = IncrementalMapper::new(Map::new(table, cameras).knowing(known.clone()), options, seed);
            if growth.start(pair)? {
                let mut grown = |num_registered: usize| {
                    let share = num_registered as f64 / usable.max(1) as f64;
                    watch((before + GROWTH_SHARE * share) / all_starts);
                };
                growth.grow(&mut grown)?;
                growth.finish()?;
                let score = self.score(&growth);
                tracing::debug!("attempt {num_starts}: {} views, score {score:.0}", growth.num_registered());
                worths.push(score);
                if best.as_ref().is_none_or(|(b, _)| score > *b) {
                    best = Some((score, growth));
                }
            }
            watch((before + 1.0) / all_starts);
            let has_most = |growth: &IncrementalMapper| growth.num_registered() as f64 >= GOOD_SHARE * usable as f64;
            let is_good = |growth: &IncrementalMapper| growth.is_from_known_poses() || has_most(growth);
            let agree = |(score, growth): &(f64, IncrementalMapper)| {
                let same = worths.iter().filter(|other| **other >= (1.0 - SAME_WORTH) * score).count();
                same > 1 && has_most(growth) && self.explains(growth, HEALTHY_SHARE)
            };
            if options.stop_early && best.as_ref().is_some_and(agree) {
                break;
            }
            if num_starts >= options.min_starts && best.as_ref().is_some_and(|(_, growth)| is_good(growth)) {
                break;
            }
        }
        Ok(Initializations { best: best.map(|(_, growth)| growth), pairs, tried: num_starts, survey })
    }

    /// The map that grows from what is known of the poses, with its worth; `None` where that is nothing, or where no
    /// points hold.
    fn grow_from_known_poses(&self, seed: u64) -> Result<Option<(f64, IncrementalMapper<'a>)>, MapperError> {
        let Some(known) = self.beside.poses else { return Ok(None) };
        self.grow_from(known, seed)
    }

    /// The map that grows from poses, with its worth; `None` where no points hold.
    fn grow_from(&self, poses: &PosePriors, seed: u64) -> Result<Option<(f64, IncrementalMapper<'a>)>, MapperError> {
        let map = Map::new(self.table, self.cameras).knowing(self.known.clone());
        let mut growth = IncrementalMapper::new(map, self.options, seed);
        if !growth.start_from(poses)? {
            return Ok(None);
        }
        growth.grow(&mut |_| {})?;
        growth.finish()?;
        let score = self.score(&growth);
        tracing::debug!("from pose priors: {} views, score {score:.0}", growth.num_registered());
        Ok(Some((score, growth)))
    }

    /// Returns true if a map that grew from pose priors has nearly all views, explains the expected share of
    /// observations, and still agrees with the priors: the share that right tracks let a map explain, and less of
    /// tracks without gaps, of which none is merged wrongly.
    fn needs_no_other(&self, growth: &IncrementalMapper) -> bool {
        const AGREES: f64 = 0.7;
        let enough = if self.table.has_gaps() { HEALTHY_SHARE } else { PLAUSIBLE_SHARE };
        let agrees = self.beside.poses.is_some_and(|known| growth.agreement(known) >= AGREES);
        self.options.stop_early
            && agrees
            && growth.num_registered() as f64 >= GOOD_SHARE * self.num_usable() as f64
            && self.explains(growth, enough)
    }

    /// Views in which there is something.
    fn num_usable(&self) -> usize {
        self.table.views.iter().filter(|view| !view.pixels.is_empty()).count()
    }

    /// The best of this map and of others, grown from other random choices and without trust in what was found again,
    /// until one explains what good tracks let a map explain.
    ///
    /// A round that gives the best map again is the last: what came out of two rounds comes out of others, too.
    ///
    /// Where few points tie two parts of a video, chance says which of several maps comes out, bent more or less; they
    /// differ in what they explain and in what leaves the silhouettes. A map that grew from known poses owes nothing to
    /// chance: another round would give it again, and where pairs of views gave nothing better they are not asked
    /// again.
    ///
    /// Without gaps no track is joined wrongly, but what is hidden in part for a while may turn over there (nearly
    /// parallel projections have two solutions), from most of the starts. Where poses are known otherwise these tell.
    pub fn best_of_rounds(
        &self,
        first: IncrementalMapper<'a>,
        seed: u64,
    ) -> Result<IncrementalMapper<'a>, MapperError> {
        let cut = self.table.has_gaps().then(|| incremental_mapper::split_at_gaps(self.table));
        let enough = match (&cut, self.beside.poses) {
            (Some(_), _) => HEALTHY_SHARE,
            (None, None) => PLAUSIBLE_SHARE,
            (None, Some(_)) => return Ok(first),
        };
        let cut = cut.as_ref().map(|table| InitializationAttempt { table, ..*self });
        let mut best = (self.score(&first), first);
        for round in 0..MAX_ROUNDS {
            if self.explains(&best.1, enough) || (round > 0 && best.1.is_from_known_poses()) {
                break;
            }
            let seed = seed.wrapping_add(round.wrapping_mul(ROUND_STRIDE));
            let again = match round {
                0 => None,
                _ => self.grow_from_pairs(None, seed, &mut |_| {})?.best,
            };
            let found = match (&cut, round) {
                (None, _) => None,
                (Some(cut), 0) => cut.grow_from_starts(seed, &mut |_| {})?.best,
                (Some(cut), _) => cut.grow_from_pairs(None, seed, &mut |_| {})?.best,
            };
            let unmerged = found.map(|found| self.joined_later(&found, seed)).transpose()?;
            let mut is_found_again = false;
            for other in again.into_iter().chain(unmerged) {
                let score = self.score(&other);
                tracing::debug!("round {round}: score {score:.0}, best {:.0}", best.0);
                is_found_again |= (score - best.0).abs() <= SAME_WORTH * best.0;
                if score > best.0 {
                    best = (score, other);
                }
            }
            if self.options.stop_early && is_found_again {
                break;
            }
        }
        Ok(best.1)
    }

    /// A video's map without its folds: the shorter side of each is grown again from the longer one, and what comes of
    /// it is taken where it lies flatter and explains about as much.
    pub fn without_folds(
        &self,
        mut best: IncrementalMapper<'a>,
        seed: u64,
    ) -> Result<IncrementalMapper<'a>, MapperError> {
        for _ in 0..self.options.max_folds {
            let Some(discontinuity) = best.discontinuity() else { break };
            let Some((score, other)) = self.grow_from(&best.longer_side(&discontinuity), seed)? else { break };
            let before = self.score(&best);
            tracing::debug!(
                "{discontinuity:?}, score {before:.0}; {score:.0} without it, with {:?}",
                other.discontinuity()
            );
            let is_flatter = other
                .discontinuity()
                .is_none_or(|left| left.turn < discontinuity.turn && left.views != discontinuity.views);
            if !is_flatter || score < (1.0 - SAME_WORTH) * before {
                break;
            }
            best = other;
        }
        Ok(best)
    }

    /// The map of all tracks that a map of those that are cut at their gaps becomes.
    fn joined_later(&self, found: &IncrementalMapper<'_>, seed: u64) -> Result<IncrementalMapper<'a>, MapperError> {
        let map = Map::new(self.table, self.cameras).knowing(self.known.clone());
        let mut whole = IncrementalMapper::new(map, self.options, seed);
        whole.adopt(found)?;
        Ok(whole)
    }

    /// Number of observations that a map explains, less those of points that contradict its silhouettes.
    fn explained(&self, growth: &IncrementalMapper) -> f64 {
        let silhouettes = self.beside.silhouettes;
        let within = silhouettes.map_or(1.0, |silhouettes| silhouettes.share_within(&growth.reconstruction()));
        growth.num_explained() * within
    }

    /// The same, the less the more its views turn otherwise than is known.
    fn score(&self, growth: &IncrementalMapper) -> f64 {
        self.explained(growth) * self.beside.poses.map_or(1.0, |known| growth.agreement(known))
    }

    /// Returns true if a map explains this share of the observations.
    fn explains(&self, growth: &IncrementalMapper, enough: f64) -> bool {
        let share = self.explained(growth) / self.table.num_observations().max(1) as f64;
        tracing::debug!("{share:.2} of the observations explained");
        share >= enough
    }
}
