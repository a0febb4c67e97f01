//! Point tracking through all frames, all over the image.
//!
//! Pyramidal Lucas-Kanade with a forward-backward check. A point with a previous step starts at its linear prediction,
//! at the finest level only: at coarse levels a small vehicle merges with the road. New points are searched through the
//! whole pyramid, and lost points as well if the motion of the image has changed. New points are the strongest corners
//! (J. Shi, C. Tomasi, *Good Features to Track*, 1994) of the grid cells without a point. A cell whose point was lost
//! soon is blocked for some frames: of ten new points four are lost soon, most of them repeatedly in the same cells.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use crate::image::{CornerStrength, LucasKanade, Picture, Pyramid, Returned, gray_from_rgb, resize_gray, scale_to_fit};
use crate::math::lower_quantile;
use crate::networks::PerceptionError;

/// Positions of one point in consecutive frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointTrack {
    /// Index of the first frame, counted from the first frame of the follower.
    pub first: u32,
    /// Pixels of the full frame, the center of the first pixel at (0.5, 0.5); one entry per frame.
    pub pixels: Vec<[f32; 2]>,
}

impl PointTrack {
    /// Index after the last frame.
    pub fn end(&self) -> u32 {
        self.first + self.pixels.len() as u32
    }

    /// Position of the point in a frame; `None` if it is not tracked there.
    pub fn at(&self, frame: u32) -> Option<[f64; 2]> {
        let k = frame.checked_sub(self.first)? as usize;
        self.pixels.get(k).map(|pixel| pixel.map(f64::from))
    }
}

/// Maximum longer side of the images that are processed, pixels; larger ones are downscaled.
pub(super) const MAX_SIDE_PX: u32 = 1280;
/// Side of the grid's cells, pixels. A cell without a point starts one: a vehicle of 30 pixels has about eight points.
pub(super) const SPACING_PX: u32 = 10;
/// Maximum number of points at a time.
const MAX_POINTS: usize = 8000;
/// Minimum corner strength of a new point, relative to the 0.9 quantile of the cells.
const QUALITY: f32 = 0.01;
/// Half the side of the tracked window, pixels.
const WINDOW_RADIUS_PX: usize = 5;
/// Number of pyramid levels above the full resolution.
const PYRAMID_LEVELS: usize = 3;
/// Maximum forward-backward error, pixels.
const MAX_ROUND_TRIP_PX: f32 = 0.6;
/// Maximum mean difference between the windows of two successive frames, in gray levels.
const MAX_DIFFERENCE: f32 = 20.0;
/// Minimum length of a track, frames.
const MIN_TRACK_LENGTH: usize = 4;

/// Indices of the tracks alive in each frame, from the first frame on.
pub fn alive(tracks: &[PointTrack]) -> impl Iterator<Item = Vec<usize>> {
    let mut starting: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (k, track) in tracks.iter().enumerate() {
        starting.entry(track.first).or_default().push(k);
    }
    let mut live: Vec<usize> = Vec::new();
    (0u32..).map(move |frame| {
        live.extend(starting.remove(&frame).into_iter().flatten());
        live.retain(|&k| tracks[k].end() > frame);
        live.clone()
    })
}

/// Point tracker, frame by frame. The same frames give the same tracks, with any number of threads.
pub struct PointFollower {
    size: (u32, u32),
    working_size: (u32, u32),
    previous: Option<Arc<Pyramid>>,
    live: Vec<Live>,
    done: Vec<PointTrack>,
    num_frames: u32,
    /// First frame in which a cell may start a point, per cell of the grid.
    blocked_until: Vec<u32>,
}

/// Share of points found near their prediction from which the other points count as occluded.
const MIN_NEAR: f64 = 0.5;
/// Number of frames for which a cell is blocked.
const BLOCKED_FRAMES: u32 = 2;

/// Live track of a point; positions in pixels of the working size.
struct Live {
    first: u32,
    positions: Vec<Point2<f32>>,
}

impl Live {
    fn last(&self) -> Point2<f32> {
        self.positions.last().copied().unwrap_or_default()
    }

    /// Linear prediction by the last step; `None` without one.
    fn predicted(&self) -> Option<Point2<f32>> {
        let [.., before, last] = self.positions.as_slice() else { return None };
        Some(*last + (*last - *before))
    }
}

/// Tracker through the whole pyramid.
const TRACKER: LucasKanade = LucasKanade {
    window_radius_px: WINDOW_RADIUS_PX,
    num_smaller: PYRAMID_LEVELS,
    max_steps: 12,
    converged_px: 0.03,
    min_eigenvalue: 1e-4,
};

