//! The output folder during a run: public results, and the state from which a run resumes.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Deref;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::cost::Cost;
use super::fingerprint;
use super::intermediate::damaged;
use crate::files;
use crate::io::{IoError, OwnedFolder, RunFolder, atomic, refuse_own_input};
use crate::pipeline::{PipelineError, Result, Stage};
use crate::scene::ObjectId;

/// An output folder locked by this process. [`RunFolder`] defines its layout.
#[derive(Debug)]
pub struct Workspace {
    pub(in crate::pipeline) owned: OwnedFolder,
    places: RunFolder,
}

impl Deref for Workspace {
    type Target = RunFolder;

    fn deref(&self) -> &RunFolder {
        &self.places
    }
}

/// Results that new ones may replace.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overwrite {
    /// Only results of the same input.
    #[default]
    SameInput,
    /// Also results of another input.
    AnyInput,
}

/// Marker of a finished stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// Hash of everything that the result depends on.
    pub fingerprint: String,
    /// Cost of the run that made it.
    #[serde(flatten)]
    pub cost: Cost,
    /// Warnings of a stage that has a result.
    pub warnings: Vec<String>,
    /// Counts and measures, by name.
    pub figures: BTreeMap<String, serde_json::Value>,
    /// Files and folders of the result, relative to the output folder. If one is missing, the stage is re-run.
    pub outputs: Vec<PathBuf>,
}

impl Marker {
    pub(in crate::pipeline) fn is_complete(&self, output: &Path) -> bool {
        self.outputs.iter().all(|path| output.join(path).exists())
    }
}

impl Workspace {
    /// Checks that a run may write into a folder, and that all its inputs are outside of it; changes nothing.
    ///
    /// * `inputs` – files that are read, each with the flag that named it.
    ///
    /// # Errors
    /// [`PipelineError::Folder`] names the obstacle.
    pub fn inspect(output: &Path, inputs: &[(&str, &Path)]) -> Result<()> {
        OwnedFolder::inspect(output, RunFolder::MADE_BY, RunFolder::place)?;
        for (flag, input) in inputs {
            refuse_own_input(output, RunFolder::place, flag, input)?;
        }
        Ok(())
    }

    /// Creates the folder if necessary, and locks it.
    ///
    /// # Errors
    /// [`PipelineError::Folder`] if it does not belong to a run, is not writable, or is locked by another run.
    pub fn open(output: &Path) -> Result<Self> {
        let owned = OwnedFolder::open(output, RunFolder::MADE_BY, RunFolder::place)?;
        let places = RunFolder::at(owned.root());
        Ok(Self { owned, places })
    }

    /// Writes a public file atomically through `fill`, which gets the path.
    ///
    /// # Errors
    /// The errors of `fill`, or [`PipelineError::Folder`].
    pub fn put_file<E>(&self, path: &Path, fill: impl FnOnce(&Path) -> Result<(), E>) -> Result<()>
    where
        PipelineError: From<E>,
    {
        self.owned.put_file(path, |fresh| fill(fresh).map_err(PipelineError::from))
    }

    /// Writes a public folder atomically through `fill`, which gets an empty one.
    ///
    /// # Errors
    /// As [`Self::put_file`].
    pub fn put_folder<T>(&self, path: &Path, fill: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
        self.owned.put_folder(path, fill)
    }

    /// Removes a run's own public files at and below a path.
    ///
    /// # Errors
    /// [`PipelineError::Folder`] if the system refuses.
    pub fn remove(&self, path: &Path) -> Result<()> {
        Ok(self.owned.remove(path)?)
    }

    /// Removes the run's files of all objects in `folder` except those to `keep`.
    ///
    /// # Errors
    /// As [`Self::remove`].
    pub fn keep_objects(&self, folder: &Path, keep: impl Fn(ObjectId) -> bool) -> Result<()> {
        let others = RunFolder::ids_in(folder).into_iter().filter(|id| !keep(*id));
        others.into_iter().try_for_each(|id| self.remove(&folder.join(id.to_string())))
    }

    /// Path of an internal file of the run, not part of the public results.
    pub fn state(&self, name: &str) -> PathBuf {
        state_of(self.root(), name)
    }

    /// Marker of a stage, if it is readable.
    pub fn marker(&self, stage: Stage) -> Option<Marker> {
        self.read_state(&marker_name(stage)).ok()
    }

