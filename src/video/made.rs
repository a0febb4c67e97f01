//! Small MP4 files with a telemetry track, for tests.

/// A box (ISO/IEC 14496-12).
pub(super) fn boxed(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    [&(content.len() as u32 + 8).to_be_bytes(), &kind[..], content].concat()
}

/// A box of numbers, the first of which holds its version and flags.
fn numbered(kind: &[u8; 4], numbers: &[u32]) -> Vec<u8> {
    boxed(kind, &numbers.iter().flat_map(|number| number.to_be_bytes()).collect::<Vec<u8>>())
}

/// An MP4 file with a telemetry track of a payload per second and settings in its user data, without images.
pub(crate) fn with_telemetry(payloads: &[Vec<u8>], settings: &[u8]) -> Vec<u8> {
    const TICKS: u32 = 1000;
    const UNITY: [u32; 9] = [0x1_0000, 0, 0, 0, 0x1_0000, 0, 0, 0, 0x4000_0000];
    let (count, length) = (payloads.len() as u32, TICKS * payloads.len() as u32);
    let start = boxed(b"ftyp", b"mp41\0\0\0\0mp41");
    let media = boxed(b"mdat", &payloads.concat());
    let sizes: Vec<u32> = payloads.iter().map(|payload| payload.len() as u32).collect();
    let table = [
        boxed(b"stsd", &[&[0, 0, 0, 0, 0, 0, 0, 1][..], &boxed(b"gpmd", &[0, 0, 0, 0, 0, 0, 0, 1])].concat()),
        numbered(b"stts", &[0, 1, count, TICKS]),
        numbered(b"stsc", &[0, 1, 1, count, 1]),
        numbered(b"stsz", &[&[0, 0, count][..], &sizes].concat()),
        numbered(b"stco", &[0, 1, start.len() as u32 + 8]),
    ];
    let media_header = numbered(b"mdhd", &[0, 0, 0, TICKS, length, 0x55c4_0000]);
    let handler = boxed(b"hdlr", b"\0\0\0\0mhlrmeta\0\0\0\0\0\0\0\0\0\0\0\0\0");
    let info =
        boxed(b"minf", &[boxed(b"gmhd", &numbered(b"gmin", &[0, 0, 0, 0])), boxed(b"stbl", &table.concat())].concat());
    let media_box = boxed(b"mdia", &[media_header, handler, info].concat());
    let head = [&[0, 0, 0, TICKS, length, 0x1_0000, 0x0100_0000, 0, 0][..], &UNITY, &[0; 6], &[2]].concat();
    let track_head = [&[7, 0, 0, 1, 0, length, 0, 0, 0, 0][..], &UNITY, &[0, 0]].concat();
    let track = boxed(b"trak", &[numbered(b"tkhd", &track_head), media_box].concat());
    let user_data = boxed(b"udta", &boxed(b"GPMF", settings));
    let movie = boxed(b"moov", &[numbered(b"mvhd", &head), user_data, track].concat());
    [start, media, movie].concat()
}
