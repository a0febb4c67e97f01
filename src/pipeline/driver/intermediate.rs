//! Intermediate files of a run: values in postcard's format, followed by the SHA-256 of these bytes.
//!
//! The checksum detects all damage. Values that name files or determine memory sizes are also validated where they are
//! used, since a folder may come from an untrusted source.

use std::io::{BufReader, ErrorKind, Read, Write};
use std::path::{Component, Path};

use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use crate::files;
use crate::io::{IoError, atomic};
use crate::pipeline::{PipelineError, Result};
use crate::scene::Frame;

/// Reads an intermediate file as a stream: reading it whole would take the memory of its content twice.
///
/// # Errors
/// [`PipelineError::State`] for a damaged or missing file, [`IoError::System`] for an unreadable one.
pub(in crate::pipeline) fn read<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let file = match files::open_within_memory(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Err(damaged(path, "missing")),
        opened => opened.map_err(IoError::system("read", path))?,
    };
    let mut reader = Checked::new(BufReader::new(file));
    let content = value_of(&mut reader);
    if let Some(error) = reader.error {
        return Err(IoError::system("read", path)(error).into());
    }
    content.map_err(|reason| damaged(path, reason))
}

/// Writes an intermediate file as a stream.
///
/// # Errors
/// [`PipelineError::Io`] if the file cannot be written.
pub(in crate::pipeline) fn write(path: &Path, value: &impl Serialize) -> Result<()> {
    let written = atomic::write_with(path, |out| {
        let mut writer = Checked::new(out);
        let done = postcard::to_io(value, &mut writer);
        let failed = done.err().map(std::io::Error::other);
        writer.error.or(failed).map_or(Ok(()), Err)?;
        writer.inner.write_all(&writer.hash.finalize())
    });
    Ok(written?)
}

/// Error of a damaged intermediate file.
pub(in crate::pipeline) fn damaged(path: &Path, reason: impl ToString) -> PipelineError {
    PipelineError::State { path: path.to_owned(), reason: reason.to_string() }
}

/// Checks that frame names are valid file names inside the output folder and that all times are finite.
///
/// # Errors
/// A description of the first invalid frame.
pub(in crate::pipeline) fn checked_frames(frames: Vec<Frame>) -> Result<Vec<Frame>, String> {
    frames.iter().find_map(flaw_of_frame).map_or(Ok(frames), Err)
}

fn flaw_of_frame(frame: &Frame) -> Option<String> {
    let leads_down = |part| matches!(part, Component::Normal(_));
    let is_name = !frame.name.is_empty() && Path::new(&frame.name).components().all(leads_down);
    if !is_name || frame.name.contains(['\0', '\n', '\r']) {
        return Some(format!("{:?} is not a frame name", frame.name));
    }
    (!frame.time_s.is_finite()).then(|| format!("{}: time is not a number", frame.name))
}

fn value_of<T: DeserializeOwned>(reader: &mut Checked<impl Read>) -> Result<T, String> {
    // Buffer for the longest text, bytes: names of frames and classes are far shorter.
    let mut text = vec![0; 1 << 20];
    let (value, _) = postcard::from_io((&mut *reader, &mut text)).map_err(|error| error.to_string())?;
    let found = reader.hash.clone().finalize();
    let mut checksum = Vec::new();
    let rest = reader.inner.by_ref().take(found.len() as u64 + 1).read_to_end(&mut checksum);
    match rest {
        Ok(_) if checksum == found.as_slice() => Ok(value),
        Ok(_) => Err("checksum mismatch".to_owned()),
        Err(error) => Err(error.to_string()),
    }
}

/// File with a running hash of its bytes. Keeps the system's error, which [`postcard`] discards.
struct Checked<T> {
    inner: T,
    hash: Sha256,
    error: Option<std::io::Error>,
}

impl<T> Checked<T> {
    fn new(inner: T) -> Self {
        Self { inner, hash: Sha256::new(), error: None }
    }

    /// Keeps an error unless it is the end of the file.
    fn keep<R>(&mut self, result: std::io::Result<R>) -> std::io::Result<R> {
        result.map_err(|error| {
            let kind = error.kind();
            if kind != ErrorKind::UnexpectedEof {
                self.error = Some(error);
            }
            kind.into()
        })
    }
}

impl<T: Write> Write for Checked<T> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.inner.write(bytes);
        let count = self.keep(written)?;
        self.hash.update(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.inner.flush()
    }
}

impl<T: Read> Read for Checked<T> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let read = self.inner.read(bytes);
        let count = self.keep(read)?;
        self.hash.update(&bytes[..count]);
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use proptest::prelude::*;
    use rand::Rng as _;

    use super::*;
    use crate::math::{Rng, seeded_rng};
    use crate::scene::FrameId;

    fn frames() -> Vec<Frame> {
        let frame = |k| Frame { id: FrameId(k), name: format!("{k:06}.jpg"), time_s: f64::from(k) };
        (0..6).map(frame).collect()
    }

    /// Returns a copy with one to four changed, missing or additional bytes.
    fn damage(whole: &[u8], rng: &mut Rng) -> Vec<u8> {
        let mut bytes = whole.to_vec();
        for _ in 0..rng.random_range(1..=4) {
            let at = rng.random_range(0..bytes.len().max(1)).min(bytes.len().saturating_sub(1));
            match rng.random_range(0..5) {
                0 => bytes.truncate(at),
                1 => bytes.insert(at, rng.random()),
                2 if !bytes.is_empty() => bytes[at] ^= 1 << rng.random_range(0..8),
                3 if !bytes.is_empty() => bytes[at] = [0, 1, 127, 255][rng.random_range(0..4)],
                _ => bytes.extend_from_within(at..),
            }
        }
        bytes
    }

    #[test]
    fn values_survive_a_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.bin");
        write(&path, &frames()).unwrap();
        assert_eq!(read::<Vec<Frame>>(&path).unwrap(), frames());
    }

    /// Content of a file with the frames.
    static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.bin");
        write(&path, &frames()).unwrap();
        std::fs::read(&path).unwrap()
    });

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        #[test]
        fn damaged_files_are_refused(seed in any::<u64>()) {
            let bytes = damage(&WHOLE, &mut seeded_rng(seed, 0));
            prop_assume!(bytes != *WHOLE);
            let mut reader = Checked::new(bytes.as_slice());
            prop_assert!(value_of::<Vec<Frame>>(&mut reader).is_err());
        }
    }

    #[test]
    fn frame_names_stay_inside_the_folder() {
        let frame = |name: &str, time_s| Frame { id: FrameId(0), name: name.into(), time_s };
        let is_good = |frame| checked_frames(vec![frame]).is_ok();
        assert!(["000000.jpg", "left/1.png"].iter().all(|name| is_good(frame(name, 0.0))));
        assert!(
            !["", "../1.png", "/etc/1.png", "a/../../1.png", "a\n.png"].iter().any(|name| is_good(frame(name, 0.0)))
        );
        assert!(!is_good(frame("a", f64::NAN)));
    }
}
