//! KML 2.2: `gx:Track` (times and coordinates in two lists) and points with a time stamp.
//!
//! Heights are used with the altitude mode `absolute`, which is relative to sea level. A truncated file is read up to
//! its last complete element.

use super::fix::{ClockKind, Fix, HeightDatum, Log};
use super::text::{check_length, number};
use super::xml::{self, Element};
use super::{coordinate, time};

/// Partially read track or point.
#[derive(Default)]
struct Open {
    times: Vec<Option<f64>>,
    coordinates: Vec<(usize, String)>,
    is_absolute: bool,
    is_point: bool,
}

/// Reads a text into an empty log.
pub(super) fn read(text: &str, empty: Log) -> Log {
    let mut log = Log { clock: ClockKind::Utc, height_datum: HeightDatum::SeaLevel, ..empty };
    let mut open = Open::default();
    xml::read(text, &mut log, |element, line, log| match element {
        Element::Start(tag) => match tag.local_name().as_ref() {
            "Placemark" | "Track" => finish(std::mem::take(&mut open), log),
            "Point" => open.is_point = true,
            _ => {}
        },
        Element::Empty(_) => {}
        Element::End(name, content) => match name {
            "Placemark" | "Track" => finish(std::mem::take(&mut open), log),
            "Point" => open.is_point = false,
            "when" => open.times.push(time::iso_s(content.trim()).map(|(time_s, _)| time_s)),
            "altitudeMode" => open.is_absolute = content.trim() == "absolute",
            "coord" => take(&mut open, content, line, log),
            "coordinates" if open.is_point => take(&mut open, content, line, log),
            _ => {}
        },
    });
    finish(open, &mut log);
    log
}

fn take(open: &mut Open, content: &str, line: usize, log: &mut Log) {
    match check_length(content) {
        // One position beyond the maximum is kept: the log reports the excess when the track ends.
        Ok(()) if open.coordinates.len() <= log.room.most => open.coordinates.push((line, content.trim().to_owned())),
        Ok(()) => log.room.is_exceeded = true,
        Err(reason) => log.skip_line(line, reason),
    }
}

fn finish(open: Open, log: &mut Log) {
    let times = open.times.into_iter().map(Some).chain(std::iter::repeat(None));
    for ((line, coordinates), clock_s) in open.coordinates.into_iter().zip(times) {
        let mut parts = coordinates.split([',', ' ']).filter(|part| !part.is_empty());
        let (longitude, latitude) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
        let height_m = parts.next().and_then(number).filter(|_| open.is_absolute);
        match coordinate::position(longitude, latitude) {
            Err(reason) => log.skip_line(line, reason),
            Ok(position) => {
                log.push("kml", Fix { clock_s: clock_s.flatten(), gps_height_m: height_m, ..Fix::at(line, position) })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_and_points_have_times_and_heights() {
        let log = read(
            "<kml><Placemark><gx:Track><altitudeMode>absolute</altitudeMode>\n<when>2024-05-04T13:05:06Z</when>\n\
             <when>2024-05-04T13:05:07Z</when>\n<gx:coord>-34.5 12.25 220.5</gx:coord>\n<gx:coord>-34.6 12.26 \
             221</gx:coord></gx:Track></Placemark>\n<Placemark><TimeStamp><when>2024-05-04T13:05:09Z</when></TimeStamp>\
             <Point><coordinates>-34.7,12.27,5</coordinates></Point></Placemark>\n<Placemark><LineString>\
             <coordinates>1,2,3 4,5,6</coordinates></LineString></Placemark></kml>",
            Log::default(),
        );
        let found: Vec<_> = log.fixes.iter().map(|fix| (fix.line, fix.longitude_deg, fix.gps_height_m)).collect();
        assert_eq!(found, [(4, -34.5, Some(220.5)), (5, -34.6, Some(221.0)), (6, -34.7, None)]);
        let times: Vec<_> = log.fixes.iter().map(|fix| fix.clock_s.unwrap() - 1_714_827_906.0).collect();
        assert_eq!((times, log.num_passed_over), (vec![0.0, 1.0, 3.0], 0));
    }
}
