//! Which folders are sequences, and what their vehicles and trajectories are called.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::cli::output::Failure;
use crate::io::{PathRole, RunFolder, Sequence};

/// The folders of a data set.
pub(in crate::cli) struct SequenceFolders {
    /// Those with a `scene.json` that were asked for, by name.
    pub(in crate::cli) sequences: Vec<PathBuf>,
    /// Names of those without.
    pub(in crate::cli) left_out: Vec<String>,
}

/// The sequences in a folder, those alone whose name has one of `only` in it, if any are given. The results' own folder
/// and hidden ones are no sequences.
///
/// # Errors
/// A folder that cannot be read, or in which nothing is left.
pub(in crate::cli) fn find(folder: &Path, only: &[String], output: &Path) -> Result<SequenceFolders, Failure> {
    let entries = fs::read_dir(folder)
        .with_context(|| format!("{}: cannot be read; give the folder of all sequences", folder.display()))?;
    let own = output.canonicalize().ok();
    let mut found = SequenceFolders { sequences: Vec::new(), left_out: Vec::new() };
    let mut num_sequences = 0;
    for entry in entries {
        let path = entry.with_context(|| format!("{}: cannot be read", folder.display()))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if !path.is_dir() || name.starts_with('.') || (own.is_some() && path.canonicalize().ok() == own) {
            continue;
        }
        if !path.join("scene.json").is_file() {
            found.left_out.push(name);
            continue;
        }
        num_sequences += 1;
        if only.is_empty() || only.iter().any(|text| name.contains(text.as_str())) {
            found.sequences.push(path);
        }
    }
    found.sequences.sort();
    found.left_out.sort();
    let problem = match (num_sequences, found.sequences.len()) {
        (0, _) if folder.join("scene.json").is_file() => {
            "this is a sequence itself; give the folder that contains it, and its name with --only".to_owned()
        }
        (0, _) => "no folder in it has a scene.json; render sequences first".to_owned(),
        (_, 0) => format!("no sequence name contains {}", only.join(" or ")),
        _ => return Ok(found),
    };
    Err(anyhow::anyhow!("{}: {problem}", folder.display()).into())
}

/// Role of a path in the folder of a benchmark or a calibration, besides the runs' own output folders.
///
/// * `is_own` – true for the names of its files.
pub(in crate::cli) fn role(relative: &Path, is_own: impl Fn(&str) -> bool) -> PathRole {
    let parts: Vec<_> = relative.iter().filter_map(|part| part.to_str()).collect();
    match parts[..] {
        [] => PathRole::Folder,
        [RunFolder::STATE, ..] => PathRole::State,
        [name] if is_own(name) => PathRole::File,
        _ => PathRole::Elsewhere,
    }
}

/// Vehicle and trajectory of a sequence: as its `scene.json` says, else from `<trajectory>_<vehicle>`, which folders
/// are called, else the folder's name.
pub(in crate::cli) fn names(folder: &str, sequence: Option<&Sequence>) -> (String, String) {
    let vehicle = sequence.and_then(|s| s.vehicle.as_deref());
    let trajectory = sequence.and_then(|s| s.trajectory.as_deref());
    let before = |vehicle: &str| folder.strip_suffix(vehicle)?.strip_suffix('_');
    let after = |trajectory: &str| folder.strip_prefix(trajectory)?.strip_prefix('_');
    // A sequence that cannot even be read keeps its place in the table.
    let parts = || folder.rsplit_once('_').filter(|(before, after)| !before.is_empty() && !after.is_empty());
    let (trajectory, vehicle) = match (trajectory, vehicle) {
        (Some(trajectory), Some(vehicle)) => (trajectory, vehicle),
        (None, Some(vehicle)) => (before(vehicle).unwrap_or(folder), vehicle),
        (Some(trajectory), None) => (trajectory, after(trajectory).unwrap_or(folder)),
        (None, None) => parts().unwrap_or((folder, folder)),
    };
    (vehicle.to_owned(), trajectory.to_owned())
}
