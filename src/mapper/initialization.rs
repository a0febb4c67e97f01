//! Initialization of a map from pose priors, or from one initial pair after the other.

use super::incremental_mapper::{IncrementalMapper, PosePriors};
use super::initial_pair;
use super::map::Map;
use super::{KnownIntrinsics, Options, Report};
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
    pub poses: Option<&'a PosePriors>,
}

/// Minimum share of registered views of a good map.
const GOOD_SHARE: f64 = 0.95;

impl<'a> InitializationAttempt<'a> {
    /// Grows a map from the pose priors, or from one initial pair after the other.
    ///
    /// Pairs are tried if there are no pose priors or too few points remain from these, until a map has nearly all
    /// views. Returns the map that explains the most observations, or a report with the reason of the failure.
    pub fn grow(
        &self,
        seed: u64,
        watch: &mut dyn FnMut(f64),
    ) -> Result<Result<IncrementalMapper<'a>, Report>, MapperError> {
        if let Some(poses) = self.poses {
            let mut mapper = self.mapper(seed);
            if mapper.initialize_from(poses)? {
                self.finish(&mut mapper, 0.0, watch)?;
                tracing::debug!("from pose priors: {} views", mapper.num_registered());
                return Ok(Ok(mapper));
            }
        }
        self.grow_from_pairs(seed, watch)
    }

    fn grow_from_pairs(
        &self,
        seed: u64,
        watch: &mut dyn FnMut(f64),
    ) -> Result<Result<IncrementalMapper<'a>, Report>, MapperError> {
        let Self { table, cameras, known, options, .. } = *self;
        let (pairs, survey) = initial_pair::ranked(table, cameras, known, options, seed);
        let num_pairs = pairs.len();
        let mut best: Option<(f64, IncrementalMapper)> = None;
        let mut tried = 0;
        let diversified = initial_pair::diversified(pairs, table.views.len());
        for pair in diversified.iter().take(options.max_starts) {
            let mut mapper = self.mapper(seed);
            if mapper.initialize(pair)? {
                self.finish(&mut mapper, tried as f64, watch)?;
                let explained = mapper.num_explained();
                tracing::debug!("attempt {}: {} views, {explained:.0}", tried + 1, mapper.num_registered());
                if best.as_ref().is_none_or(|(most, _)| explained > *most) {
                    best = Some((explained, mapper));
                }
            }
            tried += 1;
            watch(1.0);
            if best.as_ref().is_some_and(|(_, mapper)| self.is_good(mapper)) {
                break;
            }
        }
        Ok(best.map(|(_, mapper)| mapper).ok_or_else(|| Report::without_start(table, num_pairs, tried, &survey)))
    }

    /// Returns true if a map has nearly all views.
    fn is_good(&self, mapper: &IncrementalMapper) -> bool {
        mapper.num_registered() as f64 >= GOOD_SHARE * self.num_usable() as f64
    }

    fn mapper(&self, seed: u64) -> IncrementalMapper<'a> {
        IncrementalMapper::new(Map::new(self.table, self.cameras, self.known.clone()), self.options, seed)
    }

    /// Grows and finishes a map, after `before` other attempts.
    fn finish(
        &self,
        mapper: &mut IncrementalMapper<'a>,
        before: f64,
        watch: &mut dyn FnMut(f64),
    ) -> Result<(), MapperError> {
        let usable = self.num_usable().max(1) as f64;
        // Growing takes about 0.7 of the time, the last adjustments the rest.
        mapper.grow(&mut |registered| watch((before + 0.7 * registered as f64 / usable) / (before + 1.0)))?;
        mapper.finish()
    }

    /// Number of views with features.
    fn num_usable(&self) -> usize {
        self.table.views.iter().filter(|view| !view.pixels.is_empty()).count()
    }
}
