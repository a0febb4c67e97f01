//! KML 2.2 with Google's `gx:Track`: a position per time, which Google Earth animates.
//!
//! KML supports absolute dates only. Where none are known, times count from 1 January 1970, and the description notes
//! it. Vehicles are clamped to the globe's ground, which differs from that of the reconstruction; the camera keeps its
//! height.

use std::path::Path;

use super::results::Fix;
use super::units::KM_H;
use super::xml::{self, Xml, element};
use super::{Clock, ExportError, Facts, Results};
use crate::math::rounding::with_std;
use crate::report::object_colour;
use crate::scene::{GroundTrack, ObjectTrajectory};

/// Content of one track.
struct Track<'a> {
    name: String,
    description: String,
    colour: [u8; 3],
    /// Width of the line, pixels.
    width: &'static str,
    altitude_mode: &'static str,
    fixes: Vec<Fix<'a>>,
}

/// Writes the trajectories of the vehicles and the camera.
pub(super) fn write(path: &Path, results: &Results) -> Result<(), ExportError> {
    let clock = results.clock();
    let vehicles = results.trajectories.objects.iter().map(|object| vehicle(results, object));
    let ground_tracks = results.trajectories.ground_tracks.iter().map(|track| ground_track(results, track));
    let tracks = vehicles.chain(ground_tracks).chain([camera(results)]);
    let namespaces = [("xmlns", "http://www.opengis.net/kml/2.2"), ("xmlns:gx", "http://www.google.com/kml/ext/2.2")];
    xml::write(path, "kml", &namespaces, |xml| {
        xml.create_element("Document").write_inner_content(|xml| {
            element(xml, "name", &results.title)?;
            element(xml, "description", clock.in_words())?;
            tracks.filter(|track| !track.fixes.is_empty()).try_for_each(|track| placemark(xml, &track, &clock))
        })?;
        Ok(())
    })
}

fn vehicle<'a>(results: &Results, object: &'a ObjectTrajectory) -> Track<'a> {
    let facts = Facts::of(object, results.time_base);
    // A rejected trajectory's speed would be taken for a valid one.
    let speed = facts
        .mean_speed_m_s
        .filter(|_| !object.is_ruled_out())
        .map(|speed| speed.scaled(KM_H))
        .map(|speed| format!("; mean speed {} km/h", with_std(speed.value, speed.std)));
    let doubt = facts.doubt.map(|doubt| format!("; {doubt}"));
    Track {
        name: object.name(),
        description: format!(
            "{}{}{}",
            facts.verdict.unwrap_or("not judged"),
            speed.unwrap_or_default(),
            doubt.unwrap_or_default()
        ),
        colour: object_colour(object.id),
        width: "4",
        altitude_mode: "clampToGround",
        fixes: results.fixes(&object.poses),
    }
}

fn ground_track<'a>(results: &Results, track: &'a GroundTrack) -> Track<'a> {
    let verdict = track.verdict.as_ref();
    let said = verdict.map(|verdict| format!("{}; {}; ", verdict.state.name(), verdict.says)).unwrap_or_default();
    Track {
        name: format!("{} (ground track)", track.name()),
        description: format!("{}: {said}{}", track.method.name(), track.reason),
        colour: object_colour(track.id),
        width: "2",
        altitude_mode: "clampToGround",
        fixes: results.fixes(&track.positions),
    }
}

fn camera(results: &Results) -> Track<'_> {
    let (altitude_mode, description) = match results.knows_height() {
        true => ("absolute", "heights are those of the receiver"),
        false => ("relativeToGround", "heights are relative to an unknown level, assumed to be the ground"),
    };
    Track {
        name: "camera".into(),
        description: description.into(),
        colour: [255; 3],
        width: "4",
        altitude_mode,
        fixes: results.fixes(&results.views),
    }
}

fn placemark(xml: &mut Xml, track: &Track, clock: &Clock) -> std::io::Result<()> {
    let [r, g, b] = track.colour;
    xml.create_element("Placemark").write_inner_content(|xml| {
        element(xml, "name", &track.name)?;
        element(xml, "description", &track.description)?;
        xml.create_element("Style").write_inner_content(|xml| {
            xml.create_element("LineStyle").write_inner_content(|xml| {
                // KML color order: opacity first, red last.
                element(xml, "color", &format!("ff{b:02x}{g:02x}{r:02x}"))?;
                element(xml, "width", track.width)
            })?;
            Ok(())
        })?;
        xml.create_element("gx:Track").write_inner_content(|xml| {
            element(xml, "altitudeMode", track.altitude_mode)?;
            let mut times = track.fixes.iter().map(|fix| clock.date_or_since_1970(fix.at.name, fix.at.time_s));
            times.try_for_each(|time| element(xml, "when", &time))?;
            track.fixes.iter().try_for_each(|fix| {
                let place = &fix.place;
                let coordinates = format!("{:.9} {:.9} {:.4}", place.longitude, place.latitude, place.height_m);
                element(xml, "gx:coord", &coordinates)
            })
        })?;
        Ok(())
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use quick_xml::events::Event;

    use super::*;
    use crate::export::testing::{results, with_metres};

    pub(in crate::export) fn text(write: fn(&Path, &Results) -> Result<(), ExportError>, results: &Results) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.xml");
        write(&path, results).unwrap();
        std::fs::read_to_string(path).unwrap()
    }

    #[test]
    fn every_track_has_as_many_times_as_positions() {
        let mut results = with_metres(results());
        results.title = "a <b> & \u{1}".into();
        let found = text(write, &results);
        assert!(found.contains("<name>a &lt;b&gt; &amp; ?</name>"), "{found}");
        let tracks: Vec<&str> = found.split("<gx:Track>").skip(1).collect();
        assert_eq!(tracks.len(), 3);
        for (track, count) in tracks
            .iter()
            .zip(results.trajectories.objects.iter().map(|object| object.poses.len()).chain([results.views.len()]))
        {
            let of = |name: &str| track.matches(name).count();
            assert_eq!((of("<when>"), of("<gx:coord>")), (count, count));
        }
        assert!(tracks[0].contains("<when>2024-06-01T12:00:00Z</when>") && tracks[2].contains("absolute"));
        let mut events = quick_xml::Reader::from_str(&found);
        while !matches!(events.read_event().unwrap(), Event::Eof) {}
    }

    #[test]
    fn without_a_date_times_count_from_1970_and_that_is_said() {
        let mut results = with_metres(results());
        results.trajectories.metric.as_mut().unwrap().dates = None;
        let found = text(write, &results);
        assert!(found.contains("set to 1970-01-01T00:00:00Z") && found.contains("<when>1970-01-01T00:00:00Z</when>"));
    }
}