impl PointFollower {
    /// Follower for frames of `size` (width, height).
    pub fn new(size: (u32, u32)) -> Self {
        let working_size = scale_to_fit(size.0, size.1, MAX_SIDE_PX);
        let (previous, live, done, blocked_until) = (None, Vec::new(), Vec::new(), Vec::new());
        let mut follower = Self { size, working_size, previous, live, done, num_frames: 0, blocked_until };
        let (cols, rows) = follower.grid();
        follower.blocked_until = vec![0; cols * rows];
        follower
    }

    /// Tracks points into the next frame. Frames must be in the order of the source.
    ///
    /// # Errors
    /// [`PerceptionError::SizeMismatch`] for a frame of another size, [`PerceptionError::Image`] if OpenCV fails.
    pub fn push(&mut self, picture: &Picture) -> Result<(), PerceptionError> {
        let found = picture.rgb().dimensions();
        if found != self.size {
            let what = format!("frame {}", self.num_frames);
            return Err(PerceptionError::SizeMismatch { what, expected: self.size, found });
        }
        let is_whole = self.working_size == self.size;
        let pyramid = match is_whole {
            true => picture.pyramid(PYRAMID_LEVELS)?,
            false => {
                let smaller = resize_gray(&gray_from_rgb(picture.rgb())?, self.working_size.0, self.working_size.1)?;
                Arc::new(Pyramid::new(smaller, PYRAMID_LEVELS)?)
            }
        };
        if let Some(previous) = self.previous.take() {
            self.follow(&previous, &pyramid);
        }
        self.drop_duplicates();
        match is_whole {
            true => self.find_new(picture.corners(&pyramid)),
            false => self.find_new(&CornerStrength::of(pyramid.picture())),
        }
        self.previous = Some(pyramid);
        self.num_frames += 1;
        Ok(())
    }

    /// Returns all tracks of the minimum length or more, in the order of their first frames.
    pub fn finish(mut self) -> Vec<PointTrack> {
        for live in std::mem::take(&mut self.live) {
            self.end(live);
        }
        self.done.sort_by_key(|track| track.first);
        self.done
    }

    fn follow(&mut self, previous: &Pyramid, next: &Pyramid) {
        let live = std::mem::take(&mut self.live);
        let mut found = vec![None; live.len()];
        let step = |tracker: LucasKanade, chosen: &[usize], guesses: &[Point2<f32>]| -> Vec<Option<Point2<f32>>> {
            let from: Vec<Point2<f32>> = chosen.iter().map(|&k| live[k].last()).collect();
            let all = tracker.there_and_back(previous, next, &from, guesses).into_iter();
            all.map(|returned| Some(returned.filter(|returned| self.is_consistent(returned))?.position)).collect()
        };
        // From the prediction at the finest level only; then from the last position, through the whole pyramid.
        let (known, predicted): (Vec<usize>, Vec<Point2<f32>>) =
            live.iter().enumerate().filter_map(|(k, point)| Some((k, point.predicted()?))).unzip();
        let near = step(TRACKER.near(), &known, &predicted);
        known.iter().zip(near).for_each(|(&k, position)| found[k] = position);
        let num_near = found.iter().flatten().count();
        let is_occluded = |k: usize| live[k].predicted().is_some() && num_near as f64 >= MIN_NEAR * known.len() as f64;
        let remaining: Vec<usize> = (0..live.len()).filter(|&k| found[k].is_none() && !is_occluded(k)).collect();
        let last_positions: Vec<Point2<f32>> = remaining.iter().map(|&k| live[k].last()).collect();
        let refound = step(TRACKER, &remaining, &last_positions);
        remaining.iter().zip(refound).for_each(|(&k, position)| found[k] = position);
        for (mut point, found) in live.into_iter().zip(found) {
            match found {
                Some(position) => {
                    point.positions.push(position);
                    self.live.push(point);
                }
                None => {
                    self.block_cell(&point);
                    self.end(point);
                }
            }
        }
    }

    /// Blocks the cell of a point that was lost before the minimum track length.
    fn block_cell(&mut self, point: &Live) {
        if point.positions.len() < MIN_TRACK_LENGTH {
            let cell = self.cell(point.last());
            self.blocked_until[cell] = self.num_frames + BLOCKED_FRAMES;
        }
    }

