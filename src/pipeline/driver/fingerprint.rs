//! Fingerprints of results: hashes of everything that a result depends on. Equal ones mean that it can be reused.

use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::files;
use crate::pipeline::{PipelineError, Result, Stage};

/// Hash of anything that can be written as JSON, and of the code: a program built from other sources has another one.
pub(in crate::pipeline) fn of_value(value: &impl Serialize) -> String {
    of_value_in(crate::VERSION, value)
}

fn of_value_in(version: &str, value: &impl Serialize) -> String {
    let text = serde_json::to_vec(&(version, value)).expect("options and hashes have string keys and finite numbers");
    hex(&Sha256::digest(&text))
}

/// Hash of everything that a stage's result is made from: what it depends on by itself, and the fingerprints of the
/// stages that it builds on.
pub(in crate::pipeline) fn of_stage(stage: Stage, cache_key: &Value, upstream: &[&str]) -> String {
    of_value(&json!([stage, cache_key, upstream]))
}

/// Hash of the content of a file, or of the names and contents of the files directly in a folder, hidden ones aside.
/// Where it lies and when it was written does not matter.
///
/// # Errors
/// [`PipelineError::Unreadable`] names the file.
pub(in crate::pipeline) fn of_content(path: &Path) -> Result<String> {
    let unreadable = |source| PipelineError::Unreadable { path: path.to_owned(), source };
    if !path.is_dir() {
        return of_file(path).map_err(unreadable);
    }
    let mut names = Vec::new();
    for entry in fs::read_dir(path).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        if entry.path().is_file() && !hidden {
            names.push(entry.file_name());
        }
    }
    names.sort();
    let mut hasher = Sha256::new();
    for name in names {
        let file = path.join(&name);
        let hash = of_file(&file).map_err(|source| PipelineError::Unreadable { path: file, source })?;
        hasher.update(name.as_encoded_bytes());
        hasher.update([0]);
        hasher.update(hash);
    }
    Ok(hex(&hasher.finalize()))
}

/// As [`of_content`], of several files or folders together, in their order.
///
/// # Errors
/// As [`of_content`].
pub(in crate::pipeline) fn of_files(paths: &[PathBuf]) -> Result<String> {
    if let [only] = paths {
        return of_content(only);
    }
    let mut hasher = Sha256::new();
    for path in paths {
        hasher.update(path.file_name().unwrap_or_default().as_encoded_bytes());
        hasher.update([0]);
        hasher.update(of_content(path)?);
    }
    Ok(hex(&hasher.finalize()))
}

fn of_file(path: &Path) -> io::Result<String> {
    let mut file = files::open(path)?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        let count = file.read(&mut buffer)?;
        if count == 0 {
            return Ok(hex(&hasher.finalize()));
        }
        hasher.update(&buffer[..count]);
    }
}

/// Name of a folder of the run's own for the results of a fingerprint: the prefix and the fingerprint's beginning.
pub(in crate::pipeline) fn folder_name(prefix: &str, fingerprint: &str) -> String {
    format!("{prefix}{}", fingerprint.get(..16).unwrap_or_default())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_of_other_sources_has_other_fingerprints() {
        let of = |version: &str| of_value_in(version, &json!([Stage::Scale, { "ratio": 1.5 }]));
        assert_eq!(of("0.1.0+0123456789ab"), of("0.1.0+0123456789ab"));
        assert_ne!(of("0.1.0+0123456789ab"), of("0.1.0+ba9876543210"));
        assert_eq!(of(crate::VERSION), of_value(&json!([Stage::Scale, { "ratio": 1.5 }])));
    }

    #[test]
    fn content_counts_and_place_does_not() {
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
