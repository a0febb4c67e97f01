//! The list of jobs: which videos there are, what each is called, and which options it has of its own.
//!
//! A line is a video or a folder of pictures; after a tab, options of its own follow, as on the command line of `run`.
//! A folder instead of a list represents the videos in it, in the order of their names.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::ops::Range;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::words;
use crate::cli::output::Failure;
use crate::files;

/// Name endings of video files, in lower case.
const VIDEOS: [&str; 18] = [
    "3gp", "asf", "avi", "dv", "flv", "m2ts", "m4v", "mkv", "mov", "mp4", "mpeg", "mpg", "mts", "mxf", "ogv", "ts",
    "webm", "wmv",
];
/// The longest name of an output folder, bytes; file systems allow 255.
const MAX_NAME_BYTES: usize = 200;

/// One job of a list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    /// Number of its line, from 1; of a folder, number of the video.
    pub(super) line: usize,
    /// Name of its output folder.
    pub(super) name: String,
    /// The video, or the folder of images.
    pub(super) input: PathBuf,
    /// Options of its own.
    pub(super) words: Vec<String>,
}

/// The jobs of a list, or of a folder of videos, in order; never none. Entries are parsed when they are asked for, so
/// that a list takes little more memory than its file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct List {
    /// The list, or the folder.
    pub(super) path: PathBuf,
    folder: PathBuf,
    jobs: Jobs,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Jobs {
    /// A list's bytes, and of each line that names a job its number from 1 and its range.
    Lines(Vec<u8>, Vec<(usize, Range<usize>)>),
    /// Names of the videos in a folder.
    Videos(Vec<OsString>),
    /// The one job that the parent process gives: number and text of its line, or number and name of the video.
    Given(usize, OsString),
}

impl List {
    /// Reads a list, or looks which videos are in a folder.
    ///
    /// # Errors
    /// Wrong use: a line that cannot be meant, two jobs of one name, a name that no folder can have, or no job at all.
    pub(super) fn open(path: &Path) -> Result<Self, Failure> {
        let jobs = match path.is_dir() {
            true => Jobs::Videos(videos_in(path)?),
            false => {
                let bytes = files::read_text(path).with_context(|| format!("{}: cannot be read", path.display()))?;
                let lines = lines(&bytes);
                Jobs::Lines(bytes, lines)
            }
        };
        let list = Self { path: path.to_owned(), folder: folder(path), jobs };
        list.check()?;
        Ok(list)
    }

    /// The list of the one job that a parent process hands over, as [`Self::handed`] made it. The list itself may have
    /// changed since the parent read it.
    ///
    /// # Errors
    /// Wrong use: no such text.
    pub(super) fn of_handed(path: &Path, handed: &OsStr) -> Result<Self, Failure> {
        let bytes = handed.as_bytes();
        let parts = bytes.iter().position(|&byte| byte == b' ').map(|at| (&bytes[..at], &bytes[at + 1..]));
        let parsed = parts.and_then(|(number, text)| Some((std::str::from_utf8(number).ok()?.parse().ok()?, text)));
        let (number, text) =
            parsed.ok_or_else(|| Failure::Usage("--entry: internal flag, not for users".to_owned()))?;
        let jobs = Jobs::Given(number, OsStr::from_bytes(text).to_owned());
        Ok(Self { path: path.to_owned(), folder: folder(path), jobs })
    }

    /// A job as text, for [`Self::of_handed`] in another process.
    pub(super) fn handed(&self, index: usize) -> OsString {
        let (number, text) = match &self.jobs {
            Jobs::Lines(bytes, lines) => (lines[index].0, OsStr::from_bytes(&bytes[lines[index].1.clone()])),
            Jobs::Videos(names) => (index + 1, names[index].as_os_str()),
            Jobs::Given(number, text) => (*number, text.as_os_str()),
        };
        let mut handed = OsString::from(format!("{number} "));
        handed.push(text);
        handed
    }

    /// Number of jobs.
    pub(super) fn len(&self) -> usize {
        match &self.jobs {
            Jobs::Lines(_, lines) => lines.len(),
            Jobs::Videos(names) => names.len(),
            Jobs::Given(..) => 1,
        }
    }

    /// Folder at which relative paths of the list begin.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    fn check(&self) -> Result<(), Failure> {
        if self.len() == 0 {
            let wanted = if self.path.is_dir() { "no video in the folder" } else { "no video in the list" };
            return Err(Failure::Usage(format!("{}: {wanted}", self.path.display())));
        }
        let hashes = RandomState::new();
        let mut names = Vec::with_capacity(self.len());
        for index in 0..self.len() {
            let entry = self.entry(index)?;
            check_name(&entry.name).map_err(|wrong| at(&self.path, entry.line, &wrong))?;
            names.push((hashes.hash_one(&entry.name), index));
        }
        names.sort_unstable();
        let same_hash = names.windows(2).filter(|pair| pair[0].0 == pair[1].0);
        for (first, second) in same_hash.map(|pair| (pair[0].1, pair[1].1)) {
            let (first, second) = (self.entry(first)?, self.entry(second)?);
            if first.name == second.name {
                let wrong = format!(
                    "output folder '{}' is also that of line {}; give it another name: append a tab and --name NAME",
                    second.name, first.line
                );
                return Err(at(&self.path, second.line, &wrong));
            }
        }
        Ok(())
    }

    /// The job of an index.
    ///
    /// # Errors
    /// Wrong use: there is none, or its line cannot be meant.
    pub(super) fn entry(&self, index: usize) -> Result<Entry, Failure> {
        let parsed = match &self.jobs {
            Jobs::Lines(bytes, lines) => lines.get(index).map(|(k, range)| self.line(*k, &bytes[range.clone()])),
            Jobs::Videos(names) => names.get(index).map(|name| self.video(index + 1, name)),
            Jobs::Given(k, name) if self.path.is_dir() => Some(self.video(*k, name)),
            Jobs::Given(k, line) => Some(self.line(*k, line.as_bytes())),
        };
        parsed.unwrap_or_else(|| {
            let (path, number) = (self.path.display(), self.len());
            Err(Failure::Usage(format!("--index {index}: {path} has {number} jobs; give 0 to {}", number - 1)))
        })
    }

    fn line(&self, number: usize, line: &[u8]) -> Result<Entry, Failure> {
        entry(number, line, &self.folder).map_err(|wrong| at(&self.path, number, &wrong))
    }

    fn video(&self, number: usize, name: &OsStr) -> Result<Entry, Failure> {
        let input = self.folder.join(name);
        let name = name_of(&input).ok_or_else(|| at(&self.path, number, "file name is not UTF-8; rename it"))?;
        Ok(Entry { line: number, name, input, words: Vec::new() })
    }
}

