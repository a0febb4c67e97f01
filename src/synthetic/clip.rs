//! Video files of pictures that a test makes, without an encoder: motion JPEG in an AVI container (RIFF).

use std::io;
use std::path::Path;

use ::image::codecs::jpeg::JpegEncoder;
use ::image::{ImageError, RgbImage};

/// The mark of motion JPEG.
const CODING: &[u8; 4] = b"MJPG";

/// Writes pictures of one size as a video.
///
/// * `rate` – pictures per second.
///
/// # Errors
/// Those of writing the file; [`io::ErrorKind::InvalidInput`] where there is no picture or one cannot be a JPEG.
pub fn write_clip(path: &Path, rate: u32, pictures: &[RgbImage]) -> io::Result<()> {
    let first = pictures.first().ok_or(io::ErrorKind::InvalidInput)?;
    let coded: Vec<Vec<u8>> = pictures.iter().map(jpeg).collect::<Result<_, _>>().map_err(io::Error::other)?;
    let frames: Vec<u8> = coded.iter().flat_map(|data| chunk(b"00dc", data)).collect();
    let head = head(first.dimensions(), rate, pictures.len() as u32);
    let content = [head, list(b"movi", &frames), chunk(b"idx1", &index(&coded))].concat();
    std::fs::write(path, chunk(b"RIFF", &[b"AVI ", &content[..]].concat()))
}

fn jpeg(picture: &RgbImage) -> Result<Vec<u8>, ImageError> {
    let mut data = Vec::new();
    JpegEncoder::new_with_quality(&mut data, 95).encode_image(picture)?;
    Ok(data)
}

/// A chunk begins with its name and size and ends at an even byte.
fn chunk(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let padding = &[0][..content.len() % 2];
    [&name[..], &(content.len() as u32).to_le_bytes(), content, padding].concat()
}

fn list(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    chunk(b"LIST", &[&kind[..], content].concat())
}

fn numbers(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn head((width, height): (u32, u32), rate: u32, count: u32) -> Vec<u8> {
    // The flag says that the file has an index.
    let file = numbers(&[1_000_000 / rate, 0, 0, 0x10, count, 0, 1, 0, width, height, 0, 0, 0, 0]);
    let stream = [&b"vids"[..], CODING, &numbers(&[0, 0, 0, 1, rate, 0, count, 0, u32::MAX, 0, 0, 0])].concat();
    // Size of itself, width, height, one plane of 24 bits, coding, size of a picture.
    let planes = 24 << 16 | 1;
    let format = [numbers(&[40, width, height, planes]), CODING.to_vec(), numbers(&[width * height * 3, 0, 0, 0, 0])];
    let stream = list(b"strl", &[chunk(b"strh", &stream), chunk(b"strf", &format.concat())].concat());
    list(b"hdrl", &[chunk(b"avih", &file), stream].concat())
}

/// Where every picture lies, from the name of the list on.
fn index(coded: &[Vec<u8>]) -> Vec<u8> {
    let mut at = 4;
    let entry = |data: &Vec<u8>| {
        let size = data.len() as u32;
        // Every picture is a keyframe.
        let entry = [b"00dc".to_vec(), numbers(&[0x10, at, size])].concat();
        at += 8 + size + size % 2;
        entry
    };
    coded.iter().flat_map(entry).collect()
}
