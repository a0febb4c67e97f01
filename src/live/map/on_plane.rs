//! The map of a camera that does not translate: points of the background on the plane of the ground.
//!
//! Such a window has no parallax. But where the plane of the ground is known (`ground::hovering`), every ray that
//! intersects it gives a point, and the points form an ordinary map: frames are registered in it by resection, which
//! includes the sway of the camera. Points above the ground have parallax against the plane when the camera sways, and
//! are rejected.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Point3, Vector3};

use super::super::WINDOW_S;
use super::super::window::{LIMITS, SPARE_S, Snapshot, evenly, sub_table};
use super::{DENSE_VIEWS, MIN_TRACK};
use crate::camera::Camera;
use crate::features::TrackTable;
use crate::features::tracks::Feature;
use crate::geometry::resection::{self, PixelsAndPoints};
use crate::ground::{DominantPlane, HoveringGround};
use crate::mapper::RotatingCamera;
use crate::math::Rigid3;
use crate::scene::{FrameId, Observation, Point3d, Point3dId, Reconstruction, Rect, TrackElement};

/// Views of a map, with their tracks.
pub(super) fn views(snapshot: &Snapshot) -> TrackTable {
    // The window also has old keyframes, of an earlier flight.
    let since_s = snapshot.frames.last().map_or(0.0, |frame| frame.time_s) - WINDOW_S - SPARE_S;
    let recent: Vec<usize> = (0..snapshot.frames.len()).filter(|&k| snapshot.frames[k].time_s >= since_s).collect();
    let has_lines = |k: &usize| snapshot.lines.iter().any(|lines| lines.image.frame() == snapshot.frames[*k].id);
    let of_lines = recent.iter().copied().filter(has_lines);
    let chosen: Vec<usize> =
        evenly(&recent, DENSE_VIEWS).chain(of_lines).collect::<BTreeSet<_>>().into_iter().collect();
    sub_table(&snapshot.table, &chosen, MIN_TRACK)
}

/// Poses of all views with a rotation: those without a pose get the position of the nearest view with one.
///
/// * `known` – by view, of the last map.
pub(super) fn completed(known: &[Option<Rigid3>], rotations: &RotatingCamera) -> Vec<Option<Rigid3>> {
    let posed: Vec<(usize, Rigid3, Rigid3)> = known
        .iter()
        .zip(&rotations.poses)
        .enumerate()
        .filter_map(|(view, (pose, rotation))| Some((view, (*pose)?, (*rotation)?)))
        .collect();
    let turned = |(view, rotation): (usize, &Option<Rigid3>)| {
        let (_, pose, of_pose) = posed.iter().min_by_key(|(other, ..)| other.abs_diff(view))?;
        let rotation = (*rotation)?.rotation * of_pose.rotation.inverse() * pose.rotation;
        Some(Rigid3::new(rotation, -(rotation * pose.center().coords)))
    };
    let completed = rotations.poses.iter().enumerate().map(turned);
    known.iter().copied().zip(completed).map(|(pose, turned)| pose.or(turned)).collect()
}

/// Returns true if a vehicle moves: the ray to it turns by more than its extent.
///
/// * `poses` – rotations of the camera.
pub(super) fn moves(seen: &BTreeMap<FrameId, Rect>, poses: &Reconstruction) -> bool {
    let ray = |(frame, seen): (&FrameId, &Rect)| {
        let image = poses.images.get(&(*frame).into())?;
        let camera = poses.camera_of(image);
        let ray = image.cam_from_world.rotation.inverse() * camera.ray_from_pixel(seen.center().into());
        Some((ray, seen.extent_px() / camera.mean_focal()))
    };
    let ends = seen.iter().find_map(ray).zip(seen.iter().rev().find_map(ray));
    ends.is_some_and(|((first, extent), (last, _))| first.angle(&last) > extent)
}

/// The plane of a map as the ground below a camera that has stopped; `None` above whose horizon the camera is.
pub(super) fn ground_of_map(dominant: &DominantPlane, model: &Reconstruction) -> Option<HoveringGround> {
    let image = model.images.values().next_back()?;
    let spread = dominant.spread(model);
    let height = dominant.normal.dot(&(image.cam_from_world.center() - dominant.point));
    let axis = image.cam_from_world.rotation.inverse() * Vector3::z();
    let tilt_std = (spread / height).atan();
    let level = Matrix3::identity() - dominant.normal * dominant.normal.transpose();
    (height > spread).then(|| HoveringGround {
        normal_in_world: dominant.normal,
        point_in_world: dominant.point,
        tilt_std,
        num_vehicles: 0,
        pitch: (-dominant.normal.dot(&axis)).asin(),
        by_vehicles: None,
        sources: Vec::new(),
        contradictions: Vec::new(),
        normal_covariance: level * tilt_std.powi(2),
        normal_by_focal: Vector3::zeros(),
    })
}

