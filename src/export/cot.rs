//! Cursor on Target (CoT, version 2.0, MITRE): an event per vehicle and time, in one file that any CoT tool splits.
//!
//! Positions are longitude and latitude on WGS 84 with the standard deviations that the format asks for: `ce` is
//! horizontal, `le` vertical, each 1σ. Times are universal ones, which the format requires. Rejected trajectories are
//! skipped. A vehicle without a usable trajectory has the positions of its ground track.

use std::path::Path;

use quick_xml::Writer;

use super::results::Fix;
use super::xml::{self, Xml, allowed, element};
use super::{ExportError, Results};
use crate::math::median;
use crate::scene::{GroundTrack, GroundTrackTrust, ObjectId, ObjectTrajectory};
use crate::telemetry;

/// A vehicle at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct CotEvent {
    /// Identity of the vehicle.
    pub uid: String,
    /// Displayed name.
    pub callsign: String,
    /// Remarks.
    pub remarks: String,
    /// UTC, seconds after 1970.
    pub time_s: f64,
    /// Time for which the event is valid, seconds.
    pub valid_s: f64,
    /// North of the equator, degrees.
    pub latitude: f64,
    /// East of Greenwich, degrees.
    pub longitude: f64,
    /// Height, meters; `None` where it is unknown.
    pub height_m: Option<f64>,
    /// Horizontal standard deviation, meters.
    pub horizontal_std_m: f64,
    /// Standard deviation of the height, meters.
    pub vertical_std_m: Option<f64>,
    /// Speed and course, where they are known.
    pub track: Option<CotTrack>,
}

/// Motion of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CotTrack {
    /// Direction of motion, degrees clockwise from north.
    pub course_deg: Option<f64>,
    /// Its standard deviation, degrees.
    pub course_std_deg: Option<f64>,
    /// Speed, meters per second.
    pub speed_m_s: f64,
    /// Its standard deviation, meters per second.
    pub speed_std_m_s: f64,
}

impl CotEvent {
    /// The event as one line of XML without a declaration; `None` for a time beyond the calendar.
    pub fn to_line(&self) -> Option<String> {
        let mut line = Vec::new();
        let mut xml: Xml = Writer::new(&mut line);
        // Writing to memory cannot fail.
        event(&mut xml, self).ok()?;
        let line = String::from_utf8(line).ok()?.replace(['\r', '\n'], " ");
        (!line.is_empty()).then_some(line)
    }
}

/// A vehicle with its events.
struct Vehicle<'a> {
    id: ObjectId,
    /// Class and id.
    name: String,
    remarks: String,
    fixes: Vec<Fix<'a>>,
}

/// Writes the events, ascending in time.
pub(super) fn write(path: &Path, results: &Results) -> Result<(), ExportError> {
    let start_s = results.clock().utc_start_s().ok_or(ExportError::NoUtc)?;
    let vehicles = vehicles(results);
    let mut events: Vec<(&Vehicle, &Fix, f64)> = Vec::new();
    for vehicle in &vehicles {
        let steps = vehicle.fixes.windows(2).map(|pair| pair[1].at.time_s - pair[0].at.time_s).collect();
        // An event is valid until the second event after it, and for a second at least: players drop it afterwards.
        let valid_s = (2.0 * median(steps).unwrap_or(0.0)).max(1.0);
        events.extend(vehicle.fixes.iter().map(|fix| (vehicle, fix, valid_s)));
    }
    // Stable sort: vehicles of equal times stay in the order of their ids.
    events.sort_by(|(_, a, _), (_, b, _)| a.at.time_s.total_cmp(&b.at.time_s));
    xml::write(path, "events", &[], |xml| {
        let described = |(vehicle, fix, valid_s): &(&Vehicle, &Fix, f64)| {
            event(xml, &described(results, vehicle, fix, start_s, *valid_s))
        };
        events.iter().try_for_each(described)
    })
}

