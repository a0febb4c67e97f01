//! Database tables and their rows.

use nalgebra::Matrix3;
use rusqlite::{Connection, Transaction, params};

use super::geometry::TwoViewGeometry;
use super::{MAX_IMAGES, View};
use crate::camera::Camera;
use crate::io::interchange::colmap::written_camera;
use crate::math::Rigid3;
use crate::scene::{CameraId, ImageId, Reconstruction};

/// Schema of COLMAP 3.8; 3.8 requires the columns of a prior pose, and later versions ignore them.
const SCHEMA: &str = "
    PRAGMA journal_mode = OFF;
    PRAGMA synchronous = OFF;
    PRAGMA user_version = 3800;
    CREATE TABLE cameras (
        camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, model INTEGER NOT NULL, width INTEGER NOT NULL,
        height INTEGER NOT NULL, params BLOB, prior_focal_length INTEGER NOT NULL);
    CREATE TABLE images (
        image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, name TEXT NOT NULL UNIQUE, camera_id INTEGER NOT NULL,
        prior_qw REAL, prior_qx REAL, prior_qy REAL, prior_qz REAL, prior_tx REAL, prior_ty REAL, prior_tz REAL,
        CONSTRAINT image_id_check CHECK(image_id >= 0 and image_id < 2147483647),
        FOREIGN KEY(camera_id) REFERENCES cameras(camera_id));
    CREATE UNIQUE INDEX index_name ON images(name);
    CREATE TABLE keypoints (
        image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
        FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
    CREATE TABLE descriptors (
        image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
        FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
    CREATE TABLE matches (
        pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);
    CREATE TABLE two_view_geometries (
        pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
        config INTEGER NOT NULL, F BLOB, E BLOB, H BLOB, qvec BLOB, tvec BLOB);";

pub fn create(connection: &Connection) -> rusqlite::Result<()> {
    connection.execute_batch(SCHEMA)
}

pub fn insert_camera(
    tables: &Transaction<'_>,
    model: &Reconstruction,
    id: CameraId,
    camera: &Camera,
) -> rusqlite::Result<()> {
    let (kind, parameters) = written_camera(model, id, camera);
    let row = params![id.0, kind.id(), camera.width, camera.height, bytes(parameters), 1];
    tables.prepare_cached("INSERT INTO cameras VALUES (?, ?, ?, ?, ?, ?)")?.execute(row).map(drop)
}

pub fn insert_view(tables: &Transaction<'_>, id: ImageId, view: &View) -> rusqlite::Result<()> {
    let mut image = tables.prepare_cached("INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, ?)")?;
    image.execute(params![id.0, view.name, view.camera.0])?;
    let places: Vec<u8> =
        view.pixels.iter().flat_map(|p| [p.x as f32, p.y as f32]).flat_map(f32::to_le_bytes).collect();
    let mut keypoints = tables.prepare_cached("INSERT INTO keypoints VALUES (?, ?, 2, ?)")?;
    keypoints.execute(params![id.0, view.pixels.len() as u64, places]).map(drop)
}

pub fn insert_matches(tables: &Transaction<'_>, pair: [ImageId; 2], matches: &[[u32; 2]]) -> rusqlite::Result<()> {
    let row = params![pair_id(pair), matches.len() as u64, indices(matches)];
    tables.prepare_cached("INSERT INTO matches VALUES (?, ?, 2, ?)")?.execute(row).map(drop)
}

pub fn insert_geometry(
    tables: &Transaction<'_>,
    pair: [ImageId; 2],
    geometry: &TwoViewGeometry,
) -> rusqlite::Result<()> {
    let motion = geometry.cam2_from_cam1;
    let row = params![
        pair_id(pair),
        geometry.inliers.len() as u64,
        indices(&geometry.inliers),
        geometry.configuration as i32,
        geometry.fundamental.map(row_major),
        geometry.essential.map(row_major),
        geometry.homography.map(row_major),
        motion.map(quaternion),
        motion.map(|motion| bytes(motion.translation.iter().copied())),
    ];
    let sql = "INSERT INTO two_view_geometries VALUES (?, ?, 2, ?, ?, ?, ?, ?, ?, ?)";
    tables.prepare_cached(sql)?.execute(row).map(drop)
}

/// COLMAP's number of an image pair with ascending ids.
fn pair_id([first, second]: [ImageId; 2]) -> u64 {
    u64::from(first.0) * MAX_IMAGES + u64::from(second.0)
}

fn indices(matches: &[[u32; 2]]) -> Vec<u8> {
    matches.as_flattened().iter().flat_map(|index| index.to_le_bytes()).collect()
}

fn row_major(matrix: Matrix3<f64>) -> Vec<u8> {
    bytes(matrix.transpose().iter().copied())
}

fn quaternion(motion: Rigid3) -> Vec<u8> {
    let q = motion.rotation;
    bytes([q.w, q.i, q.j, q.k])
}

fn bytes(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(f64::to_le_bytes).collect()
}
