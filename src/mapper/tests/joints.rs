//! Tracks with right and wrong re-detections after a gap.

use super::*;

/// Adds features of a point in some views to the table.
fn add_features(
    world: &World,
    table: &mut TrackTable,
    point: usize,
    views: std::ops::Range<usize>,
    rng: &mut Rng,
) -> Track {
    let normal = Normal::new(0.0, 0.3).unwrap();
    let mut track = Track::new();
    for view in views {
        let Some(pixel) = world.camera.pixel_from_cam(world.poses[view] * world.points[point]) else { continue };
        let source = &mut table.views[view];
        track.push(Feature { view: view as u32, feature: source.pixels.len() as u32 });
        source.pixels.push(pixel + nalgebra::Vector2::new(normal.sample(rng), normal.sample(rng)));
        source.rgb.push([120; 3]);
    }
    track
}

#[test]
fn wrong_redetections_are_split() {
    let world = world(40, 600);
    let mut table = tracks(&world, 0.3, 0, &mut seeded_rng(2, 0));
    // Every sixth track continues as another one that begins after its end.
    let (mut kept, mut num_wrong): (Vec<Track>, usize) = (Vec::new(), 0);
    for (index, track) in std::mem::take(&mut table.tracks).into_iter().enumerate() {
        let follows = |end: &Track| end.last().zip(track.first()).is_some_and(|(a, b)| b.view > a.view + 3);
        let before = kept.iter_mut().filter(|_| index % 6 == 0).find(|before| follows(before));
        match before {
            Some(before) => {
                before.extend(track);
                num_wrong += 1;
            }
            None => kept.push(track),
        }
    }
    table.tracks = kept;
    assert!(num_wrong > 40, "{num_wrong}");
    let options = Options::background();
    let (found, report) = reconstruct(&table, &[world.camera], Intrinsics::FIXED, &options, 1).unwrap();
    assert_eq!(report.num_registered(), 40);
    assert!(center_error(&found, &world) < 0.01, "{}", center_error(&found, &world));
    // Both parts of nearly every wrong re-detection have a point.
    assert!(found.points.len() > 560, "{}", found.points.len());
}

#[test]
fn a_loop_closure_removes_the_drift() {
    // Two rounds of 126 views each.
    let world = world(252, 4000);
    let mut table = tracks_over(8, &world, 0.3, 0, &mut seeded_rng(3, 0));
    let error = |table: &TrackTable| {
        let options = Options { max_track_views: 24, min_initial_inliers: 30, ..Options::background() };
        let (found, report) = reconstruct(table, &[world.camera], Intrinsics::FIXED, &options, 1).unwrap();
        assert_eq!(report.num_registered(), 252);
        center_error(&found, &world)
    };
    let open = error(&table);
    let rng = &mut seeded_rng(4, 0);
    for index in 0..table.tracks.len() {
        let Some(&first) = table.tracks[index].first() else { continue };
        let again = first.view as usize + 126;
        if (20..24).contains(&(first.view % 40)) && again + 4 <= 252 {
            let more = add_features(&world, &mut table, index, again..again + 4, rng);
            table.tracks[index].extend(more);
        }
    }
    let closed = error(&table);
    assert!(closed < 0.7 * open, "{closed} {open}");
}
