//! The same seed gives the same bytes, and a second thread changes nothing.

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use common::{drive, outcome, tractrix};
use tempfile::TempDir;

/// A drive, and what is done with it.
struct Place {
    folder: TempDir,
}

impl Place {
    fn new(num_frames: u32) -> Self {
        let folder = TempDir::new().unwrap();
        drive::write(folder.path(), num_frames);
        Self { folder }
    }

    /// What a command writes, by file name; times are left out.
    fn files(&self, command: &str, output: &str, more: &[&str]) -> BTreeMap<PathBuf, Vec<u8>> {
        let path = |name: &str| self.folder.path().join(name).display().to_string();
        let intrinsics = drive::intrinsics();
        let (images, masks, ground, out) = (path("images"), path("masks"), path("ground"), path(output));
        let mut arguments = vec![command, &images, "--output", &out, "--masks", &masks, "--intrinsics", &intrinsics];
        if command == "run" {
            arguments.extend(["--ground-masks", &ground]);
        }
        arguments.extend(more);
        let (code, _, stderr) = outcome(tractrix().args(arguments));
        assert_eq!(code, 0, "{stderr}");
        let mut files = BTreeMap::new();
        collect(&self.folder.path().join(output), Path::new(""), &mut files);
        files
    }
}

fn collect(root: &Path, below: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(root.join(below)).unwrap() {
        let name = below.join(entry.unwrap().file_name());
        let tells_times = [".tractrix", "run.json", "report.html"].iter().any(|own| name == Path::new(own));
        if tells_times {
            continue;
        }
        if root.join(&name).is_dir() {
            collect(root, &name, files);
        } else {
            files.insert(name.clone(), fs::read(root.join(&name)).unwrap());
        }
    }
}

fn assert_same(a: &BTreeMap<PathBuf, Vec<u8>>, b: &BTreeMap<PathBuf, Vec<u8>>, what: &str) {
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>(), "{what}");
    let different: Vec<_> = a.iter().filter(|(name, bytes)| b[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(different.is_empty(), "{what}: {different:?} differ");
}

#[test]
fn a_run_gives_the_same_bytes_again_and_on_two_threads() {
    let place = Place::new(24);
    let one = place.files("run", "one", &["--threads", "1", "--seed", "7"]);
    for file in ["background/points3D.txt", "objects/1/images.txt", "trajectories.json"] {
        assert!(one.contains_key(Path::new(file)), "{file} is missing of {:?}", one.keys());
    }
    assert_same(&one, &place.files("run", "again", &["--threads", "1", "--seed", "7"]), "again");
    assert_same(&one, &place.files("run", "two", &["--threads", "2", "--seed", "7"]), "two threads");
}

#[test]
fn photographs_give_the_same_bytes_again_and_on_two_threads() {
    let place = Place::new(12);
    let flags = |threads| ["--features", "sift", "--order", "none", "--threads", threads];
    let one = place.files("sfm", "one", &flags("1"));
    assert!(one.contains_key(Path::new("background/points3D.txt")), "{:?}", one.keys());
    assert_same(&one, &place.files("sfm", "again", &flags("1")), "again");
    assert_same(&one, &place.files("sfm", "two", &flags("2")), "two threads");
}

#[test]
fn another_seed_is_another_run() {
    let place = Place::new(12);
    let of = |seed| place.files("sfm", seed, &["--features", "sift", "--order", "none", "--seed", seed]);
    let (one, two) = (of("1"), of("2"));
    let points = |files: &BTreeMap<PathBuf, Vec<u8>>| files[Path::new("background/points3D.txt")].clone();
    assert!(points(&one) != points(&two), "the seed does not reach the robust estimators");
}
