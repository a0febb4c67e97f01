//! Output folder in which the program changes only its own files.
//!
//! The program identifies its own files by a manifest, `.tractrix/manifest.json`. It uses a folder only if that is new,
//! empty or has such a manifest. It replaces and removes only files in the manifest; foreign files next to them are
//! kept. It never follows a link inside the folder. A file is added to the manifest before it is moved to its place, so
//! that a killed process leaves no unknown file.
//!
//! Output is prepared in `.tractrix/tmp` and moved to its place as a whole. A folder of results is exchanged in one
//! step if all its files are the program's own, otherwise file by file.

mod error;
mod manifest;
mod survey;
#[cfg(test)]
mod tests;
mod tree;

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use tempfile::{Builder, TempDir};

pub use error::FolderError;
pub use survey::{refuse_own_input, refuse_place_of_results};

use self::manifest::{MANIFEST, Manifest, VERSION, read_manifest};
use self::survey::{Survey, is_as_good_as_empty};
use self::tree::{files_below, files_below_if_any, folders_below, is_link, is_real_folder};
use super::atomic::{sync_folder, sync_tree};
use super::{IoError, RunFolder, atomic};
use crate::files;

const STATE: &str = RunFolder::STATE;
const LOCK: &str = "lock";
const SCRATCH: &str = "tmp";

/// Role of a path of the program's folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathRole {
    /// One of its files.
    File,
    /// One of its folders; others may have files in it.
    Folder,
    /// Inside the folder that belongs to it alone.
    State,
    /// No role: a foreign file.
    Elsewhere,
}

/// Role of each path of the folder.
pub type PathRoles = fn(&Path) -> PathRole;

/// Identity of the input of a folder's results.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputIdentity {
    /// Path of the input, for messages and for reading it again.
    pub path: PathBuf,
    /// Hash of its content.
    pub content: String,
}

/// Folder locked by this process.
#[derive(Debug)]
pub struct OwnedFolder {
    root: PathBuf,
    manifest: Mutex<Manifest>,
    _lock: File,
}

