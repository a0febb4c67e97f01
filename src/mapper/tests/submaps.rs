//! Views that no single resection brings to the map.

use super::*;

const GAP: std::ops::Range<usize> = 24..30;

/// Two stretches of tracks with a gap between; of the tracks that begin before it `num_ties` are found again behind it,
/// each in three views only, so that no view behind it sees many of them. Of these `wrong` are other points.
fn broken(world: &World, num_ties: usize, wrong: usize) -> TrackTable {
    let mut table = tracks_over(12, world, 0.2, 0, &mut seeded_rng(2, 0));
    let is_before = |track: &Track| track.last().is_some_and(|f| (f.view as usize) < GAP.start);
    for track in &mut table.tracks {
        // Of a track that reaches into the gap the longer part stays.
        let behind: Track = track.iter().filter(|f| f.view as usize >= GAP.end).copied().collect();
        track.retain(|f| (f.view as usize) < GAP.start);
        if behind.len() > track.len() {
            *track = behind;
        }
    }
    table.tracks.retain(|track| track.len() >= 4);
    let mut rng = seeded_rng(5, 0);
    let all = table.tracks.len();
    let before: Vec<usize> = (0..all).filter(|&t| is_before(&table.tracks[t])).take(num_ties).collect();
    for (k, &track) in before.iter().enumerate() {
        let seen = table.tracks[track][0];
        let pixel = table.pixel(seen);
        let nearest = |p: &&Point3<f64>| {
            let at = world.camera.pixel_from_cam(world.poses[seen.view as usize] * **p);
            at.map_or(i64::MAX, |at| ((at - pixel).norm() * 1e6) as i64)
        };
        let right = *world.points.iter().min_by_key(nearest).unwrap();
        let off = Vector3::from_fn(|_, _| rng.random_range(-1.5..1.5));
        let point = if k < wrong { right + off } else { right };
        // Three views of four for each, spread over the stretch.
        let first = GAP.end + k * 3 % (world.poses.len() - GAP.end - 4);
        for view in [first, first + 1, first + 3] {
            let Some(mut pixel) = world.camera.pixel_from_cam(world.poses[view] * point) else { continue };
            pixel += nalgebra::Vector2::new(rng.random_range(-0.3..0.3), rng.random_range(-0.3..0.3));
            let source = &mut table.views[view];
            table.tracks[track].push(Feature { view: view as u32, feature: source.pixels.len() as u32 });
            source.pixels.push(pixel);
            source.rgb.push([120; 3]);
        }
    }
    table
}

fn mapped(table: &TrackTable, world: &World) -> (Reconstruction, Report) {
    let options = Options { min_initial_inliers: 30, ..Options::background() };
    reconstruct(table, &[world.camera], Intrinsics::FIXED, &options, 1).unwrap()
}

#[test]
fn a_map_behind_a_gap_is_joined_by_what_all_its_views_see_together() {
    let world = world(60, 1200);
    let table = broken(&world, 60, 12);
    let seen_in = |view: usize| {
        let is_tie = |track: &&Track| track[0].view < GAP.start as u32 && track.iter().any(|f| f.view as usize == view);
        table.tracks.iter().filter(is_tie).count()
    };
    let most = (GAP.end..60).map(seen_in).max().unwrap();
    assert!(most < Options::background().min_resection_inliers, "{most}");
    let (found, report) = mapped(&table, &world);
    let registered: Vec<bool> = report.views.iter().map(|view| view.failure.is_none()).collect();
    assert!((0..60).all(|view| registered[view] != GAP.contains(&view)), "{:?}", report.failures().collect::<Vec<_>>());
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
    let (again, _) = mapped(&table, &world);
    assert_eq!(found, again);
}

#[test]
fn a_map_that_nothing_ties_stays_apart_and_says_so() {
    let world = world(60, 1200);
    // Nothing at all, too little, and ties of which most are wrong.
    for (num_ties, wrong) in [(0, 0), (12, 0), (50, 40)] {
        let table = broken(&world, num_ties, wrong);
        let (found, report) = mapped(&table, &world);
        let error = center_error(&found, &world);
        assert!(error < 0.02, "{num_ties}: {error}");
        let own: Vec<(&str, &Reason)> =
            report.failures().filter(|(_, reason)| matches!(reason, Reason::OwnMap { .. })).collect();
        assert!(own.len() >= 20, "{num_ties}: {:?}", report.failures().collect::<Vec<_>>());
        let Reason::OwnMap { ends, views, shared, agreeing, needed } = own[0].1 else { unreachable!() };
        assert!(*views == own.len() && agreeing < needed && *shared <= num_ties, "{:?}", own[0]);
        assert!(ends[0].as_str() == own[0].0 && ends[1].as_str() == own[own.len() - 1].0);
        assert!(own[0].1.to_string().contains("separate map"));
    }
}
