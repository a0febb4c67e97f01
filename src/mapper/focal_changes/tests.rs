//! Changes of the focal length on worlds whose truth is known.

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use rand::Rng as _;
use rand_distr::{Distribution, Normal};

use super::*;
use crate::features::tracks::{Track, TrackTable};
use crate::mapper::{Intrinsics, Options, reconstruct};
use crate::math::{Rigid3, seeded_rng};
use crate::scene::CameraId;
use crate::synthetic::{empty_table, observe};

const NUM_VIEWS: usize = 40;
const FOCAL: f64 = 600.0;

/// Motion of the camera past a street.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    Forward,
    Sideways,
    /// Upwards over level ground, looking down.
    Climb,
}

fn pose(motion: Motion, k: usize) -> Rigid3 {
    let t = k as f64;
    let (turn, center) = match motion {
        Motion::Forward => (Vector3::new(0.0, 0.03 * (0.2 * t).sin(), 0.0), Point3::new(0.02 * t, 0.0, 0.7 * t)),
        Motion::Sideways => (Vector3::new(0.0, 0.004 * t, 0.0), Point3::new(0.5 * t, 0.05 * t, 0.02 * t)),
        Motion::Climb => (Vector3::zeros(), Point3::new(0.1 * t, 0.05 * t, -0.4 * t)),
    };
    Rigid3::from_rotation_and_center(UnitQuaternion::from_scaled_axis(turn), center)
}

fn points(motion: Motion) -> Vec<Point3<f64>> {
    let mut rng = seeded_rng(31, 0);
    let mut point = || {
        let mut side = || rng.random_range(-1.0..1.0);
        let (u, v, w): (f64, f64, f64) = (side(), side(), side());
        match motion {
            Motion::Forward => Point3::new(14.0 * u + 2.0 * u.signum(), 5.0 * v, 34.0 + 32.0 * w),
            Motion::Sideways => Point3::new(10.0 + 20.0 * u, 5.0 * v, 12.0 + 7.0 * w),
            Motion::Climb => Point3::new(14.0 * u, 10.0 * v, 12.0),
        }
    };
    (0..500).map(|_| point()).collect()
}

/// Tracks of a video whose focal length follows `focal`, with noise.
fn table(motion: Motion, lens: &Camera, focal: impl Fn(usize) -> f64) -> TrackTable {
    let mut rng = seeded_rng(32, 0);
    let noise = Normal::new(0.0, 0.2).unwrap();
    let mut table = empty_table(NUM_VIEWS);
    for point in points(motion) {
        let mut track = Track::new();
        for k in 0..NUM_VIEWS {
            let camera = Camera { focal: [focal(k); 2], ..*lens };
            let in_cam = pose(motion, k) * point;
            let Some(pixel) = camera.pixel_from_cam(in_cam).filter(|p| in_cam.z > 1.0 && camera.contains(*p)) else {
                continue;
            };
            let pixel = pixel + Vector2::from_fn(|_, _| noise.sample(&mut rng));
            observe(&mut table, &mut track, k, pixel);
        }
        table.tracks.push(track);
    }
    table.tracks.retain(|track| track.len() >= 2);
    table
}

/// Changes found in the map of such a video.
fn found(motion: Motion, lens: &Camera, is_given: bool, focal: impl Fn(usize) -> f64) -> Vec<FocalChange> {
    let table = table(motion, lens, focal);
    let (camera, known) = match is_given {
        true => (Camera::with_focal(640, 360, FOCAL), Intrinsics::FIXED),
        false => (Camera::prior(640, 360), Intrinsics::GUESSED),
    };
    let (model, report) = reconstruct(&table, &[camera], known, &Options::background(), 1).unwrap();
    assert!(report.num_registered() > NUM_VIEWS / 2, "{motion:?}: {}", report.num_registered());
    focal_changes(&model, camera.principal)
}

fn lens() -> Camera {
    Camera::with_focal(640, 360, FOCAL)
}

fn ramp(from: usize, to: usize, factor: f64) -> impl Fn(usize) -> f64 {
    move |k| {
        let share = (k.saturating_sub(from) as f64 / (to - from) as f64).min(1.0);
        FOCAL * factor.powf(share)
    }
}

