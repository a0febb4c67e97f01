//! GPMF, the telemetry of GoPro cameras inside their videos: <https://github.com/gopro/gpmf-parser>.
//!
//! A track of the container has a payload per second, of devices (`DEVC`) with streams (`STRM`). Read are positions
//! (`GPS9`, otherwise `GPS5` with `GPSU`, `GPSF`, `GPSP`), attitude (`CORI`, `IORI`), gravity (`GRAV`), exposure time
//! (`SHUT`); camera and lens from the container's settings. Sample times are interpolated linearly over their payload.
//!
//! Axes of attitude and gravity are those of OpenCV's camera (x right, y down, z forward); `CORI` turns those at the
//! start of the recording into those of the body, `IORI` those of the body into those of the stabilized image. Checked
//! on a GoPro MAX: image rotations follow `IORI · CORI` within 0.85°, the vertical `IORI · GRAV` within 0.79°
//! (`docs/benchmarks/real-clips.md`).

mod klv;
mod lens;
#[cfg(test)]
pub(crate) mod made;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use self::klv::{Entry, entries};
pub use self::lens::Lens;
use super::coordinate;
use super::fix::{CameraSample, ClockKind, Fix, HeightDatum, Log, Position, Receiver};
use super::summary::Range;
use super::time::{self, DAY_S};
use crate::math::median;
use crate::scene::Timed;

/// Names of the two forms of positions in reports.
const GPS9: &str = "gpmf-gps9";
const GPS5: &str = "gpmf-gps5";

/// Returns true if a file starts with GPMF.
pub(super) fn is_gpmf(head: &[u8]) -> bool {
    head.starts_with(b"DEVC\0")
}

/// Reads the payloads of a video's track, and the container's settings.
pub(super) fn read(payloads: &[Timed<Vec<u8>>], settings: &[u8], empty: Log) -> Log {
    let has_gps9 = payloads.iter().any(|payload| has_key(&payload.content, b"GPS9"));
    let mut reading = Reading::new(has_gps9, empty);
    for (number, payload) in (1..).zip(payloads) {
        for device in devices(&payload.content) {
            reading.device(number, &device, (payload.start_s, payload.end_s));
        }
    }
    reading.log.lens = lens::read(settings);
    reading.finish()
}

/// Reads a track extracted from its video, one payload per second, without payload times. Only the receiver's clock
/// remains.
pub(super) fn read_raw(bytes: &[u8], empty: Log) -> Log {
    let mut reading = Reading::new(has_key(bytes, b"GPS9"), empty);
    for (number, device) in (1..).zip(devices(bytes)) {
        reading.device(number, &device, (number as f64, number as f64 + 1.0));
    }
    let mut log = reading.finish();
    log.fixes.iter_mut().for_each(|fix| fix.video_s = None);
    log.camera.clear();
    log
}

fn devices(data: &[u8]) -> impl Iterator<Item = Entry<'_>> {
    entries(data).filter(|entry| &entry.key == b"DEVC")
}

fn has_key(data: &[u8], key: &[u8; 4]) -> bool {
    devices(data).flat_map(|device| device.nested()).any(|stream| stream.nested().any(|entry| entry.key == *key))
}

/// Start and end, seconds.
type Span = (f64, f64);

/// State of the reader.
struct Reading {
    log: Log,
    /// True if any payload has `GPS9`; cameras that write both forms have the better positions in it.
    has_gps9: bool,
    /// Receiver time minus video time, seconds.
    clocks_s: Vec<f64>,
}

/// Properties that precede the samples of a stream.
#[derive(Default)]
struct Properties<'a> {
    scales: Vec<f64>,
    types: &'a [u8],
    lock: Option<f64>,
    dilution: Option<f64>,
    utc_s: Option<f64>,
}

