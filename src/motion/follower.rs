//! Points followed through all frames, all over the picture.
//!
//! Pyramidal Lucas-Kanade there and back. A point that has been followed before starts at
//! where its last step leads, and needs no coarse pictures, in which a small vehicle is one with the road; what is new
//! is looked for through the whole pyramid, and what is lost, too, where the picture moves otherwise than before. New
//! points are the strongest corners (J. Shi, C. Tomasi, *Good Features to Track*, 1994) of the cells of a grid in which
//! no point is. A cell whose point did not last rests for some frames: of ten new points four do not last, most of them
//! again and again in the same cells.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use crate::image::{CornerStrength, LucasKanade, Picture, Pyramid, Returned, gray_from_rgb, resize_gray, scale_to_fit};
use crate::math::lower_quantile;
use crate::networks::PerceptionError;

/// Where one point was seen, in frames that follow one another without a gap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointTrack {
    /// Index of the first frame, counted from the first one that the follower was given.
    pub first: u32,
    /// Pixels of the whole frame, the first pixel's centre at (0.5, 0.5); one entry per frame.
    pub pixels: Vec<[f32; 2]>,
}

impl PointTrack {
    /// Index after the last frame.
    pub fn end(&self) -> u32 {
        self.first + self.pixels.len() as u32
    }

    /// Where the point is in a frame; `None` if it is not seen there.
    pub fn at(&self, frame: u32) -> Option<[f64; 2]> {
        let k = frame.checked_sub(self.first)? as usize;
        self.pixels.get(k).map(|pixel| pixel.map(f64::from))
    }
}

/// Longer side at which pictures are looked at, pixels; larger ones are shrunk.
pub(super) const MAX_SIDE_PX: u32 = 1280;
/// Side of the grid's cells, each of which starts a point when it has none, pixels: a vehicle of 30 pixels has some
/// eight.
pub(super) const SPACING_PX: u32 = 10;
/// Points followed at a time, at the most.
const MAX_POINTS: usize = 8000;
/// Smallest corner strength of a new point, relative to that which one cell in ten exceeds.
const QUALITY: f32 = 0.01;
/// Half the side of the window that is followed, pixels.
const WINDOW_RADIUS_PX: usize = 5;
/// Levels of the pyramid above the picture.
const PYRAMID_LEVELS: usize = 3;
/// Largest distance between a point and where following it back leads, pixels.
const MAX_ROUND_TRIP_PX: f32 = 0.6;
/// Largest mean difference between the windows of two successive frames, in grey levels.
const MAX_DIFFERENCE: f32 = 20.0;
/// Shortest track that is kept, frames.
const MIN_TRACK_LENGTH: usize = 4;

/// Indices of the tracks that see each frame, from the first frame on.
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

/// Follows points frame by frame. The same frames give the same tracks, whatever the number of threads.
pub struct PointFollower {
    size: (u32, u32),
    work: (u32, u32),
    previous: Option<Arc<Pyramid>>,
    live: Vec<Live>,
    done: Vec<PointTrack>,
    num_frames: u32,
    /// Per cell of the grid the first frame in which it may start a point again.
    rested: Vec<u32>,
}

/// Where at least so many of the points are found where their last steps lead, the others are hidden.
const MIN_NEAR: f64 = 0.5;
/// Frames for which a cell rests.
const REST: u32 = 2;

/// A point that is being followed; positions in pixels of the working size.
struct Live {
    first: u32,
    positions: Vec<Point2<f32>>,
}

impl Live {
    fn last(&self) -> Point2<f32> {
        self.positions.last().copied().unwrap_or_default()
    }

    /// Where the last step leads; `None` for a point that has made none.
    fn predicted(&self) -> Option<Point2<f32>> {
        let [.., before, last] = self.positions.as_slice() else { return None };
        Some(*last + (*last - *before))
    }
}

/// Through the whole pyramid.
const TRACKER: LucasKanade = LucasKanade {
    window_radius_px: WINDOW_RADIUS_PX,
    num_smaller: PYRAMID_LEVELS,
    max_steps: 12,
    converged_px: 0.03,
    min_eigenvalue: 1e-4,
};

impl PointFollower {
    /// Nothing seen yet; frames will have `size` (width, height).
    pub fn new(size: (u32, u32)) -> Self {
        let work = scale_to_fit(size.0, size.1, MAX_SIDE_PX);
        let (previous, live, done, rested) = (None, Vec::new(), Vec::new(), Vec::new());
        let mut follower = Self { size, work, previous, live, done, num_frames: 0, rested };
        let (cols, rows) = follower.grid();
        follower.rested = vec![0; cols * rows];
        follower
    }

    /// Takes the next frame. Frames must follow one another as in the source.
    ///
    /// # Errors
    /// [`PerceptionError::SizeMismatch`] for a frame of another size, [`PerceptionError::Image`] if OpenCV fails.
    pub fn push(&mut self, picture: &Picture) -> Result<(), PerceptionError> {
        let found = picture.rgb().dimensions();
        if found != self.size {
            let what = format!("frame {}", self.num_frames);
            return Err(PerceptionError::SizeMismatch { what, expected: self.size, found });
        }
        let is_whole = self.work == self.size;
        let pyramid = match is_whole {
            true => picture.pyramid(PYRAMID_LEVELS)?,
            false => {
                let smaller = resize_gray(&gray_from_rgb(picture.rgb())?, self.work.0, self.work.1)?;
                Arc::new(Pyramid::new(smaller, PYRAMID_LEVELS)?)
            }
        };
        if let Some(previous) = self.previous.take() {
            self.follow(&previous, &pyramid);
        }
        self.drop_crowded();
        match is_whole {
            true => self.find_new(picture.corners(&pyramid)),
            false => self.find_new(&CornerStrength::of(pyramid.picture())),
        }
        self.previous = Some(pyramid);
        self.num_frames += 1;
        Ok(())
    }