    /// Returns true if a point passes the forward-backward check, has the same appearance, and is in the image.
    fn is_consistent(&self, returned: &Returned) -> bool {
        let is_same = returned.round_trip_px <= MAX_ROUND_TRIP_PX && returned.difference <= MAX_DIFFERENCE;
        is_same && self.is_inside(returned.position)
    }

    fn is_inside(&self, position: Point2<f32>) -> bool {
        let inside = |x: f32, side: u32| x >= 1.5 && x <= side as f32 - 1.5;
        inside(position.x, self.working_size.0) && inside(position.y, self.working_size.1)
    }

    /// Drops points that have converged on an older point: they slid along an edge.
    fn drop_duplicates(&mut self) {
        let bin_px = 0.3 * SPACING_PX as f32;
        let cols = (self.working_size.0 as f32 / bin_px) as usize + 1;
        let rows = (self.working_size.1 as f32 / bin_px) as usize + 1;
        let mut occupied = vec![false; rows * cols];
        for point in std::mem::take(&mut self.live) {
            let last = point.last();
            let bin = (last.y / bin_px) as usize * cols + (last.x / bin_px) as usize;
            if std::mem::replace(&mut occupied[bin.min(rows * cols - 1)], true) {
                self.end(point);
            } else {
                self.live.push(point);
            }
        }
    }

    /// Starts a point at the strongest corner of every cell that has none.
    fn find_new(&mut self, strength: &CornerStrength) {
        let corners = self.corners(strength);
        let mut strengths: Vec<f64> = corners.iter().map(|corner| f64::from(corner.1)).collect();
        let min_strength = QUALITY * lower_quantile(&mut strengths, 0.9).unwrap_or(0.0) as f32;
        let occupied = self.occupied_cells();
        let is_free = |p: Point2<f32>| !occupied[self.cell(p)] && self.blocked_until[self.cell(p)] <= self.num_frames;
        let mut new: Vec<(Point2<f32>, f32)> =
            corners.into_iter().filter(|(p, s)| *s > min_strength && *s > 1e-6 && is_free(*p)).collect();
        new.sort_by(|a, b| b.1.total_cmp(&a.1));
        let num_free = MAX_POINTS.saturating_sub(self.live.len());
        let first = self.num_frames;
        self.live.extend(new.into_iter().take(num_free).map(|(p, _)| Live { first, positions: vec![p] }));
    }

    /// Strongest corner of every cell with its strength, row by row.
    fn corners(&self, strength: &CornerStrength) -> Vec<(Point2<f32>, f32)> {
        let (cols, rows) = self.grid();
        let mut best = vec![(Point2::origin(), 0.0f32); cols * rows];
        let border = WINDOW_RADIUS_PX;
        let spacing = SPACING_PX as usize;
        for y in border..strength.num_rows().saturating_sub(border) {
            let cells = &mut best[y / spacing * cols..][..cols];
            let row = &strength.row(y)[..strength.num_cols().saturating_sub(border)];
            for (col, (values, cell)) in row.chunks(spacing).zip(cells).enumerate() {
                for (x, value) in (col * spacing..).zip(values) {
                    if *value > cell.1 && x >= border {
                        *cell = (Point2::new(x as f32 + 0.5, y as f32 + 0.5), *value);
                    }
                }
            }
        }
        best
    }

    fn occupied_cells(&self) -> Vec<bool> {
        let (cols, rows) = self.grid();
        let mut occupied = vec![false; cols * rows];
        for point in &self.live {
            occupied[self.cell(point.last())] = true;
        }
        occupied
    }

    fn grid(&self) -> (usize, usize) {
        let cells = |side: u32| side.div_ceil(SPACING_PX) as usize;
        (cells(self.working_size.0), cells(self.working_size.1))
    }

    fn cell(&self, p: Point2<f32>) -> usize {
        let (cols, rows) = self.grid();
        let spacing = SPACING_PX as f32;
        let at = |x: f32, cells: usize| ((x.max(0.0) / spacing) as usize).min(cells - 1);
        at(p.y, rows) * cols + at(p.x, cols)
    }

    /// Stores a track of at least the minimum length, in pixels of the full frame.
    fn end(&mut self, point: Live) {
        if point.positions.len() < MIN_TRACK_LENGTH {
            return;
        }
        let scale = [self.size.0 as f32 / self.working_size.0 as f32, self.size.1 as f32 / self.working_size.1 as f32];
        let pixels = point.positions.iter().map(|p| [p.x * scale[0], p.y * scale[1]]).collect();
        self.done.push(PointTrack { first: point.first, pixels });
    }
}

#[cfg(test)]
mod tests;