/// Streams of a device that are read together.
#[derive(Default)]
struct Attitudes<'a> {
    gravity: Option<(Entry<'a>, Vec<f64>)>,
    camera: Option<(Entry<'a>, Vec<f64>)>,
    image: Option<(Entry<'a>, Vec<f64>)>,
}

impl Properties<'_> {
    /// Numbers of a sample in their units.
    fn scaled<const N: usize>(&self, entry: &Entry, index: usize) -> Option<[f64; N]> {
        scaled(entry, &self.scales, index, self.types)
    }

    fn scale(&self, field: usize) -> f64 {
        scale(&self.scales, field)
    }
}

/// Divisor of a number: one for all numbers, or one for each.
fn scale(scales: &[f64], field: usize) -> f64 {
    if scales.len() == 1 { scales[0] } else { scales.get(field).copied().unwrap_or(1.0) }
}

fn scaled<const N: usize>(entry: &Entry, scales: &[f64], index: usize, types: &[u8]) -> Option<[f64; N]> {
    let mut numbers = entry.sample::<N>(index, types)?;
    numbers.iter_mut().enumerate().for_each(|(i, number)| *number /= scale(scales, i));
    numbers.iter().all(|number| number.is_finite()).then_some(numbers)
}

/// Time of a sample.
fn time_s((start_s, end_s): Span, index: usize, count: usize) -> f64 {
    start_s + (end_s - start_s) * index as f64 / count.max(1) as f64
}

impl Reading {
    fn new(has_gps9: bool, empty: Log) -> Self {
        let log = Log { clock: ClockKind::Utc, height_datum: HeightDatum::Ellipsoid, ..empty };
        Self { log, has_gps9, clocks_s: Vec::new() }
    }

    fn device(&mut self, number: usize, device: &Entry, span: Span) {
        let mut attitudes = Attitudes::default();
        for stream in device.nested().filter(|entry| &entry.key == b"STRM") {
            self.stream(number, &stream, span, &mut attitudes);
        }
        self.attitudes(&attitudes, span);
    }

    fn stream<'a>(&mut self, number: usize, stream: &Entry<'a>, span: Span, attitudes: &mut Attitudes<'a>) {
        let mut known = Properties::default();
        for entry in stream.nested() {
            match &entry.key {
                // `GPS9` has nine numbers; no stream that is read has more.
                b"SCAL" => known.scales = entry.numbers(9),
                b"TYPE" => known.types = entry.data,
                b"GPSF" => known.lock = entry.number(),
                b"GPSP" => known.dilution = entry.number().map(|dilution| dilution / 100.0),
                b"GPSU" => known.utc_s = utc_s(&entry.text()),
                b"GPSA" if entry.data.starts_with(b"MSL") => self.log.height_datum = HeightDatum::SeaLevel,
                b"GPS9" => self.positions(number, &entry, &known, span, GPS9),
                b"GPS5" if !self.has_gps9 => self.positions(number, &entry, &known, span, GPS5),
                b"SHUT" => self.exposures(&entry, &known),
                b"GRAV" => attitudes.gravity = Some((entry, known.scales.clone())),
                b"CORI" => attitudes.camera = Some((entry, known.scales.clone())),
                b"IORI" => attitudes.image = Some((entry, known.scales.clone())),
                _ => {}
            }
        }
    }

    fn positions(&mut self, number: usize, entry: &Entry, known: &Properties, span: Span, dialect: &'static str) {
        for index in 0..entry.len() {
            let video_s = time_s(span, index, entry.len());
            match position(entry, known, index, dialect) {
                Err(reason) => self.log.skip_line(number, reason),
                Ok((fix, utc_s)) => {
                    // The time of `GPSU` applies to its payload.
                    let at_s = if dialect == GPS5 { span.0 } else { video_s };
                    self.clocks_s.extend(utc_s.map(|utc_s| utc_s - at_s));
                    self.log.push(dialect, Fix { line: number, video_s: Some(video_s), ..fix });
                }
            }
        }
    }

    fn exposures(&mut self, entry: &Entry, known: &Properties) {
        for index in 0..entry.len() {
            if let Some([exposure_s]) = known.scaled(entry, index).filter(|[exposure_s]| *exposure_s > 0.0) {
                self.log.exposure_s = Some(Range::with(self.log.exposure_s, exposure_s));
            }
        }
    }

    fn attitudes(&mut self, found: &Attitudes, span: Span) {
        let count = |stream: &Option<(Entry, Vec<f64>)>| stream.as_ref().map_or(0, |(entry, _)| entry.len());
        let num = count(&found.gravity).max(count(&found.camera));
        for index in 0..num {
            let body_from_start = rotation(&found.camera, index, num);
            let image_from_body = match &found.image {
                None => Some(UnitQuaternion::identity()),
                image => rotation(image, index, num),
            };
            let down_in_body = found.gravity.as_ref().and_then(|(entry, scales)| {
                let down: [f64; 3] = scaled(entry, scales, same_time(index, num, entry.len())?, &[])?;
                Vector3::from(down).try_normalize(MIN_NORM)
            });
            let sample = CameraSample {
                video_s: time_s(span, index, num),
                down_in_image: image_from_body.zip(down_in_body).map(|(turn, down)| turn * down),
                image_from_start: image_from_body.zip(body_from_start).map(|(image, body)| image * body),
            };
            if sample.down_in_image.is_some() || sample.image_from_start.is_some() {
                self.log.push_camera(sample);
            }
        }
    }

    fn finish(mut self) -> Log {
        self.log.camera.sort_by(|a, b| a.video_s.total_cmp(&b.video_s));
        match median(self.clocks_s) {
            // One offset for all fixes: single times of a receiver are late by up to two seconds.
            Some(clock_s) => self.log.fixes.iter_mut().for_each(|fix| fix.clock_s = fix.video_s.map(|s| s + clock_s)),
            None => self.log.clock = ClockKind::Absent,
        }
        self.log
    }
}

