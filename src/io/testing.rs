//! Where tests find files: those of the repository, and those of the folder that `TRACTRIX_DATA` names.

use std::path::PathBuf;

/// A file or folder of the repository.
pub fn in_repository(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// A file or folder of the data that is not in the repository, for tests that say `#[ignore = "needs TRACTRIX_DATA"]`.
pub fn in_data(path: &str) -> PathBuf {
    let data = std::env::var_os("TRACTRIX_DATA").expect("TRACTRIX_DATA names the folder of the data");
    PathBuf::from(data).join(path)
}
