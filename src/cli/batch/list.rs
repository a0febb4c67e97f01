//! The list of jobs: which videos there are, what each is called, and which options it has of its own.
//!
//! A line is a video or a folder of pictures; after a tab, options of its own follow, as on the command line of `run`.
//! A folder instead of a list represents the videos in it, in the order of their names.

use std::collections::HashMap;
use std::ffi::{OsStr, OsString};
use std::fs;
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
    /// Its line, or the name of the video.
    text: OsString,
}

/// The jobs of a list, or of a folder of videos, in order; never none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct List {
    /// The list, or the folder.
    pub(super) path: PathBuf,
    folder: PathBuf,
    entries: Vec<Entry>,
}

impl List {
    /// Reads a list, or looks which videos are in a folder.
    ///
    /// # Errors
    /// Wrong use: a line that cannot be meant, two jobs of one name, a name that no folder can have, or no job at all.
    pub(super) fn open(path: &Path) -> Result<Self, Failure> {
        let mut list = Self::without_jobs(path);
        if path.is_dir() {
            let names = (1..).zip(videos_in(path)?);
            list.entries = names.map(|(number, name)| list.video(number, &name)).collect::<Result<_, _>>()?;
        } else {
            let bytes = files::read_text(path).with_context(|| format!("{}: cannot be read", path.display()))?;
            let lines = lines(&bytes).map(|(number, line)| list.line(number, line));
            list.entries = lines.collect::<Result<_, _>>()?;
        }
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
        let mut list = Self::without_jobs(path);
        let entry = if path.is_dir() { list.video(number, OsStr::from_bytes(text)) } else { list.line(number, text) };
        list.entries = vec![entry?];
        Ok(list)
    }

    fn without_jobs(path: &Path) -> Self {
        // Relative paths begin at the folder of a list.
        let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
        Self { path: path.to_owned(), folder: folder.to_owned(), entries: Vec::new() }
    }

    /// A job as text, for [`Self::of_handed`] in another process.
    pub(super) fn handed(&self, index: usize) -> OsString {
        let Entry { line, text, .. } = &self.entries[index];
        let mut handed = OsString::from(format!("{line} "));
        handed.push(text);
        handed
    }

    /// Number of jobs.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
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
        let mut lines = HashMap::with_capacity(self.len());
        for Entry { line, name, .. } in &self.entries {
            check_name(name).map_err(|wrong| at(&self.path, *line, &wrong))?;
            if let Some(first) = lines.insert(name, *line) {
                let wrong = format!(
                    "output folder '{name}' is also that of line {first}; give it another name: append a tab and \
                     --name NAME"
                );
                return Err(at(&self.path, *line, &wrong));
            }
        }
        Ok(())
    }

    /// The job of an index.
    ///
    /// # Errors
    /// Wrong use: there is none.
    pub(super) fn entry(&self, index: usize) -> Result<&Entry, Failure> {
        self.entries.get(index).ok_or_else(|| {
            let (path, number) = (self.path.display(), self.len());
            Failure::Usage(format!("--index {index}: {path} has {number} jobs; give 0 to {}", number - 1))
        })
    }

    fn line(&self, number: usize, line: &[u8]) -> Result<Entry, Failure> {
        entry(number, line, &self.folder).map_err(|wrong| at(&self.path, number, &wrong))
    }

    fn video(&self, number: usize, text: &OsStr) -> Result<Entry, Failure> {
        let input = self.folder.join(text);
        let name = name_of(&input).ok_or_else(|| at(&self.path, number, "file name is not UTF-8; rename it"))?;
        Ok(Entry { line: number, name, input, words: Vec::new(), text: text.to_owned() })
    }
}

/// Failure at a line.
pub(super) fn at(list: &Path, line: usize, wrong: &str) -> Failure {
    match list.is_dir() {
        true => Failure::Usage(format!("{}: video {line}: {wrong}", list.display())),
        false => Failure::Usage(format!("{}: line {line}: {wrong}", list.display())),
    }
}

/// Number, from 1, and text of every line that names a job, without the blanks around it.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let lines = (1..).zip(bytes.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with(b"#"))
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
    Ok(Entry { line: number, name, input, words, text: OsStr::from_bytes(line).to_owned() })
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
        // File systems allow 255 bytes.
        _ if name.len() > 200 => "is too long",
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

    fn names(list: &List) -> Vec<String> {
        list.entries.iter().map(|entry| entry.name.clone()).collect()
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
        let entries = &list.entries;
        assert_eq!(entries.iter().map(|entry| entry.line).collect::<Vec<_>>(), [3, 4, 6]);
        assert_eq!(entries[0].input, list.folder.join("day 1/a b.MP4"));
        assert_eq!(entries[1].words, ["--end", "8f"]);
    }

    #[test]
    fn an_absolute_path_stays_and_a_name_can_be_given() {
        let list = list(b"/data/a.mp4\n/other/a.mp4\t--name other --seed 3").unwrap();
        assert_eq!(names(&list), ["a", "other"]);
        let entries = &list.entries;
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
                let of_child = |index| List::of_handed(&list.path, &list.handed(index)).ok()?.entries.pop();
                for (index, entry) in list.entries.iter().enumerate() {
                    prop_assert!(is_whole(entry), "{list:?}");
                    prop_assert_eq!(of_child(index), Some(entry.clone()));
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
