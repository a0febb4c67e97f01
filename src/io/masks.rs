//! Masks and label maps as PNG: one gray value of 8 bits or of 1 bit per pixel of the frame.
//!
//! White of a 1-bit image is label 1. Color, palettes, transparency and other depths are refused rather than guessed:
//! the label of a red pixel is undefined.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageDecoder, ImageEncoder};

use super::{IoError, atomic};
use crate::files;
use crate::scene::{LabelMap, MAX_MASK_PIXELS, Mask};

/// Reads a label map: 0 is background, k is object (or class) k. `frame_size` is the width and height of its frame.
///
/// # Errors
/// A missing or broken file, another size than the frame's, or anything but gray of 8 bits or one.
pub fn read_label_map(path: &Path, frame_size: (u32, u32)) -> Result<LabelMap, IoError> {
    decode(path, Some(frame_size))
}

/// Reads a mask: every value but 0 is set.
///
/// # Errors
/// As [`read_label_map`].
pub fn read_mask(path: &Path, frame_size: (u32, u32)) -> Result<Mask, IoError> {
    Ok(as_mask(decode(path, Some(frame_size))?))
}

/// As [`read_mask`], for an image of any size.
pub fn read_mask_of_any_size(path: &Path) -> Result<Mask, IoError> {
    Ok(as_mask(decode(path, None)?))
}

/// Writes a mask as 8-bit gray, 255 where it is set.
pub fn write_mask(path: &Path, mask: &Mask) -> Result<(), IoError> {
    encode(path, &mask.to_bytes(), mask.width(), mask.height())
}

/// Writes a label map as 8-bit gray.
pub fn write_label_map(path: &Path, map: &LabelMap) -> Result<(), IoError> {
    encode(path, &map.labels, map.width, map.height)
}

/// The mask of an image in a folder: `<stem>.png`, or `<name>.png`; `None` if neither is there.
pub fn find(folder: &Path, image_name: &str) -> Option<PathBuf> {
    let stem = image_name.rsplit_once('.').map_or(image_name, |(stem, _)| stem);
    [format!("{stem}.png"), format!("{image_name}.png")].into_iter().map(|n| folder.join(n)).find(|p| p.is_file())
}

fn as_mask(map: LabelMap) -> Mask {
    Mask::from_values(map.width, map.height, &map.labels, |value| value != 0)
}

fn decode(path: &Path, frame_size: Option<(u32, u32)>) -> Result<LabelMap, IoError> {
    let bytes = files::read(path).map_err(IoError::system("read", path))?;
    let bit_depth = bit_depth(path, &bytes)?;
    let broken = |e: image::ImageError| IoError::content(path, format!("incomplete or damaged PNG image: {e}"));
    let decoder = image::codecs::png::PngDecoder::new(Cursor::new(&bytes)).map_err(broken)?;
    let size @ (width, height) = decoder.dimensions();
    // Checked before decoding: a header can declare any number of pixels.
    if let Some(expected) = frame_size.filter(|expected| *expected != size) {
        return Err(IoError::WrongSize { path: path.into(), expected, found: size });
    }
    if u64::from(width) * u64::from(height) > MAX_MASK_PIXELS {
        return Err(IoError::content(path, format!("{width}×{height} pixels are too many for a mask")));
    }
    let mut labels = vec![0; width as usize * height as usize];
    if decoder.total_bytes() != labels.len() as u64 {
        return Err(IoError::content(path, "expected one gray value per pixel"));
    }
    decoder.read_image(&mut labels).map_err(broken)?;
    if bit_depth == 1 {
        // The decoder stretches one bit to 0 and 255.
        labels.iter_mut().for_each(|value| *value = u8::from(*value != 0));
    }
    Ok(LabelMap { width, height, labels })
}

/// Bits per pixel, 1 or 8, from the PNG header itself: the decoder would scale 2 and 4 bits to eight, and labels with
/// them.
fn bit_depth(path: &Path, bytes: &[u8]) -> Result<u8, IoError> {
    // Signature, then length and name of IHDR, width, height, bit depth, color type (PNG specification, 11.2.1).
    if bytes.len() < 26 || !bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Err(IoError::content(path, "not a PNG image"));
    }
    let (bit_depth, colour_type) = (bytes[24], bytes[25]);
    if colour_type == 0 && matches!(bit_depth, 1 | 8) {
        return Ok(bit_depth);
    }
    let kind = match colour_type {
        0 => "gray",
        2 => "RGB",
        3 => "palette",
        4 => "gray with transparency",
        6 => "RGB with transparency",
        _ => "unknown",
    };
    let what = format!("mask of kind {kind}, {bit_depth} bits,");
    Err(IoError::unsupported(path, what, "save it as 8-bit gray, one label per pixel"))
}

