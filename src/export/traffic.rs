//! Trajectories in formats of traffic research: SUMO's floating car data and the tables of levelXData.
//!
//! Positions are smoothed, in meters of the metric frame, of which x and y span the ground. Rejected trajectories and
//! ground tracks are skipped: neither format can express an uncertain position.

use std::collections::BTreeMap;
use std::path::Path;

use super::results::motions;
use super::table::write as write_table;
use super::xml::{self, Xml};
use super::{ExportError, Results};
use crate::io::ExportFolder;
use crate::scene::{Motion, ObjectTrajectory};

/// A vehicle at a time.
struct Sample<'a> {
    object: &'a ObjectTrajectory,
    time_s: f64,
    motion: Motion,
    /// Degrees clockwise from y.
    heading_deg: f64,
}

impl Sample<'_> {
    /// Frame number at a rate, as text: the time is frame over rate.
    fn frame(&self, rate: f64) -> String {
        (self.time_s * rate).round().to_string()
    }
}

/// Samples of each trajectory that is not rejected and has a motion, ascending in time.
fn samples(results: &Results) -> Vec<Vec<Sample<'_>>> {
    let trusted = results.trajectories.objects.iter().filter(|object| !object.is_ruled_out());
    trusted.map(samples_of).filter(|samples| !samples.is_empty()).collect()
}

fn samples_of(object: &ObjectTrajectory) -> Vec<Sample<'_>> {
    let sample =
        |(time_s, motion): (f64, Motion)| Some(Sample { object, time_s, heading_deg: motion.heading_deg?, motion });
    motions(object).filter_map(sample).collect()
}

/// SUMO's floating car data (FCD): a `timestep` per time, with a `vehicle` each.
pub(super) fn write_sumo(path: &Path, results: &Results) -> Result<(), ExportError> {
    let samples = samples(results);
    let mut by_time: BTreeMap<String, Vec<&Sample>> = BTreeMap::new();
    for sample in samples.iter().flatten() {
        // Texts of equal width sort like their numbers.
        by_time.entry(format!("{:012.3}", sample.time_s)).or_default().push(sample);
    }
    xml::write(path, "fcd-export", &[], |xml| {
        for samples in by_time.values() {
            let time = format!("{:.3}", samples[0].time_s);
            xml.create_element("timestep")
                .with_attribute(("time", time.as_str()))
                .write_inner_content(|xml| samples.iter().try_for_each(|sample| vehicle(xml, sample)))?;
        }
        Ok(())
    })
}

/// A vehicle at a time of the floating car data.
fn vehicle(xml: &mut Xml, sample: &Sample) -> std::io::Result<()> {
    let [x, y, z] = sample.motion.smoothed_position_m;
    let numbers = [x, y, z, sample.heading_deg, sample.motion.speed_m_s, sample.motion.acceleration_m_s2];
    let [x, y, z, angle, speed, acceleration] = numbers.map(|number| format!("{number:.3}"));
    let id = sample.object.id.to_string();
    let attributes = [
        ("id", id.as_str()),
        ("x", &x),
        ("y", &y),
        ("z", &z),
        ("angle", &angle),
        ("type", &sample.object.class),
        ("speed", &speed),
        ("acceleration", &acceleration),
    ];
    xml.create_element("vehicle").with_attributes(attributes).write_empty().map(drop)
}

const TRACK_COLUMNS: [&str; 17] = [
    "recordingId",
    "trackId",
    "frame",
    "trackLifetime",
    "xCenter",
    "yCenter",
    "heading",
    "width",
    "length",
    "xVelocity",
    "yVelocity",
    "xAcceleration",
    "yAcceleration",
    "lonVelocity",
    "latVelocity",
    "lonAcceleration",
    "latAcceleration",
];
const TRACK_META_COLUMNS: [&str; 8] =
    ["recordingId", "trackId", "initialFrame", "finalFrame", "numFrames", "width", "length", "class"];
/// Id of the only recording of an export.
const RECORDING: &str = "0";

/// Writes the three tables of levelXData (inD, rounD, uniD) in the format of its tools.
pub(super) fn write_levelx(folder: &Path, results: &Results) -> Result<(), ExportError> {
    let samples = samples(results);
    let rate = frame_rate(results);
    let tracks = samples.iter().enumerate().flat_map(|(track, samples)| {
        samples.iter().enumerate().map(move |(lifetime, sample)| track_row(track, lifetime, sample, rate))
    });
    write_table(&folder.join(ExportFolder::LEVELX_TRACKS), &TRACK_COLUMNS, tracks)?;
    let meta = samples.iter().enumerate().map(|(track, samples)| meta_row(track, samples, rate));
    write_table(&folder.join(ExportFolder::LEVELX_META), &TRACK_META_COLUMNS, meta)?;
    let origin = results.map();
    let place =
        |of: fn(&crate::scene::MapOrigin) -> f64| origin.map(|(_, origin)| of(&origin).to_string()).unwrap_or_default();
    let is_vehicle = |samples: &&Vec<Sample>| !is_vulnerable(&samples[0].object.class);
    let num_vehicles = samples.iter().filter(is_vehicle).count();
    let times = || results.views.iter().map(|view| view.frame.time_s);
    let duration = times().fold(f64::NEG_INFINITY, f64::max) - times().fold(f64::INFINITY, f64::min);
    let recording = [
        ("recordingId", RECORDING.to_owned()),
        ("locationId", RECORDING.to_owned()),
        // Times are accumulated steps: 9.999999999999991 is 10.
        ("frameRate", ((rate * 1e6).round() / 1e6).to_string()),
        ("speedLimit", "-1".to_owned()),
        ("weekday", String::new()),
        ("startTime", String::new()),
        ("duration", format!("{duration:.3}")),
        ("numTracks", samples.len().to_string()),
        ("numVehicles", num_vehicles.to_string()),
        ("numVRUs", (samples.len() - num_vehicles).to_string()),
        ("latLocation", place(|origin| origin.latitude)),
        ("lonLocation", place(|origin| origin.longitude)),
    ];
    let (columns, row): (Vec<&str>, Vec<String>) = recording.into_iter().unzip();
    write_table(&folder.join(ExportFolder::LEVELX_RECORDING), &columns, [row].into_iter())
}

