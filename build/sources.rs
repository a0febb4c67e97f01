//! A hash of everything that the program is built from.
//!
//! Stages are reused only by the code that made them: the hash is part of their fingerprints.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// Files and folders whose content decides the program's behavior, relative to the package's folder.
pub const PATHS: [&str; 3] = ["src", "Cargo.toml", "Cargo.lock"];

/// Characters of the hash: 48 bits, so that two builds of one user's do not collide.
const HASH_CHARACTERS: usize = 12;

/// Hashes names and contents of the files in [`PATHS`]; those that do not exist are skipped (a packaged crate may have
/// no `Cargo.lock`).
///
/// # Errors
/// If a file or folder cannot be read.
pub fn hash(root: &Path) -> io::Result<String> {
    let mut files = Vec::new();
    for path in PATHS.iter().map(|path| root.join(path)).filter(|path| path.exists()) {
        collect(path, &mut files)?;
    }
    files.sort();
    let mut hasher = Sha256::new();
    for file in files {
        let content = fs::read(&file)?;
        hasher.update(file.strip_prefix(root).unwrap_or(&file).as_os_str().as_encoded_bytes());
        hasher.update([0]);
        hasher.update((content.len() as u64).to_le_bytes());
        hasher.update(content);
    }
    let hash: String = hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(hash[..HASH_CHARACTERS].to_owned())
}

fn collect(path: PathBuf, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if !path.is_dir() {
        files.push(path);
        return Ok(());
    }
    for entry in fs::read_dir(path)? {
        collect(entry?.path(), files)?;
    }
    Ok(())
}