    /// Marks a stage as finished. All its results must be in place before.
    pub fn set_marker(&self, stage: Stage, marker: &Marker) -> Result<()> {
        self.write_state(&marker_name(stage), marker)
    }

    /// Marks a stage as unfinished. Must be called before its results are changed.
    pub fn clear_marker(&self, stage: Stage) -> Result<()> {
        Ok(atomic::remove(&self.state(&marker_name(stage)))?)
    }

    /// Reads a value that [`Workspace::write_state`] wrote.
    ///
    /// # Errors
    /// [`PipelineError::State`] if it is missing or was modified outside the program.
    pub fn read_state<T: DeserializeOwned>(&self, name: &str) -> Result<T> {
        read_state(self.root(), name)
    }

    /// Writes an internal value of the run.
    pub fn write_state(&self, name: &str, value: &impl Serialize) -> Result<()> {
        Ok(atomic::write_json(&self.state(name), value)?)
    }

    /// Creates the folder for intermediate files of a stage's fingerprint, if it does not exist.
    pub fn intermediate(&self, stage: Stage, fingerprint: &str) -> Result<PathBuf> {
        let folder = self.state(&fingerprint::folder_name(stage, fingerprint));
        atomic::create_folders(&folder)?;
        Ok(folder)
    }

    /// Removes the folders for intermediate files of other fingerprints: they belong to other options.
    pub fn remove_intermediate(&self, stage: Stage, fingerprint: &str) -> Result<()> {
        let (keep, prefix) = (fingerprint::folder_name(stage, fingerprint), format!("{stage}-"));
        let state = self.root().join(RunFolder::STATE);
        for entry in fs::read_dir(&state).map_err(IoError::system("read", &state))? {
            let entry = entry.map_err(IoError::system("read", &state))?;
            let name = entry.file_name();
            let name = name.to_string_lossy();
            let is_fingerprint = |rest: &str| !rest.is_empty() && rest.chars().all(|c| c.is_ascii_hexdigit());
            if name != keep && name.strip_prefix(&prefix).is_some_and(is_fingerprint) {
                atomic::remove_folder(&entry.path())?;
            }
        }
        Ok(())
    }
}

/// Path of an internal file of the run in an output folder.
pub(in crate::pipeline) fn state_of(output: &Path, name: &str) -> PathBuf {
    output.join(RunFolder::STATE).join(name)
}

/// As [`Workspace::read_state`], from an output folder that need not be locked.
pub(in crate::pipeline) fn read_state<T: DeserializeOwned>(output: &Path, name: &str) -> Result<T> {
    let path = state_of(output, name);
    let bytes = files::read(&path).map_err(|error| damaged(&path, error))?;
    serde_json::from_slice(&bytes).map_err(|error| damaged(&path, error))
}

pub(in crate::pipeline) fn marker_name(stage: Stage) -> String {
    format!("{stage}.json")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::FolderError;

    #[test]
    fn one_process_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let first = Workspace::open(&folder.path().join("out")).unwrap();
        assert!(matches!(Workspace::open(first.root()), Err(PipelineError::Folder(FolderError::Busy { .. }))));
        let root = first.root().to_owned();
        drop(first);
        assert!(Workspace::open(&root).is_ok());
    }

    #[test]
    fn a_path_below_a_file_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"").unwrap();
        assert!(matches!(Workspace::open(&file.join("out")), Err(PipelineError::Folder(FolderError::System { .. }))));
    }

    #[test]
    fn damaged_markers_count_as_none() {
        let folder = tempfile::tempdir().unwrap();
        let workspace = Workspace::open(folder.path()).unwrap();
        assert_eq!(workspace.marker(Stage::Track), None);
        let marker = Marker {
            fingerprint: "f".to_owned(),
            cost: Cost::default(),
            warnings: vec![],
            figures: BTreeMap::new(),
            outputs: vec!["tracks".into()],
        };
        workspace.set_marker(Stage::Track, &marker).unwrap();
        assert_eq!(workspace.marker(Stage::Track).as_ref(), Some(&marker));
        assert!(!marker.is_complete(folder.path()));
        fs::create_dir(workspace.tracks()).unwrap();
        assert!(marker.is_complete(folder.path()));
        fs::write(workspace.state("track.json"), b"{\"finger").unwrap();
        assert_eq!(workspace.marker(Stage::Track), None);
        workspace.clear_marker(Stage::Track).unwrap();
        workspace.clear_marker(Stage::Track).unwrap();
    }
}
