//! `run -`: a video from standard input. It is recorded first, byte for byte, and the run reads the recording.

use std::fs::{self, File};
use std::io::{self, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};

use super::output::Failure;
use crate::io::{OwnedFolder, RunFolder};

/// Name of standard input on the command line.
pub(super) const STDIN: &str = "-";
/// Name of the recording without its extension; that of its telemetry, too, so that a run finds it.
pub(super) const STEM: &str = "recording";
/// Extensions that [`extension`] gives; other files of that stem are not the program's.
const EXTENSIONS: [&str; 9] = ["mkv", "mp4", "y4m", "avi", "flv", "ts", "h264", "h265", "video"];
/// Bytes by which the container is recognized: two packets of an MPEG transport stream and more.
const HEAD_BYTES: usize = 1024;

/// Records standard input to its end in the output folder; gives the file. A program that is stopped leaves what it
/// received.
///
/// # Errors
/// A terminal, no data, an earlier recording that `overwrite` does not replace, a folder of others, a full disk.
pub(super) fn record(output: &Path, overwrite: bool) -> Result<PathBuf, Failure> {
    let input = io::stdin().lock();
    if input.is_terminal() {
        return Err(Failure::Usage("-: standard input is a terminal; pipe a video into it".to_owned()));
    }
    // The folder becomes a run's own, and is free again for the run.
    drop(own(output)?);
    let earlier = replaceable(output, overwrite)?;
    Ok(write(input, output, &earlier)?)
}

/// Makes an output folder a run's own.
pub(super) fn own(output: &Path) -> anyhow::Result<OwnedFolder> {
    Ok(OwnedFolder::open(output, RunFolder::MADE_BY, RunFolder::place)?)
}

/// Earlier recordings, which a new one replaces.
///
/// # Errors
/// There are some, and `overwrite` is false.
pub(super) fn replaceable(output: &Path, overwrite: bool) -> Result<Vec<PathBuf>, Failure> {
    let earlier = recordings(output, &EXTENSIONS);
    if let Some(found) = earlier.first().filter(|_| !overwrite) {
        let (path, output) = (found.display(), output.display());
        return Err(Failure::Usage(format!(
            "{path}: recording exists; run it with `tractrix run {path} --output {output}`, or give --overwrite"
        )));
    }
    Ok(earlier)
}

/// Recordings in a folder, with one of these extensions.
pub(super) fn recordings(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    extensions.iter().map(|end| folder.join(STEM).with_extension(end)).filter(|path| path.is_file()).collect()
}

/// Removes recordings.
pub(super) fn remove(paths: &[PathBuf]) -> anyhow::Result<()> {
    let remove =
        |path: &PathBuf| fs::remove_file(path).with_context(|| format!("{}: cannot be removed", path.display()));
    paths.iter().try_for_each(remove)
}

/// Writes the recording; earlier ones go when there is something to write.
fn write(mut input: impl Read, folder: &Path, earlier: &[PathBuf]) -> anyhow::Result<PathBuf> {
    let (path, mut file) = begin(&mut input, Path::new(STDIN), folder, earlier)?;
    let copied = io::copy(&mut input, &mut file).and_then(|_| file.sync_all());
    copied.with_context(|| format!("{}: recording failed; what was received before is there", path.display()))?;
    Ok(path)
}

/// Begins a recording with the first bytes of `source`, by which it is named; earlier ones go.
///
/// # Errors
/// No data, or a file that cannot be written.
pub(super) fn begin(
    mut input: impl Read,
    source: &Path,
    folder: &Path,
    earlier: &[PathBuf],
) -> anyhow::Result<(PathBuf, File)> {
    let shown = if source == Path::new(STDIN) { "-: standard input".to_owned() } else { source.display().to_string() };
    let mut head = Vec::new();
    let read = |error| anyhow!("{shown} cannot be read: {error}");
    input.by_ref().take(HEAD_BYTES as u64).read_to_end(&mut head).map_err(read)?;
    if head.is_empty() {
        return Err(anyhow!("{shown} is empty; check the program that writes to it"));
    }
    remove(earlier)?;
    let path = folder.join(STEM).with_extension(extension(&head));
    let begun = File::create_new(&path).and_then(|mut file| file.write_all(&head).map(|()| file));
    let file = begun.with_context(|| format!("{}: recording failed", path.display()))?;
    Ok((path, file))
}

/// Extension of a container or elementary stream, by its first bytes.
fn extension(head: &[u8]) -> &'static str {
    // Length of a packet of an MPEG transport stream, bytes; each begins with the sync byte `G` (ISO/IEC 13818-1).
    const TS_PACKET: usize = 188;
    let is_sync = |at: usize| head.get(at) == Some(&b'G');
    match head {
        [0x1a, 0x45, 0xdf, 0xa3, ..] => "mkv",
        [_, _, _, _, b'f', b't', b'y', b'p', ..] => "mp4",
        [b'Y', b'U', b'V', b'4', ..] => "y4m",
        [b'R', b'I', b'F', b'F', ..] => "avi",
        [b'F', b'L', b'V', ..] => "flv",
        [0, 0, 1, unit, ..] | [0, 0, 0, 1, unit, ..] => elementary(*unit),
        _ if is_sync(0) && is_sync(TS_PACKET) => "ts",
        _ => "video",
    }
}

/// Kind of an elementary stream, by the header of its first unit. H.265 begins with its parameter sets or a delimiter,
/// types 32 to 35; in H.264 these headers would be of coded slices, with which no stream begins (ITU-T H.264 and H.265,
/// table 7-1).
fn elementary(unit: u8) -> &'static str {
    if (32..=35).contains(&(unit >> 1 & 0x3f)) { "h265" } else { "h264" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_are_byte_for_byte_and_named_by_their_content() {
        let mut ts = vec![0; 400];
        (ts[0], ts[188]) = (b'G', b'G');
        let of = |head: &[u8]| {
            let folder = tempfile::tempdir().unwrap();
            let data = [head, &[7; 3000][..]].concat();
            let path = write(&data[..], folder.path(), &[]).unwrap();
            assert_eq!(fs::read(&path).unwrap(), data);
            assert_eq!(recordings(folder.path(), &EXTENSIONS), std::slice::from_ref(&path));
            path.extension().unwrap().to_string_lossy().into_owned()
        };
        assert_eq!(of(&ts), "ts");
        assert_eq!(of(b"\x1a\x45\xdf\xa3"), "mkv");
        assert_eq!(of(b"\0\0\0\x18ftypisom"), "mp4");
        assert_eq!(of(b"YUV4MPEG2 W64 H48"), "y4m");
        assert_eq!((of(&[0, 0, 0, 1, 0x67]), of(&[0, 0, 0, 1, 0x40, 1])), ("h264".into(), "h265".into()));
        assert_eq!(of(b"?"), "video");
    }

    #[test]
    fn nothing_is_no_video() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("recording.csv"), "of the user").unwrap();
        let earlier = write(&b"FLV"[..], folder.path(), &[]).unwrap();
        let error = write(&b""[..], folder.path(), std::slice::from_ref(&earlier)).unwrap_err();
        assert!(error.to_string().contains("standard input is empty"));
        assert_eq!(recordings(folder.path(), &EXTENSIONS), [earlier], "nothing was lost");
    }
}
