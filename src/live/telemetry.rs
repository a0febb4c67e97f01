//! Telemetry that is received while the camera records: its latest lines, with the video time at which each came.
//!
//! A log that is written while the camera records needs no offset between the clocks: a line comes when its position is
//! measured, a frame when it is taken, each with a delay of some tenths of a second.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

use super::lock;
use crate::math::median;
use crate::telemetry::{self, Fix, Log, TelemetryError};

/// Number of bytes kept from the beginning, in whole lines: the header of a table, and the first position.
const HEAD_BYTES: usize = 4 << 10;
/// Bytes of the latest lines that are kept: ten minutes of a table at 10 Hz, a quarter of a minute of the subtitles of
/// a drone at 60 Hz.
const TAIL_BYTES: usize = 512 << 10;
/// Fewest positions whose arrival gives the offset between the clocks.
const MIN_ARRIVALS: usize = 4;
/// Maximum median absolute deviation of the offsets by arrival, seconds; above it, lines did not arrive as they were
/// measured: a file that is sent at once.
const MAX_SPREAD_S: f64 = 0.5;
/// Standard deviation of an offset by arrival, seconds: the difference of two delays.
const ARRIVAL_STD_S: f64 = 0.4;

/// A line, and the video time of its arrival if that is the time of measurement.
struct Received {
    text: Vec<u8>,
    video_s: Option<f64>,
}

/// Lines of a log that is still being written.
pub struct TelemetryFeed {
    /// Name of the recording in messages.
    path: PathBuf,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    head: Vec<Received>,
    head_bytes: usize,
    tail: VecDeque<Received>,
    tail_bytes: usize,
    /// Beginning of a line whose end has not come yet.
    partial: Vec<u8>,
    /// Time of the last frame and when it was decoded.
    frame: Option<(f64, Instant)>,
}

/// A log, and the offset between its clock and the video's by the arrival of its lines.
pub(super) struct Current {
    pub(super) log: Log,
    /// Time of the log minus time of the video, seconds: mean and standard deviation.
    pub(super) by_arrival: Option<(f64, f64)>,
}

impl TelemetryFeed {
    /// A feed without lines.
    ///
    /// * `path` – name of its recording, for messages.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), state: Mutex::default() }
    }

    /// Takes the next bytes of the log.
    ///
    /// * `is_live` – true if they were written just now, false for those of a file that was there before.
    pub fn push(&self, bytes: &[u8], is_live: bool) {
        let mut state = lock(&self.state);
        let video_s = state.frame.filter(|_| is_live).map(|(time_s, at)| time_s + at.elapsed().as_secs_f64());
        for part in bytes.split_inclusive(|byte| *byte == b'\n') {
            state.partial.extend_from_slice(part);
            if part.ends_with(b"\n") || state.partial.len() > TAIL_BYTES {
                let text = std::mem::take(&mut state.partial);
                state.keep(Received { text, video_s });
            }
        }
    }

    /// Takes the time of the newest frame.
    pub(super) fn note_frame(&self, time_s: f64, at: Instant) {
        lock(&self.state).frame = Some((time_s, at));
    }

    /// The log by now.
    ///
    /// # Errors
    /// [`TelemetryError`], also where nothing has come yet.
    pub(super) fn current(&self) -> Result<Current, TelemetryError> {
        let (text, arrivals) = lock(&self.state).lines();
        let log = telemetry::read_bytes(&text, &self.path)?;
        let by_arrival = by_arrival(&log.fixes, &arrivals);
        Ok(Current { log, by_arrival })
    }
}

impl State {
    /// The lines, and when each came.
    fn lines(&self) -> (Vec<u8>, Vec<Option<f64>>) {
        let lines = || self.head.iter().chain(&self.tail);
        (lines().flat_map(|line| line.text.iter().copied()).collect(), lines().map(|line| line.video_s).collect())
    }

    fn keep(&mut self, line: Received) {
        let size = line.text.len();
        if self.tail.is_empty() && self.head_bytes + size <= HEAD_BYTES {
            self.head_bytes += size;
            self.head.push(line);
            return;
        }
        self.tail_bytes += size;
        self.tail.push_back(line);
        while self.tail_bytes > TAIL_BYTES {
            let Some(dropped) = self.tail.pop_front() else { return };
            self.tail_bytes -= dropped.text.len();
        }
    }
}

