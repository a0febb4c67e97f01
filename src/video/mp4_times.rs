//! Presentation times from the index of an MP4 or MOV file.
//!
//! OpenCV gives no time for the frames that a decoder still holds when the file ends: as many as it reorders and as it
//! has threads. The index of the file has them all (ISO/IEC 14496-12: `stts` decoding times, `ctts` offsets to
//! presentation, `elst` the shift of the whole track). Whatever is unusual gives `None`, and the caller does without.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// An index larger than this belongs to no video that fits this program.
const MAX_INDEX_BYTES: u64 = 256 << 20;
/// Nor do more frames than these: ten days at 60 per second.
const MAX_FRAMES: u64 = 50_000_000;

/// Times of all frames of the first video track, ascending, seconds.
pub(super) fn read(path: &Path) -> Option<Vec<f64>> {
    let index = movie_box(&mut File::open(path).ok()?)?;
    let movie_scale = f64::from(scale(child(&index, b"mvhd")?)?);
    let track = children(&index).find(|(name, track)| *name == b"trak" && is_video(track))?.1;
    let media = child(track, b"mdia")?;
    let table = child(child(media, b"minf")?, b"stbl")?;
    let media_scale = f64::from(scale(child(media, b"mdhd")?)?);
    let (delay, skip) = edit(track)?;
    let shift = delay as f64 / movie_scale - skip as f64 / media_scale;

    let mut ticks = decoding_times(child(table, b"stts")?)?;
    if let Some(offsets) = child(table, b"ctts") {
        add_offsets(&mut ticks, offsets)?;
    }
    ticks.sort_unstable();
    Some(ticks.into_iter().map(|tick| tick as f64 / media_scale + shift).filter(|time| *time > -1e-6).collect())
}

/// The content of the top-level `moov` box.
pub(super) fn movie_box(file: &mut File) -> Option<Vec<u8>> {
    let end = file.seek(SeekFrom::End(0)).ok()?;
    let mut at = 0;
    while at + 8 <= end {
        file.seek(SeekFrom::Start(at)).ok()?;
        let mut header = [0; 16];
        file.read_exact(&mut header[..8]).ok()?;
        let (mut size, mut header_size) = (u64::from(u32_at(&header, 0)?), 8);
        if size == 1 {
            file.read_exact(&mut header[8..]).ok()?;
            (size, header_size) = (u64::from(u32_at(&header, 8)?) << 32 | u64::from(u32_at(&header, 12)?), 16);
        } else if size == 0 {
            size = end - at;
        }
        let content = size.checked_sub(header_size)?;
        if &header[4..8] == b"moov" {
            let mut index = Vec::new();
            let whole =
                content <= MAX_INDEX_BYTES && file.take(content).read_to_end(&mut index).ok()? as u64 == content;
            return whole.then_some(index);
        }
        at = at.checked_add(size)?;
    }
    None
}

/// The boxes inside a box, by name.
pub(super) fn children(content: &[u8]) -> impl Iterator<Item = (&[u8; 4], &[u8])> {
    let mut rest = content;
    std::iter::from_fn(move || {
        let size = u32_at(rest, 0)? as usize;
        let name = rest.get(4..8)?.try_into().ok()?;
        let content = rest.get(8..size)?;
        rest = &rest[size..];
        Some((name, content))
    })
}

fn child<'a>(content: &'a [u8], wanted: &[u8; 4]) -> Option<&'a [u8]> {
    children(content).find(|(name, _)| *name == wanted).map(|(_, content)| content)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

fn i64_at(bytes: &[u8], at: usize) -> Option<i64> {
    Some(i64::from(u32_at(bytes, at)?) << 32 | i64::from(u32_at(bytes, at + 4)?))
}

/// Ticks per second of a `mvhd` or `mdhd` box.
fn scale(header: &[u8]) -> Option<u32> {
    let at = if *header.first()? == 1 { 20 } else { 12 };
    u32_at(header, at).filter(|scale| *scale > 0)
}

pub(super) fn is_video(track: &[u8]) -> bool {
    let handler = child(track, b"mdia").and_then(|media| child(media, b"hdlr"));
    handler.and_then(|handler| handler.get(8..12)) == Some(b"vide")
}

