//! `trajectories.json`, version 3 of the output contract.
//!
//! Version 3 drops the key `speed` of frames where it was always null: speeds are `speed_m_s`. It has `travel`, and the
//! verdict `rejected` instead of `not-to-be-trusted`. [`write_version_2()`] writes the previous keys and words.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion};
use schemars::{JsonSchema, Schema};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::extent::{is_sensible, is_sensible_ratio};
use super::{IoError, atomic, json};
use crate::math::{MAX_UNIT_ERROR, Sim3};
use crate::scene::{
    ContactError, GroundPosition, GroundTrack, Metric, MetricVerdict, ObjectPose, ObjectTrajectory, Trajectories, Unit,
};

/// Version that is written; all versions since 1 are read.
const VERSION: u32 = 3;

/// Maximum relative difference of a pose's scale from its object's ratio.
const MAX_SCALE_ERROR: f64 = 1e-9;

// The order of these fields is the order of the keys in the file.
/// Trajectories of a run (docs/formats.md).
#[derive(Serialize, Deserialize, JsonSchema)]
struct Document {
    /// Version of this format.
    version: u32,
    /// Unit of every length whose key does not name one.
    unit: Unit,
    /// Meters; absent in files of older programs, as are the other keys of meters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    metric: Option<Metric>,
    /// Vehicles with a trajectory, ascending by id.
    objects: Vec<ObjectTrajectory>,
    /// Vehicles that are followed on the ground; absent where there is none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    ground_tracks: Vec<GroundTrack>,
}

/// The JSON schema of the file.
pub fn schema() -> Schema {
    json::schema_of::<Document>()
}

/// Writes the trajectories of a run.
///
/// # Errors
/// A system error; or a value that breaks the contract: a number that is not finite, a ratio that is not positive, a
/// pose whose scale is not its object's ratio, frames out of order, a degenerate ratio without a reason, a weight that
/// is not between 0 and 1.
pub fn write(path: &Path, trajectories: &Trajectories) -> Result<(), IoError> {
    let document = document(trajectories, VERSION);
    check(path, &document)?;
    atomic::write_json(path, &document)
}

/// Writes the trajectories of a run with the keys and words of version 2: every frame has `speed`, always null,
/// and a rejected trajectory is `not-to-be-trusted`. It has no ground tracks.
///
/// # Errors
/// As [`write()`].
pub fn write_version_2(path: &Path, trajectories: &Trajectories) -> Result<(), IoError> {
    let document = Document { ground_tracks: Vec::new(), ..document(trajectories, 2) };
    check(path, &document)?;
    let mut value = serde_json::to_value(&document).map_err(|error| IoError::content(path, error.to_string()))?;
    let objects = value["objects"].as_array_mut().into_iter().flatten();
    for object in objects {
        if object["verdict"]["state"] == "rejected" {
            object["verdict"]["state"] = "not-to-be-trusted".into();
        }
        for frame in object["frames"].as_array_mut().into_iter().flatten().filter_map(Value::as_object_mut) {
            frame.entry("speed").or_insert(Value::Null);
        }
    }
    atomic::write_json(path, &value)
}

fn document(trajectories: &Trajectories, version: u32) -> Document {
    let Trajectories { unit, metric, mut objects, ground_tracks } = trajectories.clone();
    normalize_rotations(&mut objects);
    Document { version, unit, metric, objects, ground_tracks }
}

/// Reads the trajectories of a run.
///
/// # Errors
/// A missing file, JSON of another shape or version, or values that break the contract (see [`write()`]).
pub fn read(path: &Path) -> Result<Trajectories, IoError> {
    let document: Document = json::read(path)?;
    if !(1..=VERSION).contains(&document.version) {
        json::check_version(path, document.version, VERSION)?;
    }
    check(path, &document)?;
    let Document { unit, metric, mut objects, ground_tracks, .. } = document;
    normalize_rotations(&mut objects);
    Ok(Trajectories { unit, metric, objects, ground_tracks })
}

/// Normalizes the rotations of all poses: products of many rotations drift from unit length.
fn normalize_rotations(objects: &mut [ObjectTrajectory]) {
    for pose in objects.iter_mut().flat_map(|object| &mut object.poses) {
        let rotation = &mut pose.world_from_object.rotation;
        *rotation = UnitQuaternion::new_normalize(rotation.into_inner());
    }
}

