//! All jobs on one machine, several at a time, each in a process of its own: one that crashes or takes too much memory
//! does not take the others with it.

use std::env;
use std::ffi::OsString;
use std::num::NonZeroUsize;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{self, Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use rustix::process::{Pid, Signal, kill_process};

use super::item::{Item, Maker};
use super::list::{Entry, List};
use super::resources::{MEMORY_OF_A_JOB, threads};
use super::status::{Fate, State, counted, show_counts};
use super::words::alone;
use crate::cli::Call;
use crate::cli::output::{Failure, Form};
use crate::cli::terminal::TerminalProgress;
use crate::memory::MemoryLimit;
use crate::pipeline::{Completion, FolderState, Identity};

/// Grace period of jobs that were asked to end.
const PATIENCE: Duration = Duration::from_millis(1200);
/// Polling interval for jobs that have ended.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Resources for all jobs together.
#[derive(Clone, Copy, Debug)]
pub(super) struct Share {
    /// Maximum number of concurrent jobs.
    pub(super) jobs: NonZeroUsize,
    /// Threads, where a number is asked for.
    pub(super) threads: Option<usize>,
    /// Memory limit for images and networks.
    pub(super) memory: MemoryLimit,
}

/// A job under way.
struct Running {
    item: Item,
    process: Child,
    started: Instant,
}

/// Does all jobs, each with its share.
///
/// # Errors
/// There is one that failed (exit code 1), or that has to be started again (75); or a signal came.
pub(super) fn run(list: &List, maker: &Maker, share: Share, call: Call) -> Result<(), Failure> {
    let Call { arguments, form, talk } = call;
    maker.check()?;
    let most = at_a_time(share.jobs.get().min(list.len()), share.memory, talk);
    let part = part(share, most);
    talk.ends_in_order();
    let mut fates: Vec<Fate> = Vec::with_capacity(list.len());
    let mut waiting = 0..list.len();
    let mut running: Vec<Running> = Vec::new();
    loop {
        let mut tell = |fate: Fate, name: &str, took: Option<Duration>| {
            talk.say(&said(&fate, name, took, fates.len() + 1, list.len()));
            fates.push(fate);
        };
        while running.len() < most {
            let Some(index) = waiting.next() else { break };
            let entry = list.entry(index)?;
            match take(maker, index, entry, &|item| start(item, list, arguments, &part)) {
                Ok(job) => running.push(job),
                Err(fate) => tell(fate, &entry.name, None),
            }
        }
        if running.is_empty() {
            break;
        }
        if talk.stopped_by().is_some() {
            return Err(stop(running));
        }
        thread::sleep(LOOK_EVERY);
        for (item, status, took) in ended(&mut running)? {
            tell(fate(&item, status), &item.name, Some(took));
        }
    }
    fates.sort_by_key(|fate| fate.index);
    look_again(list, maker, &mut fates)?;
    end(list, maker, &fates, form)
}

/// Starts a job that is not done; else says what has become of it.
fn take(
    maker: &Maker,
    index: usize,
    entry: &Entry,
    start: &dyn Fn(Item) -> Result<Running, anyhow::Error>,
) -> Result<Running, Fate> {
    let without_result = |state, error: String, exit_code| Fate { index, state, reason: Some(error), exit_code };
    let item = maker.item(index, entry);
    let item = item.map_err(|failure| without_result(State::Failed, failure.to_string(), Some(failure.code())))?;
    match item.folder_state() {
        folder_state @ (FolderState::Done | FolderState::Running) => Err(Fate::of(index, folder_state)),
        _ => start(item).map_err(|error| without_result(State::ToGoOn, format!("{error:#}"), None)),
    }
}

/// Looks again for results of jobs that were not done: another process may have done them in the meantime.
fn look_again(list: &List, maker: &Maker, fates: &mut [Fate]) -> Result<(), Failure> {
    for fate in fates.iter_mut().filter(|fate| !matches!(fate.state, State::Done | State::Failed)) {
        let Ok(item) = maker.item(fate.index, list.entry(fate.index)?) else { continue };
        let now = item.folder_state();
        if matches!(now, FolderState::Done | FolderState::Running) {
            *fate = Fate::of(fate.index, now);
        }
    }
    Ok(())
}

/// Number of jobs that the memory allows.
fn at_a_time(most: usize, memory: MemoryLimit, talk: &TerminalProgress) -> usize {
    let room = usize::try_from(memory.bytes() / MEMORY_OF_A_JOB).unwrap_or(most).max(1);
    if room < most {
        let each = MEMORY_OF_A_JOB >> 20;
        talk.say(&format!(
            "running {room} jobs at a time instead of {most}: a job may need {each} MiB, available: {memory}"
        ));
    }
    room.min(most)
}

/// Flags that give a job its part of the machine.
fn part(share: Share, most: usize) -> [String; 4] {
    let threads = (threads(share.threads) / most).max(1);
    // Nobody may ask for less than 64 MiB.
    let memory_mib = ((share.memory.bytes() >> 20) / most as u64).max(64);
    ["--threads".to_owned(), threads.to_string(), "--memory-limit".to_owned(), format!("{memory_mib}MiB")]
}

/// Starts a process for a job. It gets its entry of the list, which may have changed since it was read.
fn start(item: Item, list: &List, arguments: &[OsString], part: &[String]) -> Result<Running, anyhow::Error> {
    let program = env::current_exe().context("cannot locate the program's own executable")?;
    let mut entry = OsString::from("--entry=");
    entry.push(list.handed(item.index));
    let more: Vec<OsString> = [entry, format!("--parent={}", process::id()).into()]
        .into_iter()
        .chain(part.iter().map(OsString::from))
        .chain(["--quiet", "--progress", "none"].map(OsString::from))
        .collect();
    let mut command = Command::new(program);
    // A group of its own: Ctrl-C is this process's to pass on.
    command.args(alone(arguments, item.index, &more).iter().skip(1)).process_group(0);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let process = command.spawn().context("cannot be started")?;
    Ok(Running { item, process, started: Instant::now() })
}

/// Takes those out that have ended.
fn ended(running: &mut Vec<Running>) -> Result<Vec<(Item, ExitStatus, Duration)>, Failure> {
    let (mut over, mut still) = (Vec::new(), Vec::new());
    for mut job in running.drain(..) {
        match job.process.try_wait()? {
            Some(status) => over.push((job.item, status, job.started.elapsed())),
            None => still.push(job),
        }
    }
    *running = still;
    Ok(over)
}

/// Asks all jobs to end and waits a while.
fn stop(mut running: Vec<Running>) -> Failure {
    for job in &running {
        let _ = kill_process(Pid::from_child(&job.process), Signal::TERM);
    }
    let asked = Instant::now();
    while asked.elapsed() < PATIENCE && !running.is_empty() {
        thread::sleep(LOOK_EVERY);
        running.retain_mut(|job| matches!(job.process.try_wait(), Ok(None)));
    }
    Failure::from(crate::pipeline::PipelineError::Stopped)
}

/// State of a job whose process has ended. It is done if its output folder is complete, whatever the exit code.
fn fate(item: &Item, status: ExitStatus) -> Fate {
    let exit_code = status.code().and_then(|code| u8::try_from(code).ok()).filter(|&code| code != 0);
    let (state, reason) = match (status.code(), status.signal()) {
        (Some(0), _) => return of_ended(item),
        // Wrong input or wrong use: it would fail again.
        (Some(1 | 2), _) => (State::Failed, reason(item)),
        // A panic.
        (Some(101), _) => (State::Failed, "internal error; please report it".into()),
        (_, Some(9)) => (State::ToGoOn, "killed, possibly out of memory".into()),
        (_, Some(signal)) => (State::ToGoOn, format!("ended by signal {signal}")),
        (code, _) => (State::ToGoOn, format!("stopped, exit code {}", code.unwrap_or(-1))),
    };
    Fate { index: item.index, state, reason: Some(reason), exit_code }
}

/// State of a job whose process ended with exit code 0.
fn of_ended(item: &Item) -> Fate {
    let fate = Fate::of(item.index, item.folder_state());
    let unsaid = || Some("ended with exit code 0, but the output folder is incomplete".to_owned());
    match fate.state {
        State::Done | State::Outdated => fate,
        _ => Fate { state: State::ToGoOn, reason: fate.reason.or_else(unsaid), ..fate },
    }
}

/// The word that a job left in its folder; where it could not, why not.
fn reason(item: &Item) -> String {
    let is_of_now = |ended: &Completion| ended.of == Identity::of(&item.input, &item.options);
    let ended = Completion::of_folder(&item.output).filter(is_of_now);
    let left = ended.and_then(|ended| ended.failure).map(|failed| failed.reason);
    left.unwrap_or_else(|| format!("no reason recorded; `--index {}` shows it", item.index))
}

fn said(fate: &Fate, name: &str, took: Option<Duration>, number: usize, all: usize) -> String {
    let took = took.map(|took| format!(" after {:.1} s", took.as_secs_f64()));
    let before = if fate.state == State::Done { " before" } else { "" };
    let reason = fate.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
    let (state, took) = (fate.state.name(), took.unwrap_or_else(|| before.to_owned()));
    format!("[{number}/{all}] {name} {state}{took}{reason}")
}

fn end(list: &List, maker: &Maker, fates: &[Fate], form: Form) -> Result<(), Failure> {
    let is_final = |fate: &Fate| matches!(fate.state, State::Done | State::Failed);
    let said = || anyhow::anyhow!("not all jobs are done: {}", counted(fates));
    let failure = if !fates.iter().all(is_final) {
        Some(Failure::Again(said().context("run the same command again")))
    } else if fates.iter().any(|fate| fate.state == State::Failed) {
        Some(Failure::Partial(said()))
    } else {
        None
    };
    show_counts(list, maker, fates, failure.as_ref(), form)?;
    failure.map_or(Ok(()), Err)
}
