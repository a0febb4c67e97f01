//! Street with repeated façades, and a view that confuses their copies.

use super::*;

const CAMERA_FOCAL: f64 = 800.0;

/// Points in a layer in front of a street, between two positions along it.
fn along(from: f64, to: f64, count: usize, rng: &mut Rng) -> Vec<Point3<f64>> {
    let mut point =
        || Point3::new(rng.random_range(from..to), rng.random_range(8.0..12.0), rng.random_range(-2.5..2.5));
    (0..count).map(|_| point()).collect()
}

/// Views from a street, some units apart.
fn street(num_views: usize, step: f64) -> World {
    let pose = |k: usize| {
        let t = k as f64;
        let center = Point3::new(step * t, 0.3 * t.sin(), 0.2 * (0.7 * t).cos());
        look_at(center, center + Vector3::new(0.5 * (1.3 * t).sin(), 10.0, 0.0))
    };
    let camera = Camera::with_focal(960, 540, CAMERA_FOCAL);
    World { camera, poses: (0..num_views).map(pose).collect(), points: Vec::new() }
}

/// Table to which tracks are added, by the point that each view takes for the same.
struct TableBuilder<'a> {
    world: &'a World,
    table: TrackTable,
    rng: Rng,
}

impl<'a> TableBuilder<'a> {
    fn new(world: &'a World) -> Self {
        let mut rng = seeded_rng(9, 0);
        Self { world, table: tracks(world, 0.0, 0, &mut rng), rng }
    }

    fn add(&mut self, seen: impl Iterator<Item = (usize, Point3<f64>)>) {
        let normal = Normal::new(0.0, 0.2).unwrap();
        let mut track = Track::new();
        for (view, point) in seen {
            let camera = &self.world.camera;
            let pixel = camera.pixel_from_cam(self.world.poses[view] * point).filter(|p| camera.contains(*p));
            let Some(pixel) = pixel else { continue };
            let source = &mut self.table.views[view];
            track.push(Feature { view: view as u32, feature: source.pixels.len() as u32 });
            source.pixels.push(pixel + nalgebra::Vector2::from_fn(|_, _| normal.sample(&mut self.rng)));
            source.rgb.push([120; 3]);
        }
        if track.len() >= 2 {
            self.table.tracks.push(track);
        }
    }

    fn reconstructed(&self) -> (Reconstruction, Report) {
        let options = Options { ordered: false, ..Options::background() };
        reconstruct(&self.table, &[self.world.camera], Intrinsics::FIXED, &options, 1).unwrap()
    }
}

#[test]
fn a_view_at_the_wrong_copy_is_moved_to_the_right_one() {
    const CONFUSED: usize = 20;
    let world = street(24, 0.9);
    let mut rng = seeded_rng(8, 0);
    let mut builder = TableBuilder::new(&world);
    for point in along(-6.0, 26.0, 500, &mut rng) {
        builder.add((0..24).map(|view| (view, point)));
    }
    for (k, point) in along(-2.0, 6.0, 220, &mut rng).into_iter().enumerate() {
        // Half of the features of the confused view on the copy are matched to the first.
        let copy = point + Vector3::new(15.0, 0.0, 0.0);
        let first = (0..14).map(|view| (view, point));
        builder.add(first.chain((k % 2 == 0).then_some((CONFUSED, copy))));
        builder.add((14..24).filter(|&view| view != CONFUSED).map(|view| (view, copy)));
    }
    let (found, report) = builder.reconstructed();
    assert_eq!(report.num_registered(), 24);
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
}

