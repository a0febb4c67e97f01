//! What has become of every job.

use serde::Serialize;
use serde_json::{Value, json};

use super::item::Item;
use crate::cli::output::{Failure, Form, show};
use crate::pipeline::Standing;

/// What has become of a job.
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

impl State {
    const ALL: [Self; 6] = [Self::Done, Self::Failed, Self::Running, Self::ToGoOn, Self::Outdated, Self::Missing];

    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Running => "running",
            Self::ToGoOn => "to go on",
            Self::Outdated => "outdated",
            Self::Missing => "missing",
        }
    }
}

/// A job and what has become of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Fate {
    pub(super) index: usize,
    pub(super) name: String,
    pub(super) input: std::path::PathBuf,
    pub(super) output: std::path::PathBuf,
    pub(super) state: State,
    /// Why there is no result, where that is known.
    pub(super) reason: Option<String>,
    /// Exit code of the last run, where that is known and was not 0.
    pub(super) exit_code: Option<u8>,
}

impl Fate {
    /// What the output folder says.
    pub(super) fn of(item: &Item) -> Self {
        let (state, failed) = match item.standing() {
            Standing::Absent => (State::Missing, None),
            Standing::Running => (State::Running, None),
            Standing::Done => (State::Done, None),
            Standing::Outdated => (State::Outdated, None),
            Standing::Failed(failed) => (State::Failed, Some(failed)),
            Standing::Begun => (State::ToGoOn, None),
        };
        let (exit_code, reason) = failed.map(|failed| (failed.code, failed.reason)).unzip();
        Self { state, reason, exit_code, ..Self::without_state(item) }
    }

    pub(super) fn without_state(item: &Item) -> Self {
        Self {
            index: item.index,
            name: item.name.clone(),
            input: item.input.clone(),
            output: item.output.clone(),
            state: State::Missing,
            reason: None,
            exit_code: None,
        }
    }

    fn line(&self) -> String {
        let reason = self.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
        format!("{:>6}  {:<8}  {}{reason}\n", self.index, self.state.words(), self.name)
    }
}

pub(super) fn run(items: &[Item], form: Form) -> Result<(), Failure> {
    let fates: Vec<Fate> = items.iter().map(Fate::of).collect();
    let failure = (!fates.iter().all(|fate| fate.state == State::Done)).then(|| {
        let said = format!("not all jobs are done: {}; the same list again does what is left", counted(&fates));
        Failure::Partial(anyhow::anyhow!(said))
    });
    let mut value = as_json(&fates);
    if let Some(failure) = &failure {
        value["error"] = failure.as_json();
    }
    show(form, &value, || fates.iter().map(Fate::line).collect::<String>() + &counted(&fates) + "\n")?;
    failure.map_or(Ok(()), Err)
}

pub(super) fn as_json(fates: &[Fate]) -> Value {
    let counts: serde_json::Map<String, Value> =
        State::ALL.into_iter().map(|state| (state.words().replace(' ', "_"), json!(number(fates, state)))).collect();
    json!({ "jobs": fates, "counts": counts })
}

fn number(fates: &[Fate], state: State) -> usize {
    fates.iter().filter(|fate| fate.state == state).count()
}

/// How many jobs are in each state, in words.
pub(super) fn counted(fates: &[Fate]) -> String {
    let counts = State::ALL.into_iter().map(|state| (state, number(fates, state))).filter(|(_, number)| *number > 0);
    counts.map(|(state, number)| format!("{number} {}", state.words())).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fate(index: usize, state: State, reason: Option<&str>) -> Fate {
        let (input, output) = (format!("{index}.mp4").into(), format!("out/{index}").into());
        Fate {
            index,
            name: index.to_string(),
            input,
            output,
            state,
            reason: reason.map(str::to_owned),
            exit_code: None,
        }
    }

    #[test]
    fn states_are_counted_and_reasons_said() {
        let fates = [fate(0, State::Done, None), fate(1, State::Failed, Some("no video")), fate(2, State::Done, None)];
        assert_eq!(counted(&fates), "2 done, 1 failed");
        assert_eq!(fates[1].line(), "     1  failed    1: no video\n");
        let value = as_json(&fates);
        assert_eq!((&value["counts"]["done"], &value["counts"]["to_go_on"]), (&json!(2), &json!(0)));
        assert_eq!(value["jobs"][1]["state"], "failed");
    }
}
