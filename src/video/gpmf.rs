//! The telemetry track of a video (GPMF), as action cameras write it, and the settings in the container's user data.

use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use super::error::regular;
use super::{VideoError, diagnosis, tracks};
use crate::ffi::ffmpeg::{MediaFile, Packet, StreamKind};
use crate::{files, memory};

/// A payload of the track.
#[derive(Clone, Debug, PartialEq)]
pub struct Payload {
    /// Its beginning, seconds on the clock of the frames.
    pub start_s: f64,
    /// Its end, seconds; no earlier than `start_s`.
    pub end_s: f64,
    /// Content.
    pub data: Vec<u8>,
}

/// Telemetry of a video.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gpmf {
    /// In the order of the file.
    pub payloads: Vec<Payload>,
    /// Content of the box `GPMF` in the container's user data; empty if there is none.
    pub settings: Vec<u8>,
}

/// Reads the telemetry track of a video; `None` if it has none. Nothing is decoded.
///
/// * `track` – video track whose clock counts, as [`Options::track`](super::Options::track).
///
/// # Errors
/// As [`subtitles`](super::subtitles).
pub fn gpmf(path: &Path, track: Option<u32>) -> Result<Option<Gpmf>, VideoError> {
    regular(path)?;
    let mut file = MediaFile::open(path).map_err(|error| diagnosis::refused(path, error))?;
    let streams = file.streams();
    let Some(stream) = streams.iter().find(|stream| stream.kind == StreamKind::Gpmf) else { return Ok(None) };
    let origin_s = tracks::choose(&file, path, track).map_or(0.0, |chosen| chosen.stream.start_s());
    file.keep_only(stream.index);
    let mut packet = Packet::new()?;
    let (mut payloads, mut taken) = (Vec::new(), 0);
    // Its samples take up as much again.
    let limit = memory::of_machine() / 4;
    while file.read(&mut packet)? {
        let Some(time) = packet.time() else { continue };
        taken += (size_of::<Payload>() + packet.data().len()) as u64;
        if taken > limit {
            return Err(VideoError::TextTooLarge { path: path.to_owned(), limit });
        }
        payloads.push(Payload {
            start_s: stream.time_base.seconds(time) - origin_s,
            end_s: stream.time_base.seconds(time.saturating_add(packet.duration())) - origin_s,
            data: packet.data().to_vec(),
        });
    }
    // Settings that cannot be read are none: the track is what counts.
    let settings = files::open(path).and_then(|mut file| settings(&mut file)).unwrap_or_default();
    Ok(Some(Gpmf { payloads, settings }))
}

/// Boxes that are looked at on one level: files of hours have a few dozen.
const MOST_BOXES: usize = 4096;

/// Cameras write 25 KiB.
const MOST_SETTINGS: u64 = 1 << 20;

/// Content of `moov/udta/GPMF` (ISO/IEC 14496-12), empty if there is none.
fn settings(file: &mut (impl Read + Seek)) -> io::Result<Vec<u8>> {
    let end = file.seek(SeekFrom::End(0))?;
    let mut span = (0, end);
    for kind in [b"moov", b"udta", b"GPMF"] {
        match find(file, span, kind)? {
            Some(found) => span = found,
            None => return Ok(Vec::new()),
        }
    }
    file.seek(SeekFrom::Start(span.0))?;
    let mut content = Vec::new();
    file.take((span.1 - span.0).min(MOST_SETTINGS)).read_to_end(&mut content)?;
    Ok(content)
}

/// Beginning and end of the content of the first box of a kind among those from `start` to `end`.
fn find(file: &mut (impl Read + Seek), (start, end): (u64, u64), kind: &[u8; 4]) -> io::Result<Option<(u64, u64)>> {
    const HEAD: u64 = 8;
    let mut at = start;
    for _ in 0..MOST_BOXES {
        if end.saturating_sub(at) < HEAD {
            break;
        }
        file.seek(SeekFrom::Start(at))?;
        let (mut size, mut name) = ([0; 4], [0; 4]);
        file.read_exact(&mut size)?;
        file.read_exact(&mut name)?;
        let (head, size) = match u32::from_be_bytes(size) {
            // To the end of the file.
            0 => (HEAD, end - at),
            // A size of 64 bits follows.
            1 => {
                let mut size = [0; 8];
                file.read_exact(&mut size)?;
                (2 * HEAD, u64::from_be_bytes(size))
            }
            size => (HEAD, u64::from(size)),
        };
        let next = at.saturating_add(size);
        if size < head || next > end {
            break;
        }
        if name == *kind {
            return Ok(Some((at + head, next)));
        }
        at = next;
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::super::made::{boxed, with_telemetry};
    use super::*;

    #[test]
    fn payloads_have_the_times_of_their_track() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("GX010042.MP4");
        let bytes = with_telemetry(&[b"DEVC1".to_vec(), b"DEVC22".to_vec()], b"DEVC set");
        std::fs::write(&path, &bytes).unwrap();
        let found = gpmf(&path, None).unwrap().unwrap();
        let payload = |start_s, data: &[u8]| Payload { start_s, end_s: start_s + 1.0, data: data.to_vec() };
        assert_eq!(found.payloads, [payload(0.0, b"DEVC1"), payload(1.0, b"DEVC22")]);
        assert_eq!(found.settings, b"DEVC set");
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/text_track.mp4");
        assert_eq!(gpmf(&golden, None).unwrap(), None);
    }

    #[test]
    fn damaged_containers_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("damaged.mp4");
        let bytes = with_telemetry(&[b"DEVC1".to_vec()], b"DEVC");
        // Every length and count of the index, in turn, beyond all bounds.
        for at in (0..bytes.len() - 4).step_by(4) {
            let mut damaged = bytes.clone();
            damaged[at..at + 4].fill(0xff);
            std::fs::write(&path, &damaged).unwrap();
            let _ = gpmf(&path, None);
        }
    }

    #[test]
    fn settings_are_found_behind_large_boxes() {
        let read = |bytes: &[u8]| settings(&mut Cursor::new(bytes)).unwrap_or_default();
        let moov = boxed(b"moov", &boxed(b"udta", &[boxed(b"FIRM", b"1"), boxed(b"GPMF", b"DEVC")].concat()));
        let large = [&1u32.to_be_bytes()[..], b"mdat", &20u64.to_be_bytes(), b"1234"].concat();
        let bytes = [boxed(b"ftyp", b"mp41"), large, moov.clone()].concat();
        assert_eq!(read(&bytes), b"DEVC");
        for end in 0..bytes.len() {
            assert_eq!(read(&bytes[..end]), b"", "{end}");
        }
        // Sizes that lead nowhere, or backwards.
        for size in [2u32, 7, u32::MAX] {
            let damaged = [&size.to_be_bytes()[..], b"free", &moov].concat();
            assert_eq!(read(&damaged), b"", "{size}");
        }
        assert_eq!(read(&[boxed(b"free", b"").repeat(MOST_BOXES), moov].concat()), b"");
    }
}
