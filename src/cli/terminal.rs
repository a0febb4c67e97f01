//! Talk on stderr: warnings, and how far a run is.

use std::io::{self, IsTerminal, Write};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use serde_json::json;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

use super::forecast::in_words;
use super::lock;
use super::output::{Failure, Form};
use super::stage_progress::{Event, Moment, StageProgress};
use super::stop::{CaughtSignals, Signal, Stop};
use crate::checks::text::printable;
use crate::pipeline::{Plan, Progress};

/// Form of progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, clap::ValueEnum)]
pub(super) enum ProgressKind {
    /// A bar on a terminal, lines otherwise
    #[default]
    Auto,
    /// A bar
    Bar,
    /// A line at the start and end of a stage, and every 30 seconds
    Plain,
    /// JSON objects, one per line
    Json,
    /// No progress
    None,
}

/// Amount of output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verbosity {
    /// Errors alone.
    Quiet,
    /// Warnings, too.
    Normal,
    /// Details, too.
    Verbose,
}

impl ProgressKind {
    /// The form, once the kind of stderr is known: not `Auto`.
    fn shown(self, verbosity: Verbosity) -> Self {
        match self {
            _ if verbosity == Verbosity::Quiet => Self::None,
            Self::Auto if io::stderr().is_terminal() => Self::Bar,
            Self::Auto => Self::Plain,
            kind => kind,
        }
    }

    /// Interval of lines while a stage is running.
    fn period(self) -> Option<Duration> {
        match self {
            Self::Plain => Some(Duration::from_secs(30)),
            Self::Json => Some(Duration::from_secs(1)),
            _ => None,
        }
    }
}

/// Says on stderr what is going on.
pub(super) struct TerminalProgress {
    voice: Voice,
    verbosity: Verbosity,
    stop: Stop,
    course: Arc<Mutex<StageProgress>>,
    /// Ends the thread that says how far a stage is when this is dropped.
    _ticker: Option<Sender<()>>,
}

