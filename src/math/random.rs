//! Seeded random numbers: every random choice of the program comes from here, so that a seed repeats a run.

use rand::SeedableRng;

/// The one generator in use: small, fast, and the same on every platform.
pub type Rng = rand_pcg::Pcg64Mcg;

/// A generator for one purpose: `stream` tells purposes apart (an object id, a frame, a stage), so that a change in how
/// many numbers one of them draws leaves the others as they were.
pub fn seeded_rng(seed: u64, stream: u64) -> Rng {
    // SplitMix64's finaliser (Steele et al., 2014) spreads neighbouring seeds over the whole state.
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