/// Checks the contract beyond the structure; JSON has no NaN, so it must not reach the writer.
fn check(path: &Path, document: &Document) -> Result<(), IoError> {
    if let Some(problem) = document.metric.as_ref().and_then(metric_problem) {
        return Err(IoError::content(path, format!("metric: {problem}")));
    }
    for object in &document.objects {
        let wrong = |problem: String| Err(IoError::content(path, format!("object {}: {problem}", object.id)));
        let scale = &object.scale;
        if !is_sensible_ratio(scale.ratio) {
            return wrong(format!("scale ratio {:e}: not positive, or out of range", scale.ratio));
        }
        let are_finite = [
            (has_finite_numbers(scale) && object.confidence.is_finite(), "scale or confidence is not a finite number"),
            (has_finite_numbers(&object.dimensions), "a dimension is not a finite number"),
            (has_finite_numbers(&object.body_center), "the center of the body is not finite"),
            (has_finite_numbers(&object.travel), "a travel figure is not finite"),
        ];
        if let Some((_, problem)) = are_finite.into_iter().find(|(is_finite, _)| !is_finite) {
            return wrong(problem.into());
        }
        let reasons = object.verdict.iter().flat_map(|verdict| &verdict.reasons);
        if let Some(reason) = reasons.into_iter().find(|reason| !(0.0..=1.0).contains(&reason.weight)) {
            return wrong(format!("reason weight {}: not between 0 and 1", reason.weight));
        }
        if scale.degenerate && scale.reason.is_none() {
            return wrong("degenerate without a reason".into());
        }
        if let Some(pair) = object.poses.windows(2).find(|pair| pair[0].frame >= pair[1].frame) {
            return wrong(format!("frame {} after frame {}: frames must ascend", pair[1].frame.0, pair[0].frame.0));
        }
        for pose in &object.poses {
            if let Some(problem) = pose_problem(pose, scale.ratio) {
                return wrong(format!("frame {}: {problem}", pose.frame.0));
            }
        }
    }
    document.ground_tracks.iter().try_for_each(|track| {
        let wrong = |problem: String| Err(IoError::content(path, format!("ground track {}: {problem}", track.id)));
        ground_track_problem(track).map_or(Ok(()), wrong)
    })
}

/// Problem of a ground track.
fn ground_track_problem(track: &GroundTrack) -> Option<String> {
    if !has_finite_numbers(track) {
        return Some("a number is not finite".into());
    }
    let numbers = |position: &GroundPosition| {
        let ContactError { noise, drift, common, focal } = position.error;
        [noise.concat(), [drift, common, focal, position.position].concat()].concat()
    };
    if let Some(position) = track.positions.iter().find(|position| numbers(position).iter().any(|n| !is_sensible(n))) {
        return Some(format!("frame {}: a number is out of range", position.frame.0));
    }
    let pair = track.positions.windows(2).find(|pair| pair[0].frame >= pair[1].frame)?;
    Some(format!("frame {} after frame {}: frames must ascend", pair[1].frame.0, pair[0].frame.0))
}

/// Problem of the metric results.
fn metric_problem(metric: &Metric) -> Option<&'static str> {
    let positive = metric.frame.as_ref().is_none_or(|frame| frame.scale > 0.0);
    let turns = metric.frame.as_ref().is_none_or(|frame| (norm(frame.rotation_wxyz) - 1.0).abs() <= MAX_UNIT_ERROR);
    let is_unknown = metric.verdict == MetricVerdict::Unknown;
    if !has_finite_numbers(metric) {
        Some("a number is not finite")
    } else if metric.frame.is_none() != is_unknown {
        Some("verdict `unknown` and scale contradict one another")
    } else if !positive {
        Some("scale is not positive")
    } else if !turns {
        Some("quaternion is not of unit length")
    } else {
        None
    }
}

/// Returns true if every number is finite: JSON has no other numbers, so that a value with one does not round-trip.
fn has_finite_numbers<T: Serialize + DeserializeOwned + PartialEq>(value: &T) -> bool {
    let back = serde_json::to_value(value).and_then(serde_json::from_value::<T>);
    back.is_ok_and(|back| back == *value)
}

