//! Record of a folder's last run, and whether it needs another one, decided without reading the input.
//!
//! Fingerprints hash the content of all that is read, which for an hour of video takes many seconds. A run therefore
//! leaves a record, `.tractrix/ended.json`, with the name, size, times and inode of every file that it reads and a hash
//! of its options. Where they are the same, the fingerprints are; where one differs (a file was copied, touched or
//! replaced) the record says nothing, and the long way decides. A run takes the record away before it begins, and
//! leaves one only if no file has changed while it was under way.

use std::fs::{self, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::fingerprint;
use super::workspace::{self, Marker, Workspace};
use crate::ffi::onnx::{self, Provider};
use crate::io::{OwnedFolder, RunFolder, atomic};
use crate::networks::default_models;
use crate::pipeline::inputs::telemetry;
use crate::pipeline::{Instances, Options, Result, Stage, TelemetryChoice};

/// The record's file, in the folder for the run's own state.
const RECORD: &str = "ended.json";

/// Inputs of a run, as far as they can be determined without reading them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Hash of the program's version, the options but for threads and memory, and the networks that come with it.
    pub options: String,
    /// Hash of name, size, times and inode of every file that is read.
    pub files: String,
}

/// End of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Completion {
    /// Hashes of everything that it was made from.
    pub of: Identity,
    /// Its options as JSON, so that single ones can be compared; `null` in records of older programs.
    #[serde(default)]
    pub options: Value,
    /// Why it has no result, where that is so.
    pub failure: Option<RunFailure>,
}

/// Why a run ended without a result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunFailure {
    /// The program's exit code.
    pub code: u8,
    /// Error message.
    pub reason: String,
}

/// State of a folder with respect to a requested run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FolderState {
    /// Nothing was begun.
    Absent,
    /// Another process is at work there.
    Running,
    /// All is done, from this input and with these options.
    Done,
    /// All is done, but from something else; says from what.
    Outdated(String),
    /// The last run failed, and would again.
    Failed(RunFailure),
    /// Something was begun and did not come to its end.
    Begun,
}

impl Identity {
    /// Inputs of a run of `options` on `input`.
    ///
    /// A file that cannot be read counts as one that is not there.
    pub fn of(input: &Path, options: &Options) -> Self {
        let paths = std::iter::once(input).chain(options.named_paths().into_iter().map(|(_, path)| path));
        let mut files = Vec::new();
        paths.for_each(|path| states(path, 0, &mut files));
        if options.metric.telemetry == TelemetryChoice::Auto && !input.is_dir() {
            telemetry::beside(input).iter().for_each(|path| states(path, 0, &mut files));
        }
        Self { options: fingerprint::of_value(&of_options(options)), files: fingerprint::of_value(&files) }
    }
}

/// Options that the result depends on besides named files. Threads and memory are not among them.
fn of_options(options: &Options) -> Value {
    let options = Options { threads: None, memory_limit: None, ..options.clone() };
    let networks = (options.instances == Instances::Vehicles).then(|| shipped(options.provider));
    json!({ "networks": networks, "options": options })
}

/// The networks that come with the program, wherever they lie, and whether there is what runs them.
fn shipped(provider: Provider) -> Value {
    let of_file = |path: &Path| fs::metadata(path).ok().map(|found| json!([found.len(), found.mtime()]));
    let files = default_models().ok().map(|models| models.files().map(of_file).to_vec());
    json!({ "files": files, "runtime": onnx::is_in_place(provider) })
}

/// Name and state of a file, or of all files in a folder and at most four levels below it, in the order of their names.
fn states(path: &Path, depth: usize, found: &mut Vec<Value>) {
    let name = path.file_name().map(|name| name.to_string_lossy());
    let state = fs::metadata(path).ok();
    let is_folder = state.as_ref().is_some_and(Metadata::is_dir);
    let of_file = state.filter(|_| !is_folder).map(|state| {
        json!([state.len(), state.ino(), state.mtime(), state.mtime_nsec(), state.ctime(), state.ctime_nsec()])
    });
    found.push(json!([depth, name, of_file]));
    // Maximum depth of folders that are read.
    if is_folder && depth < 4 {
        let mut inside: Vec<PathBuf> =
            fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
        inside.sort();
        inside.iter().for_each(|path| states(path, depth + 1, found));
    }
}

impl Completion {
    /// The record of a run of `options` that was made from `of`.
    pub fn new(of: Identity, options: &Options, failure: Option<RunFailure>) -> Self {
        Self { of, options: json!(options), failure }
    }

    /// End of the last run of an output folder, if it is known.
    pub fn of_folder(output: &Path) -> Option<Self> {
        workspace::read_state(output, RECORD).ok()
    }

