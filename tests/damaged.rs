//! Every reader takes files that are damaged at random: what it refuses it names, and what it accepts can be written.
//! The same for hours: `examples/damage_files.rs`, and the fuzz targets in `tests/fuzz`.

#[path = "common/readers.rs"]
mod readers;

use std::fs;

use rand::Rng as _;
use readers::{damaged, read, readers as all, written};
use tractrix::math::seeded_rng;

#[test]
fn no_reader_panics_on_damaged_files() {
    const SEED: u64 = 3;
    const ROUNDS: usize = 150;
    for (stream, reader) in (0..).zip(all()) {
        let folder = tempfile::tempdir().unwrap();
        let places = written(reader, folder.path()).unwrap();
        let whole: Vec<Vec<u8>> = places.iter().map(|place| fs::read(place).unwrap()).collect();
        assert!(read(reader, &places[0]), "{reader}: the file as it was written");
        let mut rng = seeded_rng(SEED, stream);
        let mut num_refused = 0;
        for _ in 0..ROUNDS {
            let (at, other) = (rng.random_range(0..places.len()), rng.random_range(0..places.len()));
            fs::write(&places[at], damaged(&whole[at], &whole[other], &mut rng)).unwrap();
            num_refused += u32::from(!read(reader, &places[0]));
            fs::write(&places[at], &whole[at]).unwrap();
        }
        assert!(num_refused > 0, "{reader}: nothing of {ROUNDS} was damaged enough");
    }
}
