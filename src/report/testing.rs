//! Sample data for tests of the reports.

use std::collections::BTreeMap;

use super::{Data, Model, Object, Pictures, Stage, Thumbnail};
use crate::eval::Evaluation;
use crate::scene::{
    ContactError, Dimensions, Estimate, Frame, FrameId, Ground, GroundPosition, GroundTrack, Metric, ObjectId,
    ObjectTrajectory, Reconstruction, TimeBase,
};
pub(super) use crate::synthetic::showcase::UP;
use crate::synthetic::showcase::{CAR, showcase};

/// The showcase's car, which tests modify.
pub(super) struct World {
    pub title: String,
    pub class: String,
    pub time_base: TimeBase,
    pub frames: Vec<Frame>,
    pub background: Reconstruction,
    pub metric: Option<Metric>,
    pub ground: Ground,
    pub model: Reconstruction,
    pub trajectory: ObjectTrajectory,
    pub ground_track: Option<GroundTrack>,
    pub visible: Vec<FrameId>,
    pub strip: Vec<Thumbnail>,
    pub warnings: Vec<String>,
}

pub(super) fn world() -> World {
    let result = showcase(60, 1);
    let car = result.vehicles[0].clone();
    World {
        title: "clip.mp4".into(),
        class: "car".into(),
        time_base: TimeBase::Seconds,
        frames: result.frames,
        background: result.background,
        metric: None,
        ground: result.ground,
        model: car.model,
        trajectory: car.trajectory,
        ground_track: None,
        visible: car.visible,
        strip: Vec::new(),
        warnings: Vec::new(),
    }
}

impl World {
    /// The same with a metric scale.
    pub fn in_metres() -> Self {
        Self { metric: Some(showcase(60, 1).metric), ..world() }
    }

    /// The same with a ground track of a stationary vehicle, 4 m long and 2 m wide, that points 30° to the right of the
    /// frame's second axis.
    pub fn with_vehicle_at_rest() -> Self {
        let mut world = Self::in_metres();
        let at = world.trajectory.poses[0].clone();
        let position = |frame| GroundPosition {
            frame,
            name: at.name.clone(),
            time_s: at.time_s,
            position: at.position,
            error: ContactError::default(),
            metric: None,
        };
        let [length, width] = [4.0, 2.0].map(|value| Some(Estimate { value, std: 0.1 }));
        world.ground_track = Some(GroundTrack {
            dimensions: Some(Dimensions { length_m: length, width_m: width, height_m: None }),
            axis_deg: Some(Estimate { value: 30.0, std: 3.0 }),
            positions: [0, 1].map(|frame| position(FrameId(frame))).to_vec(),
            ..GroundTrack::new(world.trajectory.id, "car", 0.9)
        });
        world
    }

    pub fn data(&self) -> Data<'_> {
        let object = Object {
            id: CAR,
            class: self.class.clone(),
            confidence: 0.9,
            tracked: None,
            visible: self.visible.clone(),
            model: Some(Model { reconstruction: &self.model, unregistered: BTreeMap::new() }),
            trajectory: Some(&self.trajectory),
            ground_track: self.ground_track.as_ref().filter(|track| track.id == CAR),
            ratio_per_frame: vec![(FrameId(3), self.trajectory.scale.ratio)],
            failure: None,
        };
        let lost = Object {
            id: ObjectId(2),
            class: String::new(),
            confidence: f64::NAN,
            tracked: None,
            visible: vec![FrameId(4)],
            model: None,
            trajectory: None,
            ground_track: self.ground_track.as_ref().filter(|track| track.id == ObjectId(2)),
            ratio_per_frame: Vec::new(),
            failure: Some("too few features".into()),
        };
        Data {
            title: self.title.clone(),
            time_base: self.time_base,
            objects: vec![object, lost],
            frames: &self.frames,
            metric: self.metric.as_ref(),
            ground: Some(&self.ground),
            pictures: Pictures { strip: self.strip.clone(), ..Pictures::default() },
            warnings: self.warnings.clone(),
            ..nothing(&self.background)
        }
    }

    pub fn names(&self) -> Vec<String> {
        self.data().objects.iter().map(|o| format!("{} {}", o.class, o.id)).collect()
    }
}

/// A run that ended with this background and nothing else.
pub(super) fn nothing(background: &Reconstruction) -> Data<'_> {
    let stage = Stage { name: "sfm".into(), wall_s: 1.0, cpu_s: 2.0, peak_rss_mib: 100.0, reused: false };
    Data {
        title: "clip.mp4".into(),
        input: Vec::new(),
        version: "0".into(),
        arguments: Vec::new(),
        time_base: TimeBase::Seconds,
        frames: &[],
        background: Model { reconstruction: background, unregistered: BTreeMap::from([(FrameId(3), "dark".into())]) },
        metric: None,
        ground: None,
        objects: Vec::new(),
        missing: Vec::new(),
        pictures: Pictures::default(),
        warnings: Vec::new(),
        stages: vec![stage],
        evaluation: None,
        parts: Vec::new(),
        is_sfm: false,
    }
}

/// Evaluation of the bundled clip by `tractrix evaluate`; the errors of two frames represent all.
pub(super) fn evaluation() -> Evaluation {
    serde_json::from_str(include_str!("../../tests/golden/evaluation.json")).unwrap()
}