    /// Compares the input, the options and the program with those of the record.
    ///
    /// # Errors
    /// The difference, for people.
    fn compare(&self, input: &Path, options: &Options) -> Result<(), String> {
        let now = Identity::of(input, options);
        if now.options != self.of.options {
            let recorded = self.recorded_options();
            let keys = recorded.as_ref().map_or_else(Vec::new, |recorded| recorded.differing(options));
            return Err(recorded.filter(|_| !keys.is_empty()).map_or_else(
                || "made by another version of the program or with other networks".to_owned(),
                |recorded| other_options(&keys, &recorded, options),
            ));
        }
        // Who has the results may have given the input away.
        match now.files == self.of.files || matches!(input.try_exists(), Ok(false)) {
            true => Ok(()),
            false => Err("the input, or another file of the run, has changed".to_owned()),
        }
    }

    /// As [`Self::compare`], with the given options alone: those that `lay_over` changes.
    ///
    /// # Errors
    /// As [`Self::compare`]; the reason why `lay_over` fails.
    fn compare_given(&self, lay_over: impl Fn(Options) -> Result<(PathBuf, Options), String>) -> Result<(), String> {
        let (input, asked) = lay_over(Options::default())?;
        let Some(recorded) = self.recorded_options() else { return self.compare(&input, &asked) };
        let (input, over_recorded) = lay_over(recorded.clone())?;
        // Lists grow by what is laid over them: over the default there are the given values alone.
        let is_other = |key: &String| asked.value(key) != recorded.value(key);
        let keys: Vec<String> = recorded.differing(&over_recorded).into_iter().filter(is_other).collect();
        match keys.is_empty() {
            true => self.compare(&input, &recorded),
            false => Err(other_options(&keys, &recorded, &asked)),
        }
    }

    /// Returns true if the run read this input, and neither it nor another file that it read has changed.
    pub(in crate::pipeline) fn is_of_files(&self, input: &Path) -> bool {
        self.recorded_options().is_some_and(|options| Identity::of(input, &options).files == self.of.files)
    }

    fn recorded_options(&self) -> Option<Options> {
        (!self.options.is_null()).then(|| Options::deserialize(&self.options).ok()).flatten()
    }

    /// Leaves word in an output folder that a run failed, so that whoever collects results knows why.
    ///
    /// # Errors
    /// The folder is not a run's own, or another process is at work there.
    pub fn note_failure(output: &Path, of: Identity, options: &Options, failed: RunFailure) -> Result<()> {
        Workspace::open(output)?.set_ended(&Self::new(of, options, Some(failed)))
    }
}

/// Names options that differ, with the value of the results and that which is asked for.
fn other_options(keys: &[String], recorded: &Options, asked: &Options) -> String {
    /// More would not fit on a line.
    const SHOWN: usize = 3;
    let one = |key: &String| format!("{key} is {} in the results, now {}", recorded.value(key), asked.value(key));
    let shown: Vec<String> = keys.iter().take(SHOWN).map(one).collect();
    let more = match keys.len().saturating_sub(SHOWN) {
        0 => String::new(),
        more => format!("; {more} more"),
    };
    format!("options differ: {}{more}", shown.join("; "))
}

impl Workspace {
    /// Says how the run ended. All that it made must be in its place before.
    pub(in crate::pipeline) fn set_ended(&self, ended: &Completion) -> Result<()> {
        self.write_state(RECORD, ended)
    }

    /// Says that a run is under way. To be called before anything is touched.
    pub(in crate::pipeline) fn clear_ended(&self) -> Result<()> {
        Ok(atomic::remove(&self.state(RECORD))?)
    }
}

/// State of an output folder with respect to a run of `options` on `input`.
///
/// Reads the record and looks whether results are there; does not read the input, and changes nothing.
pub fn folder_state(output: &Path, input: &Path, options: &Options) -> FolderState {
    judge(output, |ended| ended.compare(input, options))
}

/// As [`folder_state`], for a run of which some options are given: the others are those of the last run.
///
/// * `lay_over` – gives the input, and some options with the given ones instead.
pub fn folder_state_of_given(
    output: &Path,
    lay_over: impl Fn(Options) -> Result<(PathBuf, Options), String>,
) -> FolderState {
    judge(output, |ended| ended.compare_given(lay_over))
}

fn judge(output: &Path, compare: impl FnOnce(&Completion) -> Result<(), String>) -> FolderState {
    if !is_begun(output) {
        return FolderState::Absent;
    }
    if OwnedFolder::is_busy(output) {
        return FolderState::Running;
    }
    let Some(mut ended) = Completion::of_folder(output) else { return FolderState::Begun };
    let failure = ended.failure.take();
    let marker = |stage| workspace::read_state::<Marker>(output, &workspace::marker_name(stage));
    let is_whole = |stage| marker(stage).is_ok_and(|marker| marker.is_complete(output));
    match (failure, compare(&ended)) {
        (Some(failed), Ok(())) => FolderState::Failed(failed),
        (Some(_), Err(_)) => FolderState::Begun,
        (None, _) if !Stage::ALL.into_iter().all(is_whole) => FolderState::Begun,
        (None, Ok(())) => FolderState::Done,
        (None, Err(difference)) => FolderState::Outdated(difference),
    }
}

