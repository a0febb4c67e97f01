//! Signals that ask the program to end: SIGINT (Ctrl-C), SIGTERM and SIGHUP.
//!
//! A live recording is ended by the first SIGINT or SIGTERM, after which its run begins; the next signal ends that.
//!
//! A run ends at the next unit of work, a frame or an object, and tells so; where the unit at hand takes longer than
//! [`GRACE`], it is dropped. Nothing is ever left half-written, so that dropping is safe, and a second signal does it
//! at once. Whoever starts programs knows by the exit code whether to start this one again: a person's Ctrl-C is 130,
//! what the system stopped is [`TRY_AGAIN`].
//!
//! A signal that is ignored when the program starts, as `nohup` does with SIGHUP, stays ignored.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

/// Exit code that asks for another start with the same command, `EX_TEMPFAIL` of sysexits.h.
pub(super) const TRY_AGAIN: u8 = 75;
/// Time for the current unit of work; with the rest the program ends within two seconds.
const GRACE: Duration = Duration::from_millis(1500);
/// Time for last messages: nobody may be reading them.
const LAST_WORDS: Duration = Duration::from_millis(200);
/// Number in place of a signal before any has come: signals count from 1.
const NONE: i32 = 0;

/// A signal that asked the program to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Signal(i32);

impl Signal {
    /// 130 for Ctrl-C, as shells have it; [`TRY_AGAIN`] for what the system stops.
    pub(super) fn exit_code(self) -> u8 {
        if self.0 == SIGINT { 130 } else { TRY_AGAIN }
    }
}

/// Kind of ending that a signal asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// At once: the command leaves its files at its end.
    AtOnce,
    /// At the next unit of work, which stays.
    NextUnit,
    /// The same, of a run on a recording that the command made itself.
    Recorded,
}

impl Order {
    /// Message.
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::AtOnce => "stopped; the same command starts again",
            Self::NextUnit => "stopped; the same command resumes",
            Self::Recorded => "stopped; `tractrix run` on the recording gives the results",
        }
    }
}

/// Whether, and by what, the program was asked to end.
#[derive(Clone, Debug, Default)]
pub(super) struct Stop {
    signal: Arc<AtomicI32>,
    in_order: Arc<AtomicBool>,
    recording: Arc<Recording>,
}

/// State of a recording, which the first SIGINT or SIGTERM ends without ending the program.
#[derive(Debug, Default)]
struct Recording {
    is_current: AtomicBool,
    is_ended: AtomicBool,
    /// True from its begin to the end of the program.
    has_begun: AtomicBool,
}

/// Signals from the moment on at which this was made, until someone listens.
pub(super) struct CaughtSignals(Option<Signals>);

impl CaughtSignals {
    /// Installs the handlers. Where none can be had, the system's own ends the program, without a word.
    pub(super) fn new() -> Self {
        let ignored = ignored_signals();
        let wanted = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| ignored >> (signal - 1) & 1 == 0);
        Self(Signals::new(wanted).ok())
    }
}

impl Stop {
    /// Starts to listen. `last_words` are reported where the program cannot end by itself.
    pub(super) fn listen(
        CaughtSignals(caught): CaughtSignals,
        last_words: impl Fn(Signal, Order) + Send + Sync + 'static,
    ) -> Self {
        let stop = Self::default();
        let Some(mut signals) = caught else { return stop };
        let (asked, last_words) = (stop.clone(), Arc::new(last_words));
        thread::spawn(move || {
            for signal in signals.forever() {
                if asked.ends_recording(signal) {
                    continue;
                }
                let is_first = asked.signal.compare_exchange(NONE, signal, Ordering::SeqCst, Ordering::SeqCst).is_ok();
                let grace = if is_first && asked.order() != Order::AtOnce { GRACE } else { Duration::ZERO };
                let (asked, last_words) = (asked.clone(), last_words.clone());
                thread::spawn(move || {
                    thread::sleep(grace);
                    asked.end_now(signal, last_words);
                });
            }
        });
        stop
    }

    /// From here on a signal ends the work at the next unit of it.
    pub(super) fn end_in_order(&self) {
        self.in_order.store(true, Ordering::SeqCst);
    }

