//! A box on wheels drives through a yard of boxes, filmed by a camera that moves beside it and rises. Ray-cast, with
//! textures of value noise; pictures, vehicle masks and ground masks are exact.

use std::fs;
use std::path::Path;

use image::{GrayImage, Luma, Rgb, RgbImage};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

pub const WIDTH: u32 = 320;
pub const HEIGHT: u32 = 180;
pub const FOCAL: f64 = 300.0;

/// `--intrinsics` of the pictures.
pub fn intrinsics() -> String {
    format!("{FOCAL},{FOCAL},{},{}", WIDTH / 2, HEIGHT / 2)
}

/// Half sides of the vehicle, metres.
const VEHICLE: Vector3<f64> = Vector3::new(2.2, 1.0, 0.9);
/// Centre and half sides of what stands around, metres.
const YARD: [([f64; 3], [f64; 3]); 5] = [
    ([-6.0, 9.0, 2.0], [2.0, 1.5, 2.0]),
    ([2.0, 12.0, 3.0], [2.5, 2.0, 3.0]),
    ([9.0, 10.0, 1.5], [1.5, 2.0, 1.5]),
    ([14.0, 6.0, 1.0], [1.0, 1.0, 1.0]),
    ([-10.0, 3.0, 1.2], [1.2, 1.2, 1.2]),
];

struct Hit {
    distance: f64,
    label: Label,
    /// Where it was hit, in coordinates that its texture is fixed to.
    texture: Point3<f64>,
    normal: Vector3<f64>,
}

#[derive(Clone, Copy, PartialEq)]
enum Label {
    Ground,
    Vehicle,
    Other,
}

/// Writes `images/`, `masks/` and `ground/` for `num_frames` frames into a folder.
pub fn write(folder: &Path, num_frames: u32) {
    write_sized(folder, num_frames, 1.0);
}

/// The same with a vehicle so many times as large.
pub fn write_sized(folder: &Path, num_frames: u32, size: f64) {
    for name in ["images", "masks", "ground"] {
        fs::create_dir_all(folder.join(name)).unwrap();
    }
    for k in 0..num_frames {
        let (picture, mask, ground) = frame(f64::from(k) / 23.0, size * VEHICLE);
        picture.save(folder.join(format!("images/{k:04}.png"))).unwrap();
        mask.save(folder.join(format!("masks/{k:04}.png"))).unwrap();
        ground.save(folder.join(format!("ground/{k:04}.png"))).unwrap();
    }
}

/// Picture, vehicle mask (1) and ground mask (1) at a time from 0 to 1, of a vehicle with the given half sides.
fn frame(t: f64, half: Vector3<f64>) -> (RgbImage, GrayImage, GrayImage) {
    let heading = 0.7 * t;
    let vehicle = Point3::new(-4.0 + 9.0 * t, 2.5 * t * t, half.z);
    let vehicle_from_world = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -heading);
    let eye = Point3::new(-7.0 + 8.0 * t, -10.0 - 3.0 * t, 3.5 + 4.0 * t);
    let world_from_cam = look_at(eye, Point3::new(-3.0 + 8.0 * t, 3.0, 0.5));
    let (mut picture, mut mask, mut ground) =
        (RgbImage::new(WIDTH, HEIGHT), GrayImage::new(WIDTH, HEIGHT), GrayImage::new(WIDTH, HEIGHT));
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        let mut sum = Vector3::zeros();
        // Two by two rays a pixel: features must not flicker with the pixel grid.
        for (dx, dy) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
            let u = (f64::from(x) + dx - f64::from(WIDTH) / 2.0) / FOCAL;
            let v = (f64::from(y) + dy - f64::from(HEIGHT) / 2.0) / FOCAL;
            let ray = (world_from_cam * Vector3::new(u, v, 1.0)).normalize();
            let hit = cast(eye, ray, (vehicle, half), vehicle_from_world);
            sum += hit.as_ref().map_or(Vector3::new(170.0, 190.0, 215.0), colour);
            // Labels are those of the last of the four rays.
            let label = hit.map(|hit| hit.label);
            mask.put_pixel(x, y, Luma([u8::from(label == Some(Label::Vehicle))]));
            ground.put_pixel(x, y, Luma([u8::from(label == Some(Label::Ground))]));
        }
        *pixel = Rgb([(sum.x / 4.0) as u8, (sum.y / 4.0) as u8, (sum.z / 4.0) as u8]);
    }
    (picture, mask, ground)
}

