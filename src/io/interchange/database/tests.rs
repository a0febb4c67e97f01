use nalgebra::{Matrix3, Vector2, Vector3};
use rusqlite::types::Value;

use super::*;
use crate::camera::Camera;
use crate::io::testing::{model_with, odd_model};
use crate::scene::Point3dId;

fn written(model: &Reconstruction, features: &Features) -> (tempfile::TempDir, Connection) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("below/database.db");
    write(&path, model, features).unwrap();
    let connection = Connection::open(&path).unwrap();
    (folder, connection)
}

/// Two whole numbers and a blob of every row.
fn rows(connection: &Connection, query: &str) -> Vec<(i64, i64, Vec<u8>)> {
    let mut statement = connection.prepare(query).unwrap();
    let found = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?))).unwrap();
    found.map(Result::unwrap).collect()
}

fn doubles(bytes: &[u8]) -> Vec<f64> {
    bytes.as_chunks::<8>().0.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect()
}

fn indices(bytes: &[u8]) -> Vec<[u32; 2]> {
    bytes
        .as_chunks::<8>()
        .0
        .iter()
        .map(|b| [u32::from_le_bytes(b[..4].try_into().unwrap()), u32::from_le_bytes(b[4..].try_into().unwrap())])
        .collect()
}

fn ids(pair: i64) -> [ImageId; 2] {
    [ImageId((pair as u64 / MAX_IMAGES) as u32), ImageId((pair as u64 % MAX_IMAGES) as u32)]
}

#[test]
fn cameras_images_and_features_are_those_of_the_model() {
    let model = odd_model();
    let (_folder, connection) = written(&model, &Features::of(&model));
    let cameras = rows(&connection, "SELECT camera_id, model, params FROM cameras WHERE prior_focal_length = 1");
    assert_eq!(cameras.iter().map(|c| (c.0, c.1)).collect::<Vec<_>>(), [(1, 6), (2, 2), (3, 0)]);
    assert_eq!(doubles(&cameras[1].2), [710.0, 480.0, 270.0, -0.08]);
    let names: Vec<String> = {
        let mut statement = connection.prepare("SELECT name FROM images ORDER BY image_id").unwrap();
        statement.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
    };
    assert_eq!(names, model.images.values().map(|image| image.name.clone()).collect::<Vec<_>>());
    for (id, count, data) in rows(&connection, "SELECT image_id, rows, data FROM keypoints WHERE cols = 2") {
        let seen = &model.images[&ImageId(id as u32)].observations;
        let places: Vec<f32> = data.as_chunks::<4>().0.iter().map(|chunk| f32::from_le_bytes(*chunk)).collect();
        assert_eq!(count as usize, seen.len());
        assert_eq!(places, seen.iter().flat_map(|o| [o.pixel.x as f32, o.pixel.y as f32]).collect::<Vec<_>>());
    }
}

#[test]
fn matches_are_the_pairs_within_tracks_and_lie_on_their_epipolar_lines() {
    let model = odd_model();
    let (_folder, connection) = written(&model, &Features::of(&model));
    let matches = rows(&connection, "SELECT pair_id, rows, data FROM matches");
    let num_pairs: usize = model.points.values().map(|p| p.track.len() * (p.track.len() - 1) / 2).sum();
    assert_eq!(matches.iter().map(|m| m.1 as usize).sum::<usize>(), num_pairs);
    let point = |id: ImageId, index: u32| model.images[&id].observations[index as usize].point;
    for (pair, _, data) in &matches {
        let [a, b] = ids(*pair);
        assert!(a < b && indices(data).iter().all(|m| point(a, m[0]).is_some() && point(a, m[0]) == point(b, m[1])));
    }
    let geometries = rows(&connection, "SELECT pair_id, config, F FROM two_view_geometries");
    assert_eq!(geometries.len(), matches.len());
    for (pair, configuration, fundamental) in geometries {
        let fundamental = Matrix3::from_row_slice(&doubles(&fundamental));
        let [a, b] = ids(pair).map(|id| &model.images[&id]);
        for world in model.points.values().map(|point| point.position) {
            // The pixel of a camera without distortion.
            let flat = |image: &crate::scene::Image| {
                let p = image.cam_from_world * world;
                model.camera_of(image).matrix() * Vector3::new(p.x / p.z, p.y / p.z, 1.0)
            };
            let [x, y] = [flat(a), flat(b)];
            let line = fundamental * x;
            assert!((y.dot(&line) / line.xy().norm()).abs() < 1e-6);
        }
        assert!(configuration == 2 || configuration == 6);
    }
}

#[test]
fn a_pose_is_stored_as_colmap_stores_it() {
    let model = odd_model();
    let (_folder, connection) = written(&model, &Features::of(&model));
    let query = "SELECT pair_id, config, qvec FROM two_view_geometries";
    for (pair, _, quaternion) in rows(&connection, query) {
        let [a, b] = ids(pair).map(|id| model.images[&id].cam_from_world);
        let q = (b * a.inverse()).rotation;
        assert_eq!(doubles(&quaternion), [q.w, q.i, q.j, q.k]);
    }
    for (_, _, translation) in rows(&connection, &query.replace("qvec", "tvec")) {
        assert!((Vector3::from_row_slice(&doubles(&translation)).norm() - 1.0).abs() < 1e-12);
    }
}

