//! Sample results for tests of the exports.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::{RegisteredFrame, Results};
use crate::io::interchange::colmap;
use crate::io::{RunFolder, atomic, trajectories};
use crate::math::Sim3;
use crate::scene::{
    ClockZone, Dates, Dimensions, Estimate, Frame, ImageId, MapOrigin, Metric, MetricAxes, MetricFrame, MetricPose,
    MetricShare, MetricStd, MetricVerdict, Motion, ObjectId, ObjectPose, ObjectTrajectory, Reconstruction, TimeBase,
    Trajectories, Travel, Unit,
};
use crate::synthetic::showcase::{Showcase, showcase};

/// The showcase, in units of the background.
pub(super) fn results() -> Results {
    results_of(&showcase(12, 1))
}

pub(super) fn results_of(found: &Showcase) -> Results {
    let views = found.frames.iter().filter_map(|frame| view_of(found, frame)).collect();
    Results {
        title: "clip.mp4".into(),
        input: "clip.mp4".into(),
        size: (960, 540),
        time_base: TimeBase::Seconds,
        views,
        trajectories: Trajectories {
            unit: Unit::Background,
            metric: None,
            objects: found.vehicles.iter().map(|vehicle| without_metres(&vehicle.trajectory)).collect(),
            ground_tracks: Vec::new(),
        },
        background: found.background.clone(),
        ground: Some(found.ground.clone()),
        has_trajectories: true,
        units: super::Units::default(),
    }
}

fn without_metres(trajectory: &ObjectTrajectory) -> ObjectTrajectory {
    let poses = trajectory.poses.iter().map(|pose| ObjectPose { metric: None, ..pose.clone() }).collect();
    ObjectTrajectory { dimensions: None, travel: None, poses, ..trajectory.clone() }
}

fn view_of(found: &Showcase, frame: &Frame) -> Option<RegisteredFrame> {
    let image = ImageId::from(frame.id);
    let seen = found.background.images.get(&image)?;
    let camera = found.background.cameras[&seen.camera];
    Some(RegisteredFrame { frame: frame.clone(), image, camera, cam_from_world: seen.cam_from_world })
}

/// The same with meters: georeferenced, with dates and a car that moves at eight meters per second.
pub(super) fn with_metres(mut results: Results) -> Results {
    let frame = metric_frame();
    let metric_from_world = frame.metric_from_world();
    results.trajectories.metric = Some(Metric {
        verdict: MetricVerdict::Telemetry,
        reason: None,
        frame: Some(frame),
        shares: vec![MetricShare { source: "telemetry".into(), scale: 3.2, std: 0.04, share: 1.0 }],
        contradictions: Vec::new(),
        time_offset_s: Some(1_717_243_200.0),
        time_offset_std_s: Some(0.05),
        dates: Some(Dates { start_s: Some(1_717_243_200.0), zone: ClockZone::Utc, images: BTreeMap::new() }),
    });
    let places: Vec<Vec<_>> = results
        .trajectories
        .objects
        .iter()
        .map(|object| object.poses.iter().map(|pose| results.place(Point3::from(pose.position))).collect())
        .collect();
    for (object, places) in results.trajectories.objects.iter_mut().zip(places) {
        let length_m = Some(Estimate { value: 4.3, std: 0.1 });
        object.dimensions = Some(Dimensions { length_m, ..Dimensions::default() });
        let seconds = object.poses[object.poses.len() - 1].time_s - object.poses[0].time_s;
        let speed = Estimate { value: 8.0, std: 0.4 };
        let path_m = speed.scaled(seconds);
        object.travel = Some(Travel {
            path_units: path_m.scaled(1.0 / 3.2),
            displacement_units: path_m.scaled(1.0 / 3.2),
            path_m: Some(path_m),
            displacement_m: Some(path_m),
            mean_speed_m_s: Some(speed),
            max_speed_m_s: Some(speed),
        });
        for (pose, place) in object.poses.iter_mut().zip(places) {
            pose.metric = Some(MetricPose { place, ..metric_pose(pose, &metric_from_world) });
        }
    }
    results
}

fn metric_pose(pose: &ObjectPose, metric_from_world: &Sim3) -> MetricPose {
    let position_m = (*metric_from_world * Point3::from(pose.position)).into();
    let motion = Motion {
        smoothed_position_m: position_m,
        smoothed_position_std_m: [0.1, 0.1, 0.05],
        speed_m_s: 8.0,
        speed_std_m_s: 0.4,
        raw_speed_m_s: 8.3,
        acceleration_m_s2: 0.2,
        acceleration_std_m_s2: 0.1,
        heading_deg: Some(47.5),
        heading_std_deg: Some(1.5),
        yaw_rate_deg_s: None,
        yaw_rate_std_deg_s: None,
    };
    MetricPose {
        position_m,
        position_std_m: [0.2, 0.2, 0.1],
        distance_to_camera_m: 31.0,
        distance_to_camera_std_m: 0.6,
        motion: Some(motion),
        place: None,
    }
}

fn metric_frame() -> MetricFrame {
    let up = crate::synthetic::showcase::UP;
    let east = up.cross(&Vector3::x()).cross(&up).normalize();
    let axes = Matrix3::from_rows(&[east.transpose(), up.cross(&east).transpose(), up.transpose()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let mut covariance = [[0.0; 7]; 7];
    [1.6e-4, 1e-4, 1e-4, 3e-4, 4.0, 4.0, 9.0].into_iter().enumerate().for_each(|(k, v)| covariance[k][k] = v);
    MetricFrame {
        scale: 3.2,
        rotation_wxyz: [rotation.w, rotation.i, rotation.j, rotation.k],
        translation: [5.0, -3.0, 12.0],
        axes: MetricAxes::EastNorthUp,
        origin: Some(MapOrigin { longitude: 8.5, latitude: 47.3, height_m: 410.0, knows_height: true }),
        std: MetricStd { scale: 0.04, tilt_deg: 0.6, heading_deg: Some(1.0), place_m: Some([2.0, 2.0, 3.0]) },
        anchor: [0.0; 3],
        covariance,
    }
}

/// The models of the vehicles.
pub(super) fn models_of(found: &Showcase) -> BTreeMap<ObjectId, Reconstruction> {
    found.vehicles.iter().map(|vehicle| (vehicle.trajectory.id, vehicle.model.clone())).collect()
}

/// Writes results as an output folder: trajectories, background and `run.json`.
pub(super) fn write_run(folder: &Path, results: &Results) {
    let run = RunFolder::at(folder);
    trajectories::write(&run.trajectories(), &results.trajectories).unwrap();
    colmap::write_text(&run.background(), &results.background).unwrap();
    let (width, height) = results.size;
    let run_json_content = serde_json::json!({
        "input": {
            "path": results.input, "info": { "width": width, "height": height, "fps": 15.0 }, "times": "seconds"
        },
        "warnings": [],
        "error": null,
    });
    atomic::write_json(&run.run_json(), &run_json_content).unwrap();
}
