//! Given masks: one PNG per frame in a folder.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::files;
use crate::io::{IoError, masks};
use crate::pipeline::{PipelineError, Result};
use crate::scene::{Frame, FrameId, LabelMap, Topic, Warning};
use crate::video::Info;

/// Assignment of the files of a folder to frames.
#[derive(Debug)]
pub(in crate::pipeline) struct MaskFolder {
    files: BTreeMap<FrameId, PathBuf>,
    /// Frames without a mask.
    pub(in crate::pipeline) missing: Vec<FrameId>,
    size: (u32, u32),
    source_size: (u32, u32),
    /// Size of the stored frames if their pixels are not square.
    stored_size: (u32, u32),
}

impl MaskFolder {
    /// Assigns the PNG files of a folder to frames by the frame's stem (`000042.png`, or the whole name,
    /// `000042.jpg.png`). If that matches no frame at all, files with a number as name (`42.png`, `00042.png`) are
    /// assigned by the frame's index in the source.
    ///
    /// # Errors
    /// [`PipelineError::Unreadable`] if the folder cannot be listed, [`PipelineError::NoMasks`] if no file matches.
    pub(in crate::pipeline) fn open(folder: &Path, frames: &[Frame], info: &Info) -> Result<Self> {
        let unreadable = |source| PipelineError::Unreadable { path: folder.to_owned(), source };
        let mut by_stem = BTreeMap::new();
        for entry in fs::read_dir(folder).map_err(unreadable)? {
            let path = entry.map_err(unreadable)?.path();
            let is_png = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
            if let (true, Some(stem)) = (is_png, path.file_stem().and_then(|s| s.to_str())) {
                by_stem.insert(stem.to_owned(), path.clone());
            }
        }
        let named = |frame: &Frame| by_stem.get(frame.stem()).or_else(|| by_stem.get(&frame.name));
        let mut files = assign(frames, named);
        if files.is_empty() {
            let by_index: BTreeMap<u32, &PathBuf> =
                by_stem.iter().filter_map(|(stem, path)| Some((stem.parse().ok()?, path))).collect();
            files = assign(frames, |frame| by_index.get(&frame.id.0).copied());
        }
        if files.is_empty() {
            let example = frames.first().map_or_else(String::new, |frame| frame.stem().to_owned());
            return Err(PipelineError::NoMasks { path: folder.to_owned(), example });
        }
        let missing = frames.iter().map(|f| f.id).filter(|id| !files.contains_key(id)).collect();
        Ok(Self {
            files,
            missing,
            size: (info.width, info.height),
            source_size: (info.source_width, info.source_height),
            stored_size: (info.stored_width, info.stored_height),
        })
    }

    /// The labels of a frame at the frame's size; `None` if it has no mask. A mask at the source's size before
    /// `--max-dimension`, or at the storage size of a file with non-square pixels, is resized like the frame.
    ///
    /// # Errors
    /// [`PipelineError::MaskSize`] for any other size, [`PipelineError::Io`] for a file that is not a gray PNG.
    pub(in crate::pipeline) fn labels(&self, frame: FrameId) -> Result<Option<LabelMap>> {
        let Some(path) = self.files.get(&frame) else { return Ok(None) };
        match masks::read_label_map(path, self.size) {
            Ok(labels) => Ok(Some(labels)),
            Err(IoError::WrongSize { found, .. }) if found == self.source_size || found == self.stored_size => {
                Ok(Some(masks::read_label_map(path, found)?.resized(self.size)))
            }
            Err(IoError::WrongSize { found, .. }) => Err(self.wrong_size(path, found)),
            Err(error) => Err(error.into()),
        }
    }

    /// Checks the size of every mask, and the content of the first one.
    ///
    /// # Errors
    /// As [`MaskFolder::labels`].
    pub(in crate::pipeline) fn check(&self) -> Result<()> {
        let fits = |size: (u32, u32)| [self.size, self.source_size, self.stored_size].contains(&size);
        for (k, (&frame, path)) in self.files.iter().enumerate() {
            let unreadable = |source| PipelineError::Unreadable { path: path.clone(), source };
            files::check(path).map_err(unreadable)?;
            // A valid header is sufficient.
            let is_in_order = ::image::image_dimensions(path).is_ok_and(fits);
            if k == 0 || !is_in_order {
                self.labels(frame)?;
            }
        }
        Ok(())
    }

