//! Seeded random numbers: every random choice of the program uses these, so that a seed reproduces a run.

use rand::SeedableRng;

/// The program's random number generator: small, fast, and the same on every platform.
pub type Rng = rand_pcg::Pcg64Mcg;

/// Independent generator for one purpose, identified by `stream` (an object id, a frame, a stage).
///
/// The number of draws from one stream does not affect the others.
pub fn seeded_rng(seed: u64, stream: u64) -> Rng {
    // SplitMix64's finalizer (Steele et al., 2014) spreads neighboring seeds over the whole state.
    let mut z = seed ^ stream.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    Rng::seed_from_u64(z ^ (z >> 31))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    #[test]
    fn streams_differ_and_repeat() {
        let draw = |seed, stream| seeded_rng(seed, stream).random::<u64>();
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(1, 3));
        assert_ne!(draw(1, 2), draw(2, 2));
    }
}
