//! One job of a list: what it reads and writes, and doing it.

use std::cell::RefCell;
use std::ffi::OsString;
use std::path::PathBuf;

use clap::{CommandFactory, FromArgMatches, Parser};
use serde_json::json;

use super::Args;
use super::list::{Entry, List, at};
use super::{resources, words};
use crate::cli::common::lossy;
use crate::cli::job::{self, JobArgs, apply_flags, lay_over, resolve_over, use_machine};
use crate::cli::output::{Failure, Form, show};
use crate::cli::run;
use crate::cli::terminal::TerminalProgress;
use crate::io::RunFolder;
use crate::pipeline::{self, Completion, FolderState, Identity, Job, Options, Overwrite, RunFailure, Stage};
use crate::scene::Topic;

/// The options of a line, as `run` has them.
#[derive(Debug, Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct LineArgs {
    #[command(flatten)]
    job: JobArgs,
}

/// Makes jobs of the entries of a list: lays the options of a line over those of the command line.
pub(super) struct Maker<'a> {
    args: &'a Args,
    list: &'a List,
    /// Built once: that takes longer than to parse a line.
    command: RefCell<clap::Command>,
}

/// A job with all that it needs to be done.
#[derive(Clone, Debug)]
pub(super) struct Item {
    /// Its index in the list, from 0.
    pub(super) index: usize,
    /// Name of its output folder.
    pub(super) name: String,
    /// The video, or the folder of images.
    pub(super) input: PathBuf,
    /// The output folder.
    pub(super) output: PathBuf,
    /// Everything that decides the result.
    pub(super) options: Options,
    overwrite: Overwrite,
    options_files: Vec<PathBuf>,
}

impl<'a> Maker<'a> {
    pub(super) fn new(args: &'a Args, list: &'a List) -> Self {
        Self { args, list, command: RefCell::new(LineArgs::command()) }
    }

    /// The output folder of an entry.
    pub(super) fn output(&self, entry: &Entry) -> PathBuf {
        self.args.job.output.join(&entry.name)
    }

    /// Parses the options of all lines that have some, and looks whether the files are there that they name.
    ///
    /// # Errors
    /// As [`Self::item`], of the first line that has one.
    pub(super) fn check(&self) -> Result<(), Failure> {
        job::check(&common(self.args, Options::default())?)?;
        for index in 0..self.list.len() {
            let entry = self.list.entry(index)?;
            match entry.words.is_empty() {
                true => self.check_blanks(entry)?,
                false => drop(self.item(index, entry)?),
            }
        }
        Ok(())
    }

    /// Parses the options of a line.
    ///
    /// # Errors
    /// Wrong use, with the line.
    pub(super) fn parse(&self, entry: &Entry) -> Result<JobArgs, Failure> {
        self.check_blanks(entry)?;
        let mut words: Vec<OsString> = entry.words.iter().map(OsString::from).collect();
        let output = self.output(entry).into_os_string();
        words.extend(["--output".into(), output, "--".into(), entry.input.clone().into_os_string()]);
        let matches = self.command.borrow_mut().try_get_matches_from_mut(words);
        let line = matches.and_then(|matches| LineArgs::from_arg_matches(&matches));
        let mut job = line.map_err(|error| self.at(entry, &first_line(&error)))?.job;
        job.begin_at(self.list.folder());
        // The list has joined its folder to it already.
        job.input.clone_from(&entry.input);
        Ok(job)
    }

    /// The job of an entry.
    ///
    /// # Errors
    /// Wrong use, with the line; a file that is named and is not there.
    pub(super) fn item(&self, index: usize, entry: &Entry) -> Result<Item, Failure> {
        let line = self.parse(entry)?;
        let resolved = resolve_over(common(self.args, Options::default())?, &line, Stage::Report);
        let (input, options) = resolved.map_err(|failure| match failure {
            Failure::Usage(wrong) => self.at(entry, &wrong),
            other => other,
        })?;
        let is_any = self.args.job.overwrite || line.overwrite;
        let overwrite = if is_any { Overwrite::AnyInput } else { Overwrite::SameInput };
        let options_files = self.args.job.common.options.iter().chain(&line.common.options).cloned().collect();
        Ok(Item { index, name: entry.name.clone(), input, output: line.output, options, overwrite, options_files })
    }

    /// State of the output folder of a line with respect to the given options.
    pub(super) fn folder_state_of_given(args: &Args, line: &JobArgs) -> FolderState {
        let lay_over = |options| lay_over(common(args, options)?, line, Stage::Report);
        pipeline::folder_state_of_given(&line.output, |options| {
            lay_over(options).map_err(|failure| failure.to_string())
        })
    }

    fn check_blanks(&self, entry: &Entry) -> Result<(), Failure> {
        lacks_tab(entry).map_or(Ok(()), |wrong| Err(self.at(entry, &wrong)))
    }

    fn at(&self, entry: &Entry, wrong: &str) -> Failure {
        at(&self.list.path, entry.line, wrong)
    }
}

/// Options with those of the command line instead.
fn common(args: &Args, options: Options) -> Result<Options, Failure> {
    let mut options = args.job.common.over(options)?;
    apply_flags(&args.job, &mut options);
    Ok(options)
}

impl Item {
    /// State of the output folder with respect to this job.
    pub(super) fn folder_state(&self) -> FolderState {
        pipeline::folder_state(&self.output, &self.input, &self.options)
    }

