//! Parsing and formatting of dates and times.

use jiff::Timestamp;
use jiff::civil::DateTime;

use super::text::number;

/// Seconds in a day.
pub(super) const DAY_S: f64 = 86_400.0;

/// Seconds after 1970-01-01T00:00:00 of a date and a time without a zone, both on the same clock.
///
/// Takes year, month, day, hour, minute, second; `None` for an invalid date.
pub(super) fn civil_s(parts: [u32; 6], fraction_s: f64) -> Option<f64> {
    let [year, month, day, hour, minute, second] = parts;
    let small = |value: u32| i8::try_from(value).ok();
    // A leap second counts as the preceding second.
    let second = second.min(59);
    let civil = DateTime::new(
        i16::try_from(year).ok()?,
        small(month)?,
        small(day)?,
        small(hour)?,
        small(minute)?,
        small(second)?,
        0,
    )
    .ok()?;
    let timestamp = civil.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp();
    Some(timestamp.as_second() as f64 + fraction_s)
}

/// Seconds after 1970-01-01T00:00:00 of a date and time in any of DJI's spellings: `2017.8.5 14:11:51`,
/// `2022-08-07 13:40:40,774,808` (milliseconds, then microseconds), `2026-05-27 13:14:22.911`.
///
/// Parses the start of the text only; text after the time is ignored.
pub(super) fn spelled_s(text: &str) -> Option<f64> {
    let mut rest = text.trim_start();
    let mut parts = [0; 6];
    for (i, part) in parts.iter_mut().enumerate() {
        let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
        *part = rest[..end].parse().ok()?;
        rest = &rest[end..];
        if i < 5 {
            let is_separator =
                |c: char| if i < 2 { matches!(c, '-' | '.' | '/') } else { matches!(c, ' ' | 'T' | ':') };
            rest = rest.strip_prefix(is_separator)?;
        }
    }
    civil_s(parts, fraction_s(rest))
}

/// Seconds of “,774,808” or “.911”, at most two groups of three digits after a comma.
fn fraction_s(text: &str) -> f64 {
    let Some(text) = text.strip_prefix([',', '.']) else { return 0.0 };
    let digits = |text: &str| text.bytes().take_while(u8::is_ascii_digit).count();
    let first = &text[..digits(text)];
    let after = &text[first.len()..];
    let second = after.strip_prefix(',').map_or("", |after| &after[..digits(after)]);
    let second = if first.len() == 3 && second.len() == 3 { second } else { "" };
    number(&format!("0.{first}{second}0")).unwrap_or(0.0)
}

/// Seconds after 1970-01-01T00:00:00 of an ISO 8601 time, and true if it states its zone.
pub(super) fn iso_s(text: &str) -> Option<(f64, bool)> {
    let text = text.trim();
    if let Ok(timestamp) = text.parse::<Timestamp>() {
        return Some((timestamp.as_microsecond() as f64 * 1e-6, true));
    }
    Some((spelled_s(text)?, false))
}

/// As [`iso_s`], also in the spellings of tables: a zone in letters (`2024-05-04 13:05:06 UTC`), slashes
/// (`05/04/2024`, month first unless it cannot be one), hours up to twelve (`1:05:06.00 PM`).
pub(super) fn spelled_in_table_s(text: &str) -> Option<(f64, bool)> {
    let text = text.trim();
    let without_zone = ["UTC", "GMT"].into_iter().find_map(|zone| text.strip_suffix(zone)).map(str::trim_end);
    let civil = without_zone.unwrap_or(text);
    // Other spellings end with the seconds.
    let is_half = civil.ends_with(['m', 'M']);
    let iso = if is_half { None } else { iso_s(civil) };
    let (clock_s, stated) = iso.or_else(|| Some((with_slashes_s(civil)?, false)))?;
    Some((clock_s, stated || without_zone.is_some()))
}

fn with_slashes_s(text: &str) -> Option<f64> {
    let (date, time) = text.split_once([' ', 'T'])?;
    let parts: Vec<u32> = date.split(['/', '-', '.']).map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let [first, second, third] = parts[..] else { return None };
    let (year, month, day) = match (first > 31, first > 12) {
        (true, _) => (first, second, third),
        (false, true) => (third, second, first),
        (false, false) => (third, first, second),
    };
    let (time, half) = match time.trim().rsplit_once(' ') {
        Some((time, half)) => (time, half.to_ascii_uppercase()),
        None => (time.trim(), String::new()),
    };
    let mut parts = time.splitn(3, ':');
    let (hour, minute): (u32, u32) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let second = number(parts.next().unwrap_or("0"))?;
    let hour = match half.as_str() {
        "" => hour,
        "AM" => hour % 12,
        "PM" => hour % 12 + 12,
        _ => return None,
    };
    let is_second = (0.0..61.0).contains(&second);
    civil_s([year, month, day, hour, minute, second as u32], second.fract()).filter(|_| is_second)
}

