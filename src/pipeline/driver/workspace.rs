//! The output folder while a run has it: the public results, and what the run needs to go on where it was.

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

/// An output folder that this process has for itself. What lies where in it is [`RunFolder`]'s to say.
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

/// Results that may be discarded for new ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overwrite {
    /// Results of the same input alone.
    #[default]
    SameInput,
    /// Results of another input, too.
    AnyInput,
}

/// Marker of a finished stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// Hash of everything that the result was made from.
    pub fingerprint: String,
    /// Cost when it was made.
    #[serde(flatten)]
    pub cost: Cost,
    /// Problems although there is a result.
    pub warnings: Vec<String>,
    /// Counts and measures, by name.
    pub figures: BTreeMap<String, serde_json::Value>,
    /// Files and folders that belong to the result, relative to the output folder; without one of them it is made
    /// again.
    pub outputs: Vec<PathBuf>,
}

impl Marker {
    pub(in crate::pipeline) fn is_complete(&self, output: &Path) -> bool {
        self.outputs.iter().all(|path| output.join(path).exists())
    }
}

impl Workspace {
    /// Looks whether a run may write into a folder, and whether all that it reads lies elsewhere; changes nothing.
    ///
    /// * `inputs` – what is read, after the flag that named it.
    ///
    /// # Errors
    /// [`PipelineError::Folder`] says what is in the way.
    pub fn inspect(output: &Path, inputs: &[(&str, &Path)]) -> Result<()> {
        OwnedFolder::inspect(output, RunFolder::MADE_BY, RunFolder::place)?;
        for (flag, input) in inputs {
            refuse_own_input(output, RunFolder::place, flag, input)?;
        }
        Ok(())
    }

    /// Makes the folder if need be and takes it.
    ///
    /// # Errors
    /// [`PipelineError::Folder`] if it is not a run's own, cannot be written to, or if another run has it.
    pub fn open(output: &Path) -> Result<Self> {
        let owned = OwnedFolder::open(output, RunFolder::MADE_BY, RunFolder::place)?;
        let places = RunFolder::at(owned.root());
        Ok(Self { owned, places })
    }

    /// Puts a public file in its place, whole, through `fill`, which is given the path.
    ///
    /// # Errors
    /// What `fill` says, or [`PipelineError::Folder`].
    pub fn put_file<E>(&self, path: &Path, fill: impl FnOnce(&Path) -> Result<(), E>) -> Result<()>
    where
        PipelineError: From<E>,
    {
        self.owned.put_file(path, |fresh| fill(fresh).map_err(PipelineError::from))
    }

    /// Puts a public folder in its place, whole, through `fill`, which gets an empty one.
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

    /// Removes a run's own files of all objects in `folder` but those to `keep`.
    ///
    /// # Errors
    /// As [`Self::remove`].
    pub fn keep_objects(&self, folder: &Path, keep: impl Fn(ObjectId) -> bool) -> Result<()> {
        let others = RunFolder::ids_in(folder).into_iter().filter(|id| !keep(*id));
        others.into_iter().try_for_each(|id| self.remove(&folder.join(id.to_string())))
    }

    /// A file of the run's own, of which nothing public hangs.
    pub fn state(&self, name: &str) -> PathBuf {
        state_of(self.root(), name)
    }

    /// Marker of a stage, if it can be read.
    pub fn marker(&self, stage: Stage) -> Option<Marker> {
        self.read_state(&marker_name(stage)).ok()
    }

    /// Says that a stage is done. Everything that it made must be in its place before.
    pub fn set_marker(&self, stage: Stage, marker: &Marker) -> Result<()> {
        self.write_state(&marker_name(stage), marker)
    }

    /// Says that a stage is not done. To be called before its results are touched.
    pub fn clear_marker(&self, stage: Stage) -> Result<()> {
        Ok(atomic::remove(&self.state(&marker_name(stage)))?)
    }

    /// Reads a value that [`Workspace::write_state`] wrote.
    ///
    /// # Errors
    /// [`PipelineError::State`] if it is missing or was changed by other hands.
    pub fn read_state<T: DeserializeOwned>(&self, name: &str) -> Result<T> {
        read_state(self.root(), name)
    }

    /// Writes a value of the run's own.
    pub fn write_state(&self, name: &str, value: &impl Serialize) -> Result<()> {
        Ok(atomic::write_json(&self.state(name), value)?)
    }

    /// Creates the folder for intermediate files of a stage's fingerprint, if it is not there.
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

/// Path of a file of the run's own in an output folder.
pub(in crate::pipeline) fn state_of(output: &Path, name: &str) -> PathBuf {
    output.join(RunFolder::STATE).join(name)
}

/// As [`Workspace::read_state`], from an output folder that nobody need have for itself.
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
    fn a_place_below_a_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"").unwrap();
        assert!(matches!(Workspace::open(&file.join("out")), Err(PipelineError::Folder(FolderError::System { .. }))));
    }

    #[test]
    fn markers_come_and_go_and_damaged_ones_count_as_none() {
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
