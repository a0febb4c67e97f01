//! Telemetry track of a video (GPMF), written by action cameras, and the settings in the container's user data.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::mp4::head_at;
use super::{VideoError, tracks};
use crate::ffi::ffmpeg::StreamKind;
use crate::files;
use crate::scene::Timed;

/// Telemetry of a video.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gpmf {
    /// Payloads, in file order.
    pub payloads: Vec<Timed<Vec<u8>>>,
    /// Content of the box `GPMF` in the container's user data; empty if there is none.
    pub settings: Vec<u8>,
}

/// Reads the telemetry track of a video; `None` if it has none. Nothing is decoded.
///
/// * `track` – video track whose clock applies, as [`Options::track`](super::Options::track).
///
/// # Errors
/// As [`subtitles`](super::subtitles).
pub fn gpmf(path: &Path, track: Option<u32>) -> Result<Option<Gpmf>, VideoError> {
    let payload = |_, data: &[u8]| Some((data.to_vec(), data.len()));
    let Some(payloads) = tracks::packets(path, track, |kind| kind == StreamKind::Gpmf, payload)? else {
        return Ok(None);
    };
    // Unreadable settings count as none: only the track is required.
    let settings = files::open(path).ok().and_then(|mut file| settings(&mut file)).unwrap_or_default();
    Ok(Some(Gpmf { payloads, settings }))
}

/// Maximum number of boxes examined on one level: files of hours have a few dozen.
const MOST_BOXES: usize = 4096;

/// Maximum size of the settings, bytes: cameras write 25 KiB.
const MOST_SETTINGS: u64 = 1 << 20;

/// Content of `moov/udta/GPMF` (ISO/IEC 14496-12), if it exists and can be read.
fn settings(file: &mut (impl Read + Seek)) -> Option<Vec<u8>> {
    let mut span = (0, file.seek(SeekFrom::End(0)).ok()?);
    for kind in [b"moov", b"udta", b"GPMF"] {
        span = find(file, span, kind)?;
    }
    file.seek(SeekFrom::Start(span.0)).ok()?;
    let mut content = Vec::new();
    file.take((span.1 - span.0).min(MOST_SETTINGS)).read_to_end(&mut content).ok()?;
    Some(content)
}

/// Start and end of the content of the first box of a kind between `start` and `end`.
fn find(file: &mut (impl Read + Seek), (start, end): (u64, u64), kind: &[u8; 4]) -> Option<(u64, u64)> {
    let mut at = start;
    for _ in 0..MOST_BOXES {
        let head = head_at(file, at)?;
        let content = at.saturating_add(head.num_bytes);
        let next = head.size.map_or(end, |size| at.saturating_add(size));
        if next < content || next > end {
            return None;
        }
        if head.kind == *kind {
            return Some((content, next));
        }
        at = next;
    }
    None
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
        let payload = |start_s, data: &[u8]| Timed { start_s, end_s: start_s + 1.0, content: data.to_vec() };
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
        // Each length and count of the index in turn is set far out of range.
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
        // Sizes that lead out of the file, or into the box's own head.
        for size in [2u32, 7, u32::MAX] {
            let damaged = [&size.to_be_bytes()[..], b"free", &moov].concat();
            assert_eq!(read(&damaged), b"", "{size}");
        }
        assert_eq!(read(&[boxed(b"free", b"").repeat(MOST_BOXES), moov].concat()), b"");
    }
}