impl TerminalProgress {
    /// Starts logging, and listening to signals, too.
    ///
    /// * `caught` – signals since the start of the program.
    /// * `form` – form of the message on stdout if a signal ends the program.
    pub(super) fn start(caught: CaughtSignals, kind: ProgressKind, verbosity: Verbosity, form: Form) -> Self {
        let shown = kind.shown(verbosity);
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
        if shown == ProgressKind::Bar {
            bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        let voice = Voice { bar, shown };
        start_logging(voice.clone(), verbosity);
        let course = Arc::new(Mutex::new(StageProgress::new()));
        let ticker = shown.period().map(|period| start_ticker(period, voice.clone(), course.clone()));
        let last_words = voice.clone();
        let stop = Stop::listen(caught, move |signal, order| {
            last_words.bar.finish_and_clear();
            if verbosity != Verbosity::Quiet {
                last_words.say("message", order.words());
            }
            Failure::Stopped(signal).show_as_json(form);
        });
        Self { voice, verbosity, stop, course, _ticker: ticker }
    }

    /// Says a line, above the bar, unless nothing but errors is to be reported.
    pub(super) fn say(&self, line: &str) {
        if self.verbosity != Verbosity::Quiet {
            self.voice.say("message", line);
        }
    }

    /// Says why the program ends.
    pub(super) fn error(&self, text: &str) {
        self.voice.bar.finish_and_clear();
        match self.voice.shown {
            ProgressKind::Json => self.voice.say("error", text),
            _ => self.voice.line(&format!("tractrix: error: {text}")),
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(&self) {
        self.voice.bar.finish_and_clear();
    }

    /// From here on a signal ends the work at the next unit of it, instead of at once.
    pub(super) fn ends_in_order(&self) {
        self.stop.end_in_order();
    }

    /// Signals that end a recording.
    pub(super) fn stop(&self) -> &Stop {
        &self.stop
    }

    /// Says that a signal ended the program.
    pub(super) fn say_stopped(&self) {
        self.finish();
        self.say(self.stop.order().words());
    }

    /// The signal that asks the program to end, if one came.
    pub(super) fn stopped_by(&self) -> Option<Signal> {
        self.stop.signal()
    }

    fn course(&self) -> MutexGuard<'_, StageProgress> {
        lock(&self.course)
    }
}

fn start_logging(voice: Voice, verbosity: Verbosity) {
    let level = match verbosity {
        Verbosity::Quiet => "error",
        Verbosity::Normal => "warn",
        Verbosity::Verbose => "tractrix=debug,warn",
    };
    let filter = EnvFilter::try_from_env("TRACTRIX_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    let with_colours = io::stderr().is_terminal() && voice.shown != ProgressKind::Json;
    let subscriber = tracing_subscriber::fmt().with_env_filter(filter).with_writer(voice).with_target(false);
    // Only a second start in one process fails, and then the first one's settings hold.
    // What cannot be written must not be reported either: that panics where stderr is gone.
    let _ = subscriber.without_time().with_ansi(with_colours).log_internal_errors(false).try_init();
}

/// Says how far the stage under way is, again and again, until the sender is gone.
fn start_ticker(period: Duration, voice: Voice, course: Arc<Mutex<StageProgress>>) -> Sender<()> {
    let (sender, stop): (Sender<()>, Receiver<()>) = channel();
    thread::spawn(move || {
        while stop.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
            let moment = lock(&course).moment(Event::GoesOn);
            voice.tell(moment.filter(|moment| moment.stage_s >= period.as_secs_f64() / 2.0));
        }
    });
    sender
}

/// Drawing the bar asks the course how much is left: it must not be locked while the bar is touched.
impl Progress for TerminalProgress {
    fn plan(&self, plan: &Plan) {
        self.course().plan(plan);
    }

    fn begin(&self, stage: &str, total: Option<u64>) {
        let moment = self.course().begin(stage, total);
        self.voice.show(moment.as_ref(), &self.course);
        self.voice.tell(moment.filter(|moment| moment.event == Event::Begins));
    }

    fn note(&self, line: &str) {
        self.say(line);
    }

    fn step(&self) {
        let done = self.course().step();
        self.voice.bar.set_position(done);
    }

    fn reach(&self, done: u64) {
        let done = self.course().reach(done);
        self.voice.bar.set_position(done);
    }

    fn end(&self) {
        self.voice.bar.disable_steady_tick();
        let moment = self.course().end();
        self.voice.tell(moment);
    }

    fn skip(&self, stage: &str) {
        let moment = self.course().skip(stage);
        self.voice.tell(moment);
    }

    fn is_stopped(&self) -> bool {
        self.stopped_by().is_some()
    }
}

/// Writes to stderr, above the bar. A stderr that has gone away is no failure.
#[derive(Clone)]
struct Voice {
    bar: ProgressBar,
    /// Not `Auto`.
    shown: ProgressKind,
}

impl Voice {
    fn line(&self, line: &str) {
        self.bar.suspend(|| {
            let _ = writeln!(io::stderr().lock(), "{}", printable(line));
        });
    }

    /// Says a text as a line, or as a JSON object under a key.
    fn say(&self, key: &str, text: &str) {
        match self.shown {
            ProgressKind::Json => self.line(&json!({ key: text }).to_string()),
            _ => self.line(text),
        }
    }

    /// Says how far a run is. The bar shows that by itself, but for the ends of stages.
    fn tell(&self, moment: Option<Moment>) {
        let Some(moment) = moment else { return };
        let is_over = !matches!(moment.event, Event::Begins | Event::GoesOn);
        match self.shown {
            ProgressKind::None => {}
            ProgressKind::Json => self.line(&moment.json().to_string()),
            // Reading the input is no stage, and over in a moment but for very long files.
            _ if moment.index.is_none() && moment.event != Event::GoesOn => {}
            ProgressKind::Bar if is_over => self.line(&moment.line()),
            ProgressKind::Bar => {}
            _ => self.line(&moment.line()),
        }
    }

    /// Has the bar show a stage from its beginning.
    fn show(&self, moment: Option<&Moment>, course: &Arc<Mutex<StageProgress>>) {
        let Some(moment) = moment.filter(|_| self.shown == ProgressKind::Bar) else { return };
        let template = match moment.total {
            Some(_) => "{prefix} {bar:30} {pos}/{len}, {left}",
            None => "{prefix} {spinner} {left}",
        };
        let course = course.clone();
        let left = move |_: &ProgressState, out: &mut dyn std::fmt::Write| {
            let left_s = lock(&course).moment(Event::GoesOn).and_then(|moment| moment.left_s);
            let _ = out.write_str(&left_s.map_or_else(String::new, in_words));
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            self.bar.set_style(style.with_key("left", left));
        }
        self.bar.reset();
        self.bar.set_prefix(format!("{:<10} {}", moment.name, moment.place()));
        self.bar.set_position(0);
        match moment.total {
            Some(total) => self.bar.set_length(total),
            None => self.bar.unset_length(),
        }
        self.bar.enable_steady_tick(Duration::from_millis(200));
    }
}

impl<'a> MakeWriter<'a> for Voice {
    type Writer = Self;
    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

/// For log lines, which come whole.
impl Write for Voice {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.shown {
            ProgressKind::Json => self.say("message", String::from_utf8_lossy(bytes).trim()),
            _ => {
                let _ = self.bar.suspend(|| io::stderr().write_all(bytes));
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