/// Minimum norm of a vector or quaternion with a direction: the camera writes zeros while it has none.
const MIN_NORM: f64 = 0.5;

/// Sample of a stream of `len` nearest to sample `index` of `num`.
fn same_time(index: usize, num: usize, len: usize) -> Option<usize> {
    (len > 0).then(|| (index * len / num.max(1)).min(len - 1))
}

fn rotation(stream: &Option<(Entry, Vec<f64>)>, index: usize, num: usize) -> Option<UnitQuaternion<f64>> {
    let (entry, scales) = stream.as_ref()?;
    let [w, x, y, z] = scaled(entry, scales, same_time(index, num, entry.len())?, &[])?;
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), MIN_NORM)
}

/// Position and its time, seconds after 1970.
fn position(entry: &Entry, known: &Properties, index: usize, dialect: &str) -> Result<(Fix, Option<f64>), String> {
    let damaged = || "sample without five numbers: the stream is damaged".to_owned();
    let [latitude_deg, longitude_deg, height_m, speed_m_s, _] = known.scaled(entry, index).ok_or_else(damaged)?;
    let (mut lock, mut dilution, mut utc_s) = (known.lock, known.dilution, known.utc_s);
    if dialect == GPS9 {
        let [_, _, _, _, _, days, seconds, dop, dimensions] = known.scaled(entry, index).ok_or_else(damaged)?;
        (lock, dilution, utc_s) = (Some(dimensions), Some(dop), Some(EPOCH_2000_S + days * DAY_S + seconds));
    }
    if lock.is_some_and(|lock| lock < 2.0) {
        return Err("the receiver had no fix".to_owned());
    }
    let resolution_deg = (1.0 / known.scale(0).abs()).max(1.0 / known.scale(1).abs());
    if !(resolution_deg > 0.0 && resolution_deg < 1.0) {
        return Err("position without a scale: the stream is damaged".to_owned());
    }
    let position = coordinate::checked(Position { longitude_deg, latitude_deg, resolution_deg })?;
    let has_height = lock.is_none_or(|lock| lock >= 3.0);
    let fix = Fix {
        gps_height_m: has_height.then_some(height_m),
        speed_m_s: (speed_m_s >= 0.0).then_some(speed_m_s),
        ..Fix::at(0, position).received_by(Receiver::Plain, dilution)
    };
    Ok((fix, utc_s))
}

/// 2000-01-01, seconds after 1970.
const EPOCH_2000_S: f64 = 946_684_800.0;

