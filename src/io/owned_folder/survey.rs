//! Checks of a folder before its use, and of inputs inside it; read-only.

use std::fs;
use std::io;
use std::path::Path;

use super::manifest::Manifest;
use super::tree::{is_link, is_real_folder};
use super::{FolderError, LOCK, OwnedFolder, PathRole, PathRoles, STATE};
use crate::io::{ExportFolder, RunFolder, atomic};

/// Refuses an input in a place where the program writes in the folder `output`, with links and `..` resolved.
///
/// * `flag` – the input's flag on the command line.
///
/// # Errors
/// [`FolderError::OwnInput`].
pub fn refuse_own_input(output: &Path, places: PathRoles, flag: &str, input: &Path) -> Result<(), FolderError> {
    // A missing file cannot be overwritten; its reader reports that it is missing.
    let (Ok(output), Ok(real)) = (fs::canonicalize(output), fs::canonicalize(input)) else { return Ok(()) };
    let is_own = |real: &Path| real.strip_prefix(&output).is_ok_and(|inside| places(inside) != PathRole::Elsewhere);
    let entries = fs::read_dir(&real).into_iter().flatten().flatten();
    let mut linked = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_symlink()));
    match is_own(&real) || linked.any(|entry| fs::canonicalize(entry.path()).is_ok_and(|real| is_own(&real))) {
        true => Err(FolderError::OwnInput { flag: flag.to_owned(), input: input.to_owned() }),
        false => Ok(()),
    }
}

/// Refuses a file in a place for results of a run or an export: the next one would find a foreign file there.
///
/// # Errors
/// [`FolderError::PlaceOfResults`].
pub fn refuse_place_of_results(file: &Path) -> Result<(), FolderError> {
    let absolute = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let Some((there, real)) = absolute.ancestors().find_map(|above| Some((above, fs::canonicalize(above).ok()?)))
    else {
        return Ok(());
    };
    let real = real.join(absolute.strip_prefix(there).unwrap_or(Path::new("")));
    let kinds: [(&str, PathRoles); 2] =
        [(RunFolder::MADE_BY, RunFolder::place), (ExportFolder::MADE_BY, ExportFolder::place)];
    for folder in real.ancestors().skip(1) {
        let inside = real.strip_prefix(folder).unwrap_or(&real);
        let is_in = |(made_by, places): &(&str, PathRoles)| {
            places(inside) != PathRole::Elsewhere && OwnedFolder::is_own(folder, made_by)
        };
        if kinds.iter().any(is_in) {
            return Err(FolderError::PlaceOfResults { path: file.to_owned(), folder: folder.to_owned() });
        }
    }
    Ok(())
}

/// Searches an own folder for foreign files in the places of results.
pub(super) struct Survey<'a> {
    pub(super) root: &'a Path,
    pub(super) manifest: &'a Manifest,
    pub(super) places: PathRoles,
}

impl Survey<'_> {
    pub(super) fn run(&self) -> Result<(), FolderError> {
        let mut foreign = Vec::new();
        self.visit(Path::new(""), &mut foreign)?;
        match foreign.is_empty() {
            true => Ok(()),
            false => Err(FolderError::InTheWay { path: self.root.to_owned(), examples: some_of(&foreign) }),
        }
    }

    fn visit(&self, below: &Path, foreign: &mut Vec<String>) -> Result<(), FolderError> {
        let folder = self.root.join(below);
        let system = FolderError::system(&folder);
        for entry in fs::read_dir(&folder).map_err(&system)? {
            let entry = entry.map_err(&system)?;
            let (relative, kind) = (below.join(entry.file_name()), entry.file_type().map_err(&system)?);
            let place = (self.places)(&relative);
            if place != PathRole::Elsewhere && kind.is_symlink() {
                return Err(FolderError::Link { path: self.root.to_owned(), link: relative.display().to_string() });
            }
            match place {
                PathRole::File if !kind.is_file() || !self.manifest.files.contains(&relative) => {
                    foreign.push(relative.display().to_string());
                }
                PathRole::Folder if !kind.is_dir() => foreign.push(relative.display().to_string()),
                PathRole::Folder | PathRole::State if kind.is_dir() => self.visit(&relative, foreign)?,
                _ => {}
            }
        }
        Ok(())
    }
}

/// Checks that a folder without a manifest is empty, except for the leftovers of a process killed at its start.
pub(super) fn is_as_good_as_empty(path: &Path, made_by: &'static str) -> Result<(), FolderError> {
    let system = FolderError::system(path);
    let names = |folder: &Path| -> io::Result<Vec<String>> {
        fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned())).collect()
    };
    let mut found = names(path).map_err(&system)?;
    if found == [STATE] && is_real_folder(&path.join(STATE)) {
        let state = path.join(STATE);
        let is_first = |name: &String| (name == LOCK || atomic::is_temporary(name)) && !is_link(&state.join(name));
        if names(&state).map_err(system)?.iter().all(is_first) {
            return Ok(());
        }
    }
    if found.is_empty() {
        return Ok(());
    }
    found.sort();
    Err(FolderError::NotOwn { path: path.to_owned(), program: made_by, examples: some_of(&found) })
}

fn some_of(names: &[String]) -> String {
    // Maximum number of names in a message.
    const SHOWN: usize = 3;
    let shown = names.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    match names.len().saturating_sub(SHOWN) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}