/// What the edit list says: an initial delay in the movie's ticks, and where in the media the track begins, in the
/// media's. `None` for lists that do more than that.
fn edit(track: &[u8]) -> Option<(i64, i64)> {
    let Some(list) = child(track, b"edts").and_then(|edits| child(edits, b"elst")) else { return Some((0, 0)) };
    let wide = *list.first()? == 1;
    let entry = |k: usize| -> Option<(i64, i64)> {
        let at = 8 + k * if wide { 20 } else { 12 };
        match wide {
            true => Some((i64_at(list, at)?, i64_at(list, at + 8)?)),
            false => Some((u32_at(list, at)?.into(), (u32_at(list, at + 4)? as i32).into())),
        }
    };
    let (first, second) = (entry(0)?, if u32_at(list, 4)? > 1 { Some(entry(1)?) } else { None });
    match (u32_at(list, 4)?, first, second) {
        (1, (_, skip), None) if skip >= 0 => Some((0, skip)),
        (2, (delay, -1), Some((_, skip))) if skip >= 0 => Some((delay, skip)),
        _ => None,
    }
}

/// Runs of (count, value) as one value per frame.
fn runs(table: &[u8]) -> Option<impl Iterator<Item = (u32, u32)>> {
    let count = u32_at(table, 4)? as usize;
    let entries = table.get(8..8usize.checked_add(count.checked_mul(8)?)?)?;
    Some(entries.chunks_exact(8).filter_map(|entry| Some((u32_at(entry, 0)?, u32_at(entry, 4)?))))
}

fn decoding_times(stts: &[u8]) -> Option<Vec<i64>> {
    let total: u64 = runs(stts)?.map(|(count, _)| u64::from(count)).sum();
    if total > MAX_FRAMES {
        return None;
    }
    let mut ticks = Vec::with_capacity(total as usize);
    let mut now = 0i64;
    for (count, step) in runs(stts)? {
        for _ in 0..count {
            ticks.push(now);
            now += i64::from(step);
        }
    }
    Some(ticks)
}

fn add_offsets(ticks: &mut [i64], ctts: &[u8]) -> Option<()> {
    // Version 0 is unsigned by the standard and signed in practice; no real offset tells the difference.
    let offsets = runs(ctts)?.flat_map(|(count, offset)| std::iter::repeat_n(offset as i32, count as usize));
    for (tick, offset) in ticks.iter_mut().zip(offsets) {
        *tick += i64::from(offset);
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxed(name: &[u8; 4], content: &[&[u8]]) -> Vec<u8> {
        let content = content.concat();
        [&((content.len() + 8) as u32).to_be_bytes()[..], name, &content].concat()
    }

    fn numbers(numbers: &[i64]) -> Vec<u8> {
        numbers.iter().flat_map(|&n| (n as u32).to_be_bytes()).collect()
    }

    /// Five frames at 100 ticks a second, decoded at 0, 10, 20, 60, 70 and shown at 20, 50, 30, 80, 90, less 20.
    fn movie() -> Vec<u8> {
        let header = |scale| numbers(&[0, 0, 0, scale, 0]);
        let handler = boxed(b"hdlr", &[&numbers(&[0, 0]), b"vide"]);
        let stts = boxed(b"stts", &[&numbers(&[0, 3, 2, 10, 1, 40, 2, 10])]);
        let ctts = boxed(b"ctts", &[&numbers(&[0, 4, 1, 20, 1, 40, 1, 10, 2, 20])]);
        let table = boxed(b"minf", &[&boxed(b"stbl", &[&stts, &ctts])]);
        let media = boxed(b"mdia", &[&boxed(b"mdhd", &[&header(100)]), &handler, &table]);
        let edits = boxed(b"edts", &[&boxed(b"elst", &[&numbers(&[0, 1, 500, 20, 0])])]);
        let movie = boxed(b"moov", &[&boxed(b"mvhd", &[&header(1000)]), &boxed(b"trak", &[&edits, &media])]);
        [boxed(b"ftyp", &[b"isom"]), movie].concat()
    }

    fn times_of(bytes: &[u8]) -> Option<Vec<f64>> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read(file.path())
    }

    #[test]
    fn frames_are_shown_when_the_index_says() {
        let times = times_of(&movie()).unwrap();
        let expected = [0.0, 0.1, 0.3, 0.6, 0.7];
        assert_eq!(times.len(), 5);
        for (time, expected) in times.iter().zip(expected) {
            assert!((time - expected).abs() < 1e-9, "{times:?}");
        }
    }

    #[test]
    fn broken_files_have_no_times_and_do_no_harm() {
        let movie = movie();
        for length in 0..movie.len() {
            assert_eq!(times_of(&movie[..length]), None, "cut at {length}");
        }
        for at in 0..movie.len() {
            let mut broken = movie.clone();
            broken[at] ^= 0xff;
            let _ = times_of(&broken);
        }
    }
}
