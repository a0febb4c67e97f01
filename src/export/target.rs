//! Target folder of exported files.

use std::path::{Path, PathBuf};

use super::ExportError;
use crate::io::{ExportFolder, FolderError, OwnedFolder, RunFolder, refuse_own_input};

/// A folder that this process has locked, and into which it writes files atomically.
#[derive(Debug)]
pub struct Target {
    owned: OwnedFolder,
    /// Relative path from the locked folder to that of the exports.
    below: PathBuf,
    /// Folder of the exports as the user named it.
    shown: PathBuf,
}

impl Target {
    /// `export/` in a run's output folder.
    ///
    /// # Errors
    /// [`FolderError`] if the folder is not a run's own, another process has locked it, or a file blocks the target.
    pub fn in_run(folder: &RunFolder) -> Result<Self, FolderError> {
        let owned = OwnedFolder::open(folder.root(), RunFolder::MADE_BY, RunFolder::place)?;
        let shown = folder.exports();
        let below = shown.strip_prefix(folder.root()).unwrap_or(&shown).to_owned();
        Ok(Self { owned, below, shown })
    }

    /// A separate folder for exports, created if missing.
    ///
    /// * `reads` – flags and paths of the inputs, none of which may be in the exports' folder.
    ///
    /// # Errors
    /// As [`Self::in_run`]; [`FolderError::OwnInput`].
    pub fn at(folder: &Path, reads: &[(&str, &Path)]) -> Result<Self, FolderError> {
        for (flag, path) in reads {
            refuse_own_input(folder, ExportFolder::place, flag, path)?;
        }
        let owned = OwnedFolder::open(folder, ExportFolder::MADE_BY, ExportFolder::place)?;
        Ok(Self { owned, below: PathBuf::new(), shown: folder.to_owned() })
    }

    /// The folder, as the user named it.
    pub fn folder(&self) -> &Path {
        &self.shown
    }

    /// Writes a file atomically: `fill` writes to the given path. Returns the final path.
    pub(super) fn put_file(
        &self,
        name: &str,
        fill: impl FnOnce(&Path) -> Result<(), ExportError>,
    ) -> Result<PathBuf, ExportError> {
        self.owned.put_file(&self.below.join(name), fill)?;
        Ok(self.shown.join(name))
    }

    /// Writes a folder atomically: `fill` gets an empty one. Returns its path.
    pub(super) fn put_folder(
        &self,
        name: &str,
        fill: impl FnOnce(&Path) -> Result<(), ExportError>,
    ) -> Result<PathBuf, ExportError> {
        self.owned.put_folder(&self.below.join(name), fill)?;
        Ok(self.shown.join(name))
    }
}
