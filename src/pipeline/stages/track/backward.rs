//! Objects before they were found: followed back from their first masks.
//!
//! Video is decoded forward, so the frames before first masks are gathered in windows of bounded memory, each of which
//! is gone through from its end. Windows may overlap: an object is followed back through as many frames as one holds.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::path::Path;

use ::image::RgbImage;

use super::detected::{Finds, Followed};
use crate::io::masks;
use crate::networks::FlowEstimator;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::images;
use crate::pipeline::{Result, Stage};
use crate::scene::{Frame, FrameId};
use crate::tracking::{BackwardTracker, Correction, Evidence, TrackSummary, TrackedMask};

/// Bytes of pictures that a window may hold.
const WINDOW_BYTES: usize = 160 << 20;
/// Frames that a window may hold.
const MAX_WINDOW: usize = 64;

/// Extends the objects to frames before those in which they were found; adds masks to `folder`.
pub(super) fn extend(
    run: &Run,
    finds: &mut Finds,
    folder: &Path,
    followed: &mut [Followed],
    outcome: &mut Outcome,
) -> Result<()> {
    let frames = run.frames()?;
    let index: BTreeMap<FrameId, usize> = frames.iter().enumerate().map(|(k, frame)| (frame.id, k)).collect();
    let starts: BTreeSet<usize> = followed.iter().filter_map(|f| index.get(&f.summary.first).copied()).collect();
    let picture_bytes = 3 * run.info().width as usize * run.info().height as usize;
    let most = (WINDOW_BYTES / picture_bytes.max(1)).clamp(2, MAX_WINDOW);
    let windows = windows(&starts, most);
    let wanted = windows.iter().flat_map(|window| frames[window.clone()].iter().map(|frame| frame.id)).collect();
    let place = |frame: FrameId| index.get(&frame).copied().unwrap_or_default();
    let mut flow = super::load_flow_estimator(run)?;
    let mut open = windows.into_iter().peekable();
    let mut gathered: Vec<(Frame, RgbImage)> = Vec::new();
    let mut num_done = 0;
    images::for_each(run, Stage::Track, wanted, outcome, |frame, picture| {
        let at = place(frame.id);
        while open.next_if(|window| *window.end() < at).is_some() {}
        let begin = open.peek().map_or(0, |window| *window.start());
        gathered.retain(|(frame, _)| place(frame.id) >= begin);
        gathered.push((frame, picture));
        if open.peek().is_some_and(|window| *window.end() == at) {
            let starting = followed.iter().filter(|f| (num_done..=at).contains(&place(f.summary.first)));
            let starting: Vec<TrackSummary> = starting.map(|f| f.summary.clone()).collect();
            follow_back(run, finds, folder, followed, &starting, &mut *flow, &gathered)?;
            num_done = at + 1;
        }
        Ok(())
    })
}

/// Windows of frames that end with a first mask each and hold those that come shortly before it.
///
/// * `starts` – frames with first masks.
/// * `most` – frames of a window.
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

/// Goes through a window from its end, with the objects that start in it.
fn follow_back(
    run: &Run,
    finds: &mut Finds,
    folder: &Path,
    followed: &mut [Followed],
    starting: &[TrackSummary],
    flow: &mut dyn FlowEstimator,
    window: &[(Frame, RgbImage)],
) -> Result<()> {
    let mut tracker = BackwardTracker::new(finds.tracker_options(run), starting);
    let mut found: Vec<(Frame, TrackedMask)> = Vec::new();
    let mut later: Option<&RgbImage> = None;
    for (frame, picture) in window.iter().rev() {
        let seen = followed.iter().filter(|f| f.frames.binary_search(&frame.id).is_ok()).map(|f| f.summary.id);
        let known = seen.map(|id| Ok((id, super::mask_in(run, folder, id, frame)?))).collect::<Result<Vec<_>>>()?;
        let near = |later| flow.flow(later, picture, &tracker.places());
        let carried = later.filter(|_| tracker.is_following()).map(near).transpose()?;
        let prompter = finds.prompter_backward(run, frame)?;
        let earlier = tracker.advance(frame, picture, &known, prompter, carried.as_ref())?;
        found.extend(earlier.into_iter().map(|mask| (frame.clone(), mask)));
        for Correction { frame, object, mask } in tracker.take_corrections() {
            let known = found.iter_mut().find(|(known, found)| known.id == frame && found.object == object);
            known.into_iter().for_each(|(_, found)| found.mask = mask.clone());
        }
        later = Some(picture);
    }
    let firsts = tracker.finish();
    for (frame, mask) in found {
        let is_sure = firsts.get(&mask.object).is_some_and(|first| *first <= frame.id);
        let one = followed.iter_mut().find(|one| one.summary.id == mask.object);
        if let (true, Some(one)) = (is_sure, one) {
            masks::write_mask(&super::mask_path(folder, mask.object, &frame), &mask.mask)?;
            add(one, &frame, &mask);
        }
    }
    Ok(())
}

/// Adds a frame to what is known of an object.
fn add(Followed { summary, frames, .. }: &mut Followed, frame: &Frame, mask: &TrackedMask) {
    if let Err(place) = frames.binary_search(&frame.id) {
        frames.insert(place, frame.id);
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
        // What starts within a window shares it; the next one may overlap it.
        assert_eq!(of(&[12, 15, 40], 30), [0..=15, 11..=40]);
        assert_eq!(of(&[30, 35], 10), [21..=30, 26..=35]);
        assert!(of(&[5, 9, 30, 31, 77], 8).iter().all(|window| window.end() - window.start() < 8));
    }
}
