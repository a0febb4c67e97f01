//! Frames, and identifiers of frames and objects.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Index of a frame in its source, from 0: for a video the index of the decoded frame, for a folder the index in the
/// sorted list of its images. It does not change with `--start`, `--end` or `--every`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct FrameId(pub u32);

/// One tracked vehicle; ids start at 1, since 0 means background in a label map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct ObjectId(pub u32);

impl fmt::Display for ObjectId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Unit of the times of an input's frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TimeBase {
    /// Seconds.
    Seconds,
    /// Frames: no frame rate is known, so that no time can be determined.
    Frames,
}

/// Properties of a frame besides its pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Index in the source.
    pub id: FrameId,
    /// Image name in every output: `000042.jpg` for frame 42 of a video, the file's own name for a folder.
    pub name: String,
    /// Presentation time, seconds, from the container; for a folder `index / fps` where a rate is known, else the
    /// index.
    pub time_s: f64,
}

impl Frame {
    /// The name without its extension.
    pub fn stem(&self) -> &str {
        self.name.rsplit_once('.').map_or(self.name.as_str(), |(stem, _)| stem)
    }
}

/// Content of an entry in a text or telemetry track of a video.
#[derive(Clone, Debug, PartialEq)]
pub struct Timed<T> {
    /// Start, seconds on the clock of the frames; negative before the first frame.
    pub start_s: f64,
    /// End, seconds; no earlier than `start_s`, and equal to it where the file does not state one.
    pub end_s: f64,
    /// As stored in the file.
    pub content: T,
}

/// Seconds after 1970 from a clock in seconds, milliseconds, microseconds or nanoseconds.
///
/// The magnitude decides on the unit: seconds are below 10¹¹ until the year 5138, and so on in steps of a thousand.
pub fn clock_in_seconds(time: f64) -> f64 {
    // Least number of a clock in nanoseconds, microseconds or milliseconds, and its unit, seconds.
    const UNITS: [(f64, f64); 3] = [(1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3)];
    UNITS.iter().find(|(least, _)| time >= *least).map_or(time, |(_, unit)| time * unit)
}
