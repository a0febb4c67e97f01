use nalgebra::Vector3;
use rand::Rng as _;
use rand_distr::StandardNormal;

use super::*;
use crate::math::seeded_rng;

/// Errors of a simulated drive, metres: new in every frame, along the line of sight.
const NOISE_M: f64 = 0.01;

/// A circle to the left of 30 m radius at 8 m/s, 10 Hz, seen by a camera that stands 20 m beside it.
fn circle(num: u32, seed: u64) -> Vec<Sighting> {
    let mut rng = seeded_rng(seed, 0);
    let camera_m = Vector3::new(0.0, -20.0, 6.0);
    let sight = |k| {
        let time_s = 0.1 * f64::from(k);
        let (sin, cos) = (8.0 * time_s / 30.0).sin_cos();
        let truth = Vector3::new(30.0 * sin, 30.0 - 30.0 * cos, 0.7);
        let ray = (truth - camera_m).normalize();
        let noise: f64 = rng.sample(StandardNormal);
        let forward = Some(Vector3::new(cos, sin, 0.0));
        Sighting { time_s, position_m: truth + ray * (NOISE_M * noise), camera_m, forward }
    };
    (0..num).map(sight).collect()
}

fn standing(num: u32) -> Vec<Sighting> {
    let mut all = circle(num, 4);
    for (k, sighting) in all.iter_mut().enumerate() {
        let wobble = 0.02 * ((k * 7 % 5) as f64 - 2.0);
        sighting.position_m = Vector3::new(2.0, 3.0 + wobble, 0.7);
        sighting.forward = Some(Vector3::y());
    }
    all
}

const KNOWN: CommonStd = CommonStd { ratio: 0.0, scale: 0.0 };

#[test]
fn a_circle_has_its_speed_and_its_yaw_rate() {
    let found = smooth(&circle(60, 1), &KNOWN, Movement::Moving).unwrap();
    for (k, motion) in found.iter().enumerate() {
        assert!((motion.speed_m_s - 8.0).abs() < (4.0 * motion.speed_std_m_s).max(0.05), "{k}: {motion:?}");
        assert!((motion.speed_m_s - 8.0).abs() < 0.3 && motion.acceleration_m_s2.abs() < 1.5, "{k}: {motion:?}");
        let heading = (90.0 - (8.0 * 0.1 * k as f64 / 30.0).to_degrees()).rem_euclid(360.0);
        assert!((motion.heading_deg.unwrap() - heading).abs() < 0.5, "{k}: {motion:?}");
        assert!((motion.yaw_rate_deg_s.unwrap() + 8.0f64.to_degrees() / 30.0).abs() < 1.0, "{k}: {motion:?}");
    }
}

#[test]
fn speeds_of_many_drives_are_as_sure_as_is_said() {
    let mut within = Vec::new();
    for seed in 0..20 {
        let found = smooth(&circle(40, seed), &KNOWN, Movement::Moving).unwrap();
        within.extend(found.iter().map(|m| (m.speed_m_s - 8.0).abs() < m.speed_std_m_s));
    }
    let share = within.iter().filter(|inside| **inside).count() as f64 / within.len() as f64;
    // The drives lack the error that wanders, which the deviations allow for.
    assert!((0.6..0.999).contains(&share), "{share}");
}

#[test]
fn what_all_frames_have_in_common_is_not_smoothed_away() {
    let drive = circle(60, 2);
    let known = smooth(&drive, &KNOWN, Movement::Moving).unwrap();
    let open = smooth(&drive, &CommonStd { ratio: 0.0, scale: 0.1 }, Movement::Moving).unwrap();
    for (known, open) in known.iter().zip(&open) {
        assert_eq!(known.speed_m_s, open.speed_m_s);
        let whole = known.speed_std_m_s.hypot(0.1 * known.speed_m_s);
        assert!((open.speed_std_m_s - whole).abs() < 1e-9);
    }
    let off = smooth(&drive, &CommonStd { ratio: 0.05, scale: 0.0 }, Movement::Moving).unwrap();
    // A ratio that is wrong by 5 % moves every position by 5 % of its distance.
    let moved = Vector3::from(off[30].smoothed_position_std_m).norm();
    let distance = (drive[30].position_m - drive[30].camera_m).norm();
    assert!((moved / (0.05 * distance) - 1.0).abs() < 0.05, "{moved} {distance}");
}