    fn wrong_size(&self, path: &Path, (found_width, found_height): (u32, u32)) -> PipelineError {
        let ((width, height), source) = (self.size, self.source_size);
        let or_source = match self.size == source {
            true => String::new(),
            false => format!(" ({}x{} before downscaling)", source.0, source.1),
        };
        PipelineError::MaskSize { path: path.to_owned(), width, height, or_source, found_width, found_height }
    }

    /// A warning for frames without a mask.
    pub(in crate::pipeline) fn warning(&self, folder: &Path, frames: &[Frame]) -> Option<Warning> {
        let first = frames.iter().find(|frame| Some(&frame.id) == self.missing.first())?;
        let (missing, all) = (self.missing.len(), frames.len());
        let text =
            format!("{}: {missing} of {all} frames without a mask, the first is {}", folder.display(), first.name);
        Some(Topic::FramesWithoutMask.warning(text))
    }
}

fn assign<'a>(frames: &[Frame], file: impl Fn(&Frame) -> Option<&'a PathBuf>) -> BTreeMap<FrameId, PathBuf> {
    frames.iter().filter_map(|frame| Some((frame.id, file(frame)?.clone()))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::video::Kind;

    fn frames(names: &[&str]) -> Vec<Frame> {
        (0u32..).zip(names).map(|(k, name)| Frame { id: FrameId(k), name: (*name).to_owned(), time_s: 0.0 }).collect()
    }

    fn info(width: u32, height: u32, scale: u32) -> Info {
        Info {
            kind: Kind::Video,
            width,
            height,
            source_width: width * scale,
            source_height: height * scale,
            stored_width: width * scale,
            stored_height: height * scale,
            video_track: Some(0),
            fps: None,
            num_frames: None,
            rotation_deg: 0,
            exif_focal_px: None,
        }
    }

    fn write(folder: &Path, name: &str, width: u32, height: u32) {
        let labels = (0..width * height).map(|k| (k % 3) as u8).collect();
        masks::write_label_map(&folder.join(name), &LabelMap { width, height, labels }).unwrap();
    }

    #[test]
    fn files_are_found_by_stem_or_by_index() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "00001.png", 4, 2);
        let found = MaskFolder::open(folder.path(), &frames(&["000000.jpg", "000001.jpg"]), &info(4, 2, 1)).unwrap();
        assert_eq!(found.missing, [FrameId(0)]);
        assert!(found.labels(FrameId(0)).unwrap().is_none());
        assert_eq!(found.labels(FrameId(1)).unwrap().unwrap().labels, [0, 1, 2, 0, 1, 2, 0, 1]);
        // If stems match, numbers are names and not indices.
        let found = MaskFolder::open(folder.path(), &frames(&["00001.png", "00002.png"]), &info(4, 2, 1)).unwrap();
        assert_eq!(found.missing, [FrameId(1)]);
        let strange = MaskFolder::open(folder.path(), &frames(&["a.png"]), &info(4, 2, 1));
        assert!(matches!(strange, Err(PipelineError::NoMasks { .. })));
    }

    #[test]
    fn sizes_must_be_the_frames_or_the_sources() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "a.png", 6, 4);
        let open = |info| MaskFolder::open(folder.path(), &frames(&["a.jpg"]), &info).unwrap().labels(FrameId(0));
        assert_eq!(open(info(3, 2, 2)).unwrap().unwrap().labels, [1, 0, 2, 1, 0, 2]);
        let error = open(info(5, 4, 1)).unwrap_err().to_string();
        assert!(error.contains("a.png") && error.contains("6x4") && error.contains("5x4"), "{error}");
    }

    #[test]
    fn masks_may_have_the_size_at_which_frames_are_stored() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "a.png", 3, 2);
        let widened = Info { stored_width: 3, ..info(6, 2, 1) };
        let masks = MaskFolder::open(folder.path(), &frames(&["a.jpg"]), &widened).unwrap();
        assert!(masks.check().is_ok());
        assert_eq!(masks.labels(FrameId(0)).unwrap().unwrap().labels, [0, 0, 1, 1, 2, 2, 0, 0, 1, 1, 2, 2]);
    }

    #[test]
    fn a_mask_of_the_wrong_size_is_found_early() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "a.png", 3, 2);
        write(folder.path(), "b.png", 6, 4);
        let check = |info| MaskFolder::open(folder.path(), &frames(&["a.jpg", "b.jpg"]), &info).unwrap().check();
        assert!(check(info(3, 2, 2)).is_ok());
        assert!(check(info(3, 2, 1)).unwrap_err().to_string().contains("b.png"));
        fs::write(folder.path().join("b.png"), b"no picture").unwrap();
        assert!(check(info(3, 2, 2)).unwrap_err().to_string().contains("b.png"));
    }
}
