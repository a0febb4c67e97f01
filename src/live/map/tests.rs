use nalgebra::{Point2, Point3, Vector3};

use super::*;
use crate::features::lines::ImageLines;
use crate::features::tracks::Feature;
use crate::math::{seeded_rng, umeyama};
use crate::scene::{ImageId, TrackElement};
use crate::synthetic::scene::{self, CameraMotion, static_scene};
use crate::telemetry::{Geodetic, LocalFrame};

/// Window of a scene: its images and tracks.
fn snapshot(scene: &Reconstruction, views: std::ops::Range<u32>) -> Snapshot {
    let images: Vec<_> = views.map(|k| (ImageId(k + 1), &scene.images[&ImageId(k + 1)])).collect();
    let mut table = TrackTable::default();
    for (id, image) in &images {
        let pixels: Vec<_> = image.observations.iter().map(|seen| seen.pixel).collect();
        let (rgb, whitening) = (vec![[0; 3]; pixels.len()], Vec::new());
        table.views.push(View { image: *id, name: image.name.clone(), camera: 0, pixels, rgb, whitening });
    }
    for point in scene.points.values() {
        let place = |image: ImageId| images.iter().position(|(id, _)| *id == image);
        let feature = |e: &TrackElement| Some(Feature { view: place(e.image)? as u32, feature: e.observation_idx });
        table.tracks.push(point.track.iter().filter_map(feature).collect());
    }
    let frame = |(id, image): &(ImageId, &Image)| Frame {
        id: id.frame(),
        name: image.name.clone(),
        time_s: 0.1 * f64::from(id.0),
    };
    let frames: Vec<Frame> = images.iter().map(frame).collect();
    // Every third is a keyframe, in all windows.
    let is_key = frames.iter().map(|frame| frame.id.0 % 3 == 0).collect();
    Snapshot {
        table,
        frames,
        is_key,
        poses: BTreeMap::new(),
        vehicles: Vec::new(),
        lines: Vec::new(),
        purpose: Purpose::Final,
    }
}

fn flight() -> scene::Options {
    let path = CameraMotion::Flight;
    scene::Options { num_images: 60, num_points: 4000, path, noise_px: 0.1, ..scene::Options::default() }
}

#[test]
fn maps_continue_in_the_frame_of_the_first() {
    let options = flight();
    let scene = static_scene(&options);
    let mut mapper = Mapper::new(&Options::default(), options.camera, Intrinsics::FIXED, None);
    let mut maps: Vec<WorldMap> = Vec::new();
    for begin in [0, 10, 20] {
        let mut snapshot = snapshot(&scene, begin..begin + 40);
        let images = maps.iter().flat_map(|map| &map.model.images);
        snapshot.poses = images.map(|(id, image)| (id.frame(), image.cam_from_world)).collect();
        maps.push(mapper.update(&snapshot).unwrap().expect("a map"));
    }
    assert_eq!(maps.iter().map(|map| map.is_continued).collect::<Vec<_>>(), [false, true, true]);
    assert!(maps.iter().all(|map| map.model.images.len() == 40), "the others are registered");
    // From the true frame to that of the first map, by its cameras; the last ones were not among them.
    let center = |model: &Reconstruction, k: u32| model.images[&ImageId(k + 1)].cam_from_world.center();
    let (from, to): (Vec<_>, Vec<_>) = scene
        .points
        .values()
        .filter_map(|point| {
            let e = point.track.first()?;
            let seen = maps[0].model.images.get(&e.image)?.observations[e.observation_idx as usize].point?;
            Some((point.position, maps[0].model.points[&seen].position))
        })
        .unzip();
    let first_from_true = umeyama(&from, &to).unwrap();
    let error = (center(&maps[2].model, 59) - first_from_true * center(&scene, 59)).norm();
    let length = first_from_true.scale * (center(&scene, 59) - center(&scene, 0)).norm();
    assert!(error < 0.02 * length, "{error} of {length}");
    assert!(maps[2].line.drift_std > 0.0 && maps[0].line.drift_std == 0.0);
    let far = mapper.update(&snapshot(&static_scene(&scene::Options { seed: 5, ..options }), 0..3)).unwrap();
    assert!(far.is_err(), "three views are no map");
}

