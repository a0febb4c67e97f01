//! Selection of the frames of an input, and their size.

use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{Checked, OptionError, within};
use crate::scene::{Frame, FrameId};

/// Position in the source: a time or a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Position {
    /// Seconds, on the container's clock.
    Seconds(f64),
    /// Index in the source, from 0.
    Frame(u32),
}

impl Position {
    /// Returns true if a frame is at or after this position.
    fn is_reached_by(self, id: FrameId, time_s: f64) -> bool {
        match self {
            Self::Seconds(seconds) => time_s >= seconds,
            Self::Frame(index) => id.0 >= index,
        }
    }
}

impl FromStr for Position {
    type Err = String;

    /// `12.5` is a time in seconds, `120f` a frame.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}': expected seconds (12.5) or a frame (120f)");
        if let Some(frame) = text.strip_suffix('f') {
            return frame.parse().map(Self::Frame).map_err(|_| wrong());
        }
        match text.parse::<f64>() {
            Ok(seconds) if seconds.is_finite() && seconds >= 0.0 => Ok(Self::Seconds(seconds)),
            _ => Err(wrong()),
        }
    }
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Seconds(seconds) => seconds.fmt(f),
            Self::Frame(index) => write!(f, "{index}f"),
        }
    }
}

impl From<Position> for String {
    fn from(position: Position) -> Self {
        position.to_string()
    }
}

impl TryFrom<String> for Position {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// Selection and size of frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// First frame: a time or an index; `None` for the beginning.
    #[schemars(with = "Option<String>", extend("unit" = "seconds (\"12.5\") or a frame (\"120f\")"))]
    pub start: Option<Position>,
    /// End, exclusive; `None` for the end of the video.
    #[schemars(with = "Option<String>", extend("unit" = "seconds (\"12.5\") or a frame (\"120f\")"))]
    pub end: Option<Position>,
    /// Use every n-th frame.
    #[schemars(extend("unit" = "frames"))]
    pub every: u32,
    /// Longer side to which larger images are reduced; results refer to the reduced size.
    #[schemars(extend("unit" = "pixels"))]
    pub max_dimension: Option<u32>,
    /// Frame rate of a folder of images; without it the index is the time.
    #[schemars(extend("unit" = "frames per second"))]
    pub fps: Option<f64>,
    /// Video track, counted from 0 as FFmpeg does (`-map 0:v:N`); `None` for the first one with about as many frames as
    /// any.
    pub track: Option<u32>,
    /// Rotation of photographs by their EXIF data; rotation of videos is always applied.
    pub turning: Turning,
}

/// Treatment of photographs that were taken with the camera turned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Turning {
    /// As stored if only a model is made (`tractrix sfm` without masks), otherwise upright.
    #[default]
    Auto,
    /// Upright; models refer to upright images.
    Upright,
    /// As stored; models refer to the files.
    AsStored,
}

impl Default for Options {
    fn default() -> Self {
        Self { start: None, end: None, every: 1, max_dimension: None, fps: None, track: None, turning: Turning::Auto }
    }
}

impl Options {
    /// Rejects contradictions.
    ///
    /// # Errors
    /// [`OptionError`] names the option.
    pub fn check(&self) -> Checked {
        let contradiction = match (self.start, self.end) {
            (Some(Position::Seconds(start)), Some(Position::Seconds(end))) => start >= end,
            (Some(Position::Frame(start)), Some(Position::Frame(end))) => start >= end,
            _ => false,
        };
        if contradiction {
            return Err(OptionError::new("start", "--start must be before --end"));
        }
        if self.every == 0 {
            return Err(OptionError::new("every", "--every must be at least 1"));
        }
        // No detection is possible in smaller images.
        if self.max_dimension.is_some_and(|side| side < 16) {
            return Err(OptionError::new("max_dimension", "--max-dimension must be at least 16 pixels"));
        }
        // From one image in eleven days to a million per second: beyond, times would no longer distinguish frames.
        self.fps.map_or(Ok(()), |fps| within("fps", fps, 1e-6..=1e6))
    }
}

/// Decision on a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Choice {
    Take,
    Skip,
    Stop,
}

/// Selects frames in order of their index.
#[derive(Debug)]
pub(super) struct Selection {
    options: Options,
    first: Option<FrameId>,
}

impl Selection {
    pub(super) fn new(options: &Options) -> Self {
        Self { options: options.clone(), first: None }
    }

    pub(super) fn choose(&mut self, frame: &Frame) -> Choice {
        let reached =
            |place: Option<Position>, default| place.map_or(default, |p| p.is_reached_by(frame.id, frame.time_s));
        if reached(self.options.end, false) {
            return Choice::Stop;
        }
        if self.first.is_none() && !reached(self.options.start, true) {
            return Choice::Skip;
        }
        let first = *self.first.get_or_insert(frame.id);
        if (frame.id.0 - first.0).is_multiple_of(self.options.every.max(1)) { Choice::Take } else { Choice::Skip }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(options: &Options) -> Vec<u32> {
        let mut selection = Selection::new(options);
        let mut taken = Vec::new();
        for id in 0..100 {
            let frame = Frame { id: FrameId(id), name: String::new(), time_s: f64::from(id) * 0.1 };
            match selection.choose(&frame) {
                Choice::Take => taken.push(id),
                Choice::Skip => {}
                Choice::Stop => break,
            }
        }
        taken
    }

    #[test]
    fn start_end_and_every_choose_frames() {
        let options = Options { start: "0.95".parse().ok(), end: "20f".parse().ok(), every: 4, ..Options::default() };
        assert_eq!(chosen(&options), [10, 14, 18]);
        assert_eq!(chosen(&Options::default()).len(), 100);
        assert!(chosen(&Options { start: Some(Position::Seconds(99.0)), ..Options::default() }).is_empty());
    }

    #[test]
    fn positions_are_seconds_or_frames() {
        assert_eq!("12.5".parse(), Ok(Position::Seconds(12.5)));
        assert_eq!("7f".parse(), Ok(Position::Frame(7)));
        for wrong in ["", "f", "-1", "nan", "1.5f", "1s"] {
            assert!(wrong.parse::<Position>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn contradictions_are_refused() {
        let reversed = Options { start: "2".parse().ok(), end: "1".parse().ok(), ..Options::default() };
        assert!(reversed.check().is_err());
        assert!(Options { every: 0, ..Options::default() }.check().is_err());
        assert!(Options { max_dimension: Some(3), ..Options::default() }.check().is_err());
        assert!(Options::default().check().is_ok());
    }
}
