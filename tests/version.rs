//! The version that decides which results are reused: it changes with the sources.

#[path = "../build/sources.rs"]
mod sources;

mod common;

use std::fs;
use std::path::Path;

use common::{outcome, tractrix};
use tempfile::TempDir;

/// The hash in a version such as `0.1.0+0123456789ab`; `None` for a release.
fn hash_of(version: &str) -> Option<&str> {
    version.trim().split_once('+').map(|(_, hash)| hash)
}

#[test]
fn the_program_states_the_sources_that_it_was_built_from() {
    let (code, stdout, _) = outcome(tractrix().arg("--version"));
    assert_eq!(code, 0);
    assert_eq!(stdout.trim(), format!("tractrix {}", tractrix::VERSION));
    let Some(hash) = hash_of(&stdout) else { return assert_eq!(option_env!("TRACTRIX_RELEASE"), Some("1")) };
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    assert_eq!(hash, sources::hash(root).unwrap(), "the program is not built from the sources that are here");
}

#[test]
fn an_edited_constant_a_renamed_and_a_new_file_change_the_hash() {
    let root = TempDir::new().unwrap();
    let folder = root.path().join("src/ground");
    fs::create_dir_all(&folder).unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/ground/vehicle_trajectory.rs");
    let text = fs::read_to_string(source).unwrap();
    fs::write(folder.join("path.rs"), &text).unwrap();
    let before = sources::hash(root.path()).unwrap();
    assert_eq!(before, sources::hash(root.path()).unwrap());

    let edited = text.replacen("0.17", "0.18", 1);
    assert_ne!(edited, text, "the file has a constant to edit");
    fs::write(folder.join("path.rs"), edited).unwrap();
    let after = sources::hash(root.path()).unwrap();
    assert_ne!(after, before);
    fs::write(folder.join("path.rs"), &text).unwrap();
    assert_eq!(sources::hash(root.path()).unwrap(), before);

    fs::rename(folder.join("path.rs"), folder.join("route.rs")).unwrap();
    assert_ne!(sources::hash(root.path()).unwrap(), before);
    fs::rename(folder.join("route.rs"), folder.join("path.rs")).unwrap();
    fs::write(folder.join("new.rs"), "").unwrap();
    assert_ne!(sources::hash(root.path()).unwrap(), before);
}
