//! Telemetry of a live run: recorded byte for byte, then handed to the georeferencing.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

use anyhow::Context;

use super::super::output::Failure;
use crate::files;
use crate::live::TelemetryFeed;
use crate::telemetry::Kind;

/// Name of the recording without its extension: that of the video, so that a run finds it.
const STEM: &str = "recording";
/// Its extensions.
const EXTENSIONS: [&str; 5] = ["srt", "gpx", "csv", "nmea", "log"];
/// Bytes that are copied at once at most.
const CHUNK_BYTES: usize = 16 << 10;
/// Bytes at the beginning by which the format is recognized, if they come within one line.
const HEAD_BYTES: usize = 512;
/// Wait for a file to grow.
const POLL: Duration = Duration::from_millis(50);

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
        let earlier: Vec<PathBuf> =
            EXTENSIONS.iter().map(|end| output.join(STEM).with_extension(end)).filter(|path| path.is_file()).collect();
        if let Some(found) = earlier.first().filter(|_| !overwrite) {
            return Err(Failure::Usage(format!("{}: recording exists; give --overwrite", found.display())));
        }
        for path in earlier {
            fs::remove_file(&path).with_context(|| format!("{}: cannot be removed", path.display()))?;
        }
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
        let mut input = files::open_stream(&self.source)?;
        let mut recording = Recording::NotBegun(Vec::new());
        let mut chunk = vec![0; CHUNK_BYTES];
        // What a file has at first was not written just now.
        let mut is_live = self.is_pipe;
        loop {
            let count = match input.read(&mut chunk) {
                Ok(count) => count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            if self.is_over.load(Ordering::Relaxed) {
                return recording.sync();
            }
            if count == 0 {
                if self.is_pipe {
                    return recording.end(self);
                }
                is_live = true;
                thread::sleep(POLL);
                continue;
            }
            let new = recording.write(&chunk[..count], self)?;
            self.feed.push(&new, is_live);
        }
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
}