/// The map of some views on the plane of the ground. Points that the last map has stay where they are, so that maps do
/// not drift.
///
/// * `poses` – by view.
pub(super) fn model(
    table: &TrackTable,
    camera: &Camera,
    poses: &[Option<Rigid3>],
    ground: &HoveringGround,
    last: Option<&Reconstruction>,
) -> Reconstruction {
    let mut model = RotatingCamera { poses: poses.to_vec(), error_px: 0.0 }.model(table, camera);
    for view in &table.views {
        if let Some(image) = model.images.get_mut(&view.image) {
            image.observations = view.pixels.iter().map(|&pixel| Observation { pixel, point: None }).collect();
        }
    }
    let known = |feature: &Feature| {
        let last = last?;
        let image = last.images.get(&table.views[feature.view as usize].image)?;
        Some(last.points.get(&image.observations.get(feature.feature as usize)?.point?)?.position)
    };
    let met = |feature: &Feature| {
        let pose = (*poses.get(feature.view as usize)?)?;
        let ray = pose.rotation.inverse() * camera.ray_from_pixel(table.pixel(*feature));
        ground.intersect(pose.center(), &ray)
    };
    for (id, track) in (1..).map(Point3dId).zip(&table.tracks) {
        let Some(position) = track.iter().find_map(known).or_else(|| mean(track.iter().filter_map(met))) else {
            continue;
        };
        let seen = track.iter().filter(|feature| poses[feature.view as usize].is_some());
        let track: Vec<TrackElement> = seen
            .map(|feature| TrackElement {
                image: table.views[feature.view as usize].image,
                observation_idx: feature.feature,
            })
            .collect();
        if track.len() < MIN_TRACK {
            continue;
        }
        for TrackElement { image, observation_idx } in &track {
            if let Some(image) = model.images.get_mut(image) {
                image.observations[*observation_idx as usize].point = Some(id);
            }
        }
        model.points.insert(id, Point3d { position, rgb: [0; 3], error_px: 0.0, track });
    }
    resect(&mut model, camera);
    remove_off_plane_points(&mut model, camera);
    model
}

fn mean(points: impl Iterator<Item = Point3<f64>>) -> Option<Point3<f64>> {
    let (sum, count) = points.fold((Vector3::zeros(), 0usize), |(sum, count), point| (sum + point.coords, count + 1));
    (count > 0).then(|| Point3::from(sum / count as f64))
}

/// Registers the images by resection, including their sway.
fn resect(model: &mut Reconstruction, camera: &Camera) {
    let Reconstruction { images, points, .. } = model;
    for image in images.values_mut() {
        let (pixels, points): (Vec<_>, Vec<_>) =
            image.observations.iter().filter_map(|seen| Some((seen.pixel, points.get(&seen.point?)?.position))).unzip();
        let data = PixelsAndPoints { camera, pixels: &pixels, points: &points };
        let found = resection::refine_from(&data, &image.cam_from_world, LIMITS.max_error_px);
        if let Some(found) = found.filter(|found| found.inliers.len() >= LIMITS.min_inliers) {
            image.cam_from_world = found.cam_from_world;
        }
    }
}

/// Drops the points that do not follow the motion of the plane.
fn remove_off_plane_points(model: &mut Reconstruction, camera: &Camera) {
    let images = &model.images;
    let error_px = |point: &Point3d| {
        let errors = point.track.iter().filter_map(|element| {
            let image = images.get(&element.image)?;
            let pixel = image.observations.get(element.observation_idx as usize)?.pixel;
            Some((camera.pixel_from_cam(image.cam_from_world * point.position)? - pixel).norm())
        });
        let (sum, count) = errors.fold((0.0, 0usize), |(sum, count), error| (sum + error, count + 1));
        if count == point.track.len() { sum / count as f64 } else { f64::INFINITY }
    };
    let errors: BTreeMap<Point3dId, f64> = model.points.iter().map(|(id, point)| (*id, error_px(point))).collect();
    model.points.retain(|id, _| errors[id] <= LIMITS.max_error_px);
    model.points.iter_mut().for_each(|(id, point)| point.error_px = errors[id]);
    for image in model.images.values_mut() {
        for seen in &mut image.observations {
            seen.point = seen.point.filter(|id| model.points.contains_key(id));
        }
    }
}
