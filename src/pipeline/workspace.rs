//! The output folder: where everything lies, and that one process alone writes to it.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::meter::Cost;
use super::{PipelineError, Stage};
use crate::io::atomic;
use crate::scene::{Frame, ObjectId};

/// Folder inside the output folder for what a run needs to go on where it was.
const STATE: &str = ".tractrix";

/// An output folder that this process has for itself.
#[derive(Debug)]
pub struct Workspace {
    root: PathBuf,
    _lock: File,
}

/// What a finished stage leaves behind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// Hash of everything that the result was made from.
    pub fingerprint: String,
    /// What it cost when it was made.
    #[serde(flatten)]
    pub cost: Cost,
    /// What is wrong although there is a result.
    pub warnings: Vec<String>,
    /// Counts and measures, by name.
    pub figures: BTreeMap<String, serde_json::Value>,
    /// Files and folders that belong to the result, relative to the output folder; without one of them it is made anew.
    pub outputs: Vec<PathBuf>,
}

impl Workspace {
    /// Makes the folder if need be and takes it.
    ///
    /// # Errors
    /// [`PipelineError::Output`] if it cannot be written to, [`PipelineError::Busy`] if another run has it.
    pub fn open(root: &Path) -> Result<Self, PipelineError> {
        let failed = |source| PipelineError::Output { path: root.to_owned(), source };
        let state = root.join(STATE);
        fs::create_dir_all(&state).map_err(failed)?;
        let lock = File::create(state.join("lock")).map_err(failed)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(PipelineError::Busy { path: root.to_owned() }),
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
        let workspace = Self { root: root.to_owned(), _lock: lock };
        let (kept, unchecked) = (workspace.state("objects"), workspace.unchecked_objects());
        for folder in [root, &state, &workspace.objects(), &kept, &unchecked, &workspace.tracks()] {
            if folder.is_dir() {
                atomic::remove_leftovers(folder)?;
            }
        }
        Ok(workspace)
    }

    /// The output folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// A file of the run's own.
    pub fn state(&self, name: &str) -> PathBuf {
        state_of(&self.root, name)
    }

    /// The background's model.
    pub fn background(&self) -> PathBuf {
        self.root.join("background")
    }

    /// The folder of all objects' models.
    pub fn objects(&self) -> PathBuf {
        self.root.join("objects")
    }

    /// One object's model.
    pub fn object(&self, id: ObjectId) -> PathBuf {
        self.objects().join(id.to_string())
    }

    /// One object's model as structure from motion left it, before it was put on the ground.
    pub fn reconstructed_object(&self, id: ObjectId) -> PathBuf {
        self.state("objects").join(id.to_string())
    }

    /// The folder of objects' models that are not yet compared with the masks; there only while that is to be done.
    pub fn unchecked_objects(&self) -> PathBuf {
        self.state("objects-unchecked")
    }

    /// The folder of all masks.
    pub fn tracks(&self) -> PathBuf {
        self.root.join("tracks")
    }

    /// One object's mask in one frame.
    pub fn track_mask(&self, id: ObjectId, frame: &Frame) -> PathBuf {
        self.tracks().join(id.to_string()).join(mask_name(frame))
    }

    /// What a stage left behind, if it can be read.
    pub fn marker(&self, stage: Stage) -> Option<Marker> {
        self.read_state(&marker_name(stage)).ok()
    }

    /// Says that a stage is done. Everything that it made must be in its place before.
    pub fn set_marker(&self, stage: Stage, marker: &Marker) -> Result<(), PipelineError> {
        Ok(atomic::write_json(&self.state(&marker_name(stage)), marker)?)
    }

    /// Says that a stage is not done. To be called before its results are touched.
    pub fn clear_marker(&self, stage: Stage) -> Result<(), PipelineError> {
        let path = self.state(&marker_name(stage));
        match fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(PipelineError::Output { path, source: error })
            }
            _ => Ok(()),
        }
    }

    /// Whether every part of a marked result is still there.
    pub fn has_outputs(&self, marker: &Marker) -> bool {
        marker.outputs.iter().all(|path| self.root.join(path).exists())
    }

    /// Reads a value that [`Workspace::write_state`] wrote.
    ///
    /// # Errors
    /// [`PipelineError::State`] if it is missing or was changed by other hands.
    pub fn read_state<T: DeserializeOwned>(&self, name: &str) -> Result<T, PipelineError> {
        let path = self.state(name);
        let damaged = |reason: String| PipelineError::State { path: path.clone(), reason };
        let bytes = fs::read(&path).map_err(|e| damaged(e.to_string()))?;
        serde_json::from_slice(&bytes).map_err(|e| damaged(e.to_string()))
    }

    /// Writes a value of the run's own.
    pub fn write_state(&self, name: &str, value: &impl Serialize) -> Result<(), PipelineError> {
        Ok(atomic::write_json(&self.state(name), value)?)
    }

    /// Makes sure that of the folders in `.tractrix` whose names begin with `prefix` only `keep` is there: the others
    /// belong to other options.
    pub fn keep_only(&self, prefix: &str, keep: &str) -> Result<PathBuf, PipelineError> {
        let state = self.root.join(STATE);
        let failed = |source| PipelineError::Output { path: state.clone(), source };
        for entry in fs::read_dir(&state).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.starts_with(prefix) && name != keep && entry.path().is_dir() {
                fs::remove_dir_all(entry.path()).map_err(failed)?;
            }
        }
        let kept = state.join(keep);
        fs::create_dir_all(&kept).map_err(failed)?;
        Ok(kept)
    }

    /// Removes a folder of results, if it is there.
    pub fn remove(&self, path: &Path) -> Result<(), PipelineError> {
        match fs::remove_dir_all(path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                Err(PipelineError::Output { path: path.to_owned(), source })
            }
            _ => Ok(()),
        }
    }
}

/// A file of the run's own in the output folder `root`, which need not be open.
pub(super) fn state_of(root: &Path, name: &str) -> PathBuf {
    root.join(STATE).join(name)
}

/// Name of an image's mask: COLMAP's convention, which keeps `a.jpg` and `a.png` apart.
pub fn mask_name(frame: &Frame) -> String {
    format!("{}.png", frame.name)
}

fn marker_name(stage: Stage) -> String {
    format!("{stage}.json")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_process_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let first = Workspace::open(&folder.path().join("out")).unwrap();
        assert!(matches!(Workspace::open(first.root()), Err(PipelineError::Busy { .. })));
        let root = first.root().to_owned();
        drop(first);
        assert!(Workspace::open(&root).is_ok());
    }

    #[test]
    fn a_place_below_a_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"").unwrap();
        assert!(matches!(Workspace::open(&file.join("out")), Err(PipelineError::Output { .. })));
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
        assert!(!workspace.has_outputs(&marker));
        fs::create_dir(workspace.tracks()).unwrap();
        assert!(workspace.has_outputs(&marker));
        fs::write(workspace.state("track.json"), b"{\"finger").unwrap();
        assert_eq!(workspace.marker(Stage::Track), None);
        workspace.clear_marker(Stage::Track).unwrap();
        workspace.clear_marker(Stage::Track).unwrap();
    }
}
