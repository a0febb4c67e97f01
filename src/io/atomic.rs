//! Atomic file writes: a file appears under its name only when it is complete and on the disk.
//!
//! A file is written under a temporary name in the folder where it belongs (a rename is atomic only within one file
//! system), flushed, synchronized, renamed, and then the folder is synchronized, since power can fail at any moment. A
//! process that is killed can leave a temporary file behind, never half of a real one; [`remove_leftovers`] clears
//! them. Files prepared in a folder without a final place (`UNPLACED`) are synchronized once, as a whole, by the code
//! that moves the folder to its place. Whole folders, and files next to foreign ones, are written by
//! [`OwnedFolder`](super::OwnedFolder).

use std::fs::{self, File, Permissions};
use std::io::{BufWriter, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tempfile::{Builder, NamedTempFile};

use super::IoError;

/// Prefix of temporary names, not used by any other file of an output folder.
const TEMPORARY_PREFIX: &str = ".tractrix-";

/// Prefix of a preparation folder without a final place; it is ignored after a power failure.
pub(super) const UNPLACED: &str = ".tractrix-new-";

/// Writes a whole file, replacing an existing one. Missing parent folders are created.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), IoError> {
    write_with(path, |out| out.write_all(bytes))
}

/// Writes a value as indented JSON, ending in a newline.
///
/// # Errors
/// As [`write()`]; [`IoError::Content`] if the value cannot be represented in JSON.
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<(), IoError> {
    let mut text = serde_json::to_vec_pretty(value).map_err(|e| IoError::content(path, e.to_string()))?;
    text.push(b'\n');
    write(path, &text)
}

