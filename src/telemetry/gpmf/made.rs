//! Small GPMF streams for tests.

use crate::scene::Timed;

/// Payloads of one second each.
pub(crate) fn payloads(seconds: &[Vec<u8>]) -> Vec<Timed<Vec<u8>>> {
    let numbered = (0u32..).map(f64::from).zip(seconds);
    numbered.map(|(start_s, data)| Timed { start_s, end_s: start_s + 1.0, content: data.clone() }).collect()
}

/// Creates an entry with samples of `size` bytes.
pub(crate) fn entry(key: &[u8; 4], kind: u8, size: u8, data: &[u8]) -> Vec<u8> {
    let count = (data.len() / usize::from(size)) as u16;
    let mut bytes = [&key[..], &[kind, size], &count.to_be_bytes(), data].concat();
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

/// Creates an entry of entries.
pub(crate) fn nest(key: &[u8; 4], parts: &[Vec<u8>]) -> Vec<u8> {
    entry(key, 0, 1, &parts.concat())
}

fn shorts(values: &[i16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

fn longs(values: &[i32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

/// `GPS5` as cameras up to HERO10 write it: two positions a second, 1 m/s north.
fn gps5(second: i32) -> Vec<u8> {
    let scales = entry(b"SCAL", b'l', 4, &longs(&[10_000_000, 10_000_000, 1000, 1000, 100]));
    let utc = format!("1911182345{:02}.500", second + 10);
    let position = |half: i32| {
        let north = 45 * (2 * second + half);
        longs(&[331_267_700 + north, -1_173_273_436, -22_959, 1046, 100])
    };
    nest(
        b"STRM",
        &[
            entry(b"GPSF", b'L', 4, &longs(&[3])),
            entry(b"GPSU", b'c', 1, utc.as_bytes()),
            entry(b"GPSP", b'S', 2, &shorts(&[154])),
            scales,
            entry(b"GPS5", b'l', 20, &[position(0), position(1)].concat()),
        ],
    )
}

/// `GPS9` as HERO11 and later write it: time, dilution and lock with every position.
fn gps9(second: i32, lock: i16) -> Vec<u8> {
    let row = |half: i32| {
        let north = 45 * (2 * second + half);
        let numbers =
            longs(&[331_267_700 + north, -1_173_273_436, 12_041, 1046, 100, 7261, 85_514_500 + 1000 * second]);
        [numbers, shorts(&[154, lock])].concat()
    };
    nest(
        b"STRM",
        &[
            entry(b"GPSA", b'F', 4, b"MSLV"),
            entry(b"TYPE", b'c', 1, b"lllllllSS"),
            entry(b"SCAL", b'l', 4, &longs(&[10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1])),
            entry(b"GPS9", b'?', 32, &[row(0), row(1)].concat()),
        ],
    )
}

/// Gravity straight down in the body, image rotated by a quarter turn about its axis, camera not rotated.
fn attitude() -> Vec<Vec<u8>> {
    let stream = |key, size, values: &[i16]| {
        nest(b"STRM", &[entry(b"SCAL", b's', 2, &shorts(&[32_767])), entry(key, b's', size, &shorts(values))])
    };
    vec![
        stream(b"CORI", 8, &[32_767, 0, 0, 0, 32_767, 0, 0, 0]),
        stream(b"IORI", 8, &[23_170, 0, 0, 23_170, 23_170, 0, 0, 23_170]),
        stream(b"GRAV", 6, &[0, 32_767, 0, 0, 32_767, 0]),
    ]
}

fn shutter() -> Vec<u8> {
    nest(b"STRM", &[entry(b"SHUT", b'f', 4, &[0.001f32, 0.002].map(f32::to_be_bytes).concat())])
}

/// One second of a GoPro MAX.
pub(crate) fn max(second: i32) -> Vec<u8> {
    let streams = [vec![entry(b"DVNM", b'c', 1, b"GoPro Max")], attitude(), vec![shutter(), gps5(second)]].concat();
    nest(b"DEVC", &streams)
}

/// One second of a HERO13 whose receiver has a lock of `lock` dimensions; HERO11 writes both forms.
pub(crate) fn hero(second: i32, lock: i16) -> Vec<u8> {
    nest(b"DEVC", &[gps5(second), gps9(second, lock)])
}

/// Camera settings as stored in the container.
pub(crate) fn settings() -> Vec<u8> {
    let float = |value: f32| value.to_be_bytes().to_vec();
    let polynomial: Vec<u8> =
        [0.0, 1.822_953_3, 0.106_809_6, -0.663_186_6, 0.356_311].iter().flat_map(|v| float(*v)).collect();
    nest(
        b"DEVC",
        &[
            entry(b"MINF", b'c', 1, b"HERO12 Black"),
            entry(b"VFOV", b'c', 1, b"W"),
            entry(b"ZFOV", b'f', 4, &float(151.5)),
            entry(b"SROT", b'f', 4, &float(15.5)),
            entry(b"EISE", b'c', 1, b"Y"),
            entry(b"VRES", b'L', 4, &longs(&[3840, 2160])),
            entry(b"ZMPL", b'f', 4, &float(0.6549)),
            entry(b"POLY", b'f', 20, &polynomial),
        ],
    )
}
