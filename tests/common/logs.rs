//! Small logs of where a camera was, one of every format that the room `telemetry` reads, and what holds of every log
//! that is read.

use std::fs;
use std::path::{Path, PathBuf};

use super::Failed;

/// Subtitles in four of the forms that drones write.
const SUBTITLES: &str = "1\n00:00:00,000 --> 00:00:00,033\n<font size=\"36\">SrtCnt : 1, DiffTime : 33ms\n2022-08-07 \
    13:40:40,774,808\n[iso : 100] [latitude: 41.424724] [longitude: 2.234156] [altitude: 117.0] </font>\n\n2\n\
    00:00:00,033 --> 00:00:00,066\n2022-08-07 13:40:40,808,164\n[latitude: 41.424725] [longitude: 2.234147] [rel_alt: \
    1.0 abs_alt: 2.5]\n\n3\n00:00:01,000 --> 00:00:02,000\nHOME(149.0251,-20.2532) 2017.08.05 14:11:51\n\
    GPS(149.0251,-20.2533,16) BAROMETER:1.9\nISO:100\n\n4\n00:00:02,000 --> 00:00:03,000\nF/5.6, SS 400, GPS (-58.8, \
    -34.2, 15), HOME (-58.8, -34.2, -57.98m), D 6.7m, H 85.8m, H.S 2.8m/s, V.S 0.0m/s, F.PRY (2.7\u{b0}, -7.0\u{b0}, \
    110.1\u{b0}), G.PRY (-24.4\u{b0}, 0.0\u{b0}, 1.4\u{b0})\n";
const GPX: &str = "<?xml version=\"1.0\"?><gpx version=\"1.1\"><trk><trkseg><trkpt lat=\"48.1\" lon=\"9.7\">\
    <ele>5</ele><time>2024-05-06T07:08:09Z</time></trkpt><trkpt lat=\"48.2\" lon=\"9.8\">\
    <time>2024-05-06T07:08:10+00:00</time>\
    <extensions><speed>3.5</speed></extensions></trkpt></trkseg></trk></gpx>";
const NMEA: &str = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n$GPRMC,123519,A,\
    4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W\n$GPVTG,084.4,T,081.3,M,022.4,N,041.5,K\n";
const TABLE: &str = "time_s,latitude,longitude,altitude [ft],speed(km/h)\n0.0,48.5,9.25,1000,36\n1.0,48.5001,\
    9.25,1001,37\n2.0,48\u{b0}30'0\"N,9.2502,1002,38\n";

/// Writes one into a folder.
pub fn written(log: &str, folder: &Path) -> Result<Vec<PathBuf>, Failed> {
    let (name, content) = match log {
        "subtitles" => ("flight.srt", SUBTITLES.as_bytes().to_vec()),
        "gpx" => ("ride.gpx", GPX.as_bytes().to_vec()),
        "nmea" => ("ride.nmea", NMEA.as_bytes().to_vec()),
        "table" => ("flight.csv", TABLE.as_bytes().to_vec()),
        "gpmf" => ("ride.gpmf", [gpmf(0), gpmf(1)].concat()),
        _ => ("photograph.jpg", photograph()),
    };
    let path = folder.join(name);
    fs::write(&path, content)?;
    Ok(vec![path])
}

/// A JPEG of nothing but an EXIF block with a position (TIFF 6.0, Exif 2.32).
fn photograph() -> Vec<u8> {
    /// Before the first directory.
    const HEAD: u32 = 8;
    let rationals = |numbers: &[(u32, u32)]| {
        numbers.iter().flat_map(|(a, b)| [a.to_le_bytes(), b.to_le_bytes()].concat()).collect::<Vec<u8>>()
    };
    let camera = |gps: u32| {
        [(0x10f, 2, b"maker\0".to_vec()), (0x112, 3, vec![6, 0]), (0x8825, 4, gps.to_le_bytes().to_vec())].to_vec()
    };
    let position = [
        (1, 2, b"N\0".to_vec()),
        (2, 5, rationals(&[(46, 1), (50, 1), (3339, 100)])),
        (3, 2, b"W\0".to_vec()),
        (4, 5, rationals(&[(91, 1), (59, 1), (4042, 100)])),
        (5, 1, vec![0]),
        (6, 5, rationals(&[(198_309, 1000)])),
        (7, 5, rationals(&[(16, 1), (31, 1), (595, 10)])),
        (0x1d, 2, b"2016:06:23\0".to_vec()),
    ];
    let gps = HEAD + directory(HEAD, &camera(0)).len() as u32;
    let block = [b"Exif\0\0II*\0\x08\0\0\0", &directory(HEAD, &camera(gps))[..], &directory(gps, &position)].concat();
    let length = (block.len() as u16 + 2).to_be_bytes();
    [b"\xff\xd8\xff\xe1", &length[..], &block, b"\xff\xd9"].concat()
}

