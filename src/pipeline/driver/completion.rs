//! Record of the last run of an output folder, and detection of outdated results without reading the input.
//!
//! Fingerprints hash the content of all files read, which for an hour of video takes many seconds. A run therefore
//! leaves a record, `.tractrix/ended.json`, with the name, size, times and inode of every file that it reads and a hash
//! of its options. If these are equal, the fingerprints are equal. If one differs (a file was copied, touched or
//! replaced), the fingerprints decide. A run removes the record before it starts, and writes one only if no file has
//! changed during the run.

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

/// File name of the record, in the folder for the run's state.
const RECORD: &str = "ended.json";

/// Inputs of a run, as far as they can be determined without reading them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Hash of the program's version, the options except threads and memory, and the networks that come with the
    /// program.
    pub options: String,
    /// Hash of name, size, times and inode of every file that is read.
    pub files: String,
}

/// End of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Completion {
    /// Hashes of the run's inputs.
    pub of: Identity,
    /// The run's options as JSON, which allows comparing single ones; `null` in records of older programs.
    #[serde(default)]
    pub options: Value,
    /// Reason for a missing result; `None` after a successful run.
    pub failure: Option<RunFailure>,
}

/// Reason why a run ended without a result.
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
    /// No run was started.
    Absent,
    /// Another process is using the folder.
    Running,
    /// The results are complete and match this input and these options.
    Done,
    /// The results are complete, but from other inputs or options; with a description of the difference.
    Outdated(String),
    /// The last run failed, and the same run would fail again.
    Failed(RunFailure),
    /// A run was started and did not finish.
    Begun,
}

impl Identity {
    /// Inputs of a run of `options` on `input`.
    ///
    /// An unreadable file counts as missing.
    pub fn of(input: &Path, options: &Options) -> Self {
        let paths = std::iter::once(input).chain(options.named_paths().into_iter().map(|(_, path)| path));
        let mut files = Vec::new();
        paths.for_each(|path| states(path, 0, &mut files));
        if options.metric.telemetry == TelemetryChoice::Auto && !input.is_dir() {
            telemetry::logs_next_to(input).iter().for_each(|path| states(path, 0, &mut files));
        }
        Self { options: fingerprint::of_value(&of_options(options)), files: fingerprint::of_value(&files) }
    }
}

/// Options that affect the result, without the files that they name. Threads and memory are not among them.
fn of_options(options: &Options) -> Value {
    let options = Options { threads: None, memory_limit: None, ..options.clone() };
    let networks = (options.instances == Instances::Vehicles).then(|| shipped(options.provider));
    json!({ "networks": networks, "options": options })
}

/// State of the networks that come with the program, independent of their folder, and presence of the runtime.
fn shipped(provider: Provider) -> Value {
    let of_file = |path: &Path| fs::metadata(path).ok().map(|found| json!([found.len(), found.mtime()]));
    let files = default_models().ok().map(|models| models.files().map(of_file).to_vec());
    json!({ "files": files, "runtime": onnx::is_in_place(provider) })
}

/// Appends name and state of a file, or of all files in a folder, at most four levels below it, sorted by name.
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
    /// Creates the record of a run of `options` with the inputs `of`.
    pub fn new(of: Identity, options: &Options, failure: Option<RunFailure>) -> Self {
        Self { of, options: json!(options), failure }
    }

    /// Returns the record of an output folder's last run, if there is one.
    pub fn of_folder(output: &Path) -> Option<Self> {
        workspace::read_state(output, RECORD).ok()
    }

    /// Compares the input, the options and the program with those of the record.
    ///
    /// # Errors
    /// A description of the difference for the user.
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
        // A user who has the results may have deleted the input.
        match now.files == self.of.files || matches!(input.try_exists(), Ok(false)) {
            true => Ok(()),
            false => Err("the input, or another file of the run, has changed".to_owned()),
        }
    }

    /// As [`Self::compare`], but compares only the options that `lay_over` changes.
    ///
    /// # Errors
    /// As [`Self::compare`]; the reason why `lay_over` fails.
    fn compare_given(&self, lay_over: impl Fn(Options) -> Result<(PathBuf, Options), String>) -> Result<(), String> {
        let (input, requested) = lay_over(Options::default())?;
        let Some(recorded) = self.recorded_options() else { return self.compare(&input, &requested) };
        let (input, over_recorded) = lay_over(recorded.clone())?;
        // `lay_over` appends to lists: applied to the defaults it yields the given values alone.
        let is_other = |key: &String| requested.value(key) != recorded.value(key);
        let keys: Vec<String> = recorded.differing(&over_recorded).into_iter().filter(is_other).collect();
        match keys.is_empty() {
            true => self.compare(&input, &recorded),
            false => Err(other_options(&keys, &recorded, &requested)),
        }
    }

    /// Returns true if the run read this input, and none of the files that it read has changed.
    pub(in crate::pipeline) fn is_of_files(&self, input: &Path) -> bool {
        self.recorded_options().is_some_and(|options| Identity::of(input, &options).files == self.of.files)
    }

    fn recorded_options(&self) -> Option<Options> {
        (!self.options.is_null()).then(|| Options::deserialize(&self.options).ok()).flatten()
    }

    /// Records in an output folder that a run failed, and why.
    ///
    /// # Errors
    /// The folder does not belong to a run, or another process is using it.
    pub fn note_failure(output: &Path, of: Identity, options: &Options, failed: RunFailure) -> Result<()> {
        Workspace::open(output)?.set_ended(&Self::new(of, options, Some(failed)))
    }
}

