//! Stored detections: one small file per frame, so that a run that was killed need not rerun the network.

use std::marker::PhantomData;
use std::path::PathBuf;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::pipeline::Result;
use crate::pipeline::driver::intermediate::{self, damaged};
use crate::scene::{Frame, FrameId, Mask};

/// A folder with a list of detections per frame.
#[derive(Clone, Debug)]
pub(in crate::pipeline) struct FrameFolder<T> {
    folder: PathBuf,
    item: PhantomData<T>,
}

impl<T: Serialize + DeserializeOwned> FrameFolder<T> {
    pub(in crate::pipeline) fn new(folder: PathBuf) -> Self {
        Self { folder, item: PhantomData }
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

    /// The detections of a frame; none for one that could not be decoded.
    pub(in crate::pipeline) fn read(&self, frame: FrameId) -> Result<Vec<T>> {
        let path = self.path(frame);
        if path.is_file() { intermediate::read(&path) } else { Ok(Vec::new()) }
    }

    /// As [`Self::read`], for detections with masks, whose size is checked.
    pub(in crate::pipeline) fn read_masks(
        &self,
        frame: FrameId,
        size: (u32, u32),
        mask: impl Fn(&T) -> &Mask,
    ) -> Result<Vec<T>> {
        let found = self.read(frame)?;
        match found.iter().all(|detection| mask(detection).size() == size) {
            true => Ok(found),
            false => Err(damaged(&self.path(frame), "a mask differs in size from its frame")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Detection;

    const SIZE: (u32, u32) = (7, 5);

    fn read(store: &FrameFolder<Detection>, frame: FrameId, size: (u32, u32)) -> Result<Vec<Detection>> {
        store.read_masks(frame, size, |found| &found.mask)
    }

    #[test]
    fn detections_survive_a_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let store = FrameFolder::new(folder.path().to_owned());
        let frame = Frame { id: FrameId(3), name: "000003.jpg".into(), time_s: 0.0 };
        let found: Vec<Detection> = [|x, y| x > 2 && y > 1, |_, _| true, |_, _| false]
            .iter()
            .map(|inside: &fn(u32, u32) -> bool| Mask::from_fn(7, 5, inside))
            .map(|mask| Detection { class: "car".into(), confidence: 0.25, mask })
            .collect();
        assert!(!store.has(&frame));
        store.write(&frame, &found).unwrap();
        assert!(store.has(&frame));
        assert_eq!(read(&store, frame.id, SIZE).unwrap(), found);
        assert!(read(&store, FrameId(4), SIZE).unwrap().is_empty());
    }

    #[test]
    fn damaged_files_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let store = FrameFolder::new(folder.path().to_owned());
        let frame = Frame { id: FrameId(3), name: "000003.jpg".into(), time_s: 0.0 };
        let found = Detection { class: "car".into(), confidence: 0.5, mask: Mask::empty(7, 5) };
        store.write(&frame, &[found]).unwrap();
        let bytes = std::fs::read(store.path(frame.id)).unwrap();
        for length in 0..bytes.len() {
            std::fs::write(store.path(frame.id), &bytes[..length]).unwrap();
            assert!(read(&store, frame.id, SIZE).is_err(), "cut at {length}");
        }
        std::fs::write(store.path(frame.id), &bytes).unwrap();
        assert!(read(&store, frame.id, (7, 6)).is_err());
    }
}