/// A directory of TIFF that lies `at` so many bytes behind the head: tags, types, and values in ascending order.
fn directory(at: u32, entries: &[(u16, u16, Vec<u8>)]) -> Vec<u8> {
    let mut table = (entries.len() as u16).to_le_bytes().to_vec();
    let mut values: Vec<u8> = Vec::new();
    let behind = at + 2 + 12 * entries.len() as u32 + 4;
    for (tag, kind, value) in entries {
        let size = match kind {
            3 => 2,
            4 => 4,
            5 => 8,
            _ => 1,
        };
        table.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        table.extend((value.len() as u32 / size).to_le_bytes());
        let mut field = value.clone();
        if value.len() > 4 {
            field = (behind + values.len() as u32).to_le_bytes().to_vec();
            values.extend(value);
        }
        field.resize(4, 0);
        table.extend(field);
    }
    [table, vec![0; 4], values].concat()
}

/// One second of a GoPro's telemetry: both forms of positions, attitude, gravity and exposure.
fn gpmf(second: i32) -> Vec<u8> {
    let entry = |key: &[u8; 4], kind: u8, size: u8, data: &[u8]| {
        let count = (data.len() / usize::from(size)) as u16;
        let mut bytes = [&key[..], &[kind, size], &count.to_be_bytes(), data].concat();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    };
    let longs = |values: &[i32]| values.iter().flat_map(|value| value.to_be_bytes()).collect::<Vec<u8>>();
    let shorts = |values: &[i16]| values.iter().flat_map(|value| value.to_be_bytes()).collect::<Vec<u8>>();
    let stream = |parts: &[Vec<u8>]| entry(b"STRM", 0, 1, &parts.concat());
    let place = [331_267_700 + second, -1_173_273_436, -22_959, 1046, 100];
    let dated = [longs(&place), longs(&[7261, 85_514_000 + 1000 * second]), shorts(&[154, 3])].concat();
    let streams = [
        stream(&[
            entry(b"GPSF", b'L', 4, &longs(&[3])),
            entry(b"GPSU", b'c', 1, b"191118234514.000"),
            entry(b"GPSP", b'S', 2, &shorts(&[154])),
            entry(b"SCAL", b'l', 4, &longs(&[10_000_000, 10_000_000, 1000, 1000, 100])),
            entry(b"GPS5", b'l', 20, &longs(&place)),
        ]),
        stream(&[
            entry(b"GPSA", b'F', 4, b"MSLV"),
            entry(b"TYPE", b'c', 1, b"lllllllSS"),
            entry(b"SCAL", b'l', 4, &longs(&[10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1])),
            entry(b"GPS9", b'?', 32, &dated),
        ]),
        stream(&[entry(b"SCAL", b's', 2, &shorts(&[32_767])), entry(b"CORI", b's', 8, &shorts(&[32_767, 0, 0, 0]))]),
        stream(&[entry(b"SCAL", b's', 2, &shorts(&[32_767])), entry(b"GRAV", b's', 6, &shorts(&[0, 32_767, 0]))]),
        stream(&[entry(b"SHUT", b'f', 4, &0.001f32.to_be_bytes())]),
    ];
    entry(b"DEVC", 0, 1, &streams.concat())
}

/// Whether the reader takes what lies there.
#[cfg(feature = "telemetry")]
pub fn read(place: &Path) -> bool {
    let Ok(log) = tractrix::telemetry::read(place) else { return false };
    assert!(!log.fixes.is_empty());
    for fix in &log.fixes {
        assert!(fix.longitude_deg.abs() <= 180.0 && fix.latitude_deg.abs() <= 90.0, "{fix:?}");
        let numbers = [fix.video_s, fix.clock_s, fix.gps_height_m, fix.relative_height_m, fix.speed_m_s];
        assert!(numbers.into_iter().flatten().all(f64::is_finite), "{fix:?}");
    }
    let mut summary = log.summary();
    // What was passed over is quoted from the file.
    summary.passed_over.clear();
    let said = summary.as_text();
    assert!(!said.contains("NaN") && !said.contains(" inf"), "{said}");
    true
}

#[cfg(not(feature = "telemetry"))]
pub fn read(_: &Path) -> bool {
    false
}
