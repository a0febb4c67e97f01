//! Telemetry of a live run: recorded byte for byte, then handed to the georeferencing. Of MAVLink a table is written,
//! too.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;

use anyhow::Context;

use super::super::output::Failure;
use super::super::recording::{STEM, recordings, remove};
use super::{CHUNK_BYTES, POLL};
use crate::files;
use crate::live::TelemetryFeed;
use crate::telemetry::Kind;

/// Extensions of its recording.
const EXTENSIONS: [&str; 6] = ["srt", "gpx", "csv", "nmea", "log", "mavlink"];
/// Bytes at the beginning by which the format is recognized, if they come within one line.
const HEAD_BYTES: usize = 512;

/// Telemetry that is being recorded.
pub(super) struct Telemetry {
    pub(super) feed: Arc<TelemetryFeed>,
    recorded: Arc<OnceLock<PathBuf>>,
    is_over: Arc<AtomicBool>,
}

impl Telemetry {
    /// Records a named pipe or a file that may grow, on a thread of its own: a pipe waits for its writer.
    ///
    /// # Errors
    /// A path that is neither, an earlier recording without `overwrite`.
    pub(super) fn start(path: &Path, output: &Path, overwrite: bool) -> Result<Self, Failure> {
        let shown = path.display();
        let found = fs::metadata(path).with_context(|| format!("{shown}: cannot be read; check --telemetry"))?;
        let is_pipe = found.file_type().is_fifo();
        if !is_pipe {
            files::check(path).with_context(|| format!("{shown}: cannot be read; check --telemetry"))?;
        }
        let earlier = recordings(output, &EXTENSIONS);
        if let Some(found) = earlier.first().filter(|_| !overwrite) {
            return Err(Failure::Usage(format!("{}: recording exists; give --overwrite", found.display())));
        }
        remove(&earlier)?;
        let feed = Arc::new(TelemetryFeed::new(path));
        let telemetry = Self { feed: feed.clone(), recorded: Arc::default(), is_over: Arc::default() };
        let copy = Copy {
            source: path.to_owned(),
            is_pipe,
            output: output.to_owned(),
            feed,
            recorded: telemetry.recorded.clone(),
            is_over: telemetry.is_over.clone(),
        };
        let copying = thread::Builder::new().name("telemetry".into()).spawn(move || {
            if let Err(error) = copy.run() {
                tracing::error!("{}: telemetry is not recorded any more: {error}", copy.source.display());
            }
        });
        copying.context("recorder of telemetry cannot be started")?;
        Ok(telemetry)
    }

    /// Ends the recording; gives its file, if anything came.
    pub(super) fn finish(&self) -> Option<&Path> {
        self.is_over.store(true, Ordering::Relaxed);
        self.recorded.get().map(PathBuf::as_path)
    }
}

struct Copy {
    source: PathBuf,
    is_pipe: bool,
    output: PathBuf,
    feed: Arc<TelemetryFeed>,
    recorded: Arc<OnceLock<PathBuf>>,
    is_over: Arc<AtomicBool>,
}

impl Copy {
    fn run(&self) -> io::Result<()> {
        let mut input = Input { file: files::open_stream(&self.source)?, is_live: self.is_pipe, copy: self };
        let mut chunk = vec![0; CHUNK_BYTES];
        let mut count = input.read(&mut chunk)?;
        #[cfg(feature = "live")]
        if super::mavlink_log::is_mavlink(&chunk[..count]) {
            chunk.truncate(count);
            return self.tabulate(chunk, input);
        }
        let mut recording = Recording::NotBegun(Vec::new());
        while count > 0 {
            let new = recording.write(&chunk[..count], self)?;
            self.feed.push(&new, input.is_live);
            count = input.read(&mut chunk)?;
        }
        recording.end(self)
    }

