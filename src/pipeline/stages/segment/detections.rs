//! Detections on disk: one small file per frame, so that a run that was killed need not run the network again.

use std::marker::PhantomData;
use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::pipeline::Result;
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

    pub(in crate::pipeline) fn write(&self, frame: &Frame, found: &[T]) -> Result<()> {
        intermediate::write(&self.path(frame.id), &found)
    }

    /// The things of a frame; none for one that could not be decoded.
    pub(in crate::pipeline) fn read(&self, frame: FrameId) -> Result<Vec<T>> {
        let path = self.path(frame);
        if path.is_file() { intermediate::read(&path) } else { Ok(Vec::new()) }
    }
}

/// A detection with its mask as run lengths, clear pixels first.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Stored {
    class: String,
    confidence: f64,
    runs: Vec<u32>,
}

impl From<Detection> for Stored {
    fn from(Detection { class, confidence, mask }: Detection) -> Self {
        Self { class, confidence, runs: runs_of_mask(&mask) }
    }
}

/// The detections of a run, by frame.
#[derive(Clone, Debug)]
pub(in crate::pipeline) struct DetectionFolder {
    pub(super) files: FrameFolder<Stored>,
    size: (u32, u32),
}

impl DetectionFolder {
    pub(in crate::pipeline) fn new(folder: PathBuf, size: (u32, u32)) -> Self {
        Self { files: FrameFolder::new(folder), size }
    }

    /// The detections of a frame; none for one that could not be decoded.
    pub(in crate::pipeline) fn read(&self, frame: FrameId) -> Result<Vec<Detection>> {
        let detection = |s: Stored| {
            let wrong = || damaged(&self.files.path(frame), "a mask differs in size from its frame");
            let mask = mask_of_runs(&s.runs, self.size).ok_or_else(wrong)?;
            Ok(Detection { class: s.class, confidence: s.confidence, mask })
        };
        self.files.read(frame)?.into_iter().map(detection).collect()
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
        assert!(!store.files.has(&frame));
        store.files.write(&frame, &found.iter().cloned().map(Stored::from).collect::<Vec<_>>()).unwrap();
        assert!(store.files.has(&frame));
        assert_eq!(store.read(frame.id).unwrap(), found);
        assert!(store.read(FrameId(4)).unwrap().is_empty());
    }

    #[test]
    fn damaged_files_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let store = DetectionFolder::new(folder.path().to_owned(), (7, 5));
        let frame = Frame { id: FrameId(3), name: "000003.jpg".into(), time_s: 0.0 };
        let found = Detection { class: "car".into(), confidence: 0.5, mask: Mask::empty(7, 5) };
        store.files.write(&frame, &[found.into()]).unwrap();
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
