//! Exports of real output folders for tests with other programs (`scripts/benchmark/check_exports.py`).

use super::{Format, MissingFormats, Pictures, Results, Target, write};
use crate::io::RunFolder;
use crate::video::{Options, Source};

/// Writes the output folder named by the environment in every format, into the folder next to it.
#[test]
#[ignore = "needs TRACTRIX_OUTPUT, the output folder of a run whose input is where it was"]
fn every_format_of_a_run_is_written() {
    let output = std::env::var_os("TRACTRIX_OUTPUT").expect("TRACTRIX_OUTPUT names an output folder");
    let folder = RunFolder::at(output);
    let frames = crate::io::json::read::<Vec<_>>(&folder.root().join(RunFolder::STATE).join("frames-list.json")).ok();
    let results = Results::read(&folder, frames.as_deref()).unwrap();
    let source = Source::open(&results.input, &Options::default()).unwrap();
    let pictures = Pictures::new(&folder, Ok(&source), &|| ());
    let target = || Ok(Target::in_run(&folder)?);
    let exported = write(&results, &Format::ALL, MissingFormats::ForAll, None, &pictures, target).unwrap();
    for left in &exported.passed_over {
        assert_eq!(results.map().is_none(), left.reason.contains("no georeferenced positions"), "{left:?}");
    }
    assert_eq!(exported.written.len() + exported.passed_over.len(), Format::ALL.len());
}
