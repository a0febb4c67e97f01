//! Errors of telemetry files.

use std::path::{Path, PathBuf};

/// Telemetry file without any usable content. Problems of single lines do not stop the reading; they are recorded in
/// the [`Log`](super::Log).
#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    /// Error of the operating system.
    #[error("{}: cannot be read", path.display())]
    System {
        /// The file or folder.
        path: PathBuf,
        /// Reason given by the system.
        source: std::io::Error,
    },
    /// The file is empty.
    #[error("{}: empty file; copy it from the camera again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file is larger than any log.
    #[error(
        "{}: {size_mib} MiB, larger than any log (limit {most_mib} MiB, or a quarter of the memory limit); give the \
         part that belongs to the video",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        size_mib: u64,
        /// The limit.
        most_mib: u64,
    },
    /// The file has more positions than memory allows.
    #[error(
        "{}: more than {most} positions, the limit by memory; give the part that belongs to the video, or raise \
         --memory-limit",
        path.display()
    )]
    TooMany {
        /// The file.
        path: PathBuf,
        /// Maximum number of positions.
        most: usize,
    },
    /// Unknown format.
    #[error(
        "{}: neither subtitles of a drone, nor GPX, KML, IGC, NMEA, ArduPilot's text log, a table with longitude and \
         latitude in its header, a photograph with GPS data, nor a video with telemetry; see docs/telemetry.md \
         (gpsbabel converts many others to GPX)",
        path.display()
    )]
    Unknown {
        /// The file.
        path: PathBuf,
    },
    /// Unsupported format of another program.
    #[error("{}: {what}, which is not read; {cure}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Format.
        what: &'static str,
        /// Command that makes a readable file.
        cure: &'static str,
    },
    /// The file refers to other files instead of containing positions.
    #[error("{path}: a playlist ({format}), no telemetry; give the video files it names", path = path.display())]
    Playlist {
        /// The file.
        path: PathBuf,
        /// FFmpeg's name of the format.
        format: String,
    },
    /// The format is known, but the file has no usable position.
    #[error("{}: {what} without any position{}", path.display(), first_reason(.first.as_deref()))]
    NoFix {
        /// The file.
        path: PathBuf,
        /// The format or dialect.
        what: String,
        /// Problem of the first line without a usable position.
        first: Option<String>,
    },
    /// The header of a table cannot be used.
    #[error("{}, line {line}: {problem}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// Problem, and the remedy.
        problem: String,
    },
}

impl TelemetryError {
    /// For `map_err`: the system cannot read the path.
    pub(super) fn system(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::System { path, source }
    }
}

fn first_reason(first: Option<&str>) -> String {
    first.map(|reason| format!("; {reason}")).unwrap_or_default()
}