/// A window of the views of a camera over a plane, with the poses of earlier maps.
fn window(table: &TrackTable, views: std::ops::Range<usize>, maps: &[&WorldMap]) -> Snapshot {
    let count = views.len();
    let mut table = sub_table(table, &views.collect::<Vec<_>>(), 1);
    table.views.iter_mut().for_each(|view| view.rgb = vec![[0; 3]; view.pixels.len()]);
    let frame = |view: &View| {
        let id = view.image.frame();
        Frame { id, name: view.name.clone(), time_s: 0.1 * f64::from(id.0) }
    };
    let frames: Vec<Frame> = table.views.iter().map(frame).collect();
    let is_key = (0..count).map(|view| view % 3 == 0).collect();
    let images = maps.iter().flat_map(|map| &map.model.images);
    let poses = images.map(|(id, image)| (id.frame(), image.cam_from_world)).collect();
    Snapshot { table, frames, is_key, poses, vehicles: Vec::new(), lines: Vec::new(), purpose: Purpose::Revision }
}

/// A camera 40 m above a plane with an inclination of 90° minus 0.5.
const HEIGHT_M: f64 = 40.0;

fn mapper_of(camera: Camera, pitch_std: Option<f64>) -> Mapper {
    let pitch = std::f64::consts::FRAC_PI_2 - 0.5;
    let mut options = Options::default();
    options.metric.camera_pitch = pitch_std.and_then(|std| Measured::new(pitch.to_degrees(), std));
    Mapper::new(&options, camera, Intrinsics::FIXED, None)
}

fn centers_m(map: &WorldMap) -> Vec<Vector3<f64>> {
    map.model.images.values().map(|image| image.cam_from_world.center().coords * HEIGHT_M).collect()
}

#[test]
fn the_ground_is_the_map_of_a_camera_that_hovers() {
    let sway = |phase: f64| Vector3::new(phase.sin(), 0.0, 0.5 * phase.sin()) * 0.1;
    let (table, camera, rotations) = crate::mapper::views_along(sway);
    let mut mapper = mapper_of(camera, Some(0.5));
    let first = mapper.update(&window(&table, 0..30, &[])).unwrap().expect("a map");
    let second = mapper.update(&window(&table, 0..60, &[&first])).unwrap().expect("a map");
    assert!(first.line.is_hovering && second.line.is_hovering);
    assert_eq!((first.is_continued, second.is_continued), (false, true));
    assert_eq!((first.model.images.len(), second.model.images.len()), (30, 60));
    // Axes are those of the first camera.
    let centers = centers_m(&second);
    let off_m = |(view, center): (usize, &Vector3<f64>)| {
        let truth = rotations[0] * (sway(view as f64 / 10.0) - sway(0.0));
        (center - centers[0] - truth).norm()
    };
    let mean_m = centers.iter().enumerate().map(off_m).sum::<f64>() / 60.0;
    assert!(mean_m < 0.04, "{mean_m}");
    let up = rotations[0] * -Vector3::z();
    assert!(second.frame.metric_from_world().rotation.inverse().transform_vector(&Vector3::z()).angle(&up) < 0.01);
    // No view of the window has a pose, and the camera has turned since its inclination was stated.
    let mut later = window(&table, 40..60, &[]);
    assert_eq!(mapper.update(&later).unwrap().err(), Some(NoMap::Inclination));
    let segments = crate::mapper::street(&camera, &(rotations[45] * -Vector3::z()), 0.0, &mut seeded_rng(1, 0));
    later.lines.push(ImageLines { image: later.table.views[5].image, segments });
    let new = mapper.update(&later).unwrap().expect("a map");
    assert!(new.line.is_hovering && !new.is_continued && new.model.images.len() == 20);
    let up = rotations[40] * -Vector3::z();
    assert!(new.frame.metric_from_world().rotation.inverse().transform_vector(&Vector3::z()).angle(&up) < 0.03);
    let at_rest = crate::mapper::views_along(|_| Vector3::zeros()).0;
    let lost = mapper_of(camera, None).update(&window(&at_rest, 0..30, &[]));
    assert_eq!(lost.unwrap().err(), Some(NoMap::Inclination));
}