    /// Records MAVLink, and the table of its positions.
    ///
    /// * `head` – what was read of it.
    #[cfg(feature = "live")]
    fn tabulate(&self, head: Vec<u8>, input: Input<'_>) -> io::Result<()> {
        use mavlink::MavlinkReader;
        use mavlink::dialects::common::MavMessage;
        use mavlink::error::MessageReadError;

        use super::mavlink_log::{HEADER, Table};
        use super::updates::now_s;

        let path = self.output.join(STEM).with_extension("mavlink");
        let recorded = Recorded { head: io::Cursor::new(head), input, file: File::create_new(path)? };
        let mut reader = MavlinkReader::new(recorded);
        let (mut table, mut recording) = (Table::default(), Recording::NotBegun(Vec::new()));
        self.feed.push(&recording.write(HEADER.as_bytes(), self)?, false);
        loop {
            match reader.read_any_message::<MavMessage>() {
                Ok((header, message)) => {
                    let Some(line) = table.line(header, &message, now_s()) else { continue };
                    let new = recording.write(line.as_bytes(), self)?;
                    self.feed.push(&new, reader.get_ref().input.is_live);
                }
                Err(MessageReadError::Io(error)) if error.kind() == io::ErrorKind::UnexpectedEof => break,
                Err(MessageReadError::Io(error)) => return Err(error),
                // Of another dialect.
                Err(MessageReadError::Parse(_)) => {}
            }
        }
        reader.get_ref().file.sync_all()?;
        recording.end(self)
    }
}

/// Bytes of a log until it ends: those that a file still gets, too.
struct Input<'a> {
    file: File,
    /// True for bytes that were written just now: not for those that a file had at first.
    is_live: bool,
    copy: &'a Copy,
}

impl Read for Input<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let count = match self.file.read(buffer) {
                Ok(count) => count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            if self.copy.is_over.load(Ordering::Relaxed) {
                return Ok(0);
            }
            if count > 0 || self.copy.is_pipe {
                return Ok(count);
            }
            self.is_live = true;
            thread::sleep(POLL);
        }
    }
}

/// Bytes that are written to a file as they are read.
#[cfg(feature = "live")]
struct Recorded<'a> {
    /// Bytes that were read before.
    head: io::Cursor<Vec<u8>>,
    input: Input<'a>,
    file: File,
}

#[cfg(feature = "live")]
impl Read for Recorded<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = match self.head.read(buffer)? {
            0 => self.input.read(buffer)?,
            count => count,
        };
        self.file.write_all(&buffer[..count])?;
        Ok(count)
    }
}

/// The recording: its name depends on its first line.
enum Recording {
    NotBegun(Vec<u8>),
    Begun(File),
}

impl Recording {
    /// Writes bytes; gives those that are on the disk now.
    fn write(&mut self, bytes: &[u8], copy: &Copy) -> io::Result<Vec<u8>> {
        match self {
            Self::Begun(file) => file.write_all(bytes).map(|()| bytes.to_vec()),
            Self::NotBegun(head) => {
                head.extend_from_slice(bytes);
                match head.contains(&b'\n') || head.len() >= HEAD_BYTES {
                    true => self.begin(copy),
                    false => Ok(Vec::new()),
                }
            }
        }
    }

    fn begin(&mut self, copy: &Copy) -> io::Result<Vec<u8>> {
        let Self::NotBegun(head) = self else { return Ok(Vec::new()) };
        let head = std::mem::take(head);
        let path = copy.output.join(STEM).with_extension(extension(&head));
        let mut file = File::create_new(&path)?;
        file.write_all(&head)?;
        *self = Self::Begun(file);
        // Nothing else sets it.
        drop(copy.recorded.set(path));
        Ok(head)
    }

    fn end(&mut self, copy: &Copy) -> io::Result<()> {
        if matches!(self, Self::NotBegun(head) if !head.is_empty()) {
            let new = self.begin(copy)?;
            copy.feed.push(&new, false);
        }
        self.sync()
    }

    fn sync(&mut self) -> io::Result<()> {
        match self {
            Self::Begun(file) => file.sync_all(),
            Self::NotBegun(_) => Ok(()),
        }
    }
}