#[test]
fn a_zoom_is_found_with_its_frames() {
    for motion in [Motion::Forward, Motion::Sideways] {
        for is_given in [true, false] {
            for factor in [1.4, 0.75] {
                let changes = found(motion, &lens(), is_given, ramp(12, 22, factor));
                let [change] = changes[..] else { panic!("{motion:?} {is_given} {factor}: {changes:?}") };
                assert!((change.factor / factor).ln().abs() < 0.1, "{motion:?} {is_given} {factor}: {change:?}");
                let frames = (change.first.0, change.last.0);
                assert!((9..=15).contains(&frames.0) && (19..=33).contains(&frames.1), "{motion:?}: {change:?}");
            }
        }
    }
}

#[test]
fn a_step_and_a_slow_zoom_are_found() {
    for motion in [Motion::Forward, Motion::Sideways] {
        for is_given in [true, false] {
            let step = found(motion, &lens(), is_given, |k| if k < 20 { FOCAL } else { FOCAL / 1.33 });
            assert!(step.iter().any(|c| c.first.0 <= 20 && c.last.0 >= 19), "{motion:?} {is_given}: {step:?}");
            let slow = found(motion, &lens(), is_given, ramp(0, NUM_VIEWS - 1, 1.3));
            assert!(!slow.is_empty(), "{motion:?} {is_given}");
        }
    }
}

#[test]
fn a_fixed_focal_length_changes_nowhere() {
    // A distorted lens, or an offset of the principal point, is not a zoom.
    let distorted = Camera { radial: [-0.02, 0.0], ..lens() };
    let off_center = Camera { principal: [324.0, 177.0], ..lens() };
    for motion in [Motion::Forward, Motion::Sideways, Motion::Climb] {
        for is_given in [true, false] {
            for lens in [lens(), distorted, off_center] {
                let changes = found(motion, &lens, is_given, |_| FOCAL);
                assert!(changes.is_empty(), "{motion:?} {is_given} {lens:?}: {changes:?}");
            }
        }
    }
}

#[test]
fn an_empty_map_has_no_change() {
    assert!(focal_changes(&Reconstruction::default(), lens().principal).is_empty());
    let mut model = Reconstruction::default();
    model.cameras.insert(CameraId(1), lens());
    assert!(focal_changes(&model, lens().principal).is_empty());
}

#[test]
fn windows_cover_all_views_and_overlap_by_half() {
    for count in [0, 1, 399, 400, 401, 600, 601, 5000] {
        let windows = windows(count);
        assert_eq!((windows[0].start, windows[windows.len() - 1].end), (0, count), "{count}");
        assert!(windows.windows(2).all(|pair| pair[0].start + WINDOW / 2 == pair[1].start), "{count}: {windows:?}");
        assert!(windows.windows(2).all(|pair| pair[0].end == pair[0].start + WINDOW), "{count}: {windows:?}");
    }
}

#[test]
fn a_span_begins_and_ends_where_a_series_changes() {
    let flat = |value: f64, count: usize| vec![value; count];
    let up: Vec<f64> = (1..10).map(|k| 0.036 * f64::from(k)).collect();
    let zoom = [flat(0.0, 10), up.clone(), flat(0.33, 10)].concat();
    assert_eq!(span(&zoom), ([9, 18], 0.33));
    assert_eq!(span(&[flat(0.0, 10), flat(-0.29, 9)].concat()), ([9, 10], -0.29));
    let back: Vec<f64> = up.iter().rev().copied().collect();
    let there_and_back = [flat(0.0, 10), up, flat(0.33, 10), back, flat(0.0, 10)].concat();
    assert_eq!(span(&there_and_back), ([9, 38], 0.33));
    assert_eq!(span(&flat(0.0, 9)), ([0, 8], 0.0));
    let long = [flat(0.0, 60), zoom[10..19].to_vec(), flat(0.33, 60)].concat();
    let drifting: Vec<f64> = (0..).zip(&long).map(|(t, log)| log - 0.002 * f64::from(t)).collect();
    let (frames, change) = span(&drifting);
    assert!(frames == [59, 68] && (change - 0.33).abs() < 1e-9, "{frames:?} {change}");
    let steady: Vec<f64> = (0..100).map(|t| 0.003 * f64::from(t)).collect();
    let (frames, change) = span(&steady);
    assert!(frames[0] < 15 && frames[1] > 85 && (change - 0.297).abs() < 1e-9, "{frames:?} {change}");
}
