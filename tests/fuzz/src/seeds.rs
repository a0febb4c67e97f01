//! Writes what the fuzz targets begin with: every reader's files, in `corpus/<reader>`.

use std::fs;
use std::path::Path;

// For the counters that the library was compiled with.
use libfuzzer_sys as _;
use tractrix_fuzz::readers::{Failed, readers, written};

fn main() -> Result<(), Failed> {
    for reader in readers() {
        let folder = tempfile::tempdir()?;
        let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(reader);
        fs::create_dir_all(&corpus)?;
        let places = written(reader, folder.path())?;
        for (k, place) in places.iter().enumerate() {
            // Where there are several files, the first byte says whose place the others take.
            let which = if places.len() > 1 { vec![u8::try_from(k)?] } else { Vec::new() };
            fs::write(corpus.join(format!("{k}")), [which, fs::read(place)?].concat())?;
        }
    }
    Ok(())
}
