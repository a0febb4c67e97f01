//! Times of the video as dates, where they are known.

use crate::scene::{ClockZone, Dates, Metric, TimeBase};
use crate::telemetry;

/// Conversion of a result's times for other programs.
#[derive(Clone, Debug, PartialEq)]
pub struct Clock {
    time_base: TimeBase,
    dates: Option<Dates>,
}

impl Clock {
    /// The clock of a result.
    pub fn of(metric: Option<&Metric>, time_base: TimeBase) -> Self {
        let dates = metric.and_then(|metric| metric.dates.clone());
        // Frame numbers are not seconds: then only photographs have dates.
        let dates = dates.filter(|dates| time_base == TimeBase::Seconds || !dates.images.is_empty());
        Self { time_base, dates }
    }

    /// Returns true if times are seconds; otherwise the rate is unknown, and they are frame numbers.
    pub fn has_seconds(&self) -> bool {
        self.time_base == TimeBase::Seconds
    }

    /// The date of an image at a time of the video, to the millisecond: `2024-06-01T12:00:00.5Z`, or local time without
    /// `Z` where no zone is known; `None` without a date.
    pub fn date(&self, image: &str, time_s: f64) -> Option<String> {
        let Dates { start_s, zone, images } = self.dates.as_ref()?;
        let by_start = || telemetry::date((*start_s)? + time_s, *zone == ClockZone::Utc);
        images.get(image).cloned().or_else(by_start)
    }

    /// The same for a format that supports dates only: counted from 1970 where none is known.
    pub fn date_or_since_1970(&self, image: &str, time_s: f64) -> String {
        let known = self.date(image, time_s).or_else(|| telemetry::date(time_s, true));
        known.unwrap_or_else(|| "1970-01-01T00:00:00Z".to_owned())
    }

    /// Universal time of the video's start, seconds after 1970-01-01T00:00:00Z; `None` where it is not known.
    pub fn utc_start_s(&self) -> Option<f64> {
        let dates = self.dates.as_ref().filter(|dates| dates.zone == ClockZone::Utc && self.has_seconds())?;
        dates.start_s
    }

    /// Description of the clock in a sentence.
    pub(super) fn in_words(&self) -> &'static str {
        match (self.dates.as_ref().map(|dates| dates.zone), self.time_base) {
            (Some(ClockZone::Utc), _) => "Times are UTC.",
            (Some(ClockZone::Local), _) => {
                "Times are local, from a clock without time zone; --utc-offset \u{b1}HH:MM converts them to UTC."
            }
            (Some(ClockZone::PerImage), _) => "Times are those of the photographs, local unless they end in Z.",
            (None, TimeBase::Seconds) => {
                "Date unknown: times count from the start of the video, set to 1970-01-01T00:00:00Z."
            }
            (None, TimeBase::Frames) => "Times unknown: a frame counts as one second, from 1970-01-01T00:00:00Z.",
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::scene::MetricVerdict;

    fn clock(start_s: Option<f64>, zone: ClockZone, images: &[(&str, &str)], time_base: TimeBase) -> Clock {
        let images: BTreeMap<_, _> = images.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect();
        let metric = Metric {
            verdict: MetricVerdict::Unknown,
            reason: None,
            frame: None,
            shares: Vec::new(),
            contradictions: Vec::new(),
            time_offset_s: None,
            time_offset_std_s: None,
            dates: Some(Dates { start_s, zone, images }),
        };
        Clock::of(Some(&metric), time_base)
    }

    #[test]
    fn local_dates_have_no_zone_and_universal_ones_do() {
        let start_s = Some(1_717_243_200.25);
        let utc = clock(start_s, ClockZone::Utc, &[], TimeBase::Seconds);
        assert_eq!(utc.date("a", 0.25).as_deref(), Some("2024-06-01T12:00:00.5Z"));
        let local = clock(start_s, ClockZone::Local, &[], TimeBase::Seconds);
        assert_eq!(local.date("a", 0.25).as_deref(), Some("2024-06-01T12:00:00.5"));
        assert_eq!(local.date_or_since_1970("a", 0.25), "2024-06-01T12:00:00.5");
        assert!(local.in_words().contains("--utc-offset"));
        assert_eq!(clock(start_s, ClockZone::Utc, &[], TimeBase::Frames).date("a", 1.0), None);
        assert_eq!(clock(Some(1e300), ClockZone::Utc, &[], TimeBase::Seconds).date("a", 0.0), None);
    }

    #[test]
    fn photographs_have_dates_of_their_own_and_without_any_times_count_from_1970() {
        let images = [("a.jpg", "2014-05-01T10:00:00")];
        let found = clock(None, ClockZone::PerImage, &images, TimeBase::Frames);
        assert_eq!((found.date("a.jpg", 3.0).as_deref(), found.date("b.jpg", 4.0)), (Some(images[0].1), None));
        let none = Clock::of(None, TimeBase::Seconds);
        assert_eq!(none.date_or_since_1970("a", 61.5), "1970-01-01T00:01:01.5Z");
        assert!(none.in_words().starts_with("Date unknown"));
    }
}