fn encode(path: &Path, grey: &[u8], width: u32, height: u32) -> Result<(), IoError> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(grey, width, height, ExtendedColorType::L8)
        .map_err(|e| IoError::content(path, format!("cannot be encoded: {e}")))?;
    atomic::write(path, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_and_masks_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("000003.png");
        let map = LabelMap { width: 3, height: 2, labels: vec![0, 1, 2, 255, 0, 7] };
        write_label_map(&path, &map).unwrap();
        assert_eq!(read_label_map(&path, (3, 2)).unwrap(), map);
        assert_eq!(read_mask(&path, (3, 2)).unwrap(), map.any());
        write_mask(&path, &map.mask(2)).unwrap();
        assert_eq!(read_label_map(&path, (3, 2)).unwrap().labels, [0, 0, 255, 0, 0, 0]);
        assert_eq!(read_mask_of_any_size(&path).unwrap(), map.mask(2));
        assert_eq!(find(folder.path(), "000003.jpg").unwrap(), path);
        assert_eq!(find(folder.path(), "000004.jpg"), None);
    }

    #[test]
    fn a_mask_of_another_size_names_file_and_sizes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.png");
        write_mask(&path, &Mask::empty(4, 3)).unwrap();
        let error = read_mask(&path, (8, 6)).unwrap_err().to_string();
        assert!(error.contains("m.png") && error.contains("4×3") && error.contains("8×6"), "{error}");
    }

    #[test]
    fn other_kinds_of_images_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.png");
        let save = |kind: ExtendedColorType, bytes: &[u8]| {
            PngEncoder::new(std::fs::File::create(&path).unwrap()).write_image(bytes, 2, 1, kind).unwrap();
            read_label_map(&path, (2, 1)).unwrap_err().to_string()
        };
        assert!(save(ExtendedColorType::Rgb8, &[0; 6]).contains("RGB, 8 bits"));
        assert!(save(ExtendedColorType::L16, &[0; 4]).contains("gray, 16 bits"));
        assert!(save(ExtendedColorType::La8, &[0; 4]).contains("transparency"));
        std::fs::write(&path, b"GIF89a, at any rate not the other thing").unwrap();
        assert!(read_mask(&path, (2, 1)).unwrap_err().to_string().contains("not a PNG"));
        assert!(read_mask(&folder.path().join("none.png"), (2, 1)).unwrap_err().is_not_found());
    }

    /// A 1-bit gray image of 3×2 pixels: white, black, white; black, white, black.
    const ONE_BIT: &[u8] =
        b"\x89PNG\x0d\x0a\x1a\x0a\x00\x00\x00\x0dIHDR\x00\x00\x00\x03\x00\x00\x00\x02\x01\x00\x00\x00\x00\
        \xb5\x0f[\xb7\x00\x00\x00\x0cIDATx\x9ccX\xc0\xe0\x00\x00\x02$\x00\xe1s\xeb;\xf2\x00\x00\x00\x00I\
        END\xaeB`\x82";

    #[test]
    fn white_of_one_bit_is_label_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.png");
        std::fs::write(&path, ONE_BIT).unwrap();
        assert_eq!(read_label_map(&path, (3, 2)).unwrap().labels, [1, 0, 1, 0, 1, 0]);
        assert_eq!(read_mask(&path, (3, 2)).unwrap(), Mask::from_fn(3, 2, |x, y| (x + y) % 2 == 0));
        // With two bits the meaning of the values is undefined.
        let mut two_bits = ONE_BIT.to_vec();
        two_bits[24] = 2;
        std::fs::write(&path, two_bits).unwrap();
        assert!(read_label_map(&path, (3, 2)).unwrap_err().to_string().contains("gray, 2 bits"));
    }

    #[test]
    fn a_truncated_image_never_panics() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.png");
        write_mask(&path, &Mask::from_fn(40, 30, |x, y| (x * y) % 3 == 0)).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() - 20 {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(read_mask(&path, (40, 30)).is_err(), "cut at {length}");
        }
        // A header that declares more than fits in memory.
        let mut huge = whole;
        huge[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
        std::fs::write(&path, huge).unwrap();
        assert!(read_mask_of_any_size(&path).is_err());
    }
}