impl OwnedFolder {
    /// Checks that a folder may be used, without changing anything.
    ///
    /// * `made_by` – the calling command; a folder of another command is not its own.
    ///
    /// # Errors
    /// [`FolderError`] with the obstacle.
    pub fn inspect(path: &Path, made_by: &'static str, places: PathRoles) -> Result<(), FolderError> {
        let system = FolderError::system(path);
        match fs::metadata(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return match fs::symlink_metadata(path) {
                    Ok(_) => Err(FolderError::Link { path: path.to_owned(), link: path.display().to_string() }),
                    Err(_) => Ok(()),
                };
            }
            Err(error) => return Err(system(error)),
            Ok(found) if !found.is_dir() => return Err(system(io::ErrorKind::NotADirectory.into())),
            Ok(_) => {}
        }
        let manifest = read_manifest(path, places)?;
        match manifest.filter(|manifest| manifest.made_by == made_by) {
            Some(manifest) => Survey { root: path, manifest: &manifest, places }.run(),
            None => is_as_good_as_empty(path, made_by),
        }
    }

    /// Creates the folder if it is missing and locks it, after the checks of [`Self::inspect`].
    ///
    /// # Errors
    /// [`FolderError`] with the obstacle.
    pub fn open(path: &Path, made_by: &'static str, places: PathRoles) -> Result<Self, FolderError> {
        Self::inspect(path, made_by, places)?;
        let system = FolderError::system(path);
        make(&path.join(STATE)).map_err(&system)?;
        // A link to the folder itself is the user's name for it; below it no link is followed.
        let root = fs::canonicalize(path).map_err(&system)?;
        let lock = lock(&root, path)?;
        let manifest = read_manifest(&root, places)?.unwrap_or_default();
        let owned = Self { root, manifest: Mutex::new(manifest), _lock: lock };
        // Checked again: another process may have come before the lock.
        Self::inspect(path, made_by, places)?;
        owned.tidy(made_by)?;
        Ok(owned)
    }

    /// Returns true if a path is a folder of this command's.
    pub fn is_own(path: &Path, made_by: &str) -> bool {
        manifest_of(path, made_by).is_some()
    }

    /// Input of the results in a folder of this command's, where its manifest states it.
    pub fn input_of(path: &Path, made_by: &str) -> Option<InputIdentity> {
        manifest_of(path, made_by)?.input
    }

    /// Returns true if a process uses a folder now. A process that locks it at the same moment may be refused.
    pub fn is_busy(path: &Path) -> bool {
        let lock = files::open(&path.join(STATE).join(LOCK));
        lock.is_ok_and(|lock| matches!(lock.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// Drops missing files from the manifest, so that a later file of that name counts as foreign; removes unfinished
    /// files of a killed process.
    fn tidy(&self, made_by: &str) -> Result<(), FolderError> {
        let scratch = self.root.join(STATE).join(SCRATCH);
        if scratch.exists() {
            fs::remove_dir_all(&scratch).map_err(IoError::system("remove", &scratch))?;
        }
        atomic::remove_leftovers(&self.root.join(STATE))?;
        let mut manifest = self.manifest();
        let before = manifest.clone();
        manifest.version = VERSION;
        made_by.clone_into(&mut manifest.made_by);
        manifest.files.retain(|file| fs::symlink_metadata(self.root.join(file)).is_ok());
        if *manifest != before {
            self.write_manifest(&manifest)?;
        }
        Ok(())
    }

    /// Root of the folder, with links resolved.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Input of the results, if it was recorded.
    pub fn input(&self) -> Option<InputIdentity> {
        self.manifest().input.clone()
    }

    /// Records the input of the results. Results of another input are replaced only with `overwrite`; they are then
    /// removed, so that results of two inputs never mix.
    ///
    /// # Errors
    /// [`FolderError::OtherInput`].
    pub fn claim(&self, input: InputIdentity, overwrite: bool) -> Result<(), FolderError> {
        let before = self.input();
        let others = before.as_ref().filter(|before| before.content != input.content);
        if let Some(other) = others.filter(|_| !overwrite) {
            return Err(FolderError::OtherInput { path: self.root.clone(), input: other.path.clone() });
        }
        if others.is_some() {
            self.remove(Path::new(""))?;
        }
        if before.as_ref() == Some(&input) {
            return Ok(());
        }
        let mut manifest = self.manifest();
        manifest.input = Some(input);
        self.write_manifest(&manifest)
    }

    /// Path of a folder inside this one that it does not manage; it must not be a link.
    ///
    /// # Errors
    /// [`FolderError::Link`].
    pub fn subfolder(&self, name: &str) -> Result<PathBuf, FolderError> {
        self.check_no_link(&self.relative(Path::new(name))?)?;
        Ok(self.root.join(name))
    }

    /// Writes a file as a whole: `fill` writes to the given path.
    ///
    /// # Errors
    /// The error of `fill`; [`FolderError`] if a foreign file is in that place.
    pub fn put_file<E: From<FolderError>>(
        &self,
        path: &Path,
        fill: impl FnOnce(&Path) -> Result<(), E>,
    ) -> Result<(), E> {
        let relative = self.relative(path)?;
        self.check_no_link(&relative)?;
        self.check_vacant(&relative)?;
        let scratch = self.scratch()?;
        let fresh = scratch.path().join(relative.file_name().unwrap_or_default());
        fill(&fresh)?;
        sync_folder(&fresh).map_err(FolderError::from)?;
        self.list([relative.clone()])?;
        self.move_in(&fresh, &relative)?;
        Ok(())
    }

    /// As [`Self::put_file`], for a text.
    ///
    /// # Errors
    /// As [`Self::put_file`].
    pub fn put_text(&self, name: &str, text: &str) -> Result<(), FolderError> {
        self.put_file(Path::new(name), |fresh| Ok(atomic::write(fresh, text.as_bytes())?))
    }

    /// As [`Self::put_file`], for a value as indented JSON.
    ///
    /// # Errors
    /// As [`Self::put_file`].
    pub fn put_json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), FolderError> {
        self.put_file(Path::new(name), |fresh| Ok(atomic::write_json(fresh, value)?))
    }

    /// Writes a folder as a whole: `fill` gets an empty one. The program's own previous files are removed; foreign
    /// files are kept.
    ///
    /// # Errors
    /// As [`Self::put_file`].
    pub fn put_folder<T, E: From<FolderError>>(
        &self,
        path: &Path,
        fill: impl FnOnce(&Path) -> Result<T, E>,
    ) -> Result<T, E> {
        let relative = self.relative(path)?;
        self.check_no_link(&relative)?;
        let scratch = self.scratch()?;
        let fresh = scratch.path().join("new");
        fs::create_dir(&fresh).map_err(IoError::system("create", &fresh)).map_err(FolderError::from)?;
        let value = fill(&fresh)?;
        self.replace_folder(&relative, &fresh, &scratch.path().join("old"))?;
        Ok(value)
    }

    fn replace_folder(&self, relative: &Path, fresh: &Path, aside: &Path) -> Result<(), FolderError> {
        sync_tree(fresh)?;
        let new: BTreeSet<PathBuf> = files_below(fresh)?.into_iter().map(|file| relative.join(file)).collect();
        for file in &new {
            self.check_vacant(file)?;
        }
        let target = self.root.join(relative);
        let old: BTreeSet<PathBuf> = self.own_below(relative);
        let there: Vec<PathBuf> = files_below_if_any(&target)?.into_iter().map(|file| relative.join(file)).collect();
        self.list(new.iter().cloned())?;
        match there.iter().all(|file| old.contains(file)) {
            true => self.exchange(relative, fresh, aside)?,
            false => new.iter().try_for_each(|file| {
                let inside = file.strip_prefix(relative).unwrap_or(file);
                self.move_in(&fresh.join(inside), file)
            })?,
        }
        self.remove_files(old.difference(&new))?;
        self.prune(relative)
    }

    /// Replaces a folder in which all files are the program's own. A power failure in the short moment between the two
    /// moves leaves no folder, but never half of one.
    fn exchange(&self, relative: &Path, fresh: &Path, aside: &Path) -> Result<(), FolderError> {
        let target = self.root.join(relative);
        self.make_parents(relative)?;
        if fs::symlink_metadata(&target).is_ok() {
            fs::rename(&target, aside).map_err(IoError::system("replace", &target))?;
        }
        fs::rename(fresh, &target).map_err(IoError::system("replace", &target))?;
        // A foreign file created in the meantime is kept, too.
        for file in
            files_below_if_any(aside)?.iter().filter(|file| !self.manifest().files.contains(&relative.join(file)))
        {
            self.move_in(&aside.join(file), &relative.join(file))?;
        }
        Ok(sync_folder(target.parent().unwrap_or(&self.root))?)
    }

    /// Removes the program's own files at and below a path, and folders that become empty.
    ///
    /// # Errors
    /// [`FolderError`] if the system refuses.
    pub fn remove(&self, path: &Path) -> Result<(), FolderError> {
        let relative = self.relative(path)?;
        self.check_no_link(&relative)?;
        let own = self.own_below(&relative);
        self.remove_files(own.iter())?;
        self.prune(&relative)
    }

    fn remove_files<'a>(&self, files: impl Iterator<Item = &'a PathBuf>) -> Result<(), FolderError> {
        let mut gone = BTreeSet::new();
        for file in files {
            // A link above the file would lead to a foreign file of that name.
            self.check_no_link(file.parent().unwrap_or(Path::new("")))?;
            let path = self.root.join(file);
            match fs::remove_file(&path) {
                Err(error) if !is_absent(&error) => return Err(IoError::system("remove", &path)(error).into()),
                _ => gone.insert(file.clone()),
            };
        }
        if gone.is_empty() {
            return Ok(());
        }
        // A file that reappears after a power failure must still be in the manifest.
        let folders: BTreeSet<PathBuf> = gone.iter().filter_map(|file| Some(self.root.join(file.parent()?))).collect();
        folders.iter().filter(|folder| folder.is_dir()).try_for_each(|folder| sync_folder(folder))?;
        let mut manifest = self.manifest();
        manifest.files.retain(|file| !gone.contains(file));
        self.write_manifest(&manifest)
    }

    /// Removes empty folders at and below a path, except the root.
    fn prune(&self, relative: &Path) -> Result<(), FolderError> {
        let top = self.root.join(relative);
        if relative == Path::new("") || !is_real_folder(&top) {
            return Ok(());
        }
        for folder in folders_below(&top)?.into_iter().rev().chain([top]) {
            // Fails if it is not empty, as intended.
            if fs::remove_dir(&folder).is_ok() {
                sync_folder(folder.parent().unwrap_or(&self.root))?;
            }
        }
        Ok(())
    }

    /// Adds files to the manifest.
    fn list(&self, files: impl IntoIterator<Item = PathBuf>) -> Result<(), FolderError> {
        let mut manifest = self.manifest();
        let before = manifest.files.len();
        manifest.files.extend(files);
        match manifest.files.len() == before {
            true => Ok(()),
            false => self.write_manifest(&manifest),
        }
    }

    fn own_below(&self, relative: &Path) -> BTreeSet<PathBuf> {
        self.manifest().files.iter().filter(|file| file.starts_with(relative)).cloned().collect()
    }

    /// Checks that no foreign file is at a path.
    fn check_vacant(&self, relative: &Path) -> Result<(), FolderError> {
        let path = self.root.join(relative);
        match fs::symlink_metadata(&path) {
            Ok(found) if found.file_type().is_symlink() => Err(self.link(relative)),
            Ok(found) if found.is_dir() || !self.manifest().files.contains(relative) => {
                Err(FolderError::InTheWay { path: self.root.clone(), examples: relative.display().to_string() })
            }
            _ => Ok(()),
        }
    }

    /// Checks that no component of a path inside the folder is a link.
    fn check_no_link(&self, relative: &Path) -> Result<(), FolderError> {
        let mut ancestors = relative.ancestors().filter(|above| !above.as_os_str().is_empty());
        ancestors.find(|above| is_link(&self.root.join(above))).map_or(Ok(()), |above| Err(self.link(above)))
    }

    fn link(&self, relative: &Path) -> FolderError {
        FolderError::Link { path: self.root.clone(), link: relative.display().to_string() }
    }

    fn move_in(&self, fresh: &Path, relative: &Path) -> Result<(), FolderError> {
        let target = self.root.join(relative);
        self.make_parents(relative)?;
        fs::rename(fresh, &target).map_err(IoError::system("replace", &target))?;
        Ok(sync_folder(target.parent().unwrap_or(&self.root))?)
    }

    fn make_parents(&self, relative: &Path) -> Result<(), FolderError> {
        self.check_no_link(relative)?;
        let target = self.root.join(relative);
        let folder = target.parent().unwrap_or(&self.root);
        Ok(atomic::create_folders(folder)?)
    }

    fn scratch(&self) -> Result<TempDir, FolderError> {
        let folder = self.root.join(STATE).join(SCRATCH);
        self.check_no_link(&Path::new(STATE).join(SCRATCH))?;
        let made = fs::create_dir_all(&folder);
        let made = made.and_then(|()| Builder::new().prefix(atomic::UNPLACED).tempdir_in(&folder));
        made.map_err(FolderError::system(&folder))
    }

    fn relative(&self, path: &Path) -> Result<PathBuf, FolderError> {
        let relative = if path.is_absolute() { path.strip_prefix(&self.root).ok() } else { Some(path) };
        relative
            .filter(|path| is_inside(path))
            .map(Path::to_owned)
            .ok_or_else(|| IoError::content(path, format!("outside the output folder {}", self.root.display())).into())
    }

    fn manifest(&self) -> MutexGuard<'_, Manifest> {
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write_manifest(&self, manifest: &Manifest) -> Result<(), FolderError> {
        Ok(atomic::write_json(&self.root.join(STATE).join(MANIFEST), manifest)?)
    }
}

/// The manifest of a command's folder without its files.
fn manifest_of(path: &Path, made_by: &str) -> Option<Manifest> {
    let found = read_manifest(path, |_| PathRole::Elsewhere).ok().flatten();
    found.filter(|manifest| manifest.made_by == made_by)
}

/// Creates a folder and its parents.
fn make(folder: &Path) -> io::Result<()> {
    atomic::create_folders(folder).map_err(|error| match error {
        IoError::System { source, .. } => source,
        other => io::Error::other(other),
    })
}

fn lock(root: &Path, shown: &Path) -> Result<File, FolderError> {
    let path = root.join(STATE).join(LOCK);
    let lock = files::open_own(&path).map_err(FolderError::system(&path))?;
    match lock.try_lock() {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(FolderError::Busy { path: shown.to_owned() }),
        Err(TryLockError::Error(source)) => Err(FolderError::System { path, source }),
    }
}

/// Returns true if a relative path stays below its starting folder, lexically.
fn is_inside(path: &Path) -> bool {
    path.components().all(|part| matches!(part, Component::Normal(_)))
}

fn is_absent(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}
