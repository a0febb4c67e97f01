//! Environment of the process: variables that C libraries read, and the source tree of the build.

use std::ffi::{CStr, CString, OsStr, c_char};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::atomic::{AtomicPtr, Ordering};
use std::sync::{Mutex, PoisonError};

/// Maximum number of folders between `target` and the profile's folder.
///
/// One per architecture, and one per distribution that `scripts/package` and `scripts/cross-arm64` build for.
const MAX_LEVELS_BELOW_TARGET: usize = 2;

#[allow(unsafe_code)]
unsafe extern "C" {
    /// POSIX: the variables of the process as `NAME=VALUE`, with null after the last one.
    static environ: AtomicPtr<*mut c_char>;
}

/// Sets a variable, replacing its value. Other threads may read the environment at the same time, in Rust and in C.
///
/// `setenv`, and so `std::env::set_var`, may free the list that `getenv` reads in another thread. This publishes a new
/// list and frees neither the old one nor its strings. Other changes of the environment must not happen at the same
/// time.
#[allow(unsafe_code)]
pub fn set(name: &CStr, value: &CStr) {
    static CHANGE: Mutex<()> = Mutex::new(());
    let _change = CHANGE.lock().unwrap_or_else(PoisonError::into_inner);
    let is_set = std::env::var_os(OsStr::from_bytes(name.to_bytes()));
    if is_set.is_some_and(|found| found.as_bytes() == value.to_bytes()) {
        return;
    }
    let mut prefix = name.to_bytes().to_vec();
    prefix.push(b'=');
    let mut variables = Vec::new();
    // SAFETY: by POSIX, `environ` is null, or a null-terminated list of C strings. The strings are not freed before the
    // process ends, and the list only by a change of the environment, which the caller excludes.
    unsafe {
        let mut next = environ.load(Ordering::Acquire);
        while !next.is_null() && !(*next).is_null() {
            if !CStr::from_ptr(*next).to_bytes().starts_with(&prefix) {
                variables.push(*next);
            }
            next = next.add(1);
        }
    }
    let entry = CString::from_vec_with_nul([&prefix, value.to_bytes_with_nul()].concat());
    variables.extend(entry.map(CString::into_raw));
    variables.push(ptr::null_mut());
    let variables = Box::leak(variables.into_boxed_slice());
    // SAFETY: the list has the form that POSIX requires and lives until the process ends. Storing a pointer is atomic:
    // `getenv` sees the old list or the new one.
    unsafe { environ.store(variables.as_mut_ptr(), Ordering::Release) }
}

/// Sets a variable unless the user has set it; otherwise as [`set`].
pub fn set_default(name: &CStr, value: &CStr) {
    if std::env::var_os(OsStr::from_bytes(name.to_bytes())).is_none() {
        set(name, value);
    }
}

/// Source tree whose folder `target` contains an executable built by cargo; `None` if it was installed or copied.
pub fn source_tree(executable: &Path) -> Option<PathBuf> {
    let is_named = |folder: &Path, names: &[&str]| names.iter().any(|name| folder.ends_with(name));
    let mut profile = executable.parent()?;
    // Folders of tests and examples.
    if is_named(profile, &["deps", "examples"]) {
        profile = profile.parent()?;
    }
    if !is_named(profile, &["release", "debug"]) {
        return None;
    }
    let mut above = profile.ancestors().skip(1).take(1 + MAX_LEVELS_BELOW_TARGET);
    let tree = above.find(|folder| is_named(folder, &["target"]))?.parent()?;
    tree.join("Cargo.toml").is_file().then(|| tree.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_variable_is_set_while_other_threads_read_it() {
        const NAME: &str = "TRACTRIX_TEST_OF_SET";
        let name = CString::new(NAME).unwrap();
        let path = std::env::var_os("PATH");
        std::thread::scope(|scope| {
            for _ in 0..3 {
                scope.spawn(|| (0..2000).for_each(|_| drop(std::env::var_os(NAME))));
            }
            for k in 0..200 {
                set(&name, &CString::new(k.to_string()).unwrap());
                assert_eq!(std::env::var(NAME).unwrap(), k.to_string());
            }
        });
        set_default(&name, c"other");
        assert_eq!(std::env::var(NAME).unwrap(), "199");
        assert_eq!(std::env::var_os("PATH"), path, "the others stay");
        assert_eq!(std::env::vars_os().filter(|(name, _)| name == NAME).count(), 1);
        let seen_by_others = std::process::Command::new("printenv").arg(NAME).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&seen_by_others.stdout).trim(), "199");
    }

    #[test]
    fn a_source_tree_is_found_from_cargos_folders_alone() {
        let tree = tempfile::tempdir().unwrap();
        let found = |executable: &str| source_tree(&tree.path().join(executable));
        assert_eq!(found("target/release/tractrix"), None, "there is no Cargo.toml");
        std::fs::write(tree.path().join("Cargo.toml"), "").unwrap();
        for executable in [
            "target/release/tractrix",
            "target/debug/tractrix",
            "target/release/deps/safety-0123456789abcdef",
            "target/release/examples/box_masks",
            "target/aarch64-unknown-linux-gnu/release/tractrix",
            "target/arm64-bookworm/aarch64-unknown-linux-gnu/release/deps/safety-0123456789abcdef",
        ] {
            assert_eq!(found(executable).as_deref(), Some(tree.path()), "{executable}");
        }
        for executable in
            ["tractrix", "bin/tractrix", "target/tractrix", "release/tractrix", "target/release/a/tractrix"]
        {
            assert_eq!(found(executable), None, "{executable}");
        }
    }
}
