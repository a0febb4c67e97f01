//! Fingerprints of results: hashes of everything that a result depends on. Equal fingerprints allow its reuse.

use std::fs;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::files;
use crate::pipeline::{PipelineError, Result, Stage};

/// Hash of a JSON-serializable value and of the code: a program built from other sources has another hash.
pub(in crate::pipeline) fn of_value(value: &impl Serialize) -> String {
    of_value_in(crate::VERSION, value)
}

fn of_value_in(version: &str, value: &impl Serialize) -> String {
    let text = serde_json::to_vec(&(version, value)).expect("options and hashes have string keys and finite numbers");
    format!("{:x}", Sha256::digest(&text))
}

/// Hash of everything that a stage's result depends on: its cache key and the fingerprints of its upstream stages.
pub(in crate::pipeline) fn of_stage(stage: Stage, cache_key: &Value, upstream: &[&str]) -> String {
    of_value(&json!([stage, cache_key, upstream]))
}

/// Hash of the content of a file, or of the names and contents of the files directly in a folder, without hidden ones.
/// Location and modification time do not matter.
///
/// # Errors
/// [`PipelineError::Unreadable`] names the file.
pub(in crate::pipeline) fn of_content(path: &Path) -> Result<String> {
    let unreadable = |source| PipelineError::Unreadable { path: path.to_owned(), source };
    if !path.is_dir() {
        return of_file(path).map_err(unreadable);
    }
    let entries = fs::read_dir(path).map_err(unreadable)?.collect::<Result<Vec<_>, _>>().map_err(unreadable)?;
    let is_shown = |entry: &fs::DirEntry| !entry.file_name().to_string_lossy().starts_with('.');
    let mut paths: Vec<PathBuf> = entries.iter().filter(|entry| is_shown(entry)).map(fs::DirEntry::path).collect();
    paths.retain(|path| path.is_file());
    paths.sort();
    of_each(&paths)
}

/// As [`of_content`], for several files or folders together, in their order.
///
/// # Errors
/// As [`of_content`].
pub(in crate::pipeline) fn of_files(paths: &[PathBuf]) -> Result<String> {
    if let [only] = paths { of_content(only) } else { of_each(paths) }
}

fn of_each(paths: &[PathBuf]) -> Result<String> {
    let mut hasher = Sha256::new();
    for path in paths {
        hasher.update(path.file_name().unwrap_or_default().as_encoded_bytes());
        hasher.update([0]);
        hasher.update(of_content(path)?);
    }
    Ok(format!("{:x}", hasher.finalize()))
}

fn of_file(path: &Path) -> io::Result<String> {
    let mut hasher = Sha256::new();
    io::copy(&mut BufReader::with_capacity(1 << 20, files::open(path)?), &mut hasher)?;
    Ok(format!("{:x}", hasher.finalize()))
}

/// Name of a stage's folder for intermediate files: its name and the start of the fingerprint.
pub(in crate::pipeline) fn folder_name(stage: Stage, fingerprint: &str) -> String {
    format!("{stage}-{}", fingerprint.get(..16).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fingerprints_depend_on_the_sources_of_the_program() {
        let of = |version: &str| of_value_in(version, &json!([Stage::Scale, { "ratio": 1.5 }]));
        assert_eq!(of("0.1.0+0123456789ab"), of("0.1.0+0123456789ab"));
        assert_ne!(of("0.1.0+0123456789ab"), of("0.1.0+ba9876543210"));
        assert_eq!(of(crate::VERSION), of_value(&json!([Stage::Scale, { "ratio": 1.5 }])));
    }

    #[test]
    fn hashes_depend_on_content_but_not_on_location() {
        let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        for folder in [&a, &b] {
            fs::write(folder.path().join("1.png"), b"one").unwrap();
            fs::write(folder.path().join(".hidden"), folder.path().to_string_lossy().as_bytes()).unwrap();
        }
        let hash = of_content(a.path()).unwrap();
        assert_eq!(hash, of_content(b.path()).unwrap());
        fs::write(b.path().join("1.png"), b"two").unwrap();
        assert_ne!(hash, of_content(b.path()).unwrap());
        fs::rename(a.path().join("1.png"), a.path().join("2.png")).unwrap();
        assert_ne!(hash, of_content(a.path()).unwrap());
        assert!(of_content(&a.path().join("none")).is_err());
    }
}
