//! Splitting of long tracks, so that the cost per view does not depend on the length of the video.
//!
//! Two views with a common point have a block in the reduced system of bundle adjustment. Tracks of hundreds of views,
//! as of points far ahead, fill that system, and its factorization takes time with the cube of the number of views.
//! Split into pieces, each a point of its own, they leave a band of constant width.
//!
//! A piece must observe its point from different directions, or the views in its middle observe no point of known
//! depth. So only views whose two-view geometry determines depth count towards its length: while the camera is
//! stationary, hovers or only rotates, no track is split.

use super::motion::{self, PairMotion};
use super::{Intrinsics, Options, initial_pair};
use crate::camera::Camera;
use crate::features::tracks::{Track, TrackTable};

/// Number of segments per maximum length of a piece; each is tested for depth as a whole.
const SEGMENTS: usize = 3;
/// Minimum number of features of a last piece; fewer stay with the piece before.
const MIN_PIECE: usize = 4;

/// Splits the tracks of ordered views after [`Options::max_track_views`] views with depth.
///
/// Tables without longer tracks, and those of unordered views, stay unchanged.
///
/// The first piece of a track may be longer by up to a half, by a different amount for each track. Otherwise all tracks
/// that begin in one view would also end in one view, and nothing would connect the map there.
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
    let counts = views_with_depth(table, cameras, intrinsics, options, seed);
    let before = table.tracks.len();
    let mut pieces = Vec::with_capacity(before);
    for (index, track) in std::mem::take(&mut table.tracks).into_iter().enumerate() {
        split_track(track, [longest + extra(index, longest / 2), longest], &counts, &mut pieces);
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

/// Spreads indices evenly over 0..range by multiples of the golden ratio, which puts neighbors far apart.
fn extra(index: usize, range: usize) -> usize {
    // 2³² divided by the golden ratio.
    ((u64::from((index as u32).wrapping_mul(0x9E37_79B9)) * range as u64) >> 32) as usize
}

/// Splits a track into pieces: the first after `first` counted views, every other after `later`.
fn split_track(track: Track, [first, later]: [usize; 2], counts: &[bool], pieces: &mut Vec<Track>) {
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

/// Views that count towards the length of a piece.
///
/// A view counts if the first and the last view of its segment determine depth, or if too few tracks connect these for
/// a test.
fn views_with_depth(
    table: &TrackTable,
    cameras: &[Camera],
    intrinsics: Intrinsics,
    options: &Options,
    seed: u64,
) -> Vec<bool> {
    let step = (options.max_track_views / SEGMENTS).max(1);
    // Each segment needs its part of the angle, so that all segments of a piece together have the whole.
    let min_angle = options.min_angle_deg.to_radians() / SEGMENTS as f64;
    let mut counts = vec![true; table.views.len()];
    // Tracks that reach from the first view of a segment to the first view of the next.
    for (views, tracks) in initial_pair::common_tracks(table, step, step, options.min_initial_inliers) {
        let has_depth = !initial_pair::has_no_displacement(table, cameras, &tracks, views)
            && initial_pair::geometry_of(table, cameras, options, seed, views, &tracks).is_some_and(|geometry| {
                motion::classify(&geometry, intrinsics) == PairMotion::General && geometry.median_angle >= min_angle
            });
        counts[views[0]..views[1]].fill(has_depth);
    }
    // The rest is too short for a test, and counts like the segment before it.
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
        split_track(track.clone(), limits, counts, &mut pieces);
        assert_eq!(pieces.concat(), track);
        pieces.iter().map(Vec::len).collect()
    }

    #[test]
    fn pieces_have_the_given_length_and_keep_all_features() {
        let counts = [true; 60];
        assert_eq!(lengths(track(5..15), [10, 8], &counts), [10]);
        assert_eq!(lengths(track(0..40), [10, 8], &counts), [10, 8, 8, 8, 6]);
        // Three features beyond a piece are too few for a point.
        assert_eq!(lengths(track(0..21), [10, 8], &counts), [10, 11]);
    }

    #[test]
    fn views_without_depth_do_not_count() {
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