    /// All tracks of some length, in the order of their first frames.
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
            all.map(|returned| Some(returned.filter(|returned| self.is_found(returned))?.position)).collect()
        };
        // Where the last step leads, in the finest pictures alone; then where the point was, through the whole pyramid.
        let (known, predicted): (Vec<usize>, Vec<Point2<f32>>) =
            live.iter().enumerate().filter_map(|(k, point)| Some((k, point.predicted()?))).unzip();
        let near = step(TRACKER.near(), &known, &predicted);
        known.iter().zip(near).for_each(|(&k, position)| found[k] = position);
        let num_near = found.iter().flatten().count();
        let is_hidden = |k: usize| live[k].predicted().is_some() && num_near as f64 >= MIN_NEAR * known.len() as f64;
        let open: Vec<usize> = (0..live.len()).filter(|&k| found[k].is_none() && !is_hidden(k)).collect();
        let places: Vec<Point2<f32>> = open.iter().map(|&k| live[k].last()).collect();
        let anywhere = step(TRACKER, &open, &places);
        open.iter().zip(anywhere).for_each(|(&k, position)| found[k] = position);
        for (mut point, found) in live.into_iter().zip(found) {
            match found {
                Some(position) => {
                    point.positions.push(position);
                    self.live.push(point);
                }
                None => {
                    self.rest_after(&point);
                    self.end(point);
                }
            }
        }
    }

    /// Lets the cell of a point rest that was lost too soon.
    fn rest_after(&mut self, point: &Live) {
        if point.positions.len() < MIN_TRACK_LENGTH {
            let cell = self.cell(point.last());
            self.rested[cell] = self.num_frames + REST;
        }
    }

    /// Returns true if a point came back to where it was, and looks the same.
    fn is_found(&self, returned: &Returned) -> bool {
        let is_same = returned.round_trip_px <= MAX_ROUND_TRIP_PX && returned.difference <= MAX_DIFFERENCE;
        is_same && self.is_inside(returned.position)
    }

    fn is_inside(&self, position: Point2<f32>) -> bool {
        let inside = |x: f32, side: u32| x >= 1.5 && x <= side as f32 - 1.5;
        inside(position.x, self.work.0) && inside(position.y, self.work.1)
    }

    /// Of points that have come together, the one that was found first stays: others slid along an edge.
    fn drop_crowded(&mut self) {
        let bin_px = 0.3 * SPACING_PX as f32;
        let cols = (self.work.0 as f32 / bin_px) as usize + 1;
        let rows = (self.work.1 as f32 / bin_px) as usize + 1;
        let mut taken = vec![false; rows * cols];
        for point in std::mem::take(&mut self.live) {
            let last = point.last();
            let bin = (last.y / bin_px) as usize * cols + (last.x / bin_px) as usize;
            if std::mem::replace(&mut taken[bin.min(rows * cols - 1)], true) {
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
        let least = QUALITY * lower_quantile(&mut strengths, 0.9).unwrap_or(0.0) as f32;
        let taken = self.taken_cells();
        let is_free = |p: Point2<f32>| !taken[self.cell(p)] && self.rested[self.cell(p)] <= self.num_frames;
        let mut new: Vec<(Point2<f32>, f32)> =
            corners.into_iter().filter(|(p, s)| *s > least && *s > 1e-6 && is_free(*p)).collect();
        new.sort_by(|a, b| b.1.total_cmp(&a.1));
        let room = MAX_POINTS.saturating_sub(self.live.len());
        let first = self.num_frames;
        self.live.extend(new.into_iter().take(room).map(|(p, _)| Live { first, positions: vec![p] }));
    }

    /// The strongest place of every cell with its strength, row by row.
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

    fn taken_cells(&self) -> Vec<bool> {
        let (cols, rows) = self.grid();
        let mut taken = vec![false; cols * rows];
        for point in &self.live {
            taken[self.cell(point.last())] = true;
        }
        taken
    }

    fn grid(&self) -> (usize, usize) {
        let cells = |side: u32| side.div_ceil(SPACING_PX) as usize;
        (cells(self.work.0), cells(self.work.1))
    }

    fn cell(&self, p: Point2<f32>) -> usize {
        let (cols, rows) = self.grid();
        let spacing = SPACING_PX as f32;
        let at = |x: f32, cells: usize| ((x.max(0.0) / spacing) as usize).min(cells - 1);
        at(p.y, rows) * cols + at(p.x, cols)
    }

    /// Keeps what was seen often enough, in pixels of the whole frame.
    fn end(&mut self, point: Live) {
        if point.positions.len() < MIN_TRACK_LENGTH {
            return;
        }
        let scale = [self.size.0 as f32 / self.work.0 as f32, self.size.1 as f32 / self.work.1 as f32];
        let pixels = point.positions.iter().map(|p| [p.x * scale[0], p.y * scale[1]]).collect();
        self.done.push(PointTrack { first: point.first, pixels });
    }
}

#[cfg(test)]
mod tests;
