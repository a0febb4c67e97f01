//! Whole files or none: what is written appears under its name only when it is complete and on the disk.
//!
//! A file is written under a temporary name in the folder where it belongs (a rename is atomic only within one file
//! system), flushed, synchronised, renamed, and then the folder is synchronised, since power can fail at any moment. A
//! folder is filled beside its place and renamed as one. A process that is killed can leave a temporary file or folder
//! behind, never half of a real one; [`remove_leftovers`] clears them.

use std::fs::{self, File, Permissions};
use std::io::{BufWriter, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tempfile::Builder;

use super::IoError;

/// How temporary names begin; nothing else in an output folder does.
const TEMPORARY_PREFIX: &str = ".tractrix-";

/// Writes a whole file, replacing one that is there. Missing folders above it are made.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), IoError> {
    write_with(path, |out| out.write_all(bytes))
}

/// Writes a value as indented JSON, ending in a newline.
///
/// # Errors
/// As [`write()`]; [`IoError::Content`] if the value cannot be JSON.
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<(), IoError> {
    let mut text = serde_json::to_vec_pretty(value).map_err(|e| IoError::content(path, e.to_string()))?;
    text.push(b'\n');
    write(path, &text)
}

/// Writes a file through `fill`, which gets a buffered writer; it replaces `path` only if all went well.
pub fn write_with(path: &Path, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<(), IoError> {
    let folder = parent(path);
    fs::create_dir_all(folder).map_err(IoError::system("create", folder))?;
    let mut builder = Builder::new();
    // The process's umask takes its share off these, as for any new file.
    builder.prefix(TEMPORARY_PREFIX).permissions(Permissions::from_mode(0o666));
    let mut file = builder.tempfile_in(folder).map_err(IoError::system("write into", folder))?;
    let written = {
        let mut buffered = BufWriter::new(file.as_file_mut());
        fill(&mut buffered).and_then(|()| buffered.flush())
    };
    written.and_then(|()| file.as_file().sync_all()).map_err(IoError::system("write", path))?;
    file.persist(path).map_err(|e| IoError::system("replace", path)(e.error))?;
    sync_folder(folder)
}

/// Fills a new folder through `fill`, which gets its temporary place, and puts it at `path`, replacing a folder that is
/// there with all that is in it.
///
/// If the power fails in the short moment between taking the old folder away and putting the new one in its place, there
/// is no folder at `path`, but never half of one.
///
/// # Errors
/// What `fill` reports, or a system error, as `E`; `path` is then what it was.
pub fn write_folder<T, E: From<IoError>>(path: &Path, fill: impl FnOnce(&Path) -> Result<T, E>) -> Result<T, E> {
    let above = parent(path);
    fs::create_dir_all(above).map_err(IoError::system("create", above))?;
    let mut builder = Builder::new();
    builder.prefix(TEMPORARY_PREFIX).permissions(Permissions::from_mode(0o777));
    let fresh = builder.tempdir_in(above).map_err(IoError::system("write into", above))?;
    let value = fill(fresh.path())?;
    sync_tree(fresh.path())?;
    // Dropping this handle removes the old folder, after the new one has taken its place.
    let _old = set_aside(path, above)?;
    fs::rename(fresh.path(), path).map_err(IoError::system("replace", path))?;
    // The folder has a new name now; its temporary name must not be removed from under whoever takes it next.
    let _ = fresh.keep();
    sync_folder(above)?;
    Ok(value)
}

/// Removes temporary files and folders that a killed process left directly in `folder`; returns how many.
///
/// No other process may be writing there.
pub fn remove_leftovers(folder: &Path) -> Result<usize, IoError> {
    let mut removed = 0;
    for entry in fs::read_dir(folder).map_err(IoError::system("read", folder))? {
        let entry = entry.map_err(IoError::system("read", folder))?;
        if !entry.file_name().to_string_lossy().starts_with(TEMPORARY_PREFIX) {
            continue;
        }
        let path = entry.path();
        let is_folder = entry.file_type().map_err(IoError::system("read", &path))?.is_dir();
        let result = if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        result.map_err(IoError::system("remove", &path))?;
        removed += 1;
    }
    Ok(removed)
}

/// Moves what is at `path` into a temporary folder beside it, if anything is there.
fn set_aside(path: &Path, above: &Path) -> Result<Option<tempfile::TempDir>, IoError> {
    if fs::symlink_metadata(path).is_err() {
        return Ok(None);
    }
    let aside =
        Builder::new().prefix(TEMPORARY_PREFIX).tempdir_in(above).map_err(IoError::system("write into", above))?;
    fs::rename(path, aside.path().join("old")).map_err(IoError::system("replace", path))?;
    Ok(Some(aside))
}

fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

fn sync_folder(folder: &Path) -> Result<(), IoError> {
    File::open(folder).and_then(|f| f.sync_all()).map_err(IoError::system("synchronise", folder))
}

fn sync_tree(folder: &Path) -> Result<(), IoError> {
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
    fn a_folder_is_replaced_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model");
        let fill = |names: &'static [&'static str]| {
            move |tmp: &Path| -> Result<(), IoError> { names.iter().try_for_each(|name| write(&tmp.join(name), b"x")) }
        };
        write_folder(&path, fill(&["a", "sub/b"])).unwrap();
        let failed: Result<(), IoError> = write_folder(&path, |tmp| {
            write(&tmp.join("c"), b"x")?;
            Err(IoError::content(tmp, "no"))
        });
        assert!(failed.is_err_and(|e| e.to_string().contains("no")));
        assert_eq!(names(&path), ["a", "sub"]);
        write_folder(&path, fill(&["d"])).unwrap();
        assert_eq!(names(&path), ["d"]);
        assert_eq!(names(folder.path()), ["model"]);
    }

    #[test]
    fn leftovers_of_a_killed_process_go_and_nothing_else_does() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join(".tractrix-x1")).unwrap();
        fs::write(folder.path().join(".tractrix-x1/part"), "x").unwrap();
        fs::write(folder.path().join(".tractrix-x2"), "x").unwrap();
        fs::write(folder.path().join("kept"), "x").unwrap();
        assert_eq!(remove_leftovers(folder.path()).unwrap(), 2);
        assert_eq!(names(folder.path()), ["kept"]);
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