/// Rotation of a camera at `eye` that looks at `target`, z up.
fn look_at(eye: Point3<f64>, target: Point3<f64>) -> Matrix3<f64> {
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    Matrix3::from_columns(&[right, forward.cross(&right), forward])
}

fn cast(
    eye: Point3<f64>,
    ray: Vector3<f64>,
    (vehicle, half): (Point3<f64>, Vector3<f64>),
    vehicle_from_world: UnitQuaternion<f64>,
) -> Option<Hit> {
    let mut hits = Vec::new();
    if ray.z < -1e-9 {
        let distance = -eye.z / ray.z;
        hits.push(Hit { distance, label: Label::Ground, texture: eye + ray * distance, normal: Vector3::z() });
    }
    for (center, half) in YARD {
        let from = eye - Vector3::from(center);
        hits.extend(cast_box(from, ray, half.into()).map(|(distance, normal)| Hit {
            distance,
            label: Label::Other,
            texture: eye + ray * distance,
            normal,
        }));
    }
    let from = Point3::from(vehicle_from_world * (eye - vehicle));
    let direction = vehicle_from_world * ray;
    hits.extend(cast_box(from, direction, half).map(|(distance, normal)| Hit {
        distance,
        label: Label::Vehicle,
        texture: from + direction * distance + Vector3::new(100.0, 50.0, 20.0),
        normal,
    }));
    hits.into_iter().filter(|hit| hit.distance < 80.0).min_by(|a, b| a.distance.total_cmp(&b.distance))
}

/// Distance and normal at which a ray enters a box round the origin.
fn cast_box(from: Point3<f64>, ray: Vector3<f64>, half: Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
    let (mut enter, mut leave, mut normal) = (0.0f64, f64::INFINITY, Vector3::zeros());
    for axis in 0..3 {
        let (a, b) = ((-half[axis] - from[axis]) / ray[axis], (half[axis] - from[axis]) / ray[axis]);
        if a.min(b) > enter {
            enter = a.min(b);
            normal = Vector3::zeros();
            normal[axis] = -ray[axis].signum();
        }
        leave = leave.min(a.max(b));
    }
    (enter > 0.0 && enter < leave).then_some((enter, normal))
}

fn colour(hit: &Hit) -> Vector3<f64> {
    let noise = |scale: f64, seed: i64| value_noise(hit.texture * scale, seed);
    let grain = 0.35 * noise(1.3, 1) + 0.35 * noise(4.0, 2) + 0.3 * noise(11.0, 3);
    let light = 0.75 + 0.25 * hit.normal.dot(&Vector3::new(0.3, -0.5, 0.8)).abs();
    let tint = match hit.label {
        Label::Ground => Vector3::new(215.0, 205.0, 190.0),
        Label::Vehicle => Vector3::new(240.0, 150.0, 120.0),
        Label::Other => Vector3::new(190.0, 215.0, 225.0),
    };
    // Contrast round the middle: half-way between two lattice points noise is grey.
    tint * (light * (0.15 + 0.85 * (0.5 + 1.6 * (grain - 0.5)).clamp(0.0, 1.0)))
}

/// Smooth noise from 0 to 1 on the integer lattice.
fn value_noise(p: Point3<f64>, seed: i64) -> f64 {
    let floor = p.map(f64::floor);
    let fade = (p - floor).map(|f| f * f * (3.0 - 2.0 * f));
    let corner = |dx: i64, dy: i64, dz: i64| {
        let weight = |d: i64, f: f64| if d == 1 { f } else { 1.0 - f };
        hash([floor.x as i64 + dx, floor.y as i64 + dy, floor.z as i64 + dz, seed])
            * weight(dx, fade.x)
            * weight(dy, fade.y)
            * weight(dz, fade.z)
    };
    (0..8).map(|k| corner(k & 1, k >> 1 & 1, k >> 2)).sum()
}

fn hash(key: [i64; 4]) -> f64 {
    let mut z = key.iter().fold(0x9e37_79b9_7f4a_7c15u64, |z, &k| (z ^ k as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9));
    z = (z ^ (z >> 29)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (z ^ (z >> 32)) as u32 as f64 / f64::from(u32::MAX)
}