    /// From here on the first SIGINT or SIGTERM ends the recording alone.
    pub(super) fn begin_recording(&self) {
        self.recording.has_begun.store(true, Ordering::SeqCst);
        self.recording.is_current.store(true, Ordering::SeqCst);
    }

    /// The recording is complete: from here on signals end the program.
    pub(super) fn complete_recording(&self) {
        self.recording.is_current.store(false, Ordering::SeqCst);
    }

    /// Returns true if a signal has ended the recording.
    pub(super) fn has_ended_recording(&self) -> bool {
        self.recording.is_ended.load(Ordering::SeqCst)
    }

    /// Takes a signal as the end of the recording, if there is one.
    fn ends_recording(&self, signal: i32) -> bool {
        let ends = signal != SIGHUP && self.recording.is_current.swap(false, Ordering::SeqCst);
        self.recording.is_ended.fetch_or(ends, Ordering::SeqCst);
        ends
    }

    /// The signal that asked first.
    pub(super) fn signal(&self) -> Option<Signal> {
        let signal = self.signal.load(Ordering::SeqCst);
        (signal != NONE).then_some(Signal(signal))
    }

    /// Kind of ending.
    pub(super) fn order(&self) -> Order {
        match (self.in_order.load(Ordering::SeqCst), self.recording.has_begun.load(Ordering::SeqCst)) {
            (false, _) => Order::AtOnce,
            (true, false) => Order::NextUnit,
            (true, true) => Order::Recorded,
        }
    }

    /// Ends the process whatever it is at.
    fn end_now(&self, signal: i32, last_words: Arc<impl Fn(Signal, Order) + Send + Sync + 'static>) {
        let (signal, order) = (self.signal().unwrap_or(Signal(signal)), self.order());
        let (said, heard) = std::sync::mpsc::channel();
        thread::spawn(move || {
            last_words(signal, order);
            let _ = said.send(());
        });
        let _ = heard.recv_timeout(LAST_WORDS);
        signal_hook::low_level::exit(signal.exit_code().into());
    }
}

/// The signals that whoever started the program wants ignored, a bit each, the first being signal 1.
fn ignored_signals() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    ignored_of(&status).unwrap_or(0)
}

fn ignored_of(status: &str) -> Option<u64> {
    let bits = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
    u64::from_str_radix(bits.trim(), 16).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_and_the_system_have_codes_of_their_own() {
        let codes = [SIGINT, SIGTERM, SIGHUP].map(|signal| Signal(signal).exit_code());
        assert_eq!(codes, [130, TRY_AGAIN, TRY_AGAIN]);
    }

    #[test]
    fn what_is_to_be_ignored_is_read_from_the_status() {
        // As `nohup` leaves it: SIGHUP, and SIGPIPE of Rust's own.
        let status = "Name:\tt\nSigBlk:\t0000000000000000\nSigIgn:\t0000000000001001\nSigCgt:\t0\n";
        let ignored = ignored_of(status).unwrap();
        assert_eq!([SIGHUP, SIGINT, SIGTERM].map(|signal| ignored >> (signal - 1) & 1), [1, 0, 0]);
        assert_eq!(ignored_of("Name:\tt\n"), None);
    }

    #[test]
    fn nothing_stops_a_program_that_nobody_asked() {
        let stop = Stop::default();
        assert_eq!((stop.signal(), stop.order()), (None, Order::AtOnce));
        stop.end_in_order();
        assert_eq!(stop.order(), Order::NextUnit);
    }

    #[test]
    fn the_first_signal_ends_a_recording_and_the_second_the_program() {
        let stop = Stop::default();
        assert!(!stop.ends_recording(SIGTERM), "there is none");
        stop.begin_recording();
        assert!(!stop.ends_recording(SIGHUP) && !stop.has_ended_recording());
        assert!(stop.ends_recording(SIGINT) && stop.has_ended_recording());
        assert!(!stop.ends_recording(SIGINT));
        stop.end_in_order();
        assert_eq!(stop.order(), Order::Recorded);
    }
}