/// Seconds after 1970 of `yymmddhhmmss.sss`.
fn utc_s(text: &str) -> Option<f64> {
    let two = |at: usize| text.get(at..at + 2)?.parse::<u32>().ok();
    let parts = [2000 + two(0)?, two(2)?, two(4)?, two(6)?, two(8)?, two(10)?];
    let fraction = text.get(12..).and_then(super::text::number).filter(|fraction| (0.0..1.0).contains(fraction));
    time::civil_s(parts, fraction.unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(seconds: &[Vec<u8>]) -> Log {
        read(&made::payloads(seconds), &made::settings(), Log::default())
    }

    #[test]
    fn positions_have_time_accuracy_and_clock() {
        let log = log(&[made::max(0), made::max(1), made::max(2)]);
        assert_eq!((log.fixes.len(), log.num_passed_over, log.clock), (6, 0, ClockKind::Utc));
        let fix = &log.fixes[3];
        assert_eq!((fix.video_s, fix.dialect, fix.line), (Some(1.5), GPS5, 2));
        assert!((fix.latitude_deg - 33.126_783_5).abs() < 1e-9 && (fix.longitude_deg + 117.327_343_6).abs() < 1e-9);
        assert_eq!((fix.gps_height_m, fix.speed_m_s, fix.resolution_deg), (Some(-22.959), Some(1.046), 1e-7));
        assert!((fix.horizontal_std_m - 1.54 * 3.4).abs() < 1e-9, "{fix:?}");
        assert_eq!(time::spelled(fix.clock_s.unwrap()).unwrap(), "2019-11-18T23:45:12.000");
        assert_eq!(log.height_datum, HeightDatum::Ellipsoid);
        assert_eq!(
            log.exposure_s.map(|range| ((range.least * 1e4).round(), (range.most * 1e4).round())),
            Some((10.0, 20.0))
        );
    }

    #[test]
    fn the_newer_form_is_read_where_both_are() {
        let log = log(&[made::hero(0, 3), made::hero(1, 2), made::hero(2, 0)]);
        assert_eq!((log.dialects().get(GPS9), log.fixes.len(), log.num_passed_over), (Some(&4), 4, 2));
        assert_eq!((log.fixes[0].gps_height_m, log.fixes[2].gps_height_m), (Some(12.041), None));
        assert_eq!(log.height_datum, HeightDatum::SeaLevel);
        // 7261 days after 2000, the first sample at 85514.5 s.
        assert_eq!(time::spelled(log.fixes[0].clock_s.unwrap() - 0.25).unwrap(), "2019-11-18T23:45:14.000");
        assert!(log.passed_over[0].reason.contains("no fix"));
    }

    #[test]
    fn gravity_and_attitude_are_those_of_the_image() {
        let log = log(&[made::max(0)]);
        assert_eq!(log.camera.len(), 2);
        let sample = log.camera[1];
        assert_eq!(sample.video_s, 0.5);
        // A quarter turn about z maps the body's y to the image's −x.
        assert!((sample.down_in_image.unwrap() + Vector3::x()).norm() < 1e-4, "{sample:?}");
        assert!((sample.image_from_start.unwrap() * Vector3::y() + Vector3::x()).norm() < 1e-4, "{sample:?}");
    }

    #[test]
    fn one_wrong_time_of_the_receiver_moves_no_fix() {
        let mut late = made::max(1);
        let at = late.windows(12).position(|text| text == b"191118234511").unwrap();
        late[at + 11] = b'3';
        let clocks = |log: Log| log.fixes.iter().map(|fix| fix.clock_s.unwrap()).collect::<Vec<_>>();
        assert_eq!(clocks(log(&[made::max(0), late, made::max(2)])), clocks(log(&[0, 1, 2].map(made::max))));
    }

    #[test]
    fn a_track_without_its_times_has_the_clock() {
        let bytes = [made::max(0), made::max(1)].concat();
        assert!(is_gpmf(&bytes));
        let log = read_raw(&bytes, Log::default());
        assert_eq!((log.fixes.len(), log.camera.len(), log.fixes[0].video_s), (4, 0, None));
        assert!((log.fixes[2].clock_s.unwrap() - log.fixes[0].clock_s.unwrap() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn times_of_the_receiver() {
        let spelled = |text: &str| utc_s(text).and_then(time::spelled);
        assert_eq!(spelled("191118234514.250").unwrap(), "2019-11-18T23:45:14.250");
        for text in ["", "1911", "19111823451é.0", "191318234514.000"] {
            assert_eq!(utc_s(text), None, "{text}");
        }
    }
}
