//! Backward tracking of objects from their first masks.
//!
//! Video is decoded forward, so the frames before first masks are gathered in windows of bounded memory. Each window is
//! processed from its end. Windows may overlap: an object is tracked backward through as many frames as one contains.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::path::Path;

use ::image::RgbImage;

use super::detected::{Detections, ObjectTrack};
use crate::io::masks;
use crate::networks::FlowEstimator;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::images;
use crate::pipeline::{Result, Stage};
use crate::scene::{Frame, FrameId};
use crate::tracking::{BackwardTracker, Correction, Evidence, TrackSummary, TrackedMask};

/// Maximum memory of a window's images, bytes.
const WINDOW_BYTES: usize = 160 << 20;
/// Maximum number of frames of a window.
const MAX_WINDOW: usize = 64;

/// Extends the tracks to frames before their first masks; adds masks to `folder`.
pub(super) fn extend(
    run: &Run,
    detections: &mut Detections,
    folder: &Path,
    tracks: &mut [ObjectTrack],
    outcome: &mut Outcome,
) -> Result<()> {
    let frames = run.frames()?;
    let index: BTreeMap<FrameId, usize> = frames.iter().enumerate().map(|(k, frame)| (frame.id, k)).collect();
    let starts: BTreeSet<usize> = tracks.iter().filter_map(|f| index.get(&f.summary.first).copied()).collect();
    let image_bytes = 3 * run.info().width as usize * run.info().height as usize;
    let most = (WINDOW_BYTES / image_bytes.max(1)).clamp(2, MAX_WINDOW);
    let windows = windows(&starts, most);
    let wanted = windows.iter().flat_map(|window| frames[window.clone()].iter().map(|frame| frame.id)).collect();
    let index_of = |frame: FrameId| index.get(&frame).copied().unwrap_or_default();
    let mut flow = super::load_flow_estimator(run)?;
    let mut open = windows.into_iter().peekable();
    let mut gathered: Vec<(Frame, RgbImage)> = Vec::new();
    let mut num_done = 0;
    images::for_each(run, Stage::Track, wanted, outcome, |frame, image| {
        let at = index_of(frame.id);
        while open.next_if(|window| *window.end() < at).is_some() {}
        let begin = open.peek().map_or(0, |window| *window.start());
        gathered.retain(|(frame, _)| index_of(frame.id) >= begin);
        gathered.push((frame, image));
        if open.peek().is_some_and(|window| *window.end() == at) {
            let starting = tracks.iter().filter(|f| (num_done..=at).contains(&index_of(f.summary.first)));
            let starting: Vec<TrackSummary> = starting.map(|f| f.summary.clone()).collect();
            track_backward(run, detections, folder, tracks, &starting, &mut *flow, &gathered)?;
            num_done = at + 1;
        }
        Ok(())
    })
}

/// Windows of frames that end with a first mask each, and contain the frames before it.
///
/// * `starts` – frames with first masks.
/// * `most` – maximum number of frames of a window.
fn windows(starts: &BTreeSet<usize>, most: usize) -> Vec<RangeInclusive<usize>> {
    let mut windows: Vec<RangeInclusive<usize>> = Vec::new();
    for &start in starts.iter().filter(|start| **start > 0) {
        match windows.last_mut() {
            Some(last) if start - last.start() < most => *last = *last.start()..=start,
            _ => windows.push((start + 1).saturating_sub(most)..=start),
        }
    }
    windows
}

/// Processes a window from its end, with the objects that start in it.
fn track_backward(
    run: &Run,
    detections: &mut Detections,
    folder: &Path,
    tracks: &mut [ObjectTrack],
    starting: &[TrackSummary],
    flow: &mut dyn FlowEstimator,
    window: &[(Frame, RgbImage)],
) -> Result<()> {
    let mut tracker = BackwardTracker::new(detections.tracker_options(run), starting);
    let mut found: Vec<(Frame, TrackedMask)> = Vec::new();
    let mut later_image: Option<&RgbImage> = None;
    for (frame, image) in window.iter().rev() {
        let seen = tracks.iter().filter(|f| f.frames.binary_search(&frame.id).is_ok()).map(|f| f.summary.id);
        let known = seen.map(|id| Ok((id, super::mask_in(run, folder, id, frame)?))).collect::<Result<Vec<_>>>()?;
        let flow_from = |later_image| flow.flow(later_image, image, &tracker.flow_regions());
        let flow_to_image = later_image.filter(|_| tracker.is_tracking()).map(flow_from).transpose()?;
        let segmenter = detections.segmenter_backward(run, frame)?;
        let earlier = tracker.advance(frame, image, &known, segmenter, flow_to_image.as_ref())?;
        found.extend(earlier.into_iter().map(|mask| (frame.clone(), mask)));
        for Correction { frame, object, mask } in tracker.take_corrections() {
            let known = found.iter_mut().find(|(known, found)| known.id == frame && found.object == object);
            known.into_iter().for_each(|(_, found)| found.mask = mask.clone());
        }
        later_image = Some(image);
    }
    let firsts = tracker.finish();
    for (frame, mask) in found {
        let is_reliable = firsts.get(&mask.object).is_some_and(|first| *first <= frame.id);
        let track = tracks.iter_mut().find(|track| track.summary.id == mask.object);
        if let (true, Some(track)) = (is_reliable, track) {
            masks::write_mask(&super::mask_path(folder, mask.object, &frame), &mask.mask)?;
            add(track, &frame, &mask);
        }
    }
    Ok(())
}

/// Adds a frame to an object's track.
fn add(ObjectTrack { summary, frames, .. }: &mut ObjectTrack, frame: &Frame, mask: &TrackedMask) {
    if let Err(position) = frames.binary_search(&frame.id) {
        frames.insert(position, frame.id);
        match mask.evidence {
            Evidence::Carried => summary.found.carried += 1,
            Evidence::Prompted { .. } | Evidence::Detected { .. } => summary.found.prompted += 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_end_with_first_masks_and_are_bounded() {
        let of = |starts: &[usize], most| windows(&starts.iter().copied().collect(), most);
        assert_eq!(of(&[0], 10), []);
        assert_eq!(of(&[0, 4], 10), [0..=4]);
        assert_eq!(of(&[30], 10), [21..=30]);
        // An object that starts within a window shares it; the next window may overlap it.
        assert_eq!(of(&[12, 15, 40], 30), [0..=15, 11..=40]);
        assert_eq!(of(&[30, 35], 10), [21..=30, 26..=35]);
        assert!(of(&[5, 9, 30, 31, 77], 8).iter().all(|window| window.end() - window.start() < 8));
    }
}
