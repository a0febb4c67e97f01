//! Diagnosis of files that cannot be decoded as video.

use std::fs::File;
use std::io::{Seek, SeekFrom};
use std::path::Path;

use super::VideoError;
use super::mp4::head_at;
use crate::ffi::ffmpeg::{FfmpegError, Stream, StreamKind};
use crate::files;

/// Error of a file without a video track, with a description of its other tracks.
pub(super) fn no_pictures(path: &Path, streams: &[Stream]) -> VideoError {
    VideoError::NoPictures { path: path.to_owned(), found: in_words(streams) }
}

fn in_words(streams: &[Stream]) -> &'static str {
    let has = |wanted: fn(&StreamKind) -> bool| streams.iter().any(|stream| wanted(&stream.kind));
    match (has(|kind| *kind == StreamKind::Sound), has(|kind| matches!(kind, StreamKind::Text(_)))) {
        (true, true) => "only audio and text",
        (true, false) => "only audio",
        (false, true) => "only text",
        (false, false) => "nothing to show",
    }
}

/// Diagnoses a file that FFmpeg did not open.
pub(super) fn refused(path: &Path, error: FfmpegError) -> VideoError {
    match error {
        FfmpegError::Open(_) => why_not(path),
        FfmpegError::Playlist(format) => VideoError::Playlist { path: path.to_owned(), format },
        FfmpegError::NoDecoder(coding) => VideoError::NoDecoder { path: path.to_owned(), coding },
        other => VideoError::Ffmpeg(other),
    }
}

/// Reason why FFmpeg refuses a file.
fn why_not(path: &Path) -> VideoError {
    let path = path.to_owned();
    match files::open(&path).ok().and_then(|mut file| lacks_index(&mut file)) {
        Some(true) => VideoError::NoIndex { path },
        Some(false) | None => VideoError::NotAVideo { path },
    }
}

/// True if an MP4 or MOV file lacks its index (ISO/IEC 14496-12: the `moov` box); `None` if it has no boxes.
fn lacks_index(file: &mut File) -> Option<bool> {
    /// Possible first boxes of an MP4 or MOV file.
    const FIRST_BOXES: [&[u8; 4]; 6] = [b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"];
    /// Maximum number of top-level boxes, above that of any file, including fragments of a day.
    const MOST_BOXES: usize = 1 << 20;
    let end = file.seek(SeekFrom::End(0)).ok()?;
    let mut at = 0;
    for _ in 0..MOST_BOXES {
        let Some(head) = head_at(file, at) else { break };
        if at == 0 && !FIRST_BOXES.contains(&&head.kind) {
            return None;
        }
        let next = head.size.map_or(Some(end), |size| at.checked_add(size.max(head.num_bytes)))?;
        if &head.kind == b"moov" && next <= end {
            return Some(false);
        }
        at = next;
    }
    (at > 0).then_some(true)
}

#[cfg(test)]
mod tests {
    use super::super::made::boxed;
    use super::*;

    #[test]
    fn a_file_says_why_it_is_no_video() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mp4");
        let why = |content: &[u8]| {
            std::fs::write(&path, content).unwrap();
            why_not(&path)
        };
        let (kind, data) = (boxed(b"ftyp", b"isom\0\0\0\0"), boxed(b"mdat", &[7; 100]));
        assert!(matches!(why(&[&kind[..], &data].concat()), VideoError::NoIndex { .. }));
        let whole = [&kind[..], &boxed(b"moov", &[0; 40]), &data].concat();
        assert!(matches!(why(&whole), VideoError::NotAVideo { .. }));
        assert!(matches!(why(&whole[..kind.len() + 20]), VideoError::NoIndex { .. }), "cut in the index");
        assert!(matches!(why(b"RIFF\x10\0\0\0WAVEfmt "), VideoError::NotAVideo { .. }));
        assert!(matches!(why(b"Dear reader"), VideoError::NotAVideo { .. }));
        assert!(matches!(why(b"\0\0\0\x02ftyp"), VideoError::NoIndex { .. }), "a size that cannot be");
    }
}
