//! The list of jobs: which videos there are, what each is called, and which options it has of its own.
//!
//! A line is a video or a folder of pictures; after a tab, options of its own follow, as on the command line of `run`.
//! A folder instead of a list stands for the videos in it, in the order of their names.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::words;
use crate::cli::output::Failure;
use crate::limits::files;

/// What a file's name ends in that is a video, in lower case.
const VIDEOS: [&str; 18] = [
    "3gp", "asf", "avi", "dv", "flv", "m2ts", "m4v", "mkv", "mov", "mp4", "mpeg", "mpg", "mts", "mxf", "ogv", "ts",
    "webm", "wmv",
];
/// The longest name of an output folder, bytes; file systems allow 255.
const MAX_NAME_BYTES: usize = 200;

/// One job of a list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    /// The line it stands in, from 1; the place of a video in a folder.
    pub(super) line: usize,
    /// What its output folder is called.
    pub(super) name: String,
    /// The video, or the folder of pictures.
    pub(super) input: PathBuf,
    /// Options of its own.
    pub(super) words: Vec<String>,
}

/// The jobs of a list, or of a folder of videos, in order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct List {
    /// The list, or the folder.
    pub(super) path: PathBuf,
    /// Where relative paths of the list begin.
    pub(super) folder: PathBuf,
    /// The jobs; never none.
    pub(super) entries: Vec<Entry>,
}

impl List {
    /// Reads a list, or looks what there is in a folder.
    ///
    /// # Errors
    /// Wrong use: a line that cannot be meant, two jobs of one name, a name that no folder can have, or no job at all.
    pub(super) fn open(path: &Path) -> Result<Self, Failure> {
        let (folder, entries) = match path.is_dir() {
            true => (path.to_owned(), videos_in(path)?),
            false => {
                files::check(path).with_context(|| format!("{}: cannot be read", path.display()))?;
                let bytes = fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
                let folder = path.parent().unwrap_or(Path::new("")).to_owned();
                (folder.clone(), entries(&bytes, &folder).map_err(|(line, wrong)| at(path, line, &wrong))?)
            }
        };
        let list = Self { path: path.to_owned(), folder, entries };
        list.check()?;
        Ok(list)
    }

    fn check(&self) -> Result<(), Failure> {
        if self.entries.is_empty() {
            let wanted = if self.path.is_dir() { "no video in it" } else { "no video is named in it" };
            return Err(Failure::Usage(format!("{}: {wanted}", self.path.display())));
        }
        let mut lines: BTreeMap<&str, usize> = BTreeMap::new();
        for entry in &self.entries {
            check_name(&entry.name).map_err(|wrong| at(&self.path, entry.line, &wrong))?;
            if let Some(first) = lines.insert(&entry.name, entry.line) {
                let wrong = format!(
                    "its results would lie in '{}', as those of line {first}; give it a name of its own: after the \
                     video a tab and --name NAME",
                    entry.name
                );
                return Err(at(&self.path, entry.line, &wrong));
            }
        }
        Ok(())
    }

    /// The job of an index.
    ///
    /// # Errors
    /// Wrong use: there is none.
    pub(super) fn entry(&self, index: usize) -> Result<&Entry, Failure> {
        let number = self.entries.len();
        self.entries.get(index).ok_or_else(|| {
            let path = self.path.display();
            Failure::Usage(format!("--index {index}: {path} has {number} jobs, 0 to {}", number - 1))
        })
    }
}

/// What is wrong with a line.
pub(super) fn at(list: &Path, line: usize, wrong: &str) -> Failure {
    match list.is_dir() {
        true => Failure::Usage(format!("{}: video {line}: {wrong}", list.display())),
        false => Failure::Usage(format!("{}: line {line}: {wrong}", list.display())),
    }
}

/// The jobs of a list's bytes; of a line that cannot be meant, its number and what is wrong.
fn entries(bytes: &[u8], folder: &Path) -> Result<Vec<Entry>, (usize, String)> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let lines = bytes.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii).enumerate();
    let meant = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with(b"#"));
    meant.map(|(k, line)| entry(k + 1, line, folder).map_err(|wrong| (k + 1, wrong))).collect()
}

fn entry(number: usize, line: &[u8], folder: &Path) -> Result<Entry, String> {
    let (video, options) = match line.iter().position(|&byte| byte == b'\t') {
        Some(tab) => (line[..tab].trim_ascii(), &line[tab + 1..]),
        None => (line, &[][..]),
    };
    let options = std::str::from_utf8(options).map_err(|_| "the options are not UTF-8")?;
    let mut words = words::split(options)?;
    let input = folder.join(OsStr::from_bytes(video));
    let name = match words::take_value(&mut words, "--name")? {
        Some(name) => name,
        None => name_of(&input).ok_or("no name can be made of this path; after it give a tab and --name NAME")?,
    };
    Ok(Entry { line: number, name, input, words })
}

/// What the results of a video are called: its file's name without the ending, that of a folder as it is.
fn name_of(input: &Path) -> Option<String> {
    let name = if is_video(input) { input.file_stem() } else { input.file_name() };
    name.and_then(OsStr::to_str).map(str::to_owned)
}

