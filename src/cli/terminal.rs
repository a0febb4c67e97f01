//! Talk on stderr: warnings, and how far a run is.

use std::io::{self, IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

use crate::pipeline::Progress;

/// The environment variable that sets what is logged, in `tracing`'s filter language.
const LOG_VARIABLE: &str = "TRACTRIX_LOG";

/// Shows progress: a bar where stderr is a terminal, else a line per stage.
pub(super) struct Talk {
    quiet: bool,
    bar: ProgressBar,
    stage: Mutex<Option<(String, Instant)>>,
}

impl Talk {
    /// Starts logging, too.
    pub(super) fn start(quiet: bool, verbose: bool) -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
        if io::stderr().is_terminal() && !quiet {
            bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        let level = match (quiet, verbose) {
            (true, _) => "error",
            (_, true) => "tractrix=debug,warn",
            _ => "warn",
        };
        let filter = EnvFilter::try_from_env(LOG_VARIABLE).unwrap_or_else(|_| EnvFilter::new(level));
        let writer = AboveBar { bar: bar.clone() };
        let subscriber = tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer).with_target(false);
        // Only a second start in one process fails, and then the first one's settings hold.
        let _ = subscriber.without_time().with_ansi(io::stderr().is_terminal()).try_init();
        Self { quiet, bar, stage: Mutex::new(None) }
    }

    /// Says a line, above the bar, unless nothing is to be said.
    pub(super) fn say(&self, line: &str) {
        if !self.quiet {
            self.bar.suspend(|| eprintln!("{line}"));
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn stage(&self) -> std::sync::MutexGuard<'_, Option<(String, Instant)>> {
        self.stage.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Progress for Talk {
    fn begin(&self, stage: &str, total: Option<u64>) {
        let mut current = self.stage();
        if current.as_ref().is_none_or(|(name, _)| name != stage) {
            *current = Some((stage.to_owned(), Instant::now()));
        }
        let template = match total {
            Some(_) => "{prefix:<10} {bar:30} {pos}/{len}, {eta} left",
            None => "{prefix:<10} {spinner} {elapsed}",
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            self.bar.set_style(style);
        }
        self.bar.reset();
        self.bar.set_prefix(stage.to_owned());
        self.bar.set_position(0);
        match total {
            Some(total) => self.bar.set_length(total),
            None => self.bar.unset_length(),
        }
        self.bar.enable_steady_tick(Duration::from_millis(200));
    }

    fn note(&self, line: &str) {
        self.say(line);
    }

    fn step(&self) {
        self.bar.inc(1);
    }

    fn end(&self, reused: bool) {
        self.bar.disable_steady_tick();
        let Some((stage, started)) = self.stage().take() else { return };
        if self.quiet || stage == "input" {
            return;
        }
        let took = if reused { "done before".to_owned() } else { format!("{:.1} s", started.elapsed().as_secs_f64()) };
        self.bar.suspend(|| eprintln!("{stage:<10} {took}"));
    }
}

/// Writes log lines above the bar.
#[derive(Clone)]
struct AboveBar {
    bar: ProgressBar,
}

impl<'a> MakeWriter<'a> for AboveBar {
    type Writer = Self;
    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

impl Write for AboveBar {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bar.suspend(|| io::stderr().write_all(bytes))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