fn norm([w, x, y, z]: [f64; 4]) -> f64 {
    Quaternion::new(w, x, y, z).norm()
}

fn pose_problem(pose: &ObjectPose, ratio: f64) -> Option<String> {
    let Sim3 { scale, rotation, translation } = &pose.world_from_object;
    let mut numbers = [&pose.time_s].into_iter().chain(&pose.position).chain(&rotation.coords).chain(translation);
    if let Some(number) = numbers.find(|n| !n.is_finite()) {
        return Some(format!("{number} is not a finite number"));
    }
    if !has_finite_numbers(&pose.metric) {
        return Some("a number in meters is not finite".into());
    }
    if let Some(far) = pose.position.iter().chain(translation).find(|c| !is_sensible(c)) {
        return Some(format!("{far:e} is out of range"));
    }
    // Negated, so that NaN is caught as well.
    let agrees = (scale / ratio - 1.0).abs() <= MAX_SCALE_ERROR;
    (!agrees).then(|| format!("scale {scale} differs from the object's ratio {ratio}"))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use nalgebra::Vector3;

    use super::*;
    use crate::scene::{
        CameraPathRatio, ClockZone, Dates, Dimensions, Estimate, FrameId, MapOrigin, MapPlace, MetricAxes, MetricFrame,
        MetricPose, MetricShare, MetricStd, ObjectId, PlaneBasis, Reason, ReasonKind, Reference, ScaleEstimate,
        ScaleMethod, ScaleShares, ScaleSupport, Travel, Trust, Verdict,
    };

    fn sample() -> Trajectories {
        let pose = |frame: u32| ObjectPose {
            frame: FrameId(frame),
            name: format!("{frame:06}.jpg"),
            time_s: f64::from(frame) * 0.08,
            position: [1.0 / 3.0, -2.5, 1e-17],
            world_from_object: Sim3::new(
                0.731,
                UnitQuaternion::from_euler_angles(0.1, f64::from(frame), -0.4),
                Vector3::new(4.0, 5.0, 6.0),
            ),
            metric: None,
        };
        let scale = ScaleEstimate {
            ratio: 0.731,
            std: None,
            method: ScaleMethod::ConstantDistance,
            degenerate: true,
            reason: Some("all view pairs are ill conditioned".into()),
            alternatives: [(ScaleMethod::ConstantDistance, 0.731), (ScaleMethod::Intersection, 0.7)].into(),
            as_reconstructed: Some([(ScaleMethod::Intersection, 0.71)].into()),
            shares: Some(ScaleShares { frames: 0.01, contact: 1.0 / 3.0, ..ScaleShares::default() }),
            references: [
                (ScaleMethod::Yuan, Reference { ratio: Some(0.72), std: Some(0.03), undetermined: None }),
                (
                    ScaleMethod::OzdenPlane,
                    Reference { undetermined: Some("no solution".into()), ..Reference::default() },
                ),
            ]
            .into(),
            support: Some(ScaleSupport { num_points: 90, disagreement: Some(0.041), ..ScaleSupport::default() }),
            camera_path: None,
        };
        let reasons = vec![Reason::doubts(ReasonKind::Shape, 0.5, "nearly as long as high")];
        let verdict = Some(Verdict { state: Trust::Fair, reasons });
        let object = ObjectTrajectory {
            ground: [(PlaneBasis::Mount, 2)].into(),
            verdict,
            poses: vec![pose(0), pose(2)],
            ..ObjectTrajectory::new(ObjectId(1), "car", 0.93, scale)
        };
        Trajectories { unit: Unit::Background, metric: None, objects: vec![object], ground_tracks: Vec::new() }
    }

    #[test]
    fn the_file_has_the_keys_of_the_contract_in_their_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectories.json");
        write(&path, &sample()).unwrap();
        let value: serde_json::Value = json::read(&path).unwrap();
        let keys = |v: &serde_json::Value| v.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
        assert_eq!(keys(&value), ["version", "unit", "objects"]);
        assert_eq!(value["unit"], "background");
        let object = &value["objects"][0];
        assert_eq!(keys(object), ["id", "class", "confidence", "scale", "ground", "verdict", "frames"]);
        let of_scale = ["ratio", "std", "method", "degenerate", "reason", "alternatives", "as_reconstructed"];
        let of_scale = [&of_scale[..], &["shares", "support", "references"]].concat();
        assert_eq!(keys(&object["scale"]), of_scale);
        assert_eq!(object["scale"]["method"], "constant-distance");
        assert!(object["scale"]["std"].is_null());
        let frame = &object["frames"][1];
        let of_frame = ["frame", "name", "time_s", "position", "world_from_object"];
        assert_eq!(keys(frame), of_frame, "no null where nothing is known");
        assert_eq!(keys(&frame["world_from_object"]), ["scale", "rotation_wxyz", "translation"]);
        let q: Vec<f64> = serde_json::from_value(frame["world_from_object"]["rotation_wxyz"].clone()).unwrap();
        assert!((q.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn version_2_has_the_previous_keys_and_words_and_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("old.json");
        let mut all = sample();
        all.objects[0].verdict.as_mut().unwrap().state = Trust::Rejected;
        write_version_2(&path, &all).unwrap();
        let value: serde_json::Value = json::read(&path).unwrap();
        assert_eq!(value["version"], 2);
        let object = &value["objects"][0];
        assert_eq!(object["verdict"]["state"], "not-to-be-trusted");
        assert!(object["frames"][0].as_object().unwrap()["speed"].is_null());
        assert_eq!(read(&path).unwrap().objects[0].verdict, all.objects[0].verdict);
    }

    #[test]
    fn trajectories_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectories.json");
        let mut expected = sample();
        expected.objects[0].scale.camera_path = Some(CameraPathRatio {
            ratio: 0.7,
            std: 0.01,
            residual: 0.004,
            ratio_without: 0.8,
            std_without: None,
            degenerate_without: true,
        });
        write(&path, &expected).unwrap();
        let back = read(&path).unwrap();
        for (a, b) in back.objects[0].poses.iter().zip(&mut expected.objects[0].poses) {
            assert!(a.world_from_object.rotation.angle_to(&b.world_from_object.rotation) < 1e-15);
            b.world_from_object.rotation = a.world_from_object.rotation;
        }
        assert_eq!(back, expected);
    }

    fn with_meters() -> Trajectories {
        let mut all = sample();
        all.metric = Some(Metric {
            verdict: MetricVerdict::Telemetry,
            reason: None,
            frame: Some(MetricFrame {
                scale: 12.5,
                rotation_wxyz: [0.0, 0.6, 0.8, 0.0],
                translation: [1.0, 2.0, 1.0 / 3.0],
                axes: MetricAxes::EastNorthUp,
                origin: Some(MapOrigin { longitude: 8.5, latitude: 47.3, height_m: 410.0, knows_height: true }),
                std: MetricStd { scale: 0.25, tilt_deg: 0.5, heading_deg: Some(1.0), place_m: Some([2.0, 2.0, 4.0]) },
                anchor: [0.1, 0.2, 0.3],
                covariance: [[1e-4; 7]; 7],
            }),
            shares: vec![MetricShare { source: "telemetry".into(), scale: 12.5, std: 0.25, share: 1.0 }],
            contradictions: Vec::new(),
            time_offset_s: Some(0.7),
            time_offset_std_s: Some(0.05),
            dates: Some(Dates { start_s: Some(1.7e9), zone: ClockZone::Local, images: BTreeMap::new() }),
        });
        let length_m = Some(Estimate { value: 4.4, std: 0.1 });
        let [path_units, displacement_units] = [Estimate { value: 3.2, std: 0.1 }, Estimate { value: 3.1, std: 0.1 }];
        let path_m = Some(path_units.scaled(12.5));
        let travel = Travel {
            path_units,
            displacement_units,
            path_m,
            displacement_m: None,
            mean_speed_m_s: None,
            max_speed_m_s: None,
        };
        all.objects[0].travel = Some(travel);
        all.objects[0].dimensions = Some(Dimensions { length_m, ..Dimensions::default() });
        all.objects[0].poses[1].metric = Some(MetricPose {
            position_m: [10.0, 20.0, 0.7],
            position_std_m: [0.1, 0.2, 0.1],
            distance_to_camera_m: 31.0,
            distance_to_camera_std_m: 0.6,
            motion: None,
            place: Some(MapPlace { longitude: 8.6, latitude: 47.4, height_m: 410.7, place_std_m: [2.0, 2.0, 4.0] }),
        });
        all
    }

    #[test]
    fn meters_have_separate_keys() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectories.json");
        let all = with_meters();
        write(&path, &all).unwrap();
        let value: serde_json::Value = json::read(&path).unwrap();
        assert_eq!((&value["metric"]["scale"], &value["metric"]["verdict"]), (&12.5.into(), &"telemetry".into()));
        let frames = &value["objects"][0]["frames"];
        assert_eq!((&frames[0]["position_m"], &frames[1]["longitude"]), (&serde_json::Value::Null, &8.6.into()));
        assert_eq!(value["objects"][0]["dimensions"]["length_m"]["value"], 4.4);
        let back = read(&path).unwrap();
        assert_eq!((&back.metric, back.objects[0].dimensions), (&all.metric, all.objects[0].dimensions));
        assert_eq!(back.objects[0].travel, all.objects[0].travel);
        assert_eq!(back.objects[0].poses[1].metric, all.objects[0].poses[1].metric);
        let frame = back.metric.unwrap().frame.unwrap();
        assert!((frame.log_scale_std() - 0.02).abs() < 1e-12 && frame.metric_from_world().scale == 12.5);
    }

    #[test]
    fn meters_that_are_not_finite_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |change: fn(&mut Trajectories)| {
            let mut all = with_meters();
            change(&mut all);
            write(&folder.path().join("trajectories.json"), &all).unwrap_err().to_string()
        };
        let metric = |change: fn(&mut Metric)| {
            let mut all = with_meters();
            change(all.metric.as_mut().unwrap());
            write(&folder.path().join("trajectories.json"), &all).unwrap_err().to_string()
        };
        assert!(metric(|m| m.frame.as_mut().unwrap().covariance[3][3] = f64::NAN).contains("metric: a number is not"));
        assert!(metric(|m| m.frame = None).contains("verdict `unknown`"));
        assert!(metric(|m| m.frame.as_mut().unwrap().scale = -1.0).contains("not positive"));
        assert!(metric(|m| m.frame.as_mut().unwrap().rotation_wxyz[0] = 1.0).contains("unit length"));
        assert!(
            refused(|all| all.objects[0].dimensions.as_mut().unwrap().length_m.as_mut().unwrap().std = f64::NAN)
                .contains("object 1: a dimension")
        );
        assert!(
            refused(|all| all.objects[0].travel.as_mut().unwrap().path_units.std = f64::NAN)
                .contains("object 1: a travel figure")
        );
        assert!(
            refused(|all| all.objects[0].poses[1].metric.as_mut().unwrap().position_m[1] = f64::NAN)
                .contains("frame 2: a number in meters")
        );
    }

    #[test]
    fn contract_violations_are_neither_written_nor_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectories.json");
        let refused = |change: fn(&mut ObjectTrajectory)| {
            let mut trajectories = sample();
            change(&mut trajectories.objects[0]);
            write(&path, &trajectories).unwrap_err().to_string()
        };
        assert!(refused(|o| o.scale.ratio = f64::NAN).contains("object 1: scale ratio NaN"));
        assert!(refused(|o| o.poses[1].world_from_object.scale = 0.73).contains("frame 2: scale 0.73"));
        assert!(refused(|o| o.poses[1].position[2] = f64::INFINITY).contains("frame 2: inf"));
        assert!(refused(|o| o.poses.reverse()).contains("frame 0 after frame 2"));
        assert!(refused(|o| o.scale.shares.as_mut().unwrap().plane = f64::NAN).contains("scale or confidence"));
        assert!(refused(|o| o.scale.reason = None).contains("without a reason"));
        assert!(!path.exists());
        write(&path, &sample()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let broken = [
            (text.replacen("\"version\": 3", "\"version\": 4", 1), "version 4"),
            (text.replacen("\"class\": \"car\",", "", 1), "missing field `class`"),
            (text.replacen("0.731", "-0.731", 1), "not positive"),
            (text[..text.len() / 2].to_string(), "EOF"),
        ];
        for (content, expected) in broken {
            std::fs::write(&path, content).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains("trajectories.json"), "{error}");
        }
    }
}
