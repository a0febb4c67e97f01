//! GPX 1.0 and 1.1: track points, route points and waypoints (`trkpt`, `rtept`, `wpt`).
//!
//! Read: longitude and latitude, `ele` (meters above sea level), `time` (UTC), `fix` (kind of receiver), `hdop`, and
//! `speed` anywhere inside a point. A truncated file is read up to its last complete element.

use quick_xml::events::BytesStart;

use super::fix::{ClockKind, Fix, HeightDatum, Log, Receiver};
use super::text::number;
use super::xml::{self, Element};
use super::{coordinate, time};

/// Partially read point.
#[derive(Default)]
struct Open {
    longitude: String,
    latitude: String,
    line: usize,
    height_m: Option<f64>,
    clock_s: Option<f64>,
    speed_m_s: Option<f64>,
    dilution: Option<f64>,
    fix: String,
}

/// Reads a text into an empty log.
pub(super) fn read(text: &str, empty: Log) -> Log {
    let mut log = Log { clock: ClockKind::Utc, height_datum: HeightDatum::SeaLevel, ..empty };
    let mut open: Option<Open> = None;
    xml::read(text, &mut log, |element, line, log| match element {
        Element::Start(tag) if is_point(tag.local_name().as_ref()) => open = Some(begin(&tag, line)),
        Element::Empty(tag) if is_point(tag.local_name().as_ref()) => finish(begin(&tag, line), log),
        Element::End(name, _) if is_point(name) => open.take().into_iter().for_each(|open| finish(open, log)),
        Element::End(name, content) => open.iter_mut().for_each(|open| take(open, name, content.trim())),
        _ => {}
    });
    if let Some(open) = open {
        log.skip_line(open.line, "file truncated inside this point");
    }
    log
}

fn is_point(name: &str) -> bool {
    matches!(name, "trkpt" | "rtept" | "wpt")
}

fn begin(tag: &BytesStart, line: usize) -> Open {
    let mut open = Open { line, ..Open::default() };
    for attribute in tag.attributes().with_checks(false).flatten() {
        let value = attribute.value.into_owned();
        match attribute.key.local_name().as_ref() {
            "lon" => open.longitude = value,
            "lat" => open.latitude = value,
            _ => {}
        }
    }
    open
}

/// Takes the value of an element inside a point.
fn take(open: &mut Open, name: &str, content: &str) {
    match name {
        "ele" => open.height_m = number(content),
        "time" => open.clock_s = time::iso_s(content).map(|(time_s, _)| time_s),
        "speed" => open.speed_m_s = number(content),
        "hdop" => open.dilution = number(content),
        "fix" => open.fix = content.to_ascii_lowercase(),
        _ => {}
    }
}

fn finish(open: Open, log: &mut Log) {
    let receiver = match open.fix.as_str() {
        "none" => return log.skip_line(open.line, "the receiver had no fix"),
        "dgps" => Receiver::Differential,
        _ => Receiver::Plain,
    };
    match coordinate::position(&open.longitude, &open.latitude) {
        Err(reason) => log.skip_line(open.line, reason),
        Ok(position) => log.push(
            "gpx",
            Fix {
                clock_s: open.clock_s,
                gps_height_m: open.height_m,
                speed_m_s: open.speed_m_s,
                ..Fix::at(open.line, position).received_by(receiver, open.dilution)
            },
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log_of(text: &str) -> Log {
        read(text, Log::default())
    }

    const TRACK: &str = "<?xml version=\"1.0\"?>\n<gpx version=\"1.1\" creator=\"by hand\">\n<trk><trkseg>\n\
        <trkpt lat=\"48.1234567\" lon=\"9.7654321\"><ele>512.5</ele><time>2024-05-06T07:08:09.5Z</time>\
        <fix>dgps</fix><hdop>2.0</hdop><extensions><speed>3.25</speed></extensions></trkpt>\n\
        <trkpt lon=\"9.8\" lat=\"48.2\"/>\n<trkpt lat=\"0\" lon=\"0\"></trkpt>\n<trkpt lat=\"99\" lon=\"0\"/>\n\
        </trkseg></trk>\n</gpx>\n";

    #[test]
    fn points_have_their_values() {
        let log = log_of(TRACK);
        assert_eq!((log.fixes.len(), log.num_passed_over), (2, 2), "{log:?}");
        let first = &log.fixes[0];
        assert_eq!((first.longitude_deg, first.latitude_deg, first.line), (9.7654321, 48.1234567, 4));
        assert_eq!((first.gps_height_m, first.relative_height_m, first.speed_m_s), (Some(512.5), None, Some(3.25)));
        assert_eq!((first.horizontal_std_m, first.vertical_std_m), (2.0, 4.0));
        assert_eq!(time::spelled(first.clock_s.unwrap()).unwrap(), "2024-05-06T07:08:09.500");
        assert_eq!(log.passed_over.iter().map(|passed| passed.line).collect::<Vec<_>>(), [6, 7]);
    }

    #[test]
    fn a_truncated_file_is_read_up_to_its_end() {
        let log = log_of(&TRACK[..TRACK.find("<trkpt lon").unwrap() + 12]);
        assert_eq!(log.fixes.len(), 1);
        assert_eq!(log.passed_over[0].line, 5, "{:?}", log.passed_over);
        let log = log_of(&TRACK[..TRACK.find("</ele>").unwrap()]);
        assert!(log.fixes.is_empty() && log.passed_over[0].reason.contains("truncated"), "{:?}", log.passed_over);
    }
}
