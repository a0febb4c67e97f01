//! Text track of a video, in which some cameras write their position.

use std::path::Path;

use super::{VideoError, tracks};
use crate::ffi::ffmpeg::{StreamKind, TextCoding};
use crate::scene::Timed;

/// Reads the first text track of a video, or a file of subtitles (SRT, WebVTT, ASS).
///
/// Returns the texts in file order, with line breaks and markup; invalid UTF-8 is replaced. `None` if the file has no
/// text track. Nothing is decoded: it takes little more time than reading the file.
///
/// * `track` – video track whose clock applies, as [`Options::track`](super::Options::track).
///
/// # Errors
/// [`VideoError::NoIndex`], [`VideoError::NotAVideo`] for a file that FFmpeg rejects, [`VideoError::Playlist`],
/// [`VideoError::Ffmpeg`], [`VideoError::TextTooLarge`].
pub fn subtitles(path: &Path, track: Option<u32>) -> Result<Vec<Timed<String>>, VideoError> {
    let subtitle = |kind, data: &[u8]| {
        let StreamKind::Text(coding) = kind else { return None };
        let text = text(data, coding);
        let num_bytes = text.capacity();
        (!text.is_empty()).then_some((text, num_bytes))
    };
    let is_text = |kind| matches!(kind, StreamKind::Text(_));
    Ok(tracks::packets(path, track, is_text, subtitle)?.unwrap_or_default())
}

/// Text of a packet.
fn text(data: &[u8], coding: TextCoding) -> String {
    let text = match coding {
        TextCoding::Plain => data,
        TextCoding::Timed => timed(data),
        // Eight fields precede the text.
        TextCoding::SubStation => data.splitn(9, |byte| *byte == b',').last().unwrap_or_default(),
    };
    String::from_utf8_lossy(text).trim_matches('\0').trim_end().to_owned()
}

/// Text after its length field; a length beyond the end of the packet is truncated.
fn timed(data: &[u8]) -> &[u8] {
    let [high, low, rest @ ..] = data else { return &[] };
    &rest[..rest.len().min(usize::from(u16::from_be_bytes([*high, *low])))]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_every_encoding_is_read() {
        assert_eq!(text(b"F/2.8, SS 500\nISO 100\r\n", TextCoding::Plain), "F/2.8, SS 500\nISO 100");
        assert_eq!(text(b"\0\x03abc\0\0\0\x0cencd\0\0\x01\0", TextCoding::Timed), "abc");
        assert_eq!(text(b"\0\x09abc", TextCoding::Timed), "abc", "a length beyond the end");
        assert_eq!(text(b"\0", TextCoding::Timed), "");
        assert_eq!(text(b"0,0,Default,,0,0,0,,one, two", TextCoding::SubStation), "one, two");
    }

    #[test]
    fn a_file_of_subtitles_is_read_with_its_times() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flight.srt");
        let content = "1\n00:00:00,000 --> 00:00:00,033\n<font>GPS (8.5, 47.2, 18)</font>\nBAROMETER:91.2\n\n\
                       2\n00:00:01,500 --> 00:00:02,000\nsecond\n\n";
        std::fs::write(&path, content).unwrap();
        let found = subtitles(&path, None).unwrap();
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0].content, "<font>GPS (8.5, 47.2, 18)</font>\nBAROMETER:91.2");
        assert!((found[0].end_s - 0.033).abs() < 1e-9 && (found[1].start_s - 1.5).abs() < 1e-9, "{found:?}");
        std::fs::write(&path, "").unwrap();
        assert!(subtitles(&path, None).is_err());
    }

    #[test]
    fn a_text_track_inside_a_video_is_on_the_clock_of_its_frames() {
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
        let found = subtitles(&golden.join("text_track.mp4"), None).unwrap();
        let expected = [(0.0, 0.5, "HOME(8.5,47.2) D=1.5m"), (0.5, 1.0, "HOME(8.5,47.2) D=2.5m")];
        assert_eq!(found.len(), expected.len(), "{found:?}");
        for (found, (start_s, end_s, text)) in found.iter().zip(expected) {
            assert!((found.start_s - start_s).abs() < 1e-6 && (found.end_s - end_s).abs() < 1e-6, "{found:?}");
            assert_eq!(found.content, text);
        }
        assert_eq!(subtitles(&golden.join("variable_rate_rotated.mp4"), None).unwrap(), []);
    }
}