fn vehicles(results: &Results) -> Vec<Vehicle<'_>> {
    let trajectories = &results.trajectories;
    let trusted = |object: &&ObjectTrajectory| !object.is_ruled_out();
    let usable = |track: &&GroundTrack| {
        let is_placed = trajectories.objects.iter().any(|object| object.id == track.id && !object.is_ruled_out());
        let is_bad = track.verdict.as_ref().is_some_and(|found| found.state == GroundTrackTrust::Inconsistent);
        !is_placed && !is_bad
    };
    let of_objects = trajectories.objects.iter().filter(trusted).map(|object| Vehicle {
        id: object.id,
        name: object.name(),
        remarks: format!("verdict: {}", object.verdict.as_ref().map_or("not judged", |found| found.state.name())),
        fixes: results.fixes(&object.poses),
    });
    let of_tracks = trajectories.ground_tracks.iter().filter(usable).map(|track| Vehicle {
        id: track.id,
        name: track.name(),
        remarks: format!(
            "ground track ({}), verdict: {}",
            track.method.name(),
            track.verdict.as_ref().map_or("not judged", |found| found.state.name())
        ),
        fixes: results.fixes(&track.positions),
    });
    of_objects.chain(of_tracks).collect()
}

fn described(results: &Results, vehicle: &Vehicle, fix: &Fix, start_s: f64, valid_s: f64) -> CotEvent {
    let known = |value: f64| results.knows_height().then_some(value);
    CotEvent {
        uid: format!("tractrix.{}.{}", results.title, vehicle.id),
        callsign: vehicle.name.clone(),
        remarks: vehicle.remarks.clone(),
        time_s: start_s + fix.at.time_s,
        valid_s,
        latitude: fix.place.latitude,
        longitude: fix.place.longitude,
        height_m: known(fix.place.height_m),
        horizontal_std_m: fix.place.horizontal_std_m(),
        vertical_std_m: known(fix.place.place_std_m[2]),
        track: fix.at.metric.and_then(|metric| metric.motion).map(|motion| {
            // A reversing vehicle moves against its heading.
            let turn = if motion.speed_m_s < 0.0 { 180.0 } else { 0.0 };
            let course_deg = motion.heading_deg.map(|heading| (heading + turn).rem_euclid(360.0));
            CotTrack {
                course_deg,
                course_std_deg: motion.heading_std_deg.filter(|_| course_deg.is_some()),
                speed_m_s: motion.speed_m_s.abs(),
                speed_std_m_s: motion.speed_std_m_s,
            }
        }),
    }
}

fn event(xml: &mut Xml, of: &CotEvent) -> std::io::Result<()> {
    let date = |after_s: f64| telemetry::date(of.time_s + after_s, true);
    // Beyond the calendar there is no date, and no event.
    let (Some(time), Some(stale)) = (date(0.0), date(of.valid_s)) else { return Ok(()) };
    let uid = allowed(&of.uid);
    let attributes = [
        ("version", "2.0"),
        ("uid", &uid),
        // Type: atom, unknown affiliation, ground, equipment, civilian vehicle.
        ("type", "a-u-G-E-V-C"),
        // Generated by a machine, measured in images.
        ("how", "m-i"),
        ("time", &time),
        ("start", &time),
        ("stale", &stale),
    ];
    xml.create_element("event").with_attributes(attributes).write_inner_content(|xml| {
        point(xml, of)?;
        xml.create_element("detail").write_inner_content(|xml| {
            xml.create_element("contact").with_attribute(("callsign", allowed(&of.callsign).as_str())).write_empty()?;
            of.track.as_ref().map_or(Ok(()), |found| track(xml, found))?;
            element(xml, "remarks", &of.remarks)
        })?;
        Ok(())
    })?;
    Ok(())
}

fn point(xml: &mut Xml, of: &CotEvent) -> std::io::Result<()> {
    let known = |value: Option<f64>| value.map_or_else(|| "9999999.0".to_owned(), |value| format!("{value:.4}"));
    let [latitude, longitude] = [of.latitude, of.longitude].map(|degrees| format!("{degrees:.9}"));
    let (hae, le, ce) = (known(of.height_m), known(of.vertical_std_m), format!("{:.4}", of.horizontal_std_m));
    let attributes = [("lat", latitude.as_str()), ("lon", &longitude), ("hae", &hae), ("ce", &ce), ("le", &le)];
    xml.create_element("point").with_attributes(attributes).write_empty()?;
    Ok(())
}