/// A camera that hovers for three seconds, then flies, to the side of its view.
fn departure(phase: f64) -> Vector3<f64> {
    Vector3::new(0.0, -8.0 * (phase - 3.0).max(0.0), 0.0)
}

/// The last map of a camera that departs.
fn departed(mapper: &mut Mapper, table: &TrackTable) -> WorldMap {
    let mut last = mapper.update(&window(table, 0..30, &[])).unwrap().expect("a map");
    assert!(last.line.is_hovering);
    for until in [36, 42, 48, 54, 60] {
        if let Ok(map) = mapper.update(&window(table, 0..until, &[&last])).unwrap() {
            assert!(map.is_continued, "{until}");
            last = map;
        }
    }
    assert!(!last.line.is_hovering);
    last
}

#[test]
fn a_camera_that_departs_stays_in_its_local_frame() {
    let (table, camera, rotations) = crate::mapper::views_along(departure);
    let last = departed(&mut mapper_of(camera, Some(0.5)), &table);
    let (_, image) = last.model.images.last_key_value().unwrap();
    let (found, truth) = (image.cam_from_world.center().coords * HEIGHT_M, rotations[0] * departure(5.9));
    assert!((found - truth).norm() < 0.03 * truth.norm(), "{found} {truth}");
}

#[test]
fn points_of_a_map_hold_when_the_camera_departs() {
    let (table, camera, rotations) = crate::mapper::views_along(departure);
    let map = LocalFrame::at(Geodetic { longitude_deg: 9.0, latitude_deg: 48.0, height_m: 0.0 });
    let picked = [[200.0, 200.0], [1100.0, 180.0], [1000.0, 600.0], [250.0, 650.0], [600.0, 400.0]];
    let features = picked.map(|[x, y]| {
        let ray = rotations[0].inverse() * camera.ray_from_pixel(Point2::new(x, y));
        // Axes of the scene point right, back and down.
        let place = map.to_geodetic(Point3::new(ray.x, -ray.y, 0.0) * (HEIGHT_M / ray.z));
        serde_json::json!({
            "type": "Feature",
            "geometry": { "type": "Point", "coordinates": [place.longitude_deg, place.latitude_deg] },
            "properties": { "x": x, "y": y },
        })
    });
    let file = tempfile::NamedTempFile::new().unwrap();
    let content = serde_json::json!({ "type": "FeatureCollection", "features": features });
    std::fs::write(file.path(), content.to_string()).unwrap();
    let mut mapper = mapper_of(camera, None);
    mapper.options.metric.map_points = Some(file.path().to_owned());
    let last = departed(&mut mapper, &table);
    assert!(last.is_metric && (last.frame.scale / HEIGHT_M).ln().abs() < 0.05, "{}", last.frame.scale);
    let center = last.model.images.last_key_value().unwrap().1.cam_from_world.center();
    let geo = last.geo(&georeference::camera(center)).expect("a position on the map");
    let (longitude_deg, latitude_deg) = (geo.longitude, geo.latitude);
    let found = map.from_geodetic(Geodetic { longitude_deg, latitude_deg, height_m: 0.0 });
    let (truth, off_m) = (departure(5.9), 3.0 * geo.horizontal_std);
    assert!((found.x - truth.x).hypot(found.y + truth.y) < off_m && off_m < 5.0, "{found} {truth} {off_m}");
}

#[test]
fn a_camera_that_stops_stays_in_its_local_frame() {
    let path = |phase: f64| Vector3::new(0.0, 8.0 * (3.0 - phase).max(0.0), 0.0);
    let (table, camera, rotations) = crate::mapper::views_along(path);
    let mut mapper = mapper_of(camera, None);
    let first = mapper.update(&window(&table, 0..40, &[])).unwrap().expect("a map");
    assert!(!first.line.is_hovering);
    let second = mapper.update(&window(&table, 31..60, &[&first])).unwrap().expect("a map");
    assert!(second.line.is_hovering && second.is_continued && second.model.images.len() == 29);
    let up = rotations[0] * -Vector3::z();
    let found = second.frame.metric_from_world().rotation.inverse().transform_vector(&Vector3::z());
    assert!(found.angle(&up) < 0.02, "{}", found.angle(&up));
}
