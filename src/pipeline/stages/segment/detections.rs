//! Detections on disk: one small file per frame, so that a run that was killed need not run the network again.

use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::files;
use crate::io::{IoError, atomic};
use crate::pipeline::PipelineError;
use crate::pipeline::driver::intermediate::{self, damaged};
use crate::scene::{Detection, Frame, FrameId, Mask};

/// A folder with a list of things per frame.
#[derive(Clone, Debug)]
pub(in crate::pipeline) struct FrameFolder<T> {
    folder: PathBuf,
    things: PhantomData<T>,
}

impl<T: Serialize + DeserializeOwned> FrameFolder<T> {
    pub(in crate::pipeline) fn new(folder: PathBuf) -> Self {
        Self { folder, things: PhantomData }
    }

    /// The file of a frame.
    pub(in crate::pipeline) fn path(&self, frame: FrameId) -> PathBuf {
        self.folder.join(format!("{:06}.bin", frame.0))
    }

    pub(in crate::pipeline) fn has(&self, frame: &Frame) -> bool {
        self.path(frame.id).is_file()
    }

    pub(in crate::pipeline) fn write(&self, frame: &Frame, found: &[T]) -> Result<(), PipelineError> {
        let path = self.path(frame.id);
        let bytes = intermediate::to_bytes(found).map_err(|e| damaged(&path, e))?;
        Ok(atomic::write(&path, &bytes)?)
    }

    /// Number of detections of a frame; zero for one that could not be decoded.
    pub(in crate::pipeline) fn count(&self, frame: FrameId) -> Result<u64, PipelineError> {
        let path = self.path(frame);
        let Some(bytes) = bytes_of(&path)? else { return Ok(0) };
        let found: Vec<T> = intermediate::from_bytes(&bytes).map_err(|e| damaged(&path, e))?;
        Ok(found.len() as u64)
    }

    /// The things of a frame; none for one that could not be decoded.
    pub(in crate::pipeline) fn read(&self, frame: FrameId) -> Result<Vec<T>, PipelineError> {
        let path = self.path(frame);
        let Some(bytes) = bytes_of(&path)? else { return Ok(Vec::new()) };
        intermediate::from_bytes(&bytes).map_err(|e| damaged(&path, e))
    }
}

/// A detection with its mask as run lengths, clear pixels first.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Stored {
    class: String,
    confidence: f64,
    runs: Vec<u32>,
}

/// The detections of a run, by frame.
#[derive(Clone, Debug)]
pub(in crate::pipeline) struct DetectionFolder {
    files: FrameFolder<Stored>,
    size: (u32, u32),
}

impl DetectionFolder {
    pub(in crate::pipeline) fn new(folder: PathBuf, size: (u32, u32)) -> Self {
        Self { files: FrameFolder::new(folder), size }
    }

    pub(in crate::pipeline) fn has(&self, frame: &Frame) -> bool {
        self.files.has(frame)
    }

    pub(in crate::pipeline) fn write(&self, frame: &Frame, detections: &[Detection]) -> Result<(), PipelineError> {
        let stored =
            |d: &Detection| Stored { class: d.class.clone(), confidence: d.confidence, runs: runs_of_mask(&d.mask) };
        self.files.write(frame, &detections.iter().map(stored).collect::<Vec<_>>())
    }

    /// As [`FrameFolder::count`].
    pub(in crate::pipeline) fn count(&self, frame: FrameId) -> Result<u64, PipelineError> {
        self.files.count(frame)
    }

    /// The detections of a frame; none for one that could not be decoded.
    pub(in crate::pipeline) fn read(&self, frame: FrameId) -> Result<Vec<Detection>, PipelineError> {
        let detection = |s: Stored| {
            let wrong = || damaged(&self.files.path(frame), "a mask differs in size from its frame");
            let mask = mask_of_runs(&s.runs, self.size).ok_or_else(wrong)?;
            Ok(Detection { class: s.class, confidence: s.confidence, mask })
        };
        self.files.read(frame)?.into_iter().map(detection).collect()
    }
}

/// The content of a file; `None` where there is none.
fn bytes_of(path: &Path) -> Result<Option<Vec<u8>>, PipelineError> {
    match files::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(IoError::system("read", path)(error).into()),
    }
}

/// A mask as run lengths, clear pixels first.
pub(in crate::pipeline) fn runs_of_mask(mask: &Mask) -> Vec<u32> {
    let (mut runs, mut end) = (Vec::new(), 0);
    for at in mask.iter().map(|(x, y)| y * mask.width() + x) {
        match runs.last_mut() {
            Some(run) if at == end => *run += 1,
            _ => runs.extend([at - end, 1]),
        }
        end = at + 1;
    }
    let total = mask.width() * mask.height();
    if end < total || runs.is_empty() {
        runs.push(total - end);
    }
    runs
}

/// The mask of run lengths, if it has the size.
pub(in crate::pipeline) fn mask_of_runs(runs: &[u32], (width, height): (u32, u32)) -> Option<Mask> {
    let total: u64 = runs.iter().map(|&run| u64::from(run)).sum();
    if total != u64::from(width) * u64::from(height) {
        return None;
    }
    let mut mask = Mask::empty(width, height);
    let mut at = 0;
    for (k, &run) in runs.iter().enumerate() {
        let end = at + run;
        while k % 2 == 1 && at < end {
            let (x, y) = (at % width, at / width);
            let part = (end - at).min(width - x);
            mask.fill(x..x + part, y, true);
            at += part;
        }
        at = end;
    }
    Some(mask)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn detections_come_back() {
        let folder = tempfile::tempdir().unwrap();
        let store = DetectionFolder::new(folder.path().to_owned(), (7, 5));
        let frame = Frame { id: FrameId(3), name: "000003.jpg".into(), time_s: 0.0 };
        let found: Vec<Detection> = [|x, y| x > 2 && y > 1, |_, _| true, |_, _| false]
            .iter()
            .map(|inside: &fn(u32, u32) -> bool| Mask::from_fn(7, 5, inside))
            .map(|mask| Detection { class: "car".into(), confidence: 0.25, mask })
            .collect();
        assert!(!store.has(&frame));
        store.write(&frame, &found).unwrap();
        assert!(store.has(&frame));
        assert_eq!(store.read(frame.id).unwrap(), found);
        assert_eq!((store.count(frame.id).unwrap(), store.count(FrameId(4)).unwrap()), (3, 0));
        assert!(store.read(FrameId(4)).unwrap().is_empty());
    }

    #[test]
    fn damaged_files_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let store = DetectionFolder::new(folder.path().to_owned(), (7, 5));
        let frame = Frame { id: FrameId(3), name: "000003.jpg".into(), time_s: 0.0 };
        store.write(&frame, &[Detection { class: "car".into(), confidence: 0.5, mask: Mask::empty(7, 5) }]).unwrap();
        let bytes = std::fs::read(store.files.path(frame.id)).unwrap();
        for length in 0..bytes.len() {
            std::fs::write(store.files.path(frame.id), &bytes[..length]).unwrap();
            assert!(store.read(frame.id).is_err(), "cut at {length}");
        }
        std::fs::write(store.files.path(frame.id), &bytes).unwrap();
        let other = DetectionFolder::new(folder.path().to_owned(), (7, 6));
        assert!(other.read(frame.id).is_err());
    }
}