/// Time of the log's clock minus that of the video, by the lines that came while they were written.
///
/// * `arrivals` – by line.
fn by_arrival(fixes: &[Fix], arrivals: &[Option<f64>]) -> Option<(f64, f64)> {
    let by_video = fixes.iter().all(|fix| fix.video_s.is_some());
    let offset = |fix: &Fix| {
        let time_s = if by_video { fix.video_s } else { fix.clock_s };
        Some(time_s? - (*arrivals.get(fix.line.checked_sub(1)?)?)?)
    };
    let offsets: Vec<f64> = fixes.iter().filter_map(offset).collect();
    if offsets.len() < MIN_ARRIVALS {
        return None;
    }
    let middle = median(offsets.clone())?;
    let spread = median(offsets.iter().map(|offset| (offset - middle).abs()).collect())?;
    (spread <= MAX_SPREAD_S).then_some((middle, ARRIVAL_STD_S.hypot(spread)))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn row(k: u32) -> String {
        format!("2024-06-01T12:00:{:06.3}Z,47.{k:06},8.5,400\n", 0.1 * f64::from(k % 600))
    }

    #[test]
    fn lines_that_arrive_as_they_are_measured_give_the_offset() {
        let feed = TelemetryFeed::new(Path::new("recording.csv"));
        assert!(feed.current().is_err(), "nothing has come");
        feed.push(b"time,latitude,longitude,altitude\n", true);
        for k in 0..20 {
            // A frame at second 5 + k/10, decoded by now.
            feed.note_frame(5.0 + 0.1 * f64::from(k), Instant::now());
            let (row, half) = (row(k), 9);
            feed.push(&row.as_bytes()[..half], true);
            assert_eq!(feed.current().map_or(0, |found| found.log.fixes.len()), k as usize, "whole lines alone");
            feed.push(&row.as_bytes()[half..], true);
        }
        let Current { log, by_arrival } = feed.current().unwrap();
        let (offset_s, std_s) = by_arrival.unwrap();
        let expected = log.fixes[0].clock_s.unwrap() - 5.0;
        assert!((offset_s - expected).abs() < 0.1 && std_s >= ARRIVAL_STD_S, "{offset_s} {expected}");
    }

    #[test]
    fn a_log_that_is_sent_at_once_gives_no_offset() {
        let feed = TelemetryFeed::new(Path::new("recording.csv"));
        feed.note_frame(0.0, Instant::now());
        feed.push(b"time,latitude,longitude,altitude\n", true);
        (0..100).for_each(|k| feed.push(row(k).as_bytes(), true));
        assert_eq!(feed.current().unwrap().by_arrival, None);
        let earlier = TelemetryFeed::new(Path::new("recording.csv"));
        earlier.note_frame(0.0, Instant::now() - Duration::from_secs(1));
        earlier.push(b"time,latitude,longitude,altitude\n", false);
        (0..10).for_each(|k| earlier.push(row(k).as_bytes(), false));
        assert_eq!(earlier.current().unwrap().by_arrival, None);
    }

    #[test]
    fn the_header_and_the_latest_lines_are_kept() {
        let feed = TelemetryFeed::new(Path::new("recording.csv"));
        feed.push(b"time_s,latitude,longitude,altitude\n", false);
        for k in 0..60_000u32 {
            feed.push(format!("{k},47.{k:06},8.5,400\n").as_bytes(), false);
        }
        let log = feed.current().unwrap().log;
        assert_eq!(log.fixes.last().unwrap().video_s, Some(59_999.0));
        assert_eq!(log.fixes[0].video_s, Some(0.0));
        assert!(log.fixes.len() < 30_000 && log.num_passed_over == 0, "{} {:?}", log.fixes.len(), log.passed_over);
        let state = lock(&feed.state);
        assert!(state.tail_bytes <= TAIL_BYTES && state.head_bytes <= HEAD_BYTES);
    }
}
