//! Long tracks of a video in pieces, so that a view costs the same however long the video is.
//!
//! Two views that see a common point have a block in the reduced system of bundle adjustment. Tracks that live for
//! hundreds of views, as of points far ahead, fill that system, and to factorise it then takes time with the cube of
//! the number of views. Cut in pieces, each a point of its own, they leave a band whose width does not grow.
//!
//! A piece must show its point from different sides, or the views in its middle see no point whose depth is known. So
//! only those views count towards its length between which the two-view geometry shows depth: while the camera stands,
//! hovers or turns on the spot, no track is cut.

use super::motion::{self, PairMotion};
use super::{Intrinsics, Options, initial_pair};
use crate::camera::Camera;
use crate::features::tracks::{Track, TrackTable};

/// Stretches that are judged as one, per length of a piece.
const STRETCHES: usize = 3;
/// A last piece with fewer features stays with the one before it.
const MIN_PIECE: usize = 4;

/// Cuts the tracks of views in time order after [`Options::max_track_views`] views that show depth; tables without
/// longer tracks, and those of views in no order, stay as they are.
///
/// The first piece of a track may be longer by up to a half, by another part for each track: else all that begin in one
/// view would end in one view, too, and nothing would hold the map together there.
pub fn cut_long_tracks(
    table: &mut TrackTable,
    cameras: &[Camera],
    intrinsics: Intrinsics,
    options: &Options,
    seed: u64,
) {
    let longest = options.max_track_views.max(MIN_PIECE);
    if !options.ordered || table.tracks.iter().all(|track| track.len() <= longest) {
        return;
    }
    let counts = views_that_count(table, cameras, intrinsics, options, seed);
    let before = table.tracks.len();
    let mut pieces = Vec::with_capacity(before);
    for (index, track) in std::mem::take(&mut table.tracks).into_iter().enumerate() {
        cut(track, [longest + extra(index, longest / 2), longest], &counts, &mut pieces);
    }
    pieces.sort_by_key(|piece| piece.first().copied());
    tracing::debug!(
        "{before} tracks in {} pieces; {} of {} views used",
        pieces.len(),
        counts.iter().filter(|&&c| c).count(),
        counts.len()
    );
    table.tracks = pieces;
}

/// Spreads indices evenly over 0..range: multiples of the golden ratio, of which neighbours lie far apart.
fn extra(index: usize, range: usize) -> usize {
    // 2³² divided by the golden ratio.
    ((u64::from((index as u32).wrapping_mul(0x9E37_79B9)) * range as u64) >> 32) as usize
}

/// Cuts a track into pieces: the first is over when `first` of its views have counted, every other after `later`.
fn cut(track: Track, [first, later]: [usize; 2], counts: &[bool], pieces: &mut Vec<Track>) {
    let (mut start, mut limit, mut counted) = (0, first, 0);
    for end in 1..=track.len() {
        counted += usize::from(counts[track[end - 1].view as usize]);
        if counted >= limit && track.len() - end >= MIN_PIECE {
            pieces.push(track[start..end].to_vec());
            (start, limit, counted) = (end, later, 0);
        }
    }
    pieces.push(if start == 0 { track } else { track[start..].to_vec() });
}

/// By view: whether it counts, which it does if the first and the last view of its stretch together show depth, or if
/// too few tracks reach from one to the other to tell.
fn views_that_count(
    table: &TrackTable,
    cameras: &[Camera],
    intrinsics: Intrinsics,
    options: &Options,
    seed: u64,
) -> Vec<bool> {
    let step = (options.max_track_views / STRETCHES).max(1);
    // Each stretch has its part of the angle, so that all stretches of a piece together have the whole.
    let min_angle = options.min_angle_deg.to_radians() / STRETCHES as f64;
    let mut counts = vec![true; table.views.len()];
    // The tracks that reach from the first view of a stretch to the first view of the next.
    for (views, tracks) in initial_pair::common_tracks(table, step, step, options.min_initial_inliers) {
        let shows_depth = !initial_pair::is_still(table, cameras, &tracks, views)
            && initial_pair::geometry_of(table, cameras, options, seed, views, &tracks).is_some_and(|geometry| {
                motion::of_pair(&geometry, intrinsics) == PairMotion::Other && geometry.median_angle >= min_angle
            });
        counts[views[0]..views[1]].fill(shows_depth);
    }
    // What is left at the end is too short to be judged, and counts like what is before it.
    let rest = counts.len().saturating_sub(1) / step * step;
    if let Some(&before) = rest.checked_sub(1).and_then(|last| counts.get(last)) {
        counts[rest..].fill(before);
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::tracks::Feature;

    fn track(views: std::ops::Range<u32>) -> Track {
        views.map(|view| Feature { view, feature: 0 }).collect()
    }

    fn lengths(track: Track, limits: [usize; 2], counts: &[bool]) -> Vec<usize> {
        let mut pieces = Vec::new();
        cut(track.clone(), limits, counts, &mut pieces);
        assert_eq!(pieces.concat(), track);
        pieces.iter().map(Vec::len).collect()
    }

    #[test]
    fn pieces_are_as_long_as_asked_and_lose_nothing() {
        let counts = [true; 60];
        assert_eq!(lengths(track(5..15), [10, 8], &counts), [10]);
        assert_eq!(lengths(track(0..40), [10, 8], &counts), [10, 8, 8, 8, 6]);
        // Three features more than a piece are not worth a point.
        assert_eq!(lengths(track(0..21), [10, 8], &counts), [10, 11]);
    }

    #[test]
    fn views_that_show_no_depth_do_not_count() {
        let counts: Vec<bool> = (0..60).map(|view| !(5..30).contains(&view)).collect();
        assert_eq!(lengths(track(0..60), [10, 10], &counts), [35, 10, 10, 5]);
        assert_eq!(lengths(track(5..30), [10, 10], &counts), [25]);
    }

    #[test]
    fn first_pieces_differ_from_track_to_track() {
        let mut seen = [0usize; 48];
        (0..480).for_each(|index| seen[extra(index, 48)] += 1);
        assert!(seen.iter().all(|&n| (8..=12).contains(&n)), "{seen:?}");
        assert_eq!(extra(7, 0), 0);
    }
}
