//! Files that the program wrote into a folder, and their input.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::tree::is_link;
use super::{FolderError, InputIdentity, PathRole, PathRoles, STATE, is_inside};
use crate::files;

/// File name in the state folder.
pub(super) const MANIFEST: &str = "manifest.json";
/// Only version of the format.
pub(super) const VERSION: u32 = 1;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Manifest {
    pub(super) version: u32,
    /// Command that writes into the folder.
    pub(super) made_by: String,
    pub(super) input: Option<InputIdentity>,
    /// Relative to the folder, without the content of the state folder.
    pub(super) files: BTreeSet<PathBuf>,
}

impl Manifest {
    /// Returns true if it has a known version and names nothing outside the folder: other programs may have written it.
    fn is_sound(&self) -> bool {
        self.version == VERSION && self.files.iter().all(|file| is_inside(file))
    }
}

/// Reads the manifest of a folder, without names where the program never writes: the folder may be foreign, and listed
/// files can be removed.
pub(super) fn read_manifest(root: &Path, places: PathRoles) -> Result<Option<Manifest>, FolderError> {
    let state = root.join(STATE);
    for (path, name) in [(state.clone(), STATE.to_owned()), (state.join(MANIFEST), format!("{STATE}/{MANIFEST}"))] {
        if is_link(&path) {
            return Err(FolderError::Link { path: root.to_owned(), link: name });
        }
    }
    let Ok(bytes) = files::read(&state.join(MANIFEST)) else { return Ok(None) };
    // An unreadable manifest is ignored: the folder then counts as foreign and is kept.
    let mut manifest = serde_json::from_slice::<Manifest>(&bytes).ok().filter(Manifest::is_sound);
    if let Some(manifest) = &mut manifest {
        manifest.files.retain(|file| places(file) == PathRole::File);
    }
    Ok(manifest)
}
