//! Files of the run's own, as they are read again. What later stages take for granted is checked here: a disk may have
//! failed, or another hand changed them.

use std::io::{BufReader, ErrorKind, Read, Write};
use std::path::{Component, Path};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::features::TrackTable;
use crate::files;
use crate::io::{IoError, atomic, is_sensible};
use crate::motion::{PointTrack, TrackLabel};
use crate::pipeline::PipelineError;
use crate::pipeline::stages::motion::Points;
use crate::pipeline::stages::motion::followed::Followed;
use crate::scene::{BoxDetection, Frame, Rect};

/// Content of an intermediate file.
pub(in crate::pipeline) trait Content: DeserializeOwned {
    /// Flaw that no run has written, in words.
    fn flaw(&self) -> Option<String>;
}

impl<T: Content> Content for Vec<T> {
    fn flaw(&self) -> Option<String> {
        self.iter().find_map(Content::flaw)
    }
}

/// Reads a file in postcard's format, piece by piece: next to the tracks of a long video their file would take as much
/// memory again.
///
/// # Errors
/// [`PipelineError::State`] for one that is damaged or missing, [`IoError::System`] for one that cannot be read.
pub(in crate::pipeline) fn read<T: Content>(path: &Path) -> Result<T, PipelineError> {
    let file = match files::open_within_memory(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Err(damaged(path, "missing")),
        opened => opened.map_err(IoError::system("read", path))?,
    };
    let mut reader = KeepsError { inner: BufReader::new(file), error: None };
    let mut word = vec![0; LONGEST_WORD];
    let content = postcard::from_io((&mut reader, &mut word)).map(|(content, _)| content);
    if let Some(error) = reader.error {
        return Err(IoError::system("read", path)(error).into());
    }
    content.map_err(|error| error.to_string()).and_then(checked).map_err(|reason| damaged(path, reason))
}

/// Room for the longest name in such a file.
const LONGEST_WORD: usize = 1 << 20;

/// Writes such a file, piece by piece: the tracks of a long video are not to lie in memory twice.
///
/// # Errors
/// What the system says of the file.
pub(in crate::pipeline) fn write(path: &Path, value: &impl Serialize) -> Result<(), PipelineError> {
    let written = atomic::write_with(path, |out| {
        let mut out = KeepsError { inner: out, error: None };
        let done = postcard::to_io(value, &mut out);
        let failed = done.err().map(std::io::Error::other);
        out.error.or(failed).map_or(Ok(()), Err)
    });
    Ok(written?)
}

/// Keeps what went wrong, of which [`postcard`] says only that something did.
struct KeepsError<T> {
    inner: T,
    error: Option<std::io::Error>,
}

impl<T> KeepsError<T> {
    /// Keeps an error, but for that of a file that is over.
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

impl<T: Write> Write for KeepsError<T> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.inner.write(bytes)
    }

    fn write_all(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        let written = self.inner.write_all(bytes);
        self.keep(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.inner.flush()
    }
}

impl<T: Read> Read for KeepsError<T> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        self.inner.read(bytes)
    }

    fn read_exact(&mut self, bytes: &mut [u8]) -> std::io::Result<()> {
        let read = self.inner.read_exact(bytes);
        self.keep(read)
    }
}

/// The content of such a file; what is wrong with it, in words.
pub(in crate::pipeline) fn taken<T: Content>(bytes: &[u8]) -> Result<T, String> {
    let content: T = postcard::from_bytes(bytes).map_err(|error| error.to_string())?;
    checked(content)
}

/// The content, if a run may have written it.
pub(in crate::pipeline) fn checked<T: Content>(content: T) -> Result<T, String> {
    content.flaw().map_or(Ok(content), Err)
}

pub(in crate::pipeline) fn damaged(path: &Path, reason: impl ToString) -> PipelineError {
    PipelineError::State { path: path.to_owned(), reason: reason.to_string() }
}

impl Content for TrackTable {
    fn flaw(&self) -> Option<String> {
        TrackTable::flaw(self)
    }
}

impl Content for Followed {
    fn flaw(&self) -> Option<String> {
        self.frames.iter().find_map(Content::flaw).or_else(|| flaw_of_points(&self.tracks, self.frames.len()))
    }
}

/// They belong to points, with which [`flaw_of_labels`] holds them.
impl Content for TrackLabel {
    fn flaw(&self) -> Option<String> {
        None
    }
}

/// Flaw of points and their labels, in words.
pub(in crate::pipeline) fn flaw_of_labels(points: &Points) -> Option<String> {
    let (labels, tracks) = (points.labels.len(), points.tracks.len());
    (labels != tracks).then(|| format!("{tracks} points, but {labels} labels"))
}

fn flaw_of_points(tracks: &[PointTrack], num_frames: usize) -> Option<String> {
    let is_wrong = |track: &PointTrack| {
        let end = u64::from(track.first) + track.pixels.len() as u64;
        end > num_frames as u64 || !track.pixels.as_flattened().iter().all(|side| side.is_finite())
    };
    let found = tracks.iter().position(is_wrong);
    found.map(|k| format!("point {k}: frames or positions out of range"))
}

impl Content for BoxDetection {
    fn flaw(&self) -> Option<String> {
        is_wrong(&self.rect).then(|| "a box with invalid sides".to_owned()).or_else(|| share(self.confidence))
    }
}

/// Returns true if the sides of a box are not finite or beyond the limit.
pub(in crate::pipeline) fn is_wrong(rect: &Rect) -> bool {
    ![rect.x0, rect.y0, rect.x1, rect.y1].iter().all(is_sensible)
}