/// Returns true if a run was ever started in a folder.
pub fn is_begun(output: &Path) -> bool {
    output.join(RunFolder::STATE).is_dir()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let input = folder.path().join("a.mp4");
        fs::write(&input, b"pictures").unwrap();
        (folder, input)
    }

    fn without_vehicles() -> Options {
        Options { instances: Instances::None, ..Options::default() }
    }

    #[test]
    fn a_file_that_was_replaced_is_another_one_although_it_has_the_same_size() {
        let (folder, input) = place();
        let options = without_vehicles();
        let before = Identity::of(&input, &options);
        assert_eq!(before, Identity::of(&input, &options));
        let other = folder.path().join("b");
        fs::write(&other, b"PICTURES").unwrap();
        fs::rename(&other, &input).unwrap();
        assert_ne!(before.files, Identity::of(&input, &options).files);
        assert_eq!(before.options, Identity::of(&input, &options).options);
    }

    #[test]
    fn a_log_that_is_put_beside_a_video_changes_what_is_found() {
        let (folder, input) = place();
        let before = Identity::of(&input, &without_vehicles());
        fs::write(folder.path().join("a.SRT"), b"1").unwrap();
        assert_ne!(before, Identity::of(&input, &without_vehicles()));
    }

    #[test]
    fn a_picture_that_comes_or_goes_changes_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let masks = folder.path().join("deep/masks");
        fs::create_dir_all(&masks).unwrap();
        let before = Identity::of(folder.path(), &without_vehicles());
        fs::write(masks.join("0.png"), b"").unwrap();
        assert_ne!(before, Identity::of(folder.path(), &without_vehicles()));
    }

    #[test]
    fn options_count_and_threads_do_not() {
        let (_folder, input) = place();
        let options = without_vehicles();
        let before = Identity::of(&input, &options);
        assert_eq!(before, Identity::of(&input, &Options { threads: Some(7), ..options.clone() }));
        assert_ne!(before, Identity::of(&input, &Options { seed: 9, ..options }));
    }

    #[test]
    fn a_failure_stands_until_options_or_input_change() {
        let (folder, input) = place();
        let (output, options) = (folder.path().join("out"), without_vehicles());
        assert_eq!(folder_state(&output, &input, &options), FolderState::Absent);
        let failed = RunFailure { code: 1, reason: "a.mp4 is no video".to_owned() };
        Completion::note_failure(&output, Identity::of(&input, &options), &options, failed.clone()).unwrap();
        assert_eq!(folder_state(&output, &input, &options), FolderState::Failed(failed));
        fs::write(&input, b"a repaired video").unwrap();
        assert_eq!(folder_state(&output, &input, &options), FolderState::Begun);
        Workspace::open(&output).unwrap().clear_ended().unwrap();
        assert_eq!(folder_state(&output, &input, &options), FolderState::Begun);
    }

    #[test]
    fn who_is_at_work_is_seen_and_a_record_without_results_counts_as_none() {
        let (folder, input) = place();
        let (output, options) = (folder.path().join("out"), without_vehicles());
        let workspace = Workspace::open(&output).unwrap();
        workspace.set_ended(&Completion::new(Identity::of(&input, &options), &options, None)).unwrap();
        assert_eq!(folder_state(&output, &input, &options), FolderState::Running);
        drop(workspace);
        assert_eq!(folder_state(&output, &input, &options), FolderState::Begun);
    }

    #[test]
    fn only_given_options_are_compared_and_the_one_that_differs_is_named() {
        let (_folder, input) = place();
        let of_run = Options { seed: 3, threads: Some(2), ..without_vehicles() };
        let ended = Completion::new(Identity::of(&input, &of_run), &of_run, None);
        let with = |seed: Option<u64>| {
            let input = input.clone();
            ended.compare_given(move |options| {
                Ok((input.clone(), Options { seed: seed.unwrap_or(options.seed), ..options }))
            })
        };
        assert_eq!((with(None), with(Some(3))), (Ok(()), Ok(())));
        assert_eq!(with(Some(0)), Err("options differ: seed is 3 in the results, now 0".to_owned()));
        let asked = ended.compare(&input, &without_vehicles()).unwrap_err();
        assert_eq!(asked, "options differ: seed is 3 in the results, now 0");
        fs::write(&input, b"other pictures").unwrap();
        assert!(with(None).unwrap_err().contains("has changed"));
    }

    #[test]
    fn values_that_are_collected_in_a_list_are_compared_as_given() {
        let (_folder, input) = place();
        let with = |mut options: Options, length: &str| {
            options.metric.known_lengths.push(length.parse().unwrap());
            options
        };
        let of_run = with(without_vehicles(), "1:length=4.47");
        let ended = Completion::new(Identity::of(&input, &of_run), &of_run, None);
        let compared = |length: &str| ended.compare_given(|options| Ok((input.clone(), with(options, length))));
        assert_eq!(compared("1:length=4.47"), Ok(()));
        assert!(compared("1:length=5").unwrap_err().contains("metric.known_lengths"));
    }
}