fn is_video(path: &Path) -> bool {
    let ending = path.extension().and_then(OsStr::to_str).unwrap_or_default().to_lowercase();
    VIDEOS.contains(&ending.as_str())
}

fn videos_in(folder: &Path) -> Result<Vec<Entry>, Failure> {
    let unreadable = || format!("{}: cannot be read", folder.display());
    let mut names: Vec<OsString> = Vec::new();
    for found in fs::read_dir(folder).with_context(unreadable)? {
        let found = found.with_context(unreadable)?;
        let is_hidden = found.file_name().as_bytes().starts_with(b".");
        if !is_hidden && is_video(&found.path()) && found.path().is_file() {
            names.push(found.file_name());
        }
    }
    names.sort();
    let entry = |(k, name): (usize, OsString)| {
        let input = folder.join(&name);
        let name = name_of(&input).ok_or_else(|| at(folder, k + 1, "its name is not UTF-8; rename it"))?;
        Ok(Entry { line: k + 1, name, input, words: Vec::new() })
    };
    names.into_iter().enumerate().map(entry).collect()
}

fn check_name(name: &str) -> Result<(), String> {
    let wrong = match name {
        "" => "has no letter",
        _ if name.starts_with('.') => "begins with a dot",
        _ if name.contains('/') => "has a slash in it",
        _ if name.chars().any(char::is_control) => "has characters that cannot be shown",
        _ if name.len() > MAX_NAME_BYTES => "is too long",
        _ => return Ok(()),
    };
    Err(format!("no folder can be called {name:?}, which {wrong}; after the video give a tab and --name NAME"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn list(text: &[u8]) -> Result<List, Failure> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("list.txt");
        fs::write(&path, text).unwrap();
        List::open(&path)
    }

    fn names(list: &List) -> Vec<&str> {
        list.entries.iter().map(|entry| entry.name.as_str()).collect()
    }

    fn refusal(text: &[u8]) -> String {
        match list(text) {
            Err(Failure::Usage(said)) => said,
            other => panic!("not refused as wrong use: {other:?}"),
        }
    }

    #[test]
    fn comments_empty_lines_and_marks_of_other_systems_are_passed_over() {
        let list = list(b"\xef\xbb\xbf# flights\r\n\r\nday 1/a b.MP4\r\n  c.mov\t--end 8f\n\nframes.v2").unwrap();
        assert_eq!(names(&list), ["a b", "c", "frames.v2"]);
        assert_eq!(list.entries.iter().map(|entry| entry.line).collect::<Vec<_>>(), [3, 4, 6]);
        assert_eq!(list.entries[0].input, list.folder.join("day 1/a b.MP4"));
        assert_eq!(list.entries[1].words, ["--end", "8f"]);
    }

    #[test]
    fn an_absolute_path_stays_and_a_name_can_be_given() {
        let list = list(b"/data/a.mp4\n/other/a.mp4\t--name other --seed 3").unwrap();
        assert_eq!(names(&list), ["a", "other"]);
        assert_eq!(list.entries[1].input, Path::new("/other/a.mp4"));
        assert_eq!(list.entries[1].words, ["--seed", "3"]);
    }

    #[test]
    fn what_cannot_be_is_said_with_its_line() {
        let twice = refusal(b"x/DJI_1.MP4\n# x\ny/DJI_1.MOV\n");
        assert!(twice.contains("line 3") && twice.contains("line 1") && twice.contains("--name"), "{twice}");
        for (text, word) in [
            (&b".mp4"[..], "dot"),
            (b"a/..", "--name"),
            (b"a.mp4\t--name x/y", "slash"),
            (b"a.mp4\t--name 'x", "quotation"),
            (b"# nothing\n", "no video"),
            (b"", "no video"),
        ] {
            assert!(refusal(text).contains(word), "{}", refusal(text));
        }
        assert!(refusal(&[b'a'; 300]).contains("too long"));
    }

    proptest! {
        #[test]
        fn of_any_bytes_every_job_has_a_line_and_a_name(
            bytes in prop::collection::vec(
                prop_oneof![any::<u8>(), prop::sample::select(b"a/.\t\n\r #'\"-=".to_vec())], 0..80
            ),
        ) {
            let num_lines = bytes.split(|&byte| byte == b'\n').count();
            if let Ok(list) = list(&bytes) {
                let is_whole = |entry: &Entry| (1..=num_lines).contains(&entry.line) && check_name(&entry.name).is_ok();
                prop_assert!(!list.entries.is_empty() && list.entries.iter().all(is_whole), "{list:?}");
            }
        }
    }

    #[test]
    fn a_folder_is_its_videos_in_order() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b.mp4", "A.MKV", "notes.txt", ".c.mp4"] {
            fs::write(folder.path().join(name), b"").unwrap();
        }
        fs::create_dir(folder.path().join("d.mp4")).unwrap();
        let list = List::open(folder.path()).unwrap();
        assert_eq!(names(&list), ["A", "b"]);
        assert!(list.entry(1).is_ok());
        assert!(matches!(list.entry(2), Err(Failure::Usage(said)) if said.contains("0 to 1")));
    }
}