#[test]
fn a_view_without_a_consistent_pose_is_rejected_and_the_others_stay() {
    const CONFUSED: usize = 9;
    const COPIES: [f64; 3] = [0.0, 15.0, 30.0];
    let world = street(18, 2.0);
    let mut rng = seeded_rng(8, 1);
    let mut builder = TableBuilder::new(&world);
    for point in along(-6.0, 42.0, 900, &mut rng) {
        builder.add((0..18).filter(|&view| view != CONFUSED).map(|view| (view, point)));
    }
    for (k, point) in along(-2.0, 6.0, 360, &mut rng).into_iter().enumerate() {
        let copies = COPIES.map(|x| point + Vector3::new(x, 0.0, 0.0));
        for (c, copy) in copies.iter().enumerate() {
            // It observes the copy in the middle, and matches a third of its points to each.
            let others = (0..18).filter(|&view| view != CONFUSED).map(|view| (view, *copy));
            builder.add(others.chain((k % 3 == c).then_some((CONFUSED, copies[1]))));
        }
    }
    let (found, report) = builder.reconstructed();
    let failures: Vec<_> = report.failures().collect();
    assert!(matches!(failures[..], [("000009.jpg", Reason::Contradicted { .. })]), "{failures:?}");
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
}

#[test]
fn a_view_without_known_points_in_common_with_its_true_neighbors_is_rejected() {
    const CONFUSED: usize = 20;
    let world = street(24, 0.9);
    let mut rng = seeded_rng(8, 2);
    let mut builder = TableBuilder::new(&world);
    for point in along(-6.0, 26.0, 500, &mut rng) {
        builder.add((0..24).filter(|&view| view != CONFUSED).map(|view| (view, point)));
    }
    // No other view observes the points that it shares with each of its neighbors, so the map lacks them.
    for neighbor in (16..24).filter(|&view| view != CONFUSED) {
        for point in along(12.0, 24.0, 160, &mut rng) {
            builder.add([neighbor, CONFUSED].map(|view| (view, point)).into_iter());
        }
    }
    // Some windows are matched to those at the beginning of the street.
    for point in along(0.0, 6.0, 90, &mut rng) {
        let copy = point + Vector3::new(15.0, 0.0, 0.0);
        builder.add((1..6).map(|view| (view, point)).chain([(CONFUSED, copy)]));
    }
    let (found, report) = builder.reconstructed();
    let failures: Vec<_> = report.failures().collect();
    assert!(matches!(failures[..], [("000020.jpg", Reason::Contradicted { .. })]), "{failures:?}");
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
}

/// Reconstruction with a view whose bricks are matched to those one row lower, a quarter of a unit away, of two far
/// views.
///
/// It shares points with each of its neighbors, and `known` ones with each of five pairs of them, fewer than the
/// bricks.
fn with_a_wrong_row(known: usize) -> (Reconstruction, Report, World) {
    const CONFUSED: usize = 20;
    const WRONG: usize = 240;
    let world = street(24, 0.9);
    let mut rng = seeded_rng(8, 3);
    let mut builder = TableBuilder::new(&world);
    for point in along(-6.0, 26.0, 500, &mut rng) {
        builder.add((0..24).filter(|&view| view != CONFUSED).map(|view| (view, point)));
    }
    for neighbor in (15..24).filter(|&view| view != CONFUSED) {
        for point in along(14.0, 22.0, 160, &mut rng) {
            builder.add([neighbor, CONFUSED].map(|view| (view, point)).into_iter());
        }
    }
    for neighbor in [16, 17, 18, 21, 22] {
        for point in along(14.0, 22.0, known, &mut rng) {
            builder.add([neighbor, neighbor + 1, CONFUSED].map(|view| (view, point)).into_iter());
        }
    }
    for point in along(12.0, 16.0, WRONG, &mut rng) {
        let row = point - Vector3::new(0.0, 0.0, 0.25);
        builder.add([(11, row), (12, row), (CONFUSED, point)].into_iter());
    }
    let (found, report) = builder.reconstructed();
    (found, report, world)
}

#[test]
fn a_view_a_row_of_bricks_away_is_rejected() {
    let (found, report, world) = with_a_wrong_row(0);
    let failures: Vec<_> = report.failures().collect();
    assert!(matches!(failures[..], [("000020.jpg", Reason::Contradicted { .. })]), "{failures:?}");
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
}

#[test]
fn a_view_a_row_of_bricks_away_is_corrected_by_enough_known_points() {
    let (found, report, world) = with_a_wrong_row(25);
    assert_eq!(report.num_registered(), 24, "{:?}", report.failures().collect::<Vec<_>>());
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
}
