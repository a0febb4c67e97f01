//! Start of a map: pose priors, or one pair of views after the other.

use super::incremental_mapper::{IncrementalMapper, PosePriors};
use super::initial_pair::{self, InitialPair};
use super::map::Map;
use super::motion::Survey;
use super::{KnownIntrinsics, Options};
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

/// Outcomes of the initial pairs.
#[derive(Default)]
pub struct Initializations<'a> {
    /// The map that explains the most observations.
    pub best: Option<IncrementalMapper<'a>>,
    pub pairs: Vec<InitialPair>,
    pub tried: usize,
    pub survey: Survey,
}

/// Share of the views that a good map has.
const GOOD_SHARE: f64 = 0.95;

impl<'a> InitializationAttempt<'a> {
    /// Grows a map from the pose priors; without these, or where their points do not hold, from one pair after the
    /// other, until a map has nearly all views.
    pub fn grow_from_starts(&self, seed: u64, watch: &mut dyn FnMut(f64)) -> Result<Initializations<'a>, MapperError> {
        let from_priors = match self.poses {
            Some(poses) => self.grow_from_priors(poses, seed, watch)?,
            None => None,
        };
        match from_priors {
            Some(mapper) => Ok(Initializations { best: Some(mapper), tried: 1, ..Initializations::default() }),
            None => self.grow_from_pairs(seed, watch),
        }
    }

    /// Returns true if a map has nearly all views.
    fn is_good(&self, mapper: &IncrementalMapper) -> bool {
        mapper.num_registered() as f64 >= GOOD_SHARE * self.num_usable() as f64
    }

    fn mapper(&self, seed: u64) -> IncrementalMapper<'a> {
        let map = Map::new(self.table, self.cameras).knowing(self.known.clone());
        IncrementalMapper::new(map, self.options, seed)
    }

    /// The map that grows from poses; `None` where no points hold.
    fn grow_from_priors(
        &self,
        poses: &PosePriors,
        seed: u64,
        watch: &mut dyn FnMut(f64),
    ) -> Result<Option<IncrementalMapper<'a>>, MapperError> {
        let mut mapper = self.mapper(seed);
        if !mapper.start_from(poses)? {
            return Ok(None);
        }
        self.finish(&mut mapper, 0.0, watch)?;
        tracing::debug!("from pose priors: {} views", mapper.num_registered());
        Ok(Some(mapper))
    }

    fn grow_from_pairs(&self, seed: u64, watch: &mut dyn FnMut(f64)) -> Result<Initializations<'a>, MapperError> {
        let Self { table, cameras, known, options, .. } = *self;
        let (pairs, survey) = initial_pair::ranked(table, cameras, known, options, seed);
        let mut found = Initializations { survey, ..Initializations::default() };
        let mut most = f64::NEG_INFINITY;
        let apart = initial_pair::far_from_one_another(pairs.clone(), table.views.len());
        for pair in apart.iter().take(options.max_starts) {
            let before = found.tried as f64;
            found.tried += 1;
            let mut mapper = self.mapper(seed);
            if mapper.start(pair)? {
                self.finish(&mut mapper, before, watch)?;
                let explained = mapper.num_explained();
                tracing::debug!("attempt {}: {} views, {explained:.0}", found.tried, mapper.num_registered());
                if explained > most {
                    most = explained;
                    found.best = Some(mapper);
                }
            }
            watch((before + 1.0) / found.tried as f64);
            if found.best.as_ref().is_some_and(|mapper| self.is_good(mapper)) {
                break;
            }
        }
        found.pairs = pairs;
        Ok(found)
    }

    /// Grows a map to its end, after `before` other attempts.
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

    /// Views in which there is something.
    fn num_usable(&self) -> usize {
        self.table.views.iter().filter(|view| !view.pixels.is_empty()).count()
    }
}