/// Frames per second: the inverse of the median step.
fn frame_rate(results: &Results) -> f64 {
    results.median_step().filter(|step| *step > 0.0).map_or(1.0, |step| 1.0 / step)
}

fn is_vulnerable(class: &str) -> bool {
    matches!(class, "person" | "bicycle" | "motorcycle")
}

fn class(name: &str) -> &str {
    match name {
        "truck" | "bus" => "truck_bus",
        "person" => "pedestrian",
        other => other,
    }
}

/// Width and length, meters; 0 where unknown, as in these data sets.
fn size(object: &ObjectTrajectory) -> [f64; 2] {
    let size = object.dimensions.unwrap_or_default();
    [size.width_m, size.length_m].map(|side| side.map_or(0.0, |side| side.value))
}

fn track_row(track: usize, lifetime: usize, sample: &Sample, rate: f64) -> Vec<String> {
    let [x, y, _] = sample.motion.smoothed_position_m;
    // Counterclockwise from x.
    let heading_deg = (90.0 - sample.heading_deg).rem_euclid(360.0);
    let (sin, cos) = heading_deg.to_radians().sin_cos();
    let (speed, ahead) = (sample.motion.speed_m_s, sample.motion.acceleration_m_s2);
    // Positive to the left, in a left turn.
    let aside = -speed * sample.motion.yaw_rate_deg_s.unwrap_or(0.0).to_radians();
    let [width, length] = size(sample.object);
    let numbers = [
        x,
        y,
        heading_deg,
        width,
        length,
        speed * cos,
        speed * sin,
        ahead * cos - aside * sin,
        ahead * sin + aside * cos,
        speed,
        0.0,
        ahead,
        aside,
    ];
    let ids = [RECORDING.to_owned(), track.to_string(), sample.frame(rate), lifetime.to_string()];
    ids.into_iter().chain(numbers.map(|number| format!("{number:.5}"))).collect()
}

fn meta_row(track: usize, samples: &[Sample], rate: f64) -> Vec<String> {
    let object = samples[0].object;
    let [width, length] = size(object).map(|side| format!("{side:.5}"));
    vec![
        RECORDING.to_owned(),
        track.to_string(),
        samples[0].frame(rate),
        samples[samples.len() - 1].frame(rate),
        samples.len().to_string(),
        width,
        length,
        class(&object.class).to_owned(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{results, with_metres};

    fn rows(path: &Path) -> Vec<BTreeMap<String, String>> {
        csv::Reader::from_path(path).unwrap().deserialize().collect::<Result<_, _>>().unwrap()
    }

    #[test]
    fn tables_of_levelx_agree_with_one_another() {
        let results = with_metres(results());
        let folder = tempfile::tempdir().unwrap();
        write_levelx(folder.path(), &results).unwrap();
        let [tracks, meta, recording] =
            [ExportFolder::LEVELX_TRACKS, ExportFolder::LEVELX_META, ExportFolder::LEVELX_RECORDING]
                .map(|name| rows(&folder.path().join(name)));
        let trusted: Vec<_> = results.trajectories.objects.iter().filter(|object| !object.is_ruled_out()).collect();
        assert!(!trusted.is_empty() && trusted.len() < results.trajectories.objects.len());
        assert_eq!((meta.len(), recording.len()), (trusted.len(), 1));
        assert_eq!(meta[0]["numFrames"].parse::<usize>().unwrap(), trusted[0].poses.len());
        assert_eq!((meta[0]["length"].as_str(), meta[0]["width"].as_str()), ("4.30000", "0.00000"));
        let number = |row: &BTreeMap<String, String>, key: &str| row[key].parse::<f64>().unwrap();
        let first = &tracks[0];
        assert!((number(first, "heading") - 42.5).abs() < 1e-9, "47.5 degrees clockwise from y");
        let speed = number(first, "xVelocity").hypot(number(first, "yVelocity"));
        assert!((speed - 8.0).abs() < 1e-4);
        // Frame and rate give the time.
        let rate = number(&recording[0], "frameRate");
        assert!((number(first, "frame") / rate - trusted[0].poses[0].time_s).abs() < 0.5 / rate);
    }

    #[test]
    fn floating_car_data_have_every_vehicle_at_its_times() {
        let results = with_metres(results());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fcd.xml");
        write_sumo(&path, &results).unwrap();
        let text = std::fs::read_to_string(path).unwrap();
        let samples: usize = samples(&results).iter().map(Vec::len).sum();
        assert_eq!(text.matches("<vehicle ").count(), samples);
        assert!(text.contains("angle=\"47.500\" type=\"car\" speed=\"8.000\" acceleration=\"0.200\""), "{text}");
        let times: Vec<f64> = text
            .split("<timestep time=\"")
            .skip(1)
            .map(|rest| rest.split_once('"').unwrap().0.parse().unwrap())
            .collect();
        assert!(times.is_sorted() && times.len() > 5);
    }
}