/// Flaw of a network's confidence.
pub(in crate::pipeline) fn share(confidence: f64) -> Option<String> {
    (!confidence.is_finite()).then(|| format!("confidence {confidence:e} is not finite"))
}

impl Content for Frame {
    /// Frames give files their names: they lead nowhere but down.
    fn flaw(&self) -> Option<String> {
        let leads_down = |part| matches!(part, Component::Normal(_));
        let is_name = !self.name.is_empty() && Path::new(&self.name).components().all(leads_down);
        if !is_name || self.name.contains(['\0', '\n', '\r']) {
            return Some(format!("{:?} is not a frame name", self.name));
        }
        (!self.time_s.is_finite()).then(|| format!("{}: time is not a number", self.name))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use proptest::prelude::*;
    use rand::Rng as _;
    use serde::Serialize;

    use super::*;
    use crate::features::tracks::{Feature, View};
    use crate::math::{Rng, seeded_rng};
    use crate::scene::{Finder, FrameId, ImageId};

    fn table() -> TrackTable {
        let view = |k: u32| View {
            image: ImageId(k + 1),
            name: format!("{k:06}.jpg"),
            camera: 0,
            pixels: (0..5).map(|i| Point2::new(f64::from(i), 2.5)).collect(),
            rgb: vec![[9; 3]; 5],
            whitening: Vec::new(),
        };
        let track = |feature| (0..4).map(|view| Feature { view, feature }).collect();
        TrackTable { views: (0..4).map(view).collect(), tracks: (0..5).map(track).collect() }
    }

    fn points() -> Followed {
        let frame = |k| Frame { id: FrameId(k), name: format!("{k:06}.jpg"), time_s: f64::from(k) };
        let track = |first| PointTrack { first, pixels: vec![[1.5, 2.5]; 3] };
        Followed { frames: (0..6).map(frame).collect(), tracks: (0..4).map(track).collect() }
    }

    fn boxes() -> Vec<BoxDetection> {
        let rect = Rect { x0: 1.0, y0: 2.0, x1: 30.0, y1: 40.0 };
        vec![BoxDetection { class: "car".into(), confidence: 0.5, rect, finder: Finder::Detector }; 3]
    }

    /// A copy with one to four bytes that are others, too few or too many.
    fn hurt(whole: &[u8], rng: &mut Rng) -> Vec<u8> {
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

    /// Content read from damaged bytes, if any is accepted.
    fn taken_of<T: Content + Serialize>(whole: &T, seed: u64) -> Option<T> {
        let bytes = postcard::to_stdvec(whole).unwrap();
        assert!(taken::<T>(&bytes).is_ok(), "as it was written");
        taken(&hurt(&bytes, &mut seeded_rng(seed, 0))).ok()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn of_damaged_files_what_is_taken_can_be_used(seed in any::<u64>()) {
            if let Some(table) = taken_of(&table(), seed) {
                let features = table.tracks.iter().flatten();
                prop_assert!(features.map(|&seen| table.pixel(seen)).all(|pixel| pixel.x.is_finite()));
                prop_assert!(table.tracks.iter().all(|track| track.is_sorted_by_key(|seen| seen.view)));
            }
            if let Some(points) = taken_of(&points(), seed) {
                for track in &points.tracks {
                    let last = track.end().checked_sub(1).filter(|_| !track.pixels.is_empty());
                    prop_assert!(last.is_none_or(|k| track.at(k).is_some() && points.frames.get(k as usize).is_some()));
                }
            }
            for found in taken_of(&boxes(), seed).into_iter().flatten() {
                prop_assert!(found.rect.width().is_finite() && found.confidence.is_finite());
            }
        }
    }

    #[test]
    fn what_no_run_writes_is_named() {
        let flaw = |change: &dyn Fn(&mut TrackTable)| {
            let mut table = table();
            change(&mut table);
            Content::flaw(&table).unwrap()
        };
        assert!(flaw(&|t| t.tracks[2][3].feature = 5).contains("track 2"));
        assert!(flaw(&|t| t.tracks[1][0].view = 9).contains("track 1"));
        assert!(flaw(&|t| t.tracks[0].swap(0, 1)).contains("track 0"));
        assert!(flaw(&|t| t.views[3].pixels[0].x = f64::NAN).contains("000003.jpg"));
        assert!(flaw(&|t| t.views[1].rgb.truncate(2)).contains("000001.jpg"));
        assert!(flaw(&|t| t.views[1].image = ImageId(1)).contains("000001.jpg"));
        let mut late = points();
        late.tracks[3].first = u32::MAX;
        assert!(late.flaw().unwrap().contains("point 3"));
        let unlabelled = Points { frames: vec![FrameId(0); 6], tracks: points().tracks, labels: Vec::new() };
        assert!(flaw_of_labels(&unlabelled).unwrap().contains("labels"));
        let mut endless = boxes();
        endless[1].rect.x1 = f64::INFINITY;
        assert!(endless.flaw().is_some());
    }

    #[test]
    fn names_of_frames_lead_nowhere_but_down() {
        let flaw = |name: &str| Frame { id: FrameId(0), name: name.into(), time_s: 0.0 }.flaw();
        assert!(["000000.jpg", "left/1.png"].iter().all(|name| flaw(name).is_none()));
        assert!(["", "../1.png", "/etc/1.png", "a/../../1.png", "a\n.png"].iter().all(|name| flaw(name).is_some()));
        assert!(Frame { id: FrameId(0), name: "a".into(), time_s: f64::NAN }.flaw().is_some());
    }
}