#[test]
fn a_standing_vehicle_stands() {
    for movement in [Movement::Standing, Movement::Undetermined] {
        for motion in smooth(&standing(60), &KNOWN, movement).unwrap() {
            assert!(motion.speed_m_s.abs() < (2.0 * motion.speed_std_m_s).min(0.05), "{movement:?}: {motion:?}");
            assert!(motion.heading_deg.is_none() && motion.yaw_rate_deg_s.is_none(), "{motion:?}");
            assert!((motion.smoothed_position_m[1] - 3.0).abs() < 0.05);
        }
    }
}

#[test]
fn a_heading_is_as_sure_as_the_way_that_shows_it() {
    let heading_std = |factor: f64| {
        let mut drive = circle(60, 6);
        let (origin, camera) = (drive[0].position_m, drive[0].camera_m);
        for sighting in &mut drive {
            sighting.position_m = origin + (sighting.position_m - origin) * factor;
            sighting.camera_m = camera;
        }
        smooth(&drive, &KNOWN, Movement::Moving).unwrap()[30].heading_std_deg
    };
    let (far, near) = (heading_std(1.0).unwrap(), heading_std(0.01).unwrap());
    assert!(near > 2.0 * far, "{near} {far}");
    assert_eq!(heading_std(0.001), None);
}

#[test]
fn a_jump_does_not_make_a_speed() {
    let mut drive = circle(60, 3);
    drive[25].position_m += Vector3::new(0.0, 3.0, 0.0);
    let found = smooth(&drive, &KNOWN, Movement::Moving).unwrap();
    for motion in &found {
        assert!((motion.speed_m_s - 8.0).abs() < 0.5, "{motion:?}");
    }
    // The raw speed shows it.
    assert!(found[24].raw_speed_m_s > 12.0);
}

#[test]
fn a_gap_is_less_sure() {
    let mut drive = circle(60, 3);
    drive.drain(20..40);
    let found = smooth(&drive, &KNOWN, Movement::Moving).unwrap();
    assert!(found.iter().all(|motion| (motion.speed_m_s - 8.0).abs() < 0.8));
    assert!(found[19].speed_std_m_s > 1.2 * found[10].speed_std_m_s, "{:?} {:?}", found[19], found[10]);
}

#[test]
fn backing_up_is_negative() {
    let mut drive = circle(40, 5);
    for sighting in &mut drive {
        sighting.forward = sighting.forward.map(|f| -f);
    }
    assert!(
        smooth(&drive, &KNOWN, Movement::Moving).unwrap().iter().all(|m| m.speed_m_s < -7.0 && m.raw_speed_m_s < -7.0)
    );
}

#[test]
fn without_a_model_the_motion_shows_the_heading() {
    let mut drive = circle(40, 5);
    for sighting in &mut drive {
        sighting.forward = None;
    }
    let found = smooth(&drive, &KNOWN, Movement::Moving).unwrap();
    assert!((found[0].heading_deg.unwrap() - 90.0).abs() < 5.0 && found[0].yaw_rate_deg_s.is_none());
    let parked: Vec<Sighting> = standing(40).into_iter().map(|s| Sighting { forward: None, ..s }).collect();
    assert!(smooth(&parked, &KNOWN, Movement::Standing).unwrap().iter().all(|m| m.heading_deg.is_none()));
}

#[test]
fn too_little_and_nonsense_have_no_motion() {
    assert_eq!(smooth(&circle(3, 1), &KNOWN, Movement::Moving), None);
    let mut broken = circle(10, 1);
    broken[4].position_m.x = f64::NAN;
    assert_eq!(smooth(&broken, &KNOWN, Movement::Moving), None);
    // The same time twice is no reason to fail.
    let mut twice = circle(10, 1);
    twice[5].time_s = twice[4].time_s;
    assert!(smooth(&twice, &KNOWN, Movement::Moving).is_some());
}
