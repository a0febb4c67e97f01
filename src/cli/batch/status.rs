//! State of every job.

use std::path::{Path, PathBuf};

use rayon::iter::{IndexedParallelIterator, IntoParallelRefIterator, ParallelExtend, ParallelIterator};
use serde::Serialize;
use serde_json::{Value, json};

use super::Args;
use super::item::Maker;
use super::list::List;
use crate::cli::job::JobArgs;
use crate::cli::output::{Failure, Form, print, print_json, show};
use crate::pipeline::{FolderState, is_begun};

/// Jobs whose options are in memory at a time: enough that no thread waits for work, and some MiB.
const AT_ONCE: usize = 1024;

/// State of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum State {
    /// Results are there, of this input and these options.
    Done,
    /// It has no result, and would have none if it were started again.
    Failed,
    /// A process is at work on it.
    Running,
    /// It was begun; the next start goes on.
    ToGoOn,
    /// Results are there, of other options or of an input that has changed since.
    Outdated,
    /// It was never begun.
    Missing,
}

with_names!(State {
    Done = "done",
    Failed = "failed",
    Running = "running",
    ToGoOn = "to go on",
    Outdated = "outdated",
    Missing = "missing",
});

/// State of a job of the list.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fate {
    pub(super) index: usize,
    pub(super) state: State,
    /// Reason why there is no result of what was asked for, where that is known.
    pub(super) reason: Option<String>,
    /// Exit code of the last run, where that is known and was not 0.
    pub(super) exit_code: Option<u8>,
}

/// A job's state with its entry in the list, as JSON shows it.
#[derive(Serialize)]
struct Shown<'a> {
    index: usize,
    name: &'a str,
    input: &'a Path,
    output: PathBuf,
    state: State,
    reason: Option<&'a str>,
    exit_code: Option<u8>,
}

impl Fate {
    /// State of a job by its output folder.
    pub(super) fn of(index: usize, folder_state: FolderState) -> Self {
        let (state, reason, exit_code) = match folder_state {
            FolderState::Absent => (State::Missing, None, None),
            FolderState::Running => (State::Running, None, None),
            FolderState::Done => (State::Done, None, None),
            FolderState::Outdated(difference) => (State::Outdated, Some(difference), None),
            FolderState::Failed(failed) => (State::Failed, Some(failed.reason), Some(failed.code)),
            FolderState::Begun => (State::ToGoOn, None, None),
        };
        Self { index, state, reason, exit_code }
    }

    fn line(&self, name: &str) -> String {
        let reason = self.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
        format!("{:>6}  {:<8}  {name}{reason}\n", self.index, self.state.name())
    }
}

pub(super) fn run(args: &Args, list: &List, maker: &Maker, form: Form) -> Result<(), Failure> {
    let mut fates = Vec::with_capacity(list.len());
    for start in (0..list.len()).step_by(AT_ONCE) {
        let end = list.len().min(start + AT_ONCE);
        let lines = (start..end).map(|index| line(list, maker, index)).collect::<Result<Vec<_>, _>>()?;
        let of_line = |(k, line): (usize, &Option<JobArgs>)| {
            let folder_state =
                line.as_ref().map_or(FolderState::Absent, |line| Maker::folder_state_of_given(args, line));
            Fate::of(start + k, folder_state)
        };
        fates.par_extend(lines.par_iter().enumerate().map(of_line));
    }
    let failure = (!fates.iter().all(|fate| fate.state == State::Done)).then(|| {
        let said = format!("not all jobs are done: {}; run the same list again", counted(&fates));
        Failure::Partial(anyhow::anyhow!(said))
    });
    show_all(list, maker, &fates, failure.as_ref(), form)?;
    failure.map_or(Ok(()), Err)
}

/// The options of a line whose job was begun. Those of others are only checked.
fn line(list: &List, maker: &Maker, index: usize) -> Result<Option<JobArgs>, Failure> {
    let entry = list.entry(index)?;
    let is_begun = is_begun(&maker.output(entry));
    match is_begun || !entry.words.is_empty() {
        true => Ok(Some(maker.parse(entry)?).filter(|_| is_begun)),
        false => Ok(None),
    }
}

/// Prints the state of all jobs.
fn show_all(list: &List, maker: &Maker, fates: &[Fate], failure: Option<&Failure>, form: Form) -> Result<(), Failure> {
    let lines = || -> Result<String, Failure> {
        let line = |fate: &Fate| Ok(fate.line(&list.entry(fate.index)?.name));
        Ok(fates.iter().map(line).collect::<Result<String, Failure>>()? + &counted(fates) + "\n")
    };
    match form {
        Form::Json => print_json(&AllJobs::of(list, maker, fates, failure)?),
        Form::Nothing => Ok(()),
        Form::Text => print(&lines()?),
    }
}

/// Prints how many jobs are in each state; as JSON the state of each, too.
pub(super) fn show_counts(
    list: &List,
    maker: &Maker,
    fates: &[Fate],
    failure: Option<&Failure>,
    form: Form,
) -> Result<(), Failure> {
    match form {
        Form::Json => show_all(list, maker, fates, failure, form),
        _ => show(form, &(), || counted(fates) + "\n"),
    }
}

/// State of all jobs, as JSON shows it.
#[derive(Serialize)]
struct AllJobs<'a> {
    jobs: Vec<Shown<'a>>,
    counts: serde_json::Map<String, Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<Value>,
}

impl<'a> AllJobs<'a> {
    fn of(list: &'a List, maker: &Maker, fates: &'a [Fate], failure: Option<&Failure>) -> Result<Self, Failure> {
        let shown = |fate: &'a Fate| {
            let Fate { index, state, ref reason, exit_code } = *fate;
            let entry = list.entry(index)?;
            let (name, input, output) = (entry.name.as_str(), entry.input.as_path(), maker.output(entry));
            Ok(Shown { index, name, input, output, state, reason: reason.as_deref(), exit_code })
        };
        let jobs = fates.iter().map(shown).collect::<Result<_, Failure>>()?;
        Ok(Self { jobs, counts: counts(fates), error: failure.map(Failure::as_json) })
    }
}

fn counts(fates: &[Fate]) -> serde_json::Map<String, Value> {
    State::ALL.into_iter().map(|state| (state.name().replace(' ', "_"), json!(number(fates, state)))).collect()
}

fn number(fates: &[Fate], state: State) -> usize {
    fates.iter().filter(|fate| fate.state == state).count()
}

/// Numbers of jobs in each state, in words.
pub(super) fn counted(fates: &[Fate]) -> String {
    let counts = State::ALL.into_iter().map(|state| (state, number(fates, state))).filter(|(_, number)| *number > 0);
    counts.map(|(state, number)| format!("{number} {}", state.name())).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::RunFailure;

    #[test]
    fn states_are_counted_and_reasons_said() {
        let failed = FolderState::Failed(RunFailure { code: 1, reason: "no video".to_owned() });
        let fates: Vec<Fate> = (0..)
            .zip([FolderState::Done, failed, FolderState::Done])
            .map(|(k, folder_state)| Fate::of(k, folder_state))
            .collect();
        assert_eq!(counted(&fates), "2 done, 1 failed");
        assert_eq!(fates[1].line("b"), "     1  failed    b: no video\n");
        let counts = counts(&fates);
        assert_eq!((&counts["done"], &counts["to_go_on"]), (&json!(2), &json!(0)));
    }
}