    /// Does the job, unless it is done, and leaves word in its folder if it fails.
    ///
    /// * `arguments` – the command line that would do this job alone.
    ///
    /// # Errors
    /// As `run`.
    pub(super) fn work(mut self, arguments: &[OsString], form: Form, talk: &TerminalProgress) -> Result<(), Failure> {
        self.note_other_index();
        if self.folder_state() == FolderState::Done {
            let report = RunFolder::at(&self.output).report();
            // Paths need not be UTF-8.
            let (output, page) = (self.output.to_string_lossy(), report.to_string_lossy());
            let value = json!({ "output": output, "report": page, "done_before": true });
            return show(form, &value, || format!("{}\n", report.display()));
        }
        let threads = resources::threads(self.options.threads);
        self.options.threads = Some(threads);
        use_machine(&self.options)?;
        let identity = Identity::of(&self.input, &self.options);
        let result = run::perform(&self.task(&lossy(arguments)), form, talk);
        if let Err(failure) = &result {
            self.leave_word(identity, failure);
        }
        result
    }

    /// Warns where the last run of this folder had another index: a list that changes while a scheduler starts its
    /// jobs one by one has some of them started twice and others never.
    fn note_other_index(&self) {
        let before = words::index_of_run(&pipeline::arguments_of_run(&self.output).unwrap_or_default());
        if let Some(before) = before.filter(|before| *before != self.index) {
            let text = format!(
                "{}: index {} in the list, {before} in its last run: list changed; submit all indices again, see \
                 --status",
                self.name, self.index
            );
            tracing::warn!("{}", Topic::ListChanged.warning(text));
        }
    }

    fn task<'a>(&'a self, arguments: &'a [String]) -> Job<'a> {
        Job {
            input: &self.input,
            output: &self.output,
            options: &self.options,
            goal: Stage::Report,
            also_read: self.options_files.iter().map(|path| ("--options", path.as_path())).collect(),
            overwrite: self.overwrite,
            arguments,
        }
    }

    /// Leaves a record of a failure that would happen again; where none can be left, the failure itself says enough.
    fn leave_word(&self, identity: Identity, failure: &Failure) {
        if matches!(failure.code(), 1 | 2) && !failure.is_stop() {
            let failed = RunFailure { code: failure.code(), reason: failure.to_string() };
            let _ = Completion::note_failure(&self.output, identity, &self.options, failed);
        }
    }
}

/// That options were written after a blank, and so count as a part of the video's name.
fn lacks_tab(entry: &Entry) -> Option<String> {
    let name = entry.input.to_string_lossy();
    (name.contains(" --") && !entry.input.exists())
        .then(|| format!("'{name}' not found; separate the video from its options by a tab"))
}

/// Message of clap, without its usage line.
fn first_line(error: &clap::Error) -> String {
    let said = error.render().to_string();
    let first = said.lines().next().unwrap_or_default();
    first.strip_prefix("error: ").unwrap_or(first).to_owned()
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use clap::ValueHint;

    use super::*;
    use crate::cli::args;
    use crate::pipeline::Instances;

    fn batch(list: &Path, more: &str) -> Args {
        let line = format!("tractrix batch {} --output out --index 0 {more}", list.display());
        let parsed = args::Args::try_parse_from(line.split_whitespace()).unwrap();
        match parsed.command {
            args::Command::Batch(own) => *own,
            _ => panic!("batch is batch"),
        }
    }

    /// The first job of a list of one line, with options that all jobs have.
    fn item(line: &str, more: &str) -> Result<Item, Failure> {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("masks")).unwrap();
        let path = folder.path().join("list.txt");
        fs::write(&path, line).unwrap();
        let list = List::open(&path)?;
        let mut item = Maker::new(&batch(&path, more), &list).item(0, list.entry(0)?)?;
        if let Instances::Masks(masks) = &mut item.options.instances {
            *masks = masks.strip_prefix(folder.path()).unwrap().to_owned();
        }
        Ok(item)
    }

    #[test]
    fn options_of_a_line_go_before_those_of_all() {
        let found = item("a.mp4\t--seed 3 --masks masks", "--seed 2 --max-dimension 480 --threads 5").unwrap();
        assert_eq!((found.options.seed, found.options.video.max_dimension), (3, Some(480)));
        assert_eq!(found.options.instances, Instances::Masks("masks".into()));
        assert_eq!((found.output.as_path(), found.options.threads), (Path::new("out/a"), Some(5)));
    }

    #[test]
    fn what_cannot_be_meant_is_said_with_its_line() {
        for line in [
            "a.mp4 --seed 3",
            "a.mp4\t--no-such-flag",
            "a.mp4\t--output there",
            "a.mp4\tb.mp4",
            "a.mp4\t--set nothing=1",
        ] {
            let Err(Failure::Usage(said)) = item(line, "") else { panic!("{line} is refused") };
            assert!(said.contains("list.txt: line 1: ") && !said.contains('\n'), "{said}");
        }
    }

    #[test]
    fn every_path_of_a_line_begins_where_the_list_lies() {
        let takes_path = |flag: &clap::Arg| flag.get_value_hint() == ValueHint::AnyPath;
        let of_other_types = ["detector", "intrinsics", "object-model"];
        let command = LineArgs::command();
        let flags = command.get_arguments().filter_map(|flag| Some((flag.get_long()?, takes_path(flag))));
        let named: Vec<&str> =
            flags.filter(|(name, path)| *path || of_other_types.contains(name)).map(|(name, _)| name).collect();
        assert!(named.len() >= 10, "{named:?}");
        for name in named.into_iter().filter(|name| *name != "output") {
            let value = if name == "object-model" { "1=x.txt" } else { "x.txt" };
            let words = [&format!("--{name}={value}"), "--output", "o", "i"];
            // Flags that want others next to them are tried by their own commands.
            let Ok(mut line) = LineArgs::try_parse_from(words) else { continue };
            line.job.begin_at(Path::new("/list"));
            assert!(format!("{:?}", line.job).contains("\"/list/x.txt\""), "--{name}: {:?}", line.job);
        }
    }
}