/// Where relative paths of a list begin, or where the videos of a folder lie.
fn folder(path: &Path) -> PathBuf {
    if path.is_dir() { path.to_owned() } else { path.parent().unwrap_or(Path::new("")).to_owned() }
}

/// Failure at a line.
pub(super) fn at(list: &Path, line: usize, wrong: &str) -> Failure {
    match list.is_dir() {
        true => Failure::Usage(format!("{}: video {line}: {wrong}", list.display())),
        false => Failure::Usage(format!("{}: line {line}: {wrong}", list.display())),
    }
}

/// Number, from 1, and range of every line that names a job, without the blanks around it.
fn lines(bytes: &[u8]) -> Vec<(usize, Range<usize>)> {
    let (mut found, mut start) = (Vec::new(), 0);
    for (k, line) in bytes.split(|&byte| byte == b'\n').enumerate() {
        let (trimmed, begin) = (line.trim_ascii(), start + line.len() - line.trim_ascii_start().len());
        if !trimmed.is_empty() && !trimmed.starts_with(b"#") {
            found.push((k + 1, begin..begin + trimmed.len()));
        }
        start += line.len() + 1;
    }
    found
}

fn entry(number: usize, line: &[u8], folder: &Path) -> Result<Entry, String> {
    let (video, options) = match line.iter().position(|&byte| byte == b'\t') {
        Some(tab) => (line[..tab].trim_ascii(), &line[tab + 1..]),
        None => (line, &[][..]),
    };
    let options = std::str::from_utf8(options).map_err(|_| "options are not UTF-8")?;
    let mut words = words::split(options)?;
    let input = folder.join(OsStr::from_bytes(video));
    let name = match words::take_value(&mut words, "--name")? {
        Some(name) => name,
        None => name_of(&input).ok_or("no name can be derived from this path; append a tab and --name NAME")?,
    };
    Ok(Entry { line: number, name, input, words })
}

/// Name of a video's results: its file name without the ending; that of a folder unchanged.
fn name_of(input: &Path) -> Option<String> {
    let name = if is_video(input) { input.file_stem() } else { input.file_name() };
    name.and_then(OsStr::to_str).map(str::to_owned)
}

fn is_video(path: &Path) -> bool {
    let ending = path.extension().and_then(OsStr::to_str).unwrap_or_default().to_lowercase();
    VIDEOS.contains(&ending.as_str())
}

fn videos_in(folder: &Path) -> Result<Vec<OsString>, Failure> {
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
    Ok(names)
}

fn check_name(name: &str) -> Result<(), String> {
    let wrong = match name {
        "" => "is empty",
        _ if name.starts_with('.') => "begins with a dot",
        _ if name.contains('/') => "contains a slash",
        _ if name.chars().any(char::is_control) => "contains unprintable characters",
        _ if name.len() > MAX_NAME_BYTES => "is too long",
        _ => return Ok(()),
    };
    Err(format!("name {name:?} {wrong}; append a tab and --name NAME"))
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

    fn entries(list: &List) -> Vec<Entry> {
        (0..list.len()).map(|index| list.entry(index).unwrap()).collect()
    }

    fn names(list: &List) -> Vec<String> {
        entries(list).into_iter().map(|entry| entry.name).collect()
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
        let entries = entries(&list);
        assert_eq!(entries.iter().map(|entry| entry.line).collect::<Vec<_>>(), [3, 4, 6]);
        assert_eq!(entries[0].input, list.folder.join("day 1/a b.MP4"));
        assert_eq!(entries[1].words, ["--end", "8f"]);
    }

    #[test]
    fn an_absolute_path_stays_and_a_name_can_be_given() {
        let list = list(b"/data/a.mp4\n/other/a.mp4\t--name other --seed 3").unwrap();
        assert_eq!(names(&list), ["a", "other"]);
        let entries = entries(&list);
        assert_eq!(entries[1].input, Path::new("/other/a.mp4"));
        assert_eq!(entries[1].words, ["--seed", "3"]);
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
                let of_child = |index| List::of_handed(&list.path, &list.handed(index))?.entry(0);
                for (index, entry) in entries(&list).into_iter().enumerate() {
                    prop_assert!(is_whole(&entry), "{list:?}");
                    prop_assert_eq!(of_child(index).ok(), Some(entry));
                }
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
        fs::remove_file(folder.path().join("A.MKV")).unwrap();
        let handed = List::of_handed(folder.path(), &list.handed(1)).unwrap();
        assert_eq!(handed.entry(0).ok(), list.entry(1).ok());
    }
}
