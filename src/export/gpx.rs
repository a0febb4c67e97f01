//! GPX 1.1: the camera's trajectory as one track, with times where dates are known and heights where they are
//! absolute.

use std::path::Path;

use super::xml::{self, Xml, element};
use super::{ExportError, Results};

/// Writes the camera's trajectory.
pub(super) fn write(path: &Path, results: &Results) -> Result<(), ExportError> {
    let attributes = [("version", "1.1"), ("creator", "tractrix"), ("xmlns", "http://www.topografix.com/GPX/1/1")];
    xml::write(path, "gpx", &attributes, |xml| {
        xml.create_element("trk").write_inner_content(|xml| {
            element(xml, "name", &format!("camera of {}", results.title))?;
            xml.create_element("trkseg").write_inner_content(|xml| points(xml, results))?;
            Ok(())
        })?;
        Ok(())
    })
}

fn points(xml: &mut Xml, results: &Results) -> std::io::Result<()> {
    let clock = results.clock();
    for fix in results.fixes(&results.views) {
        let [latitude, longitude] = [fix.place.latitude, fix.place.longitude].map(|degrees| format!("{degrees:.9}"));
        let attributes = [("lat", latitude.as_str()), ("lon", longitude.as_str())];
        xml.create_element("trkpt").with_attributes(attributes).write_inner_content(|xml| {
            if results.knows_height() {
                element(xml, "ele", &format!("{:.4}", fix.place.height_m))?;
            }
            clock.date(fix.at.name, fix.at.time_s).map_or(Ok(()), |date| element(xml, "time", &date))
        })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{results, with_metres};

    #[test]
    fn written_track_is_read_as_telemetry() {
        let results = with_metres(results());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.gpx");
        write(&path, &results).unwrap();
        let log = crate::telemetry::read(&path).unwrap();
        assert_eq!((log.fixes.len(), log.num_passed_over), (results.views.len(), 0));
        let expected = results.place(results.views[0].cam_from_world.center()).unwrap();
        let found = &log.fixes[0];
        assert!((found.longitude_deg - expected.longitude).abs() < 1e-8);
        assert!((found.latitude_deg - expected.latitude).abs() < 1e-8);
        assert!((found.gps_height_m.unwrap() - expected.height_m).abs() < 1e-3);
        assert_eq!(found.clock_s, Some(1_717_243_200.0));
    }
}