/// Features of a run complement those of its model: an image without a pose has matches, and a fundamental matrix.
#[test]
fn images_without_a_pose_take_part() {
    let whole = model_with(&[Camera::with_focal(960, 540, 700.0)]);
    let all = Features::of(&whole);
    let lost = *whole.images.keys().last().unwrap();
    let mut model = whole.clone();
    model.images.remove(&lost);
    model.points.clear();
    let features = Features { tracks: Vec::new(), ..Features::of(&model) }.joined(all.clone()).unwrap();
    assert_eq!(features, all);
    let (_folder, connection) = written(&model, &features);
    let with_lost: Vec<_> = rows(&connection, "SELECT pair_id, config, ifnull(F, x'') FROM two_view_geometries")
        .into_iter()
        .filter(|(pair, ..)| ids(*pair)[1] == lost)
        .collect();
    // Six points are shared with the first image, and a fundamental matrix needs eight.
    assert!(with_lost.iter().all(|(_, configuration, _)| [3, 6].contains(configuration)));
    let stored: i64 = connection.query_row("SELECT count(*) FROM images", [], |row| row.get(0)).unwrap();
    assert_eq!(stored as usize, whole.images.len());
    let essential: Vec<Value> = connection
        .prepare("SELECT E FROM two_view_geometries")
        .unwrap()
        .query_map([], |row| row.get(0))
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert!(essential.contains(&Value::Null) != with_lost.is_empty());
    let mut other = all.clone();
    other.views.get_mut(&ImageId(1)).unwrap().name = "other.jpg".into();
    assert!(all.joined(other).is_none());
}

#[test]
fn a_feature_has_one_match_in_an_image() {
    let view = |n: usize| View { name: String::new(), camera: CameraId(1), pixels: vec![Point2::origin(); n] };
    let (a, b) = (view(3), view(3));
    let views = [(ImageId(1), &a), (ImageId(2), &b)].into();
    let element = |image, observation_idx| TrackElement { image: ImageId(image), observation_idx };
    let tracks = [[element(2, 0), element(1, 1)], [element(1, 1), element(2, 2)], [element(1, 2), element(2, 0)]];
    let outside = vec![element(1, 0), element(2, 3), element(7, 0)];
    let tracks: Vec<_> = tracks.into_iter().map(Vec::from).chain([outside]).collect();
    assert_eq!(matches::of_tracks(&views, &tracks), [([ImageId(1), ImageId(2)], vec![[1, 0]])].into());
}

/// A planar scene is explained by a homography and labeled as planar.
#[test]
fn a_planar_scene_is_called_planar() {
    let mut model = model_with(&[Camera::with_focal(960, 540, 700.0)]);
    let poses: BTreeMap<_, _> = model.images.iter().map(|(id, image)| (*id, image.cam_from_world)).collect();
    let camera = model.cameras[&CameraId(1)];
    for (k, point) in (0u8..).zip(model.points.values_mut()) {
        point.position = nalgebra::Point3::new(f64::from(k % 4) / 2.0 - 1.0, f64::from(k / 4) / 2.0 - 0.5, 0.0);
        for element in &point.track {
            let seen =
                &mut model.images.get_mut(&element.image).unwrap().observations[element.observation_idx as usize];
            seen.pixel = camera.pixel_from_cam(poses[&element.image] * point.position).unwrap();
        }
    }
    let (_folder, connection) = written(&model, &Features::of(&model));
    let found = rows(&connection, "SELECT pair_id, config, H FROM two_view_geometries");
    assert!(found.iter().all(|(_, configuration, _)| *configuration == 6));
    let (pair, _, homography) = &found[0];
    let homography = Matrix3::from_row_slice(&doubles(homography));
    let [a, b] = ids(*pair).map(|id| poses[&id]);
    let pixel = |pose: crate::math::Rigid3| camera.pixel_from_cam(pose * nalgebra::Point3::new(0.3, 0.2, 0.0)).unwrap();
    let moved = homography * pixel(a).coords.push(1.0);
    assert!((moved.xy() / moved.z - pixel(b).coords).norm() < 1e-6, "{}", Vector2::new(moved.x, moved.y));
}

#[test]
fn the_same_model_gives_the_same_bytes() {
    let model = odd_model();
    let folder = tempfile::tempdir().unwrap();
    let paths = ["a.db", "b.db"].map(|name| folder.path().join(name));
    paths.iter().for_each(|path| drop(write(path, &model, &Features::of(&model)).unwrap()));
    let [a, b] = paths.map(|path| std::fs::read(path).unwrap());
    assert!(a == b && a.starts_with(b"SQLite format 3"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "no journal stays");
}

#[test]
fn models_that_a_database_cannot_represent_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("database.db");
    let said = |model: &Reconstruction| write(&path, model, &Features::of(model)).unwrap_err().to_string();
    let model = odd_model();
    let mut empty = model.clone();
    empty.images.values_mut().for_each(|image| image.observations.clear());
    empty.points.clear();
    assert!(said(&empty).contains("without observations"));
    let mut far = model.clone();
    let image = far.images.pop_last().unwrap().1;
    far.images.insert(ImageId(u32::MAX), image);
    far.points.clear();
    assert!(said(&far).contains("below 2147483647"));
    let mut twice = model.clone();
    twice.images.values_mut().for_each(|image| image.name = "same.jpg".into());
    assert!(said(&twice).contains("the same name"));
    let mut nan = model.clone();
    nan.points.get_mut(&Point3dId(1)).unwrap().position.x = f64::NAN;
    assert!(said(&nan).contains("not finite"));
    let mut unknown = model;
    unknown.camera_forms.insert(CameraId(1), CameraForm::Unknown);
    assert!(said(&unknown).contains("no intrinsics"));
    assert!(!path.exists());
}
