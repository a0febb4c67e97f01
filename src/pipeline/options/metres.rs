//! Where metres come from.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::limits::{Checked, OptionError, within};
use crate::metric::{KnownLength, Measured, TimeOffset, UtcOffset};

/// Which telemetry is taken.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum TelemetryChoice {
    /// A file next to the video with its stem, else what is inside the video, else what photographs say of their
    /// places.
    #[default]
    Auto,
    /// None.
    None,
    /// A log: DJI's subtitles, GPX, NMEA or CSV.
    File(PathBuf),
}

/// Where metres come from, besides what vehicles are like. All that is there is weighed together.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MetricOptions {
    /// Which telemetry is taken.
    pub telemetry: TelemetryChoice,
    /// Time of the telemetry minus time of the video, with its standard deviation: `"0.7±0.1"`. The time of a log with
    /// a clock counts from its first fix. `null`: 0 for logs that belong to a video, else it is found.
    #[schemars(with = "Option<String>", extend("unit" = "seconds, as text"))]
    pub time_offset: Option<TimeOffset>,
    /// Local time minus UTC of logs and photographs whose clock states no zone: `"+02:00"`. `null`: their dates stay
    /// local.
    #[schemars(with = "Option<String>", extend("unit" = "±HH:MM, as text"))]
    pub utc_offset: Option<UtcOffset>,
    /// Height of the camera over the ground, on average over the video, with its standard deviation: `"1.45±0.05"`.
    #[schemars(with = "Option<String>", extend("unit" = "metres, as text"))]
    pub camera_height: Option<Measured>,
    /// Metres per unit of the background, with their standard deviation: `"12.3±0.1"`.
    #[schemars(with = "Option<String>", extend("unit" = "metres per unit, as text"))]
    pub scale: Option<Measured>,
    /// Lengths, widths and heights of vehicles that are known, with their standard deviations: `"1:length=4.47±0.02"`.
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
