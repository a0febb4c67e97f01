//! Why a file is no video that can be decoded, as far as its first bytes and its index tell.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::VideoError;
use super::mp4_times::{children, is_video, movie_box};

/// Bytes of a file in which its kind shows.
const HEAD_BYTES: u64 = 4096;

/// What is wrong with a file that no decoder takes.
pub(super) fn why_not(path: &Path) -> VideoError {
    let path = path.to_owned();
    let mut head = Vec::new();
    let file = File::open(&path).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
    match file {
        Ok(_) if is_mp4(&head) => match index(&path) {
            None => VideoError::NoIndex { path },
            Some(index) if has_pictures(&index) => VideoError::NotAVideo { path },
            Some(_) => VideoError::NoPictures { path },
        },
        Ok(_) if is_sound(&head) => VideoError::NoPictures { path },
        _ => VideoError::NotAVideo { path },
    }
}

/// MP4 and MOV: a box with one of these names comes first.
fn is_mp4(head: &[u8]) -> bool {
    const FIRST_BOXES: [&[u8]; 6] = [b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"];
    head.get(4..8).is_some_and(|name| FIRST_BOXES.contains(&name))
}

fn index(path: &Path) -> Option<Vec<u8>> {
    movie_box(&mut File::open(path).ok()?)
}

/// Whether there is a track of pictures. An index in pieces has no tracks that are easily found; it is given the
/// benefit of the doubt.
fn has_pictures(index: &[u8]) -> bool {
    let mut tracks = children(index).filter(|(name, _)| *name == b"trak").peekable();
    tracks.peek().is_none() || tracks.any(|(_, track)| is_video(track))
}

/// WAV, MP3, FLAC, AAC, and Ogg without pictures.
fn is_sound(head: &[u8]) -> bool {
    let contains = |text: &[u8]| head.windows(text.len()).any(|window| window == text);
    // MP3 (layers II and III) and AAC in ADTS frames.
    let is_mpeg_audio = matches!(head, [0xff, 0xf0..=0xfd, ..]);
    head.starts_with(b"RIFF") && head.get(8..12) == Some(b"WAVE")
        || head.starts_with(b"ID3")
        || head.starts_with(b"fLaC")
        || head.starts_with(b"OggS") && !contains(b"theora")
        || is_mpeg_audio
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxed(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
        [&(content.len() as u32 + 8).to_be_bytes()[..], name, content].concat()
    }

    fn track(handler: &[u8; 4]) -> Vec<u8> {
        let handler = boxed(b"hdlr", &[&[0; 8][..], handler, &[0; 13]].concat());
        boxed(b"trak", &boxed(b"mdia", &handler))
    }

    #[test]
    fn a_file_says_why_it_is_no_video() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mp4");
        let why = |content: &[u8]| {
            std::fs::write(&path, content).unwrap();
            why_not(&path)
        };
        let (kind, data) = (boxed(b"ftyp", b"isom\0\0\0\0"), boxed(b"mdat", &[7; 100]));
        let unfinished = [&kind[..], &data].concat();
        assert!(matches!(why(&unfinished), VideoError::NoIndex { .. }));
        let sound = [&kind[..], &boxed(b"moov", &track(b"soun")), &data].concat();
        assert!(matches!(why(&sound), VideoError::NoPictures { .. }));
        assert!(matches!(why(&sound[..kind.len() + 20]), VideoError::NoIndex { .. }), "cut in the index");
        let broken = [&kind[..], &boxed(b"moov", &track(b"vide")), &data].concat();
        assert!(matches!(why(&broken), VideoError::NotAVideo { .. }));
        assert!(matches!(why(b"RIFF\x10\0\0\0WAVEfmt "), VideoError::NoPictures { .. }));
        assert!(matches!(why(b"ID3\x04\0"), VideoError::NoPictures { .. }));
        assert!(matches!(why(b"Dear reader"), VideoError::NotAVideo { .. }));
        assert!(matches!(why(b"\xff\xd8\xff\xe0 a photograph"), VideoError::NotAVideo { .. }));
    }
}