/// Seconds after 1970-01-01T00:00:00 of an ISO 8601 time.
pub fn clock_s(text: &str) -> Option<f64> {
    iso_s(text).map(|(clock_s, _)| clock_s)
}

/// Seconds after 1970-01-01T00:00:00 as ISO 8601, to the millisecond: `2024-06-01T12:00:00.5Z` on universal time,
/// without `Z` on a local clock; `None` outside the range of years of the calendar.
pub fn date(seconds: f64, is_utc: bool) -> Option<String> {
    let moment = Timestamp::from_millisecond((1e3 * seconds).round() as i64).ok()?.to_string();
    Some(if is_utc { moment } else { moment.trim_end_matches('Z').to_owned() })
}

/// Time on the log's clock, for messages: `2022-08-07T13:40:40.774`.
pub(super) fn spelled(clock_s: f64) -> Option<String> {
    let timestamp = Timestamp::from_millisecond((clock_s * 1e3).round() as i64).ok()?;
    let civil = timestamp.to_zoned(jiff::tz::TimeZone::UTC).datetime();
    Some(civil.strftime("%Y-%m-%dT%H:%M:%S%.3f").to_string())
}

/// Seconds of `00:01:02,345` or `00:01:02.345`.
pub(super) fn subtitle_s(text: &str) -> Option<f64> {
    let mut parts = text.trim().splitn(3, ':');
    let [hours, minutes] = [parts.next()?, parts.next()?].map(|part| part.trim().parse::<u32>().ok());
    let seconds = number(&parts.next()?.replace(',', "."))?;
    let is_time = (0.0..61.0).contains(&seconds) && minutes? < 60;
    is_time.then_some(f64::from(hours?) * 3600.0 + f64::from(minutes?) * 60.0 + seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2022-08-07T13:40:40, from `date --utc --date=2022-08-07T13:40:40 +%s`.
    const AUGUST_S: f64 = 1_659_879_640.0;

    #[test]
    fn all_spellings_are_one_time() {
        for text in ["2022-08-07 13:40:40", "2022.8.7 13:40:40 x", "2022/08/07T13:40:40,000,000,000"] {
            assert_eq!(spelled_s(text), Some(AUGUST_S), "{text}");
        }
        assert_eq!(spelled_s("2022-08-07 13:40:40,774,808"), Some(AUGUST_S + 0.774_808));
        assert_eq!(spelled_s("2022-08-07 13:40:40.5"), Some(AUGUST_S + 0.5));
        assert_eq!(iso_s("2022-08-07T15:40:40+02:00"), Some((AUGUST_S, true)));
        assert_eq!(iso_s("2022-08-07 13:40:40"), Some((AUGUST_S, false)));
        assert_eq!(spelled(AUGUST_S + 0.774).unwrap(), "2022-08-07T13:40:40.774");
    }

    #[test]
    fn tables_write_zones_slashes_and_halves_of_the_day() {
        let noon = AUGUST_S - 40.0;
        assert_eq!(spelled_in_table_s("2022-08-07 13:40:00.5 UTC"), Some((noon + 0.5, true)));
        assert_eq!(spelled_in_table_s("2022-08-07T13:40:00Z"), Some((noon, true)));
        for text in ["08/07/2022 13:40", "8/7/2022 1:40:00.00 PM", "2022/8/7 01:40:00 pm"] {
            assert_eq!(spelled_in_table_s(text), Some((noon, false)), "{text}");
        }
        assert_eq!(spelled_in_table_s("25/12/2022 12:00:00 AM"), spelled_in_table_s("2022-12-25 00:00:00"));
        for text in ["UTC", "8/7/2022", "8/7 13:40", "1/2/3/4 13:40", "8/7/2022 13:40 XM", "8/7/2022 13:40:77", ""] {
            assert_eq!(spelled_in_table_s(text), None, "{text}");
        }
    }

    #[test]
    fn invalid_times_are_none() {
        for text in ["", "2022-13-07 13:40:40", "2022-02-30 00:00:00", "99999-01-01 00:00:00", "2022-08-07", "a"] {
            assert_eq!(spelled_s(text), None, "{text}");
        }
        assert_eq!((spelled(f64::MAX), spelled(1e17)), (None, None));
        assert_eq!(subtitle_s("01:02:03,500"), Some(3723.5));
        assert_eq!((subtitle_s("00:61:00,0"), subtitle_s("x"), subtitle_s("0:0:-1")), (None, None, None));
    }
}
