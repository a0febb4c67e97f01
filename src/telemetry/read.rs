//! Reading of telemetry files of any format.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::bytes::bytes_of;
use super::error::TelemetryError;
use super::fix::{ClockKind, Log, Room};
use super::gpmf;
use super::kind::head_of;
use super::srt::{self, Subtitle};
use super::text::decode;
use super::{Kind, ardupilot, csv, dji, foreign, gpx, igc, kml, nmea, order, photographs};
use crate::memory::MemoryLimit;
use crate::scene::Timed;

/// Reads a file, or the photographs of a folder in order of their names.
///
/// # Errors
/// [`TelemetryError`] names the file and the remedy.
pub fn read(path: &Path) -> Result<Log, TelemetryError> {
    read_within(path, MemoryLimit::of_machine())
}

/// As [`read`], within a memory limit.
///
/// # Errors
/// As [`read`]; [`TelemetryError::TooLarge`] and [`TelemetryError::TooMany`] where the file exceeds the limit.
pub fn read_within(path: &Path, limit: MemoryLimit) -> Result<Log, TelemetryError> {
    if path.is_dir() {
        return photographs::read_photographs(&photographs_in(path)?);
    }
    parse(&bytes_of(path, limit)?, path, limit)
}

/// Reads the content of a file; `path` is its name in messages.
///
/// # Errors
/// As [`read`].
pub fn read_bytes(bytes: &[u8], path: &Path) -> Result<Log, TelemetryError> {
    parse(bytes, path, MemoryLimit::of_machine())
}

fn parse(bytes: &[u8], path: &Path, limit: MemoryLimit) -> Result<Log, TelemetryError> {
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(TelemetryError::Empty { path: path.to_path_buf() });
    }
    let kind = Kind::of(bytes).ok_or_else(|| unreadable(bytes, path))?;
    let empty = Log { room: Room::within(limit), ..Log::default() };
    let log = match kind {
        Kind::Dji => subtitles(&decode(bytes), empty),
        Kind::Gpx => gpx::read(&decode(bytes), empty),
        Kind::Kml => kml::read(&decode(bytes), empty),
        Kind::Igc => igc::read(&decode(bytes), empty),
        Kind::ArduPilot => ardupilot::read(&decode(bytes), empty),
        Kind::Nmea => nmea::read(&decode(bytes), empty),
        Kind::Csv => csv::read(&decode(bytes), path, empty)?,
        Kind::Photograph => photographs::read_one(bytes),
        Kind::Gpmf => gpmf::read_raw(bytes, empty),
    };
    in_order(log, kind, path)
}

/// Reads the entries of a video's subtitle track; `path` is the video's name in messages.
///
/// # Errors
/// [`TelemetryError::NoFix`] if no entry has a position.
pub fn read_subtitles(entries: &[Timed<String>], path: &Path) -> Result<Log, TelemetryError> {
    let mut log = Log::default();
    for (line, entry) in (1..).zip(entries) {
        let lines = entry.content.lines().map(str::trim).collect();
        dji::read_block(&Subtitle { line, start_s: Some(entry.start_s), lines }, &mut log);
    }
    in_order(with_clock(log), Kind::Dji, path)
}

/// Reads the GPMF track of a video within a memory limit; `path` is the video's name in messages.
///
/// * `settings` – GPMF of the container's user data, with the lens; empty if there is none.
///
/// # Errors
/// [`TelemetryError::NoFix`] if no payload has a position; [`TelemetryError::TooMany`].
pub fn read_gpmf(
    payloads: &[Timed<Vec<u8>>],
    settings: &[u8],
    path: &Path,
    limit: MemoryLimit,
) -> Result<Log, TelemetryError> {
    let empty = Log { room: Room::within(limit), ..Log::default() };
    in_order(gpmf::read(payloads, settings, empty), Kind::Gpmf, path)
}

/// Returns the error for an unknown format, with the converter where it is known.
fn unreadable(bytes: &[u8], path: &Path) -> TelemetryError {
    let head = head_of(bytes);
    let path = path.to_path_buf();
    match foreign::recognize(head, &decode(head)) {
        Some(format) => TelemetryError::Foreign { path, what: format.name, cure: format.cure },
        None => TelemetryError::Unknown { path },
    }
}

fn subtitles(text: &str, empty: Log) -> Log {
    let mut log = empty;
    srt::blocks(text, |block| match block {
        Ok(block) => dji::read_block(&block, &mut log),
        Err((line, reason)) => log.skip_line(line, reason),
    });
    with_clock(log)
}

fn with_clock(mut log: Log) -> Log {
    if log.fixes.iter().any(|fix| fix.clock_s.is_some()) {
        // The drone's clock is set to the time zone of the pilot's phone.
        log.clock = ClockKind::Local;
    }
    time_by_clock(&mut log);
    log
}

/// Derives video times from the clock, relative to the first fix, where subtitles have none.
fn time_by_clock(log: &mut Log) {
    let Some(first_s) = log.fixes.first().and_then(|fix| fix.clock_s) else { return };
    if log.fixes.iter().all(|fix| fix.video_s.is_none()) {
        log.fixes.iter_mut().for_each(|fix| fix.video_s = fix.clock_s.map(|clock_s| clock_s - first_s));
    }
}

fn in_order(mut log: Log, kind: Kind, path: &Path) -> Result<Log, TelemetryError> {
    if log.room.is_exceeded {
        return Err(TelemetryError::TooMany { path: path.to_path_buf(), most: log.room.most });
    }
    log.room = Room::default();
    share_resolution(&mut log);
    if !log.is_by_name() {
        order::sort_by_time(&mut log);
        order::keep_rising(&mut log);
    }
    log.passed_over.sort_by_key(|passed| passed.line);
    if log.fixes.is_empty() {
        let first = log.passed_over.first().map(ToString::to_string);
        return Err(TelemetryError::NoFix { path: path.to_path_buf(), what: kind.name().to_owned(), first });
    }
    Ok(log)
}

/// Gives all fixes of a dialect the finest resolution of any of them: programs drop trailing zeros.
fn share_resolution(log: &mut Log) {
    let mut finest: BTreeMap<&str, f64> = BTreeMap::new();
    for fix in &log.fixes {
        let least = finest.entry(fix.dialect).or_insert(fix.resolution_deg);
        *least = least.min(fix.resolution_deg);
    }
    for fix in &mut log.fixes {
        fix.resolution_deg = finest.get(fix.dialect).copied().unwrap_or(fix.resolution_deg);
    }
}

fn photographs_in(folder: &Path) -> Result<Vec<PathBuf>, TelemetryError> {
    let entries = fs::read_dir(folder).map_err(TelemetryError::system(folder))?;
    let mut paths = Vec::new();
    for entry in entries {
        let path = entry.map_err(TelemetryError::system(folder))?.path();
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        let is_photograph =
            ["jpg", "jpeg", "png", "tif", "tiff"].iter().any(|known| extension.eq_ignore_ascii_case(known));
        if is_photograph && path.is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    match paths.is_empty() {
        true => Err(TelemetryError::NoFix { path: folder.to_path_buf(), what: "a folder".to_owned(), first: None }),
        false => Ok(paths),
    }
}
