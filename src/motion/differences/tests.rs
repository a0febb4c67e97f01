//! Tests with a hovering drone over a textured ground, on which small objects move.

use ::image::Rgb;
use nalgebra::{Point2, Point3, UnitQuaternion};

use super::*;
use crate::camera::Camera;
use crate::math::{Rigid3, seeded_rng};
use crate::scene::Rect;
use rand::Rng as _;

const SIZE: (u32, u32) = (320, 180);
const NUM_FRAMES: u32 = 40;
const STEP_S: f64 = 0.2;

/// Center of an object by frame, on the plane z = 1 of a camera that does not rotate, and its sides there.
type Object = (fn(u32) -> [f64; 2], [f64; 2]);

/// Views of a camera that sways by a degree and rotates steadily.
fn views() -> Vec<Option<View>> {
    let camera = Camera::with_focal(SIZE.0, SIZE.1, 250.0);
    let view = |k: u32| {
        let t = f64::from(k);
        let rotation = UnitQuaternion::from_euler_angles(0.01 * (0.9 * t).sin(), 0.002 * t, 0.015 * (0.5 * t).cos());
        Some(View { camera, cam_from_world: Rigid3::new(rotation, Default::default()) })
    };
    (0..NUM_FRAMES).map(view).collect()
}

/// Brightness of the ground in a direction: squares of random brightness, two pixels wide and more.
fn ground(x: f64, y: f64) -> f64 {
    let cell = |size: f64, stream: u64| {
        let (i, j) = ((x / size).floor() as i64, (y / size).floor() as i64);
        seeded_rng((i * 7919 + j) as u64, stream).random_range(-1.0..1.0)
    };
    110.0 + 20.0 * cell(0.05, 1) + 10.0 * cell(0.012, 2)
}

fn image(view: &View, frame: u32, objects: &[Object], brightness: f64) -> RgbImage {
    let mut rng = seeded_rng(3, u64::from(frame));
    RgbImage::from_fn(SIZE.0, SIZE.1, |u, v| {
        let ray = view.camera.ray_from_pixel(Point2::new(f64::from(u) + 0.5, f64::from(v) + 0.5));
        let ray = view.cam_from_world.rotation.inverse() * ray;
        let (x, y) = (ray.x / ray.z, ray.y / ray.z);
        let is_of = |(at, sides): &&Object| {
            let [cx, cy] = at(frame);
            (x - cx).abs() < 0.5 * sides[0] && (y - cy).abs() < 0.5 * sides[1]
        };
        // The shadow of each object is to its right.
        let shadow = |(at, sides): &Object| {
            let [cx, cy] = at(frame);
            (0.0..sides[0]).contains(&(x - cx)) && (y - cy).abs() < 0.5 * sides[1]
        };
        let shade = if objects.iter().any(shadow) { 0.6 } else { 1.0 };
        let value = if objects.iter().any(|object| is_of(&object)) { 190.0 } else { shade * ground(x, y) };
        let noisy = value * brightness + rng.random_range(-3.0..3.0);
        Rgb([noisy as u8; 3])
    })
}

fn detected(objects: &[Object], brightness: fn(u32) -> f64) -> Vec<MovingObject> {
    let views = views();
    let times_s: Vec<f64> = (0..NUM_FRAMES).map(|k| STEP_S * f64::from(k)).collect();
    let surroundings = Surroundings { size: SIZE, times_s: &times_s, views: &views, ground: None };
    let mut detector = DifferenceDetector::new(surroundings);
    for (frame, view) in (0..NUM_FRAMES).zip(views.iter().flatten()) {
        // Every third frame is compared.
        if frame % 3 == 0 || frame + 1 == NUM_FRAMES {
            detector.push(frame, &image(view, frame, objects, brightness(frame))).unwrap();
        }
    }
    detector.finish().unwrap()
}

/// A car of 11 × 6 pixels.
const CAR: [f64; 2] = [0.044, 0.024];

fn driving(frame: u32) -> [f64; 2] {
    [-0.25 + 0.012 * f64::from(frame), 0.05]
}

fn stationary(_: u32) -> [f64; 2] {
    [0.2, -0.1]
}

fn swaying(frame: u32) -> [f64; 2] {
    [-0.2 + 0.008 * (2.3 * f64::from(frame)).sin(), -0.15]
}

#[test]
fn only_a_small_moving_car_is_detected_in_every_frame() {
    let found = detected(&[(driving, CAR), (stationary, CAR), (swaying, CAR)], |_| 1.0);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].confidence > 0.99);
    assert_eq!(found[0].boxes.keys().copied().collect::<Vec<_>>(), (0..NUM_FRAMES).collect::<Vec<_>>());
    for (frame, view) in (0..NUM_FRAMES).zip(views().iter().flatten()) {
        let [x, y] = driving(frame);
        let middle = view.camera.pixel_from_cam(view.cam_from_world.rotation * Point3::new(x, y, 1.0)).unwrap();
        let [dx, dy] = CAR.map(|side| 0.5 * side * view.camera.focal[0]);
        let truth = Rect { x0: middle.x - dx, y0: middle.y - dy, x1: middle.x + dx, y1: middle.y + dy };
        let iou = found[0].boxes[&frame].iou(&truth);
        assert!(iou > 0.6, "frame {frame}: {iou}");
    }
}

#[test]
fn a_change_of_brightness_is_no_motion() {
    assert_eq!(detected(&[(stationary, CAR)], |frame| if frame < 20 { 1.0 } else { 0.7 }), []);
}

#[test]
fn frames_without_cameras_have_no_objects() {
    let surroundings = Surroundings { size: SIZE, times_s: &[], views: &[], ground: None };
    let mut detector = DifferenceDetector::new(surroundings);
    detector.push(0, &RgbImage::new(SIZE.0, SIZE.1)).unwrap();
    assert_eq!(detector.finish().unwrap(), []);
}
