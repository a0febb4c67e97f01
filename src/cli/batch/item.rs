//! One job of a list: what it reads and writes, and doing it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Parser;
use serde_json::json;

use super::Args;
use super::list::{Entry, List, at};
use super::resources;
use crate::cli::job::{JobArgs, apply_flags, resolve_over, use_threads};
use crate::cli::output::{Failure, Form, show};
use crate::cli::run;
use crate::cli::terminal::Talk;
use crate::io::RunFolder;
use crate::pipeline::{self, Ended, Failed, Identity, Job, Options, Overwrite, Stage, Standing};

/// The options of a line, as `run` has them.
#[derive(Debug, Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct LineArgs {
    #[command(flatten)]
    job: JobArgs,
}

/// A job with all that it needs to be done.
#[derive(Clone, Debug)]
pub(super) struct Item {
    /// Its place in the list, from 0.
    pub(super) index: usize,
    /// What its output folder is called.
    pub(super) name: String,
    /// What is read: a video or a folder of pictures.
    pub(super) input: PathBuf,
    /// The output folder.
    pub(super) output: PathBuf,
    /// Everything that decides the result.
    pub(super) options: Options,
    overwrite: Overwrite,
    options_files: Vec<PathBuf>,
}

impl Item {
    /// Lays the options of a line over those that all jobs have.
    ///
    /// # Errors
    /// Wrong use, with the line; a file that is named and is not there.
    pub(super) fn new(args: &Args, list: &List, index: usize) -> Result<Self, Failure> {
        let entry = list.entry(index)?;
        lacks_tab(entry).map_or(Ok(()), |wrong| Err(at(&list.path, entry.line, &wrong)))?;
        let in_line = |failure: Failure| match failure {
            Failure::Usage(wrong) => at(&list.path, entry.line, &wrong),
            other => other,
        };
        let line = parse(entry, args, &list.folder).map_err(|wrong| at(&list.path, entry.line, &wrong))?;
        let mut options = args.job.common.options()?;
        apply_flags(&args.job, &mut options);
        let (input, options) = resolve_over(options, &line, Stage::Report).map_err(in_line)?;
        let overwrite = if args.job.overwrite || line.overwrite { Overwrite::AnyInput } else { Overwrite::SameInput };
        let options_files = args.job.common.options.iter().chain(&line.common.options).cloned().collect();
        Ok(Self { index, name: entry.name.clone(), input, output: line.output, options, overwrite, options_files })
    }

    /// How the output folder stands to this job.
    pub(super) fn standing(&self) -> Standing {
        pipeline::standing(&self.output, &self.input, &self.options)
    }

    /// Does the job, unless it is done, and leaves word in its folder if it fails.
    ///
    /// * `arguments` – the command line that would do this job alone.
    ///
    /// # Errors
    /// As `run`.
    pub(super) fn work(mut self, arguments: &[OsString], form: Form, talk: &Talk) -> Result<(), Failure> {
        if self.standing() == Standing::Done {
            let report = RunFolder::at(&self.output).report();
            let value = json!({ "output": self.output, "report": report, "done_before": true });
            return show(form, &value, || format!("{}\n", report.display()));
        }
        let threads = resources::threads(self.options.threads);
        self.options.threads = Some(threads);
        use_threads(Some(threads))?;
        let identity = Identity::of(&self.input, &self.options);
        let result = run::perform(&self.task(&lossy(arguments)), form, talk);
        if let Err(failure) = &result {
            self.leave_word(identity, failure);
        }
        result
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

    /// What is to be done again anyway needs no word; where none can be left, the failure itself says enough.
    fn leave_word(&self, identity: Identity, failure: &Failure) {
        if matches!(failure.code(), 1 | 2) && !failure.is_stop() {
            let failed = Failed { code: failure.code(), reason: failure.to_string() };
            let _ = Ended::note_failure(&self.output, identity, failed);
        }
    }
}

fn parse(entry: &Entry, args: &Args, folder: &Path) -> Result<JobArgs, String> {
    let output = args.job.output.join(&entry.name);
    let mut words: Vec<OsString> = entry.words.iter().map(OsString::from).collect();
    words.extend(["--output".into(), output.into_os_string(), "--".into(), entry.input.clone().into_os_string()]);
    let line = LineArgs::try_parse_from(words).map_err(|error| first_line(&error))?;
    let mut job = line.job;
    job.begin_at(folder);
    // The list has joined its folder to it already.
    job.input.clone_from(&entry.input);
    Ok(job)
}

/// That options were written after a blank, and so count as a part of the video's name.
fn lacks_tab(entry: &Entry) -> Option<String> {
    let name = entry.input.to_string_lossy();
    (name.contains(" --") && !entry.input.exists())
        .then(|| format!("there is no '{name}'; between a video and its options stands a tab"))
}

/// What clap says, without how its command line would be right.
fn first_line(error: &clap::Error) -> String {
    let said = error.render().to_string();
    let first = said.lines().next().unwrap_or_default();
    first.strip_prefix("error: ").unwrap_or(first).to_owned()
}

fn lossy(arguments: &[OsString]) -> Vec<String> {
    arguments.iter().map(|argument| argument.to_string_lossy().into_owned()).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::{CommandFactory, ValueHint};

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
        let mut item = Item::new(&batch(&path, more), &list, 0)?;
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
            // Flags that want others beside them are tried by their own commands.
            let Ok(mut line) = LineArgs::try_parse_from(words) else { continue };
            line.job.begin_at(Path::new("/list"));
            assert!(format!("{:?}", line.job).contains("\"/list/x.txt\""), "--{name}: {:?}", line.job);
        }
    }
}
