//! Completeness check of JPEG files.
//!
//! Decoders fill the missing part of an image with gray and report success. A truncated file has no end-of-image marker
//! (ITU-T T.81, B.1.1.3). The marker need not be at the end of the file: cameras write zeros, previews or whole videos
//! after it.

use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use crate::files;

/// Start-of-image marker (ITU-T T.81, table B.1).
const START: [u8; 2] = [0xff, 0xd8];
/// End-of-image marker (ITU-T T.81, table B.1).
const END: [u8; 2] = [0xff, 0xd9];
/// Number of bytes at the end of a file that are read first.
const TAIL_BYTES: i64 = 4096;

/// Returns true if a file is a JPEG image without an end marker. For most complete files the last bytes suffice.
pub(super) fn is_truncated(path: &Path) -> io::Result<bool> {
    let mut file = files::open(path)?;
    let mut start = Vec::new();
    file.by_ref().take(2).read_to_end(&mut start)?;
    if start != START {
        return Ok(false);
    }
    if file.seek(SeekFrom::End(-TAIL_BYTES)).is_err() {
        file.rewind()?;
    }
    let mut tail = Vec::new();
    file.by_ref().take(TAIL_BYTES.unsigned_abs()).read_to_end(&mut tail)?;
    let without_padding = tail.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
    if tail[..without_padding].ends_with(&END) {
        return Ok(false);
    }
    file.seek(SeekFrom::Start(START.len() as u64))?;
    Ok(!has_end(BufReader::new(file))?)
}

/// Follows the markers until the end of the image.
///
/// Segments are skipped by their length, since a preview in one of them has an end marker of its own.
///
/// * `jpeg` – data after the start marker.
fn has_end(mut jpeg: impl BufRead + Seek) -> io::Result<bool> {
    while let Some(marker) = next_marker(&mut jpeg)? {
        match marker {
            0xd9 => return Ok(true),
            // Stuffed bytes of image data, restart markers, and other markers without a length.
            0x00 | 0x01 | 0xd0..=0xd8 => {}
            _ => match (byte(&mut jpeg)?, byte(&mut jpeg)?) {
                (Some(high), Some(low)) => {
                    let length = u16::from_be_bytes([high, low]).saturating_sub(2);
                    jpeg.seek_relative(i64::from(length))?;
                }
                _ => return Ok(false),
            },
        }
    }
    Ok(false)
}

/// Byte after the next 0xff, without fill bytes; `None` at the end.
fn next_marker(jpeg: &mut impl BufRead) -> io::Result<Option<u8>> {
    loop {
        let there = jpeg.fill_buf()?;
        let (found, length) = (there.iter().position(|&byte| byte == 0xff), there.len());
        jpeg.consume(found.map_or(length, |at| at + 1));
        match (found, length) {
            (_, 0) => return Ok(None),
            (None, _) => {}
            (Some(_), _) => loop {
                match byte(jpeg)? {
                    Some(0xff) => {}
                    other => return Ok(other),
                }
            },
        }
    }
}

fn byte(from: &mut impl BufRead) -> io::Result<Option<u8>> {
    let byte = from.fill_buf()?.first().copied();
    from.consume(usize::from(byte.is_some()));
    Ok(byte)
}

#[cfg(test)]
mod tests {
    use ::image::codecs::jpeg::JpegEncoder;
    use ::image::{Rgb, RgbImage};

    use std::fs;

    use super::*;

    fn jpeg() -> Vec<u8> {
        let image = RgbImage::from_fn(64, 48, |x, y| Rgb([(x * 37 % 251) as u8, (y * 91 % 241) as u8, (x * y) as u8]));
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(&image).unwrap();
        bytes
    }

    /// Adds a segment that holds a whole image, as cameras do.
    fn with_preview(jpeg: &[u8]) -> Vec<u8> {
        let length = u16::try_from(jpeg.len() + 2).unwrap().to_be_bytes();
        [&START[..], &[0xff, 0xe1], &length, jpeg, &jpeg[2..]].concat()
    }

    #[test]
    fn an_image_without_its_end_is_truncated_wherever_it_was_cut() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        let is_cut = |bytes: &[u8]| {
            fs::write(&path, bytes).unwrap();
            is_truncated(&path).unwrap()
        };
        let plain = jpeg();
        let whole = with_preview(&plain);
        assert!(whole.len() > 2 * TAIL_BYTES as usize);
        for file in [&plain, &whole] {
            assert!(!is_cut(file));
            assert!(!is_cut(&[&file[..], &[0; 5000]].concat()), "padded");
            assert!(!is_cut(&[&file[..], b"\0\0\0\x18ftypmp42 and so on"].concat()), "with a film behind it");
            for tenths in 1..10 {
                let cut = &file[..file.len() * tenths / 10];
                assert!(is_cut(cut), "{tenths} tenths");
                assert!(is_cut(&[cut, &[0; 5000]].concat()), "{tenths} tenths, padded");
            }
            assert!(is_cut(&file[..file.len() - 1]));
            assert!(is_cut(&file[..2]));
        }
        assert!(!is_cut(b"") && !is_cut(b"\xff") && !is_cut(b"no JPEG at all"));
    }
}
