//! Detector boxes of stationary objects, by the points that the stage `motion` tracked.
//!
//! The stage that has the points labels every box, so the tracker does not need them in memory.

use std::path::Path;

use crate::motion::{PointTrack, TrackLabel, alive, shows_stationary};
use crate::pipeline::Result;
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::segment;
use crate::pipeline::stages::segment::detections::FrameFolder;
use crate::scene::{Frame, FrameId, Rect};
use crate::tracking::DetectedBox;

/// The numbers of the stationary boxes, by frame, in the folder of the stage `motion`.
fn stationary_folder(motion_folder: &Path) -> FrameFolder<u32> {
    FrameFolder::new(motion_folder.join("standing"))
}

/// Determines which boxes of the detector are stationary, and stores their numbers.
///
/// * `frames` – those that `tracks` index.
pub(in crate::pipeline) fn write(
    run: &Run,
    motion_folder: &Path,
    frames: &[Frame],
    tracks: &[PointTrack],
    labels: &[TrackLabel],
) -> Result<()> {
    let (detected, stationary_folder) = (segment::finished_boxes(run), stationary_folder(motion_folder));
    for ((index, frame), live) in (0u32..).zip(frames).zip(alive(tracks)) {
        let boxes = detected.read(frame.id)?;
        if boxes.is_empty() {
            continue;
        }
        let seen: Vec<([f64; 2], &TrackLabel)> =
            live.iter().filter_map(|&k| Some((tracks[k].at(index)?, &labels[k]))).collect();
        let is_stationary_box = |rect: &Rect| {
            shows_stationary(seen.iter().filter(|([x, y], _)| rect.contains(*x, *y)).map(|(_, label)| label.verdict))
        };
        let stationary: Vec<u32> =
            (0u32..).zip(&boxes).filter(|(_, found)| is_stationary_box(&found.rect)).map(|(k, _)| k).collect();
        stationary_folder.write(frame, &stationary)?;
    }
    Ok(())
}

/// The boxes of the detector in a frame, with their stationary flags. The stages `segment` and `motion` must be done.
pub(in crate::pipeline) fn boxes(run: &Run, detected: &segment::BoxFolder, frame: FrameId) -> Result<Vec<DetectedBox>> {
    let mut found: Vec<DetectedBox> = detected.read(frame)?.into_iter().map(DetectedBox::from).collect();
    let stationary_folder = stationary_folder(&super::folder(run));
    for number in stationary_folder.read(frame)? {
        let wrong = || intermediate::damaged(&stationary_folder.path(frame), format!("box {number} does not exist"));
        found.get_mut(number as usize).ok_or_else(wrong)?.is_stationary = true;
    }
    Ok(found)
}
