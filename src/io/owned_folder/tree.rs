//! Content below a folder; links are never followed.

use std::fs;
use std::path::{Path, PathBuf};

use super::FolderError;
use crate::io::IoError;

/// Files, links and the like below a folder, relative to it, ascending; links are not followed.
pub(super) fn files_below(folder: &Path) -> Result<Vec<PathBuf>, FolderError> {
    let mut found = Vec::new();
    for inside in std::iter::once(folder.to_owned()).chain(folders_below(folder)?) {
        for entry in fs::read_dir(&inside).map_err(IoError::system("read", &inside))? {
            let entry = entry.map_err(IoError::system("read", &inside))?;
            if !entry.file_type().map_err(IoError::system("read", &inside))?.is_dir() {
                let path = entry.path();
                found.push(path.strip_prefix(folder).unwrap_or(&path).to_owned());
            }
        }
    }
    found.sort();
    Ok(found)
}

pub(super) fn files_below_if_any(folder: &Path) -> Result<Vec<PathBuf>, FolderError> {
    if is_real_folder(folder) { files_below(folder) } else { Ok(Vec::new()) }
}

/// Folders below a folder, parents before their children.
pub(super) fn folders_below(folder: &Path) -> Result<Vec<PathBuf>, FolderError> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(inside) = open.pop() {
        for entry in fs::read_dir(&inside).map_err(IoError::system("read", &inside))? {
            let entry = entry.map_err(IoError::system("read", &inside))?;
            if entry.file_type().map_err(IoError::system("read", &inside))?.is_dir() {
                found.push(entry.path());
                open.push(entry.path());
            }
        }
    }
    Ok(found)
}

pub(super) fn is_link(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|found| found.file_type().is_symlink())
}

pub(super) fn is_real_folder(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|found| found.is_dir())
}