/// Extension of a log by its first line. Subtitles begin with a number, which is no format by itself.
fn extension(head: &[u8]) -> &'static str {
    let first = head.split(|byte| *byte == b'\n').next().unwrap_or_default().trim_ascii();
    match Kind::of(head) {
        Some(Kind::Nmea) => "nmea",
        Some(Kind::Csv) => "csv",
        Some(Kind::Gpx) => "gpx",
        Some(Kind::Dji) => "srt",
        _ if !first.is_empty() && first.iter().all(u8::is_ascii_digit) => "srt",
        _ if first.starts_with(b"$") => "nmea",
        _ => "log",
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn logs_are_named_by_their_first_line() {
        assert_eq!(extension(b"time_s,latitude,longitude\n"), "csv");
        assert_eq!(extension(b"1\r\n"), "srt");
        assert_eq!(extension(b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"), "nmea");
        assert_eq!(extension(b"$PUBX,00\n"), "nmea");
        assert_eq!(extension(b"hello\n"), "log");
    }

    #[test]
    fn a_growing_file_is_recorded_byte_for_byte() {
        let folder = tempfile::tempdir().unwrap();
        let (source, output) = (folder.path().join("log"), folder.path().join("out"));
        fs::create_dir(&output).unwrap();
        fs::write(&source, "time_s,latitude,longitude\n0,47.1,8.5\n").unwrap();
        let telemetry = Telemetry::start(&source, &output, false).unwrap();
        let recording = output.join("recording.csv");
        let has = |text: &str| {
            let is_there = || fs::read_to_string(&recording).is_ok_and(|found| found.ends_with(text));
            (0..200).any(|_| {
                is_there() || {
                    thread::sleep(Duration::from_millis(10));
                    false
                }
            })
        };
        assert!(has("0,47.1,8.5\n"));
        let mut file = fs::OpenOptions::new().append(true).open(&source).unwrap();
        file.write_all(b"1,47.2,8.5\n").unwrap();
        assert!(has("1,47.2,8.5\n"));
        assert_eq!(telemetry.finish(), Some(recording.as_path()));
        assert_eq!(fs::read(&recording).unwrap(), fs::read(&source).unwrap());
        let refused = Telemetry::start(&source, &output, false).map(drop).unwrap_err().to_string();
        assert!(refused.contains("--overwrite"), "{refused}");
    }

    #[test]
    #[cfg(feature = "live")]
    fn mavlink_is_recorded_byte_for_byte_and_as_a_table() {
        use mavlink::dialects::common::{GLOBAL_POSITION_INT_DATA, MavMessage};
        use mavlink::{MavHeader, write_v2_msg};

        let folder = tempfile::tempdir().unwrap();
        let (source, output) = (folder.path().join("log"), folder.path().join("out"));
        fs::create_dir(&output).unwrap();
        let packet = |time_boot_ms| {
            let position =
                GLOBAL_POSITION_INT_DATA { time_boot_ms, lat: 471_000_000, lon: 85_000_000, ..Default::default() };
            let header = MavHeader { system_id: 1, component_id: 1, sequence: 0 };
            let mut packet = Vec::new();
            write_v2_msg(&mut packet, header, &MavMessage::GLOBAL_POSITION_INT(position)).unwrap();
            packet
        };
        // A packet that is damaged, and one that is cut off, between two whole ones.
        let mut damaged = packet(1_500);
        damaged[14] ^= 1;
        let bytes = [packet(1_000), damaged, packet(1_600)[..12].to_vec(), packet(2_000)].concat();
        fs::write(&source, &bytes).unwrap();
        let telemetry = Telemetry::start(&source, &output, false).unwrap();
        let rows = || {
            let text = fs::read_to_string(output.join("recording.csv")).unwrap_or_default();
            text.lines().skip(1).filter(|row| row.contains(",47.1000000,8.5000000,")).count()
        };
        let are_there = (0..200).any(|_| {
            rows() == 2 || {
                thread::sleep(Duration::from_millis(10));
                false
            }
        });
        assert!(are_there, "{} rows", rows());
        assert_eq!(telemetry.finish(), Some(output.join("recording.csv").as_path()));
        assert_eq!(fs::read(output.join("recording.mavlink")).unwrap(), bytes);
    }
}
