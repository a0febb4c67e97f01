//! Times of the video as dates, where a receiver's clock is known.

use jiff::Timestamp;

use crate::scene::{Metric, TimeBase};

/// What the times of a result are to other programs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clock {
    /// Dates: seconds after 1970 = time of the video + `offset_s`.
    Dated {
        /// Seconds.
        offset_s: f64,
    },
    /// Seconds after the video's start.
    OfVideo,
    /// Numbers of frames: nobody stated a rate.
    Frames,
}

/// The sixth of January 1980, where the time of satellites begins: no receiver states an earlier one, so that an
/// offset of less is one to a clock that starts with the video.
const EARLIEST_S: f64 = 315_964_800.0;

impl Clock {
    /// Of a result.
    pub fn of(metric: Option<&Metric>, time_base: TimeBase) -> Self {
        let offset_s = metric.and_then(|metric| metric.time_offset_s);
        match (time_base, offset_s) {
            (TimeBase::Frames, _) => Self::Frames,
            (_, Some(offset_s)) if offset_s >= EARLIEST_S => Self::Dated { offset_s },
            _ => Self::OfVideo,
        }
    }

    /// The date of a time of the video, to the millisecond, as `2024-06-01T12:00:00.5Z`; `None` where none is known.
    pub fn date(&self, time_s: f64) -> Option<String> {
        match self {
            Self::Dated { offset_s } => date(offset_s + time_s),
            Self::OfVideo | Self::Frames => None,
        }
    }

    /// The same for a format that knows nothing but dates: counted from 1970 where none is known.
    pub fn date_or_since_1970(&self, time_s: f64) -> String {
        let known = self.date(time_s).or_else(|| date(time_s));
        known.unwrap_or_else(|| "1970-01-01T00:00:00Z".to_owned())
    }
}

/// `None` beyond the years that a calendar has.
fn date(seconds: f64) -> Option<String> {
    Timestamp::from_millisecond((1e3 * seconds).round() as i64).ok().map(|moment| moment.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Metric, MetricVerdict};

    #[test]
    fn a_large_offset_is_a_date_and_a_small_one_is_none() {
        let metric = |time_offset_s| Metric {
            verdict: MetricVerdict::Unknown,
            reason: None,
            frame: None,
            shares: Vec::new(),
            contradictions: Vec::new(),
            time_offset_s,
            time_offset_std_s: None,
        };
        let dated = Clock::of(Some(&metric(Some(1_717_243_200.25))), TimeBase::Seconds);
        assert_eq!(dated.date(0.25).as_deref(), Some("2024-06-01T12:00:00.5Z"));
        let own = Clock::of(Some(&metric(Some(0.7))), TimeBase::Seconds);
        assert_eq!((own, own.date(1.0)), (Clock::OfVideo, None));
        assert_eq!(own.date_or_since_1970(61.5), "1970-01-01T00:01:01.5Z");
        assert_eq!(Clock::of(Some(&metric(Some(2e9))), TimeBase::Frames), Clock::Frames);
        assert_eq!(Clock::Dated { offset_s: 1e300 }.date(0.0), None);
    }
}
