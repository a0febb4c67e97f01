//! Vehicle so far away that its images are nearly parallel projections.

use super::*;
use crate::features::tracks::View;
use crate::synthetic::drive::{self, Drive};

fn far_options() -> drive::Options {
    drive::Options {
        camera_height_m: 70.0,
        distance_m: [150.0, 160.0],
        num_object_points: 80,
        num_ground_points: 50,
        num_other_points: 0,
        ..drive::Options::default()
    }
}

/// A vehicle of 25 to 30 pixels, at a distance of 150 m.
fn far(seed: u64) -> Drive {
    drive::drive(&far_options(), seed)
}

/// Its tracks, of `length` frames at most, with the noise of a compressed video.
fn tracks_lasting(world: &Drive, seed: u64, length: u32) -> TrackTable {
    const NOISE_PX: f64 = 0.15;
    let (mut rng, normal) = (seeded_rng(seed, 7), Normal::new(0.0, NOISE_PX).unwrap());
    let mut table = TrackTable::default();
    for (id, image) in &world.object.images {
        let pixels: Vec<Point2<f64>> = image
            .observations
            .iter()
            .map(|seen| seen.pixel + Vector3::from_fn(|_, _| normal.sample(&mut rng)).xy())
            .collect();
        let rgb = vec![[120; 3]; pixels.len()];
        table.views.push(View { image: *id, name: image.name.clone(), camera: 0, pixels, rgb, whitening: Vec::new() });
    }
    let view_of = |image: ImageId| world.object.images.keys().position(|id| *id == image).unwrap() as u32;
    for point in world.object.points.values() {
        let start = rng.random_range(0..length);
        let feature = |e: &crate::scene::TrackElement| Feature { view: view_of(e.image), feature: e.observation_idx };
        let all: Vec<Feature> = point.track.iter().map(feature).collect();
        let pieces =
            all.chunk_by(|a, b| (a.view + start) / length == (b.view + start) / length && b.view == a.view + 1);
        table.tracks.extend(pieces.filter(|piece| piece.len() >= 4).map(<[Feature]>::to_vec));
    }
    table
}

/// The poses in a frame whose z is up, off by some degrees and pixels.
///
/// * `aside_px` – standard deviation of the position in the image that differs from view to view.
fn inaccurate_poses(world: &Drive, aside_px: f64) -> PosePriors {
    let mut rng = seeded_rng(0, 3);
    let pose = |(k, (id, image)): (usize, (&ImageId, &crate::scene::Image))| {
        let (plane, in_background) = (world.planes.get(&id.frame())?, world.background.images.get(id)?);
        let up = image.cam_from_world.rotation.inverse() * (in_background.cam_from_world.rotation * plane.normal);
        let level = UnitQuaternion::rotation_between(&up, &Vector3::z())?;
        let wobble = (0.4 * k as f64).sin();
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), (3.0 * wobble).to_radians());
        let random = Vector3::from_fn(|_, _| Normal::new(0.0, aside_px).unwrap().sample(&mut rng));
        let aside_px = Vector3::new(wobble + random.x, -wobble + random.y, 0.0);
        let aside = aside_px / 900.0 * image.cam_from_world.translation.norm();
        let cam_from_level = image.cam_from_world * Rigid3::new((turn * level).inverse(), Vector3::zeros());
        Some(Rigid3::new(cam_from_level.rotation, cam_from_level.translation + aside))
    };
    PosePriors { poses: world.object.images.iter().enumerate().map(pose).collect(), error_px: 5.0 + 2.0 * aside_px }
}

/// Median angle between the cameras' directions and the true ones after rotational alignment, degrees.
fn rotation_error_deg(found: &Reconstruction, world: &Drive) -> f64 {
    let (ours, truth): (Vec<_>, Vec<_>) = found
        .images
        .iter()
        .map(|(id, image)| {
            let axis = |pose: &Rigid3| pose.rotation.inverse() * Vector3::z();
            (axis(&image.cam_from_world), axis(&world.object.images[id].cam_from_world))
        })
        .unzip();
    let points =
        |axes: &[Vector3<f64>]| axes.iter().map(|a| Point3::from(*a)).chain([Point3::origin()]).collect::<Vec<_>>();
    let (ours, truth) = (points(&ours), points(&truth));
    let similarity = umeyama(&ours, &truth).unwrap();
    let angles = ours.iter().zip(&truth).map(|(a, b)| ((similarity * *a) - b).norm().to_degrees());
    crate::math::median(angles.collect()).unwrap()
}

#[test]
fn pose_priors_stabilize_a_far_vehicle() {
    for seed in 0..6 {
        let world = far(seed);
        let table = tracks_lasting(&world, seed, 25);
        let poses = inaccurate_poses(&world, 0.0);
        let camera = *world.object.cameras.values().next().unwrap();
        let build = |poses| {
            let options = Options::object();
            reconstruct_watched(table.clone(), &[camera], Intrinsics::FIXED, &options, seed, poses, &mut |_| {})
                .unwrap()
                .0
        };
        let (alone, helped) = (build(None), build(Some(&poses)));
        let off =
            [&alone, &helped].map(|model| if model.is_empty() { f64::NAN } else { rotation_error_deg(model, &world) });
        assert!(helped.images.len() == 60 && off[1] < 3.0, "{seed}: {off:?}");
    }
}

#[test]
fn position_errors_of_pose_priors_do_not_rotate_the_cameras() {
    for seed in 0..6 {
        let (camera_height_m, distance_m) = (30.0, [60.0, 60.0]);
        let options = drive::Options { camera_height_m, distance_m, num_frames: 30, ..far_options() };
        let world = drive::drive(&options, seed);
        // Short tracks leave the rotations of the cameras to the poses.
        let table = tracks_lasting(&world, seed, 5);
        let poses = inaccurate_poses(&world, 16.0);
        let camera = *world.object.cameras.values().next().unwrap();
        let found = reconstruct_watched(
            table,
            &[camera],
            Intrinsics::FIXED,
            &Options::object(),
            seed,
            Some(&poses),
            &mut |_| {},
        );
        let off = rotation_error_deg(&found.unwrap().0, &world);
        assert!(off < 1.2, "{seed}: {off}");
    }
}
