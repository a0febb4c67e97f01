//! Where exported files go.

use std::path::{Path, PathBuf};

use super::ExportError;
use crate::io::{ExportFolder, FolderError, OwnedFolder, RunFolder, refuse_own_input};

/// A folder that this process has for itself, and into which it writes whole files.
#[derive(Debug)]
pub struct Target {
    owned: OwnedFolder,
    /// From the folder that is owned to that of the exports.
    below: PathBuf,
    /// The latter as the user named it.
    shown: PathBuf,
}

impl Target {
    /// `export/` in a run's output folder.
    ///
    /// # Errors
    /// [`FolderError`] if the folder is not a run's own, another process has it, or something is in the way.
    pub fn in_run(folder: &RunFolder) -> Result<Self, FolderError> {
        let owned = OwnedFolder::open(folder.root(), RunFolder::MADE_BY, RunFolder::place)?;
        let shown = folder.exports();
        let below = shown.strip_prefix(folder.root()).unwrap_or(&shown).to_owned();
        Ok(Self { owned, below, shown })
    }

    /// A folder for exports alone, which is made if need be.
    ///
    /// * `reads` – what is read, after the flag that named it: it must not lie where the exports go.
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

    /// Puts a file in its place, whole: `fill` writes to the given path. Returns its final path.
    pub(super) fn put_file(
        &self,
        name: &str,
        fill: impl FnOnce(&Path) -> Result<(), ExportError>,
    ) -> Result<PathBuf, ExportError> {
        self.owned.put_file(&self.below.join(name), fill)?;
        Ok(self.shown.join(name))
    }

    /// Puts a folder in its place, whole: `fill` gets an empty one. Gives its path.
    pub(super) fn put_folder(
        &self,
        name: &str,
        fill: impl FnOnce(&Path) -> Result<(), ExportError>,
    ) -> Result<PathBuf, ExportError> {
        self.owned.put_folder(&self.below.join(name), fill)?;
        Ok(self.shown.join(name))
    }
}