/// Writes a file through `fill`, which gets a buffered writer; it replaces `path` only on success.
pub fn write_with(path: &Path, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<(), IoError> {
    let mut file = temporary_file(path)?;
    let written = {
        let mut buffered = BufWriter::new(file.as_file_mut());
        fill(&mut buffered).and_then(|()| buffered.flush())
    };
    written.map_err(IoError::system("write", path))?;
    put(file, path)
}

/// As [`write_with`], through `fill`, which gets the name of an empty file to open and fill.
#[cfg(feature = "database")]
pub fn write_through(path: &Path, fill: impl FnOnce(&Path) -> Result<(), IoError>) -> Result<(), IoError> {
    let file = temporary_file(path)?;
    fill(file.path())?;
    put(file, path)
}

/// Creates an empty file under a temporary name in the folder of `path`.
fn temporary_file(path: &Path) -> Result<NamedTempFile, IoError> {
    let folder = parent(path);
    create_folders(folder)?;
    let mut builder = Builder::new();
    // The process's umask applies to these, as for any new file.
    builder.prefix(TEMPORARY_PREFIX).permissions(Permissions::from_mode(0o666));
    builder.tempfile_in(folder).map_err(IoError::system("write into", folder))
}

fn put(file: NamedTempFile, path: &Path) -> Result<(), IoError> {
    if has_place(path) {
        file.as_file().sync_all().map_err(IoError::system("write", path))?;
    }
    file.persist(path).map_err(|e| IoError::system("replace", path)(e.error))?;
    sync_placed(parent(path))
}

fn has_place(path: &Path) -> bool {
    !path.components().any(|part| part.as_os_str().as_encoded_bytes().starts_with(UNPLACED.as_bytes()))
}

/// Synchronizes a folder whose content has its final place.
fn sync_placed(folder: &Path) -> Result<(), IoError> {
    if has_place(folder) { sync_folder(folder) } else { Ok(()) }
}

/// Removes a file, if it exists, so that it does not reappear after a power failure.
///
/// # Errors
/// [`IoError::System`] names the file.
pub fn remove(path: &Path) -> Result<(), IoError> {
    removed(path, fs::remove_file(path))
}

/// As [`remove`], for a folder with all its content.
///
/// # Errors
/// As [`remove`].
pub fn remove_folder(path: &Path) -> Result<(), IoError> {
    removed(path, fs::remove_dir_all(path))
}

fn removed(path: &Path, result: std::io::Result<()>) -> Result<(), IoError> {
    match result {
        Ok(()) => sync_folder(parent(path)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(IoError::system("remove", path)(error)),
    }
}

/// Returns true if a name is that of an incomplete file.
pub(super) fn is_temporary(name: &str) -> bool {
    name.starts_with(TEMPORARY_PREFIX)
}

/// Creates a folder and its missing parents, so that they survive a power failure.
///
/// # Errors
/// [`IoError::System`] names the folder that cannot be created.
pub fn create_folders(folder: &Path) -> Result<(), IoError> {
    if folder.is_dir() {
        return Ok(());
    }
    let above = parent(folder);
    if above != folder {
        create_folders(above)?;
    }
    match fs::create_dir(folder) {
        // Another thread may have been faster.
        Err(_) if folder.is_dir() => Ok(()),
        Err(error) => Err(IoError::system("create", folder)(error)),
        Ok(()) => sync_placed(above),
    }
}

/// Removes temporary files and folders of a killed process in `folder` and below it; returns their number. Links are
/// not followed.
///
/// No other process may be writing there.
pub fn remove_leftovers(folder: &Path) -> Result<usize, IoError> {
    let mut removed = 0;
    for entry in fs::read_dir(folder).map_err(IoError::system("read", folder))? {
        let entry = entry.map_err(IoError::system("read", folder))?;
        let path = entry.path();
        let is_folder = entry.file_type().map_err(IoError::system("read", &path))?.is_dir();
        if !is_temporary(&entry.file_name().to_string_lossy()) {
            removed += if is_folder { remove_leftovers(&path)? } else { 0 };
            continue;
        }
        let result = if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        result.map_err(IoError::system("remove", &path))?;
        removed += 1;
    }
    Ok(removed)
}

fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

pub(super) fn sync_folder(folder: &Path) -> Result<(), IoError> {
    match File::open(folder).and_then(|f| f.sync_all()) {
        // A folder with write but no read permission cannot be synchronized.
        Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => Ok(()),
        done => done.map_err(IoError::system("synchronise", folder)),
    }
}

pub(super) fn sync_tree(folder: &Path) -> Result<(), IoError> {
    for entry in fs::read_dir(folder).map_err(IoError::system("read", folder))? {
        let path: PathBuf = entry.map_err(IoError::system("read", folder))?.path();
        if path.is_dir() {
            sync_tree(&path)?;
        } else {
            sync_folder(&path)?;
        }
    }
    sync_folder(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/er/file.txt");
        write(&path, b"first").unwrap();
        let failed = write_with(&path, |out| {
            out.write_all(b"half of the sec")?;
            Err(std::io::Error::other("the cable came off"))
        });
        assert!(matches!(failed, Err(IoError::System { action: "write", .. })));
        assert_eq!(fs::read(&path).unwrap(), b"first");
        write(&path, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(names(path.parent().unwrap()), ["file.txt"]);
        assert_ne!(fs::metadata(&path).unwrap().permissions().mode() & 0o044, 0, "others may read results");
    }

    #[test]
    fn leftovers_of_a_killed_process_go_and_nothing_else_does() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join(".tractrix-x1")).unwrap();
        fs::write(folder.path().join(".tractrix-x1/part"), "x").unwrap();
        fs::write(folder.path().join(".tractrix-x2"), "x").unwrap();
        fs::write(folder.path().join("kept"), "x").unwrap();
        fs::create_dir_all(folder.path().join("deep/er")).unwrap();
        fs::write(folder.path().join("deep/er/.tractrix-x3"), "x").unwrap();
        assert_eq!(remove_leftovers(folder.path()).unwrap(), 3);
        assert_eq!(names(folder.path()), ["deep", "kept"]);
        assert!(names(&folder.path().join("deep/er")).is_empty());
    }

    #[test]
    fn only_files_with_a_final_place_are_synchronized_individually() {
        assert!(
            ["out/run.json", "out/.tractrix/frames.json", "tmp/.tractrix-x1"].map(Path::new).map(has_place)
                == [true; 3]
        );
        assert!(!has_place(Path::new("out/.tractrix/tmp/.tractrix-new-x1y2/new/1/000000.jpg.png")));
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let blocked = folder.path().join("file");
        fs::write(&blocked, "x").unwrap();
        let error = write(&blocked.join("below"), b"x").unwrap_err();
        assert!(error.to_string().contains("file"), "{error}");
    }
}
