//! All jobs on one machine, several at a time, each in a process of its own: one that crashes or takes too much memory
//! does not take the others with it.

use std::env;
use std::ffi::OsString;
use std::num::NonZeroUsize;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use rustix::process::{Pid, Signal, kill_process};

use super::item::Item;
use super::resources::{MEMORY_OF_A_JOB, threads};
use super::status::{Fate, State, as_json, counted};
use super::words::alone;
use crate::cli::output::{Failure, Form, show};
use crate::cli::terminal::Talk;
use crate::limits::memory::MemoryLimit;
use crate::pipeline::{Ended, Identity, Standing};

/// How long jobs that were asked to end are waited for.
const PATIENCE: Duration = Duration::from_millis(1200);
/// How often is looked which jobs have ended.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Less than this of memory nobody may ask for, MiB.
const LEAST_MIB: u64 = 64;
/// Exit codes of a job that would fail again: wrong input, wrong use.
const FINAL: [i32; 2] = [1, 2];
/// Exit code of a program that broke, as Rust's runtime has it.
const BROKEN: i32 = 101;

/// What there is for all jobs together.
#[derive(Clone, Copy, Debug)]
pub(super) struct Share {
    /// How many jobs may run at a time.
    pub(super) jobs: NonZeroUsize,
    /// Threads, where a number is asked for.
    pub(super) threads: Option<usize>,
    /// What pictures and networks may take of memory.
    pub(super) memory: MemoryLimit,
}

/// A job under way.
struct Running<'a> {
    item: &'a Item,
    process: Child,
    started: Instant,
}

/// Does all jobs, each with its share.
///
/// # Errors
/// There is one that failed (exit code 1), or that has to be started again (75); or a signal came.
pub(super) fn run(
    items: &[Item],
    share: Share,
    arguments: &[OsString],
    form: Form,
    talk: &Talk,
) -> Result<(), Failure> {
    let most = at_a_time(share.jobs.get().min(items.len()), share.memory, talk);
    let part = part(share, most);
    talk.ends_in_order();
    let mut fates: Vec<Fate> = Vec::with_capacity(items.len());
    let mut waiting = items.iter();
    let mut running: Vec<Running> = Vec::new();
    loop {
        let mut tell = |fate: Fate, took: Option<Duration>| {
            talk.say(&said(&fate, took, fates.len() + 1, items.len()));
            fates.push(fate);
        };
        while running.len() < most {
            let Some(item) = waiting.next() else { break };
            match item.standing() {
                Standing::Done => tell(Fate::of(item), None),
                _ => running.push(start(item, arguments, &part)?),
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
            tell(fate(item, status), Some(took));
        }
    }
    fates.sort_by_key(|fate| fate.index);
    end(&fates, form)
}

/// How many jobs there is memory for.
fn at_a_time(most: usize, memory: MemoryLimit, talk: &Talk) -> usize {
    let room = usize::try_from(memory.bytes() / MEMORY_OF_A_JOB).unwrap_or(most).max(1);
    if room < most {
        let each = MEMORY_OF_A_JOB >> 20;
        talk.say(&format!(
            "{room} jobs at a time instead of {most}: a job may need {each} MiB, and there are {memory}"
        ));
    }
    room.min(most)
}

/// What a job is told of its part of the machine.
fn part(share: Share, most: usize) -> [String; 4] {
    let threads = (threads(share.threads) / most).max(1);
    let memory = (share.memory.bytes() >> 20) / most as u64;
    ["--threads".to_owned(), threads.to_string(), "--memory-limit".to_owned(), format!("{}MiB", memory.max(LEAST_MIB))]
}

fn start<'a>(item: &'a Item, arguments: &[OsString], part: &[String]) -> Result<Running<'a>, Failure> {
    let program = env::current_exe().context("the program does not find itself")?;
    let more: Vec<&str> = part.iter().map(String::as_str).chain(["--quiet", "--progress", "none"]).collect();
    let mut command = Command::new(program);
    // A group of its own: Ctrl-C is this process's to pass on.
    command.args(alone(arguments, item.index, &more).iter().skip(1)).process_group(0);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let process = command.spawn().with_context(|| format!("{}: cannot be started", item.name))?;
    Ok(Running { item, process, started: Instant::now() })
}

/// Takes those out that have ended.
fn ended<'a>(running: &mut Vec<Running<'a>>) -> Result<Vec<(&'a Item, ExitStatus, Duration)>, Failure> {
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

/// What became of a job by the way its process ended.
fn fate(item: &Item, status: ExitStatus) -> Fate {
    let before = Fate::without_state(item);
    let exit_code = status.code().and_then(|code| u8::try_from(code).ok());
    let (state, reason) = match (status.code(), status.signal()) {
        (Some(0), _) => (State::Done, None),
        (Some(code), _) if FINAL.contains(&code) => (State::Failed, Some(reason(item))),
        (Some(BROKEN), _) => (State::Failed, Some("the program broke, which is a defect to be reported".into())),
        (_, Some(9)) => (State::ToGoOn, Some("it was killed: perhaps there was not enough memory".into())),
        (_, Some(signal)) => (State::ToGoOn, Some(format!("it was ended by signal {signal}"))),
        (code, _) => (State::ToGoOn, Some(format!("it was stopped, exit code {}", code.unwrap_or(-1)))),
    };
    Fate { state, reason, exit_code: exit_code.filter(|&code| code != 0), ..before }
}

/// The word that a job left in its folder; where it could not, why not.
fn reason(item: &Item) -> String {
    let is_of_now = |ended: &Ended| ended.of == Identity::of(&item.input, &item.options);
    let ended = Ended::of_folder(&item.output).filter(is_of_now);
    let left = ended.and_then(|ended| ended.failure).map(|failed| failed.reason);
    left.unwrap_or_else(|| format!("it could leave no word; `--index {}` says why", item.index))
}

fn said(fate: &Fate, took: Option<Duration>, number: usize, all: usize) -> String {
    let took = took.map_or(" before".to_owned(), |took| format!(" after {:.1} s", took.as_secs_f64()));
    let reason = fate.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
    format!("[{number}/{all}] {} {}{took}{reason}", fate.name, fate.state.words())
}

fn end(fates: &[Fate], form: Form) -> Result<(), Failure> {
    let any = |state: State| fates.iter().any(|fate| fate.state == state);
    let said = || anyhow::anyhow!("not all jobs are done: {}", counted(fates));
    let failure = match (any(State::ToGoOn), any(State::Failed)) {
        (true, _) => Some(Failure::Again(said().context("the same command again does what is left"))),
        (false, true) => Some(Failure::Partial(said())),
        (false, false) => None,
    };
    let mut value = as_json(fates);
    if let Some(failure) = &failure {
        value["error"] = failure.as_json();
    }
    show(form, &value, || counted(fates) + "\n")?;
    failure.map_or(Ok(()), Err)
}
