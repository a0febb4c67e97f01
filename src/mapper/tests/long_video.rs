//! Tracks far longer than the pieces into which they are split.

use super::motion::{camera, landscape_along, observed_by_all};
use super::*;

/// Poses of a camera that looks aside: flying, stationary and flying again, for some views each.
fn flight(counts: [usize; 3]) -> Vec<Rigid3> {
    const STEP: f64 = 0.1;
    let [before, stationary, after] = counts;
    let center = |x: f64| Point3::new(x, 0.3 * (0.7 * x).sin(), 0.2 * (0.4 * x).cos());
    let at = |x: f64| Rigid3::from_rotation_and_center(UnitQuaternion::identity(), center(x));
    let step_index = |view: usize| view.min(before) + view.saturating_sub(before + stationary);
    (0..before + stationary + after).map(|view| at(STEP * step_index(view) as f64)).collect()
}

fn options() -> Options {
    Options { max_track_views: 24, ..Options::background() }
}

fn split(table: &TrackTable) -> TrackTable {
    let mut table = table.clone();
    cut_long_tracks(&mut table, &[camera()], Intrinsics::FIXED, &options(), 1);
    table
}

fn mapped(table: &TrackTable, poses: &[Rigid3]) -> (Report, f64) {
    let (found, report) = reconstruct(table, &[camera()], Intrinsics::FIXED, &options(), 1).unwrap();
    let truth = World { camera: camera(), poses: poses.to_vec(), points: Vec::new() };
    (report, center_error(&found, &truth))
}

fn longest(table: &TrackTable) -> usize {
    table.tracks.iter().map(Vec::len).max().unwrap_or(0)
}

#[test]
fn a_video_of_split_tracks_is_one_map() {
    let poses = flight([150, 0, 0]);
    let whole = observed_by_all(&camera(), &poses, &landscape_along(15.0), 0.2);
    let pieces = split(&whole);
    assert_eq!(pieces.num_observations(), whole.num_observations());
    // A first piece is longer by up to a half, a last one by three.
    assert!(longest(&whole) > 120 && longest(&pieces) <= 24 + 12 + 3, "{} {}", longest(&whole), longest(&pieces));
    assert!(pieces.tracks.is_sorted_by_key(|t| t[0]) && pieces.tracks.iter().all(|t| t.is_sorted()));
    let ((report_of_whole, whole), (report_of_pieces, pieces)) = (mapped(&whole, &poses), mapped(&pieces, &poses));
    assert_eq!([report_of_whole.num_registered(), report_of_pieces.num_registered()], [150; 2]);
    // Independent noise is the worst case of a split, which may cost at most a quarter of that error.
    assert!(pieces < 1.25 * whole, "{pieces} {whole}");
}

#[test]
fn no_track_is_split_while_the_camera_is_stationary() {
    let poses = flight([50, 60, 50]);
    let whole = observed_by_all(&camera(), &poses, &landscape_along(10.0), 0.1);
    let pieces = split(&whole);
    // Segments of eight views are tested; two of them are half stationary and half moving.
    let begins_stationary = |track: &&Track| (57..104).contains(&track[0].view);
    assert!(pieces.tracks.len() > whole.tracks.len() && !pieces.tracks.iter().any(|t| begins_stationary(&t)));
    let (report, error) = mapped(&pieces, &poses);
    assert_eq!(report.num_registered(), 160);
    // 0.1 px at 900 px focal length and 15 units distance are 1.7 thousandths; hundreds of points average that down.
    assert!(error < 0.002, "{error}");
}

#[test]
fn more_views_than_are_adjusted_at_once_are_as_exact() {
    // Without rotations the motion would not determine the focal length.
    let turned = |pose: &Rigid3| {
        let center = pose.center();
        let turn = Vector3::new((0.5 * center.x).sin(), (0.3 * center.x).cos(), (0.9 * center.x).sin()) * 0.1;
        Rigid3::from_rotation_and_center(UnitQuaternion::from_scaled_axis(turn), center)
    };
    let poses: Vec<Rigid3> = flight([1000, 0, 0]).iter().map(turned).collect();
    let shifted = |part: u32| landscape_along(25.0).into_iter().map(move |p| p + 25.0 * f64::from(part) * Vector3::x());
    let points: Vec<_> = (0..4).flat_map(shifted).collect();
    let mut table = observed_by_all(&camera(), &poses, &points, 0.2);
    let (options, guess) = (Options::background(), Camera::prior(960, 540));
    cut_long_tracks(&mut table, &[guess], Intrinsics::GUESSED, &options, 1);
    let (found, report) = reconstruct(&table, &[guess], Intrinsics::GUESSED, &options, 1).unwrap();
    assert_eq!(report.num_registered(), 1000);
    let focal = found.cameras.values().next().unwrap().mean_focal();
    let deviation = report.focal_deviation().unwrap();
    assert!((focal / 900.0 - 1.0).abs() < 3.0 * deviation && deviation < 0.01, "{focal} {deviation}");
    let error = center_error(&found, &World { camera: camera(), poses, points: Vec::new() });
    assert!(error < 0.05, "{error}");
}
