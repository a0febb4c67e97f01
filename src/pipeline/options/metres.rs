//! Where metres come from.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{Checked, OptionError, within};
use crate::metric::{KnownLength, Measured, TimeOffset, UtcOffset};

/// Which telemetry is taken.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum TelemetryChoice {
    /// File with the video's stem, otherwise data in the video, otherwise EXIF positions of photographs.
    #[default]
    Auto,
    /// No telemetry.
    None,
    /// Log file: subtitles of a drone, GPX, KML, NMEA, CSV and others, or a video with telemetry.
    File(PathBuf),
}

/// Sources of the metric scale besides typical vehicle sizes; all are fused.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MetricOptions {
    /// Telemetry.
    pub telemetry: TelemetryChoice,
    /// Telemetry time minus video time, with standard deviation: `"0.7±0.1"`; `null` is 0 for logs that belong to the
    /// video, otherwise estimated.
    #[schemars(with = "Option<String>", extend("unit" = "seconds, as text"))]
    pub time_offset: Option<TimeOffset>,
    /// Local time minus UTC of logs and photographs without a time zone: `"+02:00"`.
    #[schemars(with = "Option<String>", extend("unit" = "±HH:MM, as text"))]
    pub utc_offset: Option<UtcOffset>,
    /// Mean height of the camera above the ground, with standard deviation: `"1.45±0.05"`.
    #[schemars(with = "Option<String>", extend("unit" = "metres, as text"))]
    pub camera_height: Option<Measured>,
    /// Inclination of the camera below the horizon in the first frame, where it does not translate, with standard
    /// deviation: `"45±1"`.
    #[schemars(with = "Option<String>", extend("unit" = "degrees, as text"))]
    pub camera_pitch: Option<Measured>,
    /// GeoJSON file of at least four points of the ground with the pixel (properties `x`, `y`) at which a camera that
    /// does not translate sees them in a frame (`frame`, index in the source; `null` is the first one). The ground is
    /// level, or follows the points where all have heights.
    pub map_points: Option<PathBuf>,
    /// Meters per unit of the background, with standard deviation: `"12.3±0.1"`.
    #[schemars(with = "Option<String>", extend("unit" = "metres per unit, as text"))]
    pub scale: Option<Measured>,
    /// Known dimensions of vehicles, with standard deviation: `"1:length=4.47±0.02"`.
    #[schemars(with = "Vec<String>", extend("unit" = "metres, as text"))]
    pub known_lengths: Vec<KnownLength>,
}

impl MetricOptions {
    /// Rejects what cannot be meant.
    ///
    /// # Errors
    /// [`OptionError`] names the option.
    pub fn check(&self) -> Checked {
        self.camera_height.map_or(Ok(()), |height| value_within("camera_height", height, [0.01, 100_000.0]))?;
        self.camera_pitch.map_or(Ok(()), |pitch| value_within("camera_pitch", pitch, [1.0, 90.0]))?;
        self.scale.map_or(Ok(()), |scale| value_within("scale", scale, [1e-9, 1e9]))?;
        self.known_lengths.iter().try_for_each(|known| value_within("known_lengths", known.length, [0.1, 100.0]))?;
        let Some(offset) = self.time_offset else { return Ok(()) };
        within("time_offset", offset.mean_s, -1e10..=1e10)?;
        within("time_offset", offset.std_s, 1e-3..=1e6)
    }
}

/// A value in its range whose deviation is no larger than half of it: beyond that its logarithm means nothing.
fn value_within(key: &str, measured: Measured, [least, most]: [f64; 2]) -> Checked {
    within(key, measured.value, least..=most)?;
    let too_wide = || OptionError::new(key, format!("{measured}: standard deviation must be below half the value"));
    (measured.std <= 0.5 * measured.value).then_some(()).ok_or_else(too_wide)
}

#[cfg(test)]
mod tests {
    use super::super::Options;

    #[test]
    fn quantities_are_texts_with_limits() {
        let with = |key: &str, text: &str| Options::default().with_value(key, text);
        let options = with("metric.camera_height", "1.45±0.05").unwrap();
        assert_eq!(options.metric.camera_height, "1.45±0.05".parse().ok());
        assert!(with("metric.time_offset", "-0.7").unwrap().check().is_ok());
        assert!(with("metric.scale", "-3").is_err() && with("metric.camera_height", "tall").is_err());
        for (key, text) in [
            ("metric.camera_height", "1e9"),
            ("metric.known_lengths", "[\"1:length=447\"]"),
            ("metric.camera_height", "1.4±1"),
            ("metric.scale", "1e-12"),
        ] {
            let said = with(key, text).unwrap().check().unwrap_err().to_string();
            assert!(said.contains(key), "{said}");
        }
    }
}
