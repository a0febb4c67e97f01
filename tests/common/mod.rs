//! What tests of the whole program share: the program itself, and a small rendered drive.

#![allow(dead_code)] // Every test file uses its own share of this.

pub mod drive;

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use tempfile::TempDir;

/// The program.
pub fn tractrix() -> Command {
    let mut command = Command::cargo_bin("tractrix").expect("the binary is built with the tests");
    command.env_remove("TRACTRIX_LOG").env_remove("OPENCV_LOG_LEVEL");
    command
}

/// Exit code, stdout and stderr of the program. A panic fails the test, whatever else was expected.
pub fn outcome(command: &mut Command) -> (i32, String, String) {
    let output = command.output().expect("the program starts");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!stderr.contains("panicked"), "{stderr}");
    let code = output.status.code().expect("the program ends by itself");
    (code, String::from_utf8_lossy(&output.stdout).into_owned(), stderr)
}

/// A JSON file.
pub fn json(path: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// A rendered drive, and a place for results.
pub struct Place {
    pub folder: TempDir,
}

impl Place {
    pub fn new(num_frames: u32) -> Self {
        let folder = TempDir::new().unwrap();
        drive::write(folder.path(), num_frames);
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}