/// Speed and the direction of motion, with their standard deviations.
fn track(xml: &mut Xml, of: &CotTrack) -> std::io::Result<()> {
    let values = [
        ("course", of.course_deg),
        ("speed", Some(of.speed_m_s)),
        ("eCourse", of.course_std_deg),
        ("eSpeed", Some(of.speed_std_m_s)),
    ];
    let texts = values.map(|(name, value)| (name, value.map(|value| format!("{value:.4}"))));
    let attributes = texts.iter().filter_map(|(name, text)| Some((*name, text.as_deref()?)));
    xml.create_element("track").with_attributes(attributes).write_empty()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use quick_xml::Reader;

    use quick_xml::events::Event;

    use super::*;
    use crate::export::testing::{results, with_metres};

    /// Start tags and empty tags of a document, with their attributes.
    fn tags(path: &Path) -> Vec<(String, BTreeMap<String, String>)> {
        let text = std::fs::read_to_string(path).unwrap();
        let mut reader = Reader::from_str(&text);
        let mut found = Vec::new();
        loop {
            match reader.read_event().unwrap() {
                Event::Start(tag) | Event::Empty(tag) => {
                    let attributes = tag.attributes().map(Result::unwrap);
                    let named = attributes.map(|a| (a.key.as_ref().to_owned(), a.value.into_owned())).collect();
                    found.push((tag.name().as_ref().to_owned(), named));
                }
                Event::Eof => return found,
                _ => {}
            }
        }
    }

    #[test]
    fn every_event_has_the_attributes_of_the_schema_and_the_positions_of_the_results() {
        let results = with_metres(results());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events.xml");
        write(&path, &results).unwrap();
        let tags = tags(&path);
        let named = |name: &str| tags.iter().filter(|(tag, _)| tag == name).map(|(_, a)| a).collect::<Vec<_>>();
        let (events, points) = (named("event"), named("point"));
        let trusted: Vec<_> = results.trajectories.objects.iter().filter(|object| !object.is_ruled_out()).collect();
        let poses: usize = trusted.iter().map(|object| object.poses.len()).sum();
        assert_eq!((events.len(), points.len(), named("track").len()), (poses, poses, poses));
        for event in &events {
            let keys: Vec<&str> = event.keys().map(String::as_str).collect();
            assert_eq!(keys, ["how", "stale", "start", "time", "type", "uid", "version"]);
            assert!(event["stale"] > event["start"] && event["time"].ends_with('Z'), "{event:?}");
        }
        assert_eq!((events[0]["time"].as_str(), events[0]["how"].as_str()), ("2024-06-01T12:00:00Z", "m-i"));
        let place = results.place_of(&trusted[0].poses[0]).unwrap();
        assert_eq!(
            (&points[0]["lat"], &points[0]["hae"]),
            (&format!("{:.9}", place.latitude), &format!("{:.4}", place.height_m))
        );
        let [east, north, up] = place.place_std_m;
        assert_eq!((&points[0]["ce"], &points[0]["le"]), (&format!("{:.4}", east.hypot(north)), &format!("{up:.4}")));
        let track = named("track")[0];
        assert_eq!(
            (track["course"].as_str(), track["speed"].as_str(), track["eSpeed"].as_str()),
            ("47.5000", "8.0000", "0.4000")
        );
    }

    #[test]
    fn without_universal_time_there_are_no_events() {
        let mut results = with_metres(results());
        let dates = results.trajectories.metric.as_mut().unwrap().dates.as_mut().unwrap();
        dates.zone = crate::scene::ClockZone::Local;
        let refused = write(Path::new("unused"), &results).unwrap_err().to_string();
        assert!(refused.contains("--utc-offset"), "{refused}");
    }
}
