//! Which boxes of the detector show something that stands, by the points that the stage `motion` followed.
//!
//! The stage that knows the points says it of every box, so that the tracker need not hold them.

use std::path::Path;

use crate::motion::{PointTrack, TrackLabel, alive, shows_stationary};
use crate::pipeline::Result;
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::segment;
use crate::pipeline::stages::segment::detections::FrameFolder;
use crate::scene::{Frame, FrameId, Rect};
use crate::tracking::DetectedBox;

/// The numbers of the boxes that stand, by frame, in the folder of the stage `motion`.
fn known(motion_folder: &Path) -> FrameFolder<u32> {
    FrameFolder::new(motion_folder.join("standing"))
}

/// Says of all boxes of the detector which of them stand.
///
/// * `frames` – those that `tracks` count.
pub(in crate::pipeline) fn write(
    run: &Run,
    motion_folder: &Path,
    frames: &[Frame],
    tracks: &[PointTrack],
    labels: &[TrackLabel],
) -> Result<()> {
    let (detected, known) = (segment::finished_boxes(run), known(motion_folder));
    for ((index, frame), live) in (0u32..).zip(frames).zip(alive(tracks)) {
        let boxes = detected.read(frame.id)?;
        if boxes.is_empty() {
            continue;
        }
        let seen: Vec<([f64; 2], &TrackLabel)> =
            live.iter().filter_map(|&k| Some((tracks[k].at(index)?, &labels[k]))).collect();
        let stands = |rect: &Rect| {
            shows_stationary(seen.iter().filter(|([x, y], _)| rect.contains(*x, *y)).map(|(_, label)| label.verdict))
        };
        let standing: Vec<u32> =
            (0u32..).zip(&boxes).filter(|(_, found)| stands(&found.rect)).map(|(k, _)| k).collect();
        known.write(frame, &standing)?;
    }
    Ok(())
}

/// The boxes of the detector in a frame, and which of them stand. The stages `segment` and `motion` must be done.
pub(in crate::pipeline) fn boxes(run: &Run, detected: &segment::BoxFolder, frame: FrameId) -> Result<Vec<DetectedBox>> {
    let mut found: Vec<DetectedBox> = detected.read(frame)?.into_iter().map(DetectedBox::from).collect();
    let known = known(&super::folder(run));
    for number in known.read(frame)? {
        let wrong = || intermediate::damaged(&known.path(frame), format!("box {number} does not exist"));
        found.get_mut(number as usize).ok_or_else(wrong)?.is_stationary = true;
    }
    Ok(found)
}