/// Lists the options that differ, with their values in the results and the requested ones.
fn other_options(keys: &[String], recorded: &Options, requested: &Options) -> String {
    /// Maximum number of listed options: more do not fit on a line.
    const SHOWN: usize = 3;
    let one = |key: &String| format!("{key} is {} in the results, now {}", recorded.value(key), requested.value(key));
    let shown: Vec<String> = keys.iter().take(SHOWN).map(one).collect();
    let more = match keys.len().saturating_sub(SHOWN) {
        0 => String::new(),
        more => format!("; {more} more"),
    };
    format!("options differ: {}{more}", shown.join("; "))
}

impl Workspace {
    /// Records the end of the run. All its results must be in place before.
    pub(in crate::pipeline) fn set_ended(&self, ended: &Completion) -> Result<()> {
        self.write_state(RECORD, ended)
    }

    /// Marks the run as unfinished. Must be called before any result is changed.
    pub(in crate::pipeline) fn clear_ended(&self) -> Result<()> {
        Ok(atomic::remove(&self.state(RECORD))?)
    }
}

/// State of an output folder with respect to a run of `options` on `input`.
///
/// Reads the record and checks whether results are present; does not read the input, and changes nothing.
pub fn folder_state(output: &Path, input: &Path, options: &Options) -> FolderState {
    judge(output, |ended| ended.compare(input, options))
}

/// As [`folder_state`], with some options given and the others those of the last run.
///
/// * `lay_over` – returns the input, and the options with the given ones applied.
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
    fn a_replaced_file_of_the_same_size_is_detected() {
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
    fn a_new_log_next_to_a_video_changes_the_files_hash() {
        let (folder, input) = place();
        let before = Identity::of(&input, &without_vehicles());
        fs::write(folder.path().join("a.SRT"), b"1").unwrap();
        assert_ne!(before, Identity::of(&input, &without_vehicles()));
    }

    #[test]
    fn added_and_removed_images_change_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let masks = folder.path().join("deep/masks");
        fs::create_dir_all(&masks).unwrap();
        let before = Identity::of(folder.path(), &without_vehicles());
        fs::write(masks.join("0.png"), b"").unwrap();
        assert_ne!(before, Identity::of(folder.path(), &without_vehicles()));
    }

    #[test]
    fn the_hash_depends_on_options_but_not_on_threads() {
        let (_folder, input) = place();
        let options = without_vehicles();
        let before = Identity::of(&input, &options);
        assert_eq!(before, Identity::of(&input, &Options { threads: Some(7), ..options.clone() }));
        assert_ne!(before, Identity::of(&input, &Options { seed: 9, ..options }));
    }

    #[test]
    fn a_failure_persists_until_options_or_input_change() {
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
    fn running_processes_and_records_without_results_are_detected() {
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
        let requested = ended.compare(&input, &without_vehicles()).unwrap_err();
        assert_eq!(requested, "options differ: seed is 3 in the results, now 0");
        fs::write(&input, b"other pictures").unwrap();
        assert!(with(None).unwrap_err().contains("has changed"));
    }

    #[test]
    fn values_of_lists_are_compared_as_given() {
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
