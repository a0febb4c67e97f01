//! Input of the report.

use std::collections::{BTreeMap, HashMap};

use super::Pictures;
use crate::eval::Evaluation;
use crate::scene::{
    Frame, FrameId, Ground, GroundTrack, Image, Metric, ObjectId, ObjectTrajectory, Reconstruction, TimeBase,
    TrackedObject,
};

/// Content of the page, filled by the pipeline from a finished output folder.
#[derive(Clone, Debug)]
pub struct Data<'a> {
    /// Title: the input's file or folder name.
    pub title: String,
    /// Facts on the input: kind, size, rate, source of the intrinsics.
    pub input: Vec<Fact>,
    /// Version of the program.
    pub version: String,
    /// The command line.
    pub arguments: Vec<String>,
    /// Unit of the frames' times.
    pub time_base: TimeBase,
    /// All frames that were used, ascending in time.
    pub frames: &'a [Frame],
    /// The background, with the reasons for its missing frames.
    pub background: Model<'a>,
    /// Metric scale, if known.
    pub metric: Option<&'a Metric>,
    /// Ground points and local planes, if any were found.
    pub ground: Option<&'a Ground>,
    /// Every tracked vehicle, with or without a trajectory.
    pub objects: Vec<Object<'a>>,
    /// Other objects that could not be reconstructed.
    pub missing: Vec<Missing>,
    /// Film, strip and portraits.
    pub pictures: Pictures,
    /// Warnings of the run, the most severe first.
    pub warnings: Vec<String>,
    /// Cost of the run.
    pub stages: Vec<Stage>,
    /// Comparison with the ground truth, if it was given.
    pub evaluation: Option<&'a Evaluation>,
    /// The files and folders of the result.
    pub parts: Vec<Part>,
    /// True if models are all that was requested (`tractrix sfm`): then no trajectory is missing.
    pub is_sfm: bool,
}

/// A reconstruction and its missing frames.
#[derive(Clone, Debug)]
pub struct Model<'a> {
    /// Registered images and points; images belong to frames by name.
    pub reconstruction: &'a Reconstruction,
    /// Unregistered frames, with reasons.
    pub unregistered: BTreeMap<FrameId, String>,
}

impl<'a> Model<'a> {
    /// The registered image of each frame. Models made elsewhere share only the image names with the program.
    pub(super) fn images(&self, frames: &[Frame]) -> Vec<Option<&'a Image>> {
        let by_name: HashMap<&str, &'a Image> =
            self.reconstruction.images.values().map(|image| (image.name.as_str(), image)).collect();
        frames.iter().map(|frame| by_name.get(frame.name.as_str()).copied()).collect()
    }
}

/// One tracked vehicle.
#[derive(Clone, Debug)]
pub struct Object<'a> {
    /// Its id.
    pub id: ObjectId,
    /// Its class name.
    pub class: String,
    /// Mean score of its detections, 0 to 1.
    pub confidence: f64,
    /// Sources of its detections and its motion state, if known.
    pub tracked: Option<&'a TrackedObject>,
    /// The frames in which it has a mask, ascending.
    pub visible: Vec<FrameId>,
    /// Its reconstruction, if there is one.
    pub model: Option<Model<'a>>,
    /// Its trajectory, if there is one.
    pub trajectory: Option<&'a ObjectTrajectory>,
    /// Its ground track, where there is no usable trajectory.
    pub ground_track: Option<&'a GroundTrack>,
    /// The scale ratio of each single frame (eq. r_per_image), where the intersection method ran.
    pub ratio_per_frame: Vec<(FrameId, f64)>,
    /// Reason for a missing trajectory.
    pub failure: Option<String>,
}

impl<'a> Object<'a> {
    /// The ground track, where it is the reported result: the trajectory is missing or rejected.
    pub(super) fn answering_track(&self) -> Option<&'a GroundTrack> {
        self.ground_track.filter(|_| self.trajectory.is_none_or(ObjectTrajectory::is_ruled_out))
    }
}

/// An object without a reconstruction.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Missing {
    /// The object.
    pub what: String,
    /// The reason.
    pub reason: String,
}

/// A figure with a name.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Fact {
    /// The name.
    pub label: String,
    /// The figure, with its unit.
    pub value: String,
    /// Note for the reader.
    pub note: Option<String>,
}

impl Fact {
    /// A figure that needs no note.
    pub fn new(label: impl Into<String>, value: impl Into<String>) -> Self {
        Self { label: label.into(), value: value.into(), note: None }
    }

    /// A figure with a note.
    pub fn with_note(self, note: impl Into<String>) -> Self {
        Self { note: Some(note.into()), ..self }
    }
}

/// A file or a folder of the result, to which the page links.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// The vehicle it belongs to; `None` if the whole run.
    pub object: Option<ObjectId>,
    /// Its path, relative to the page, with `/` between folders and at the end of a folder.
    pub path: String,
    /// Content.
    pub holds: String,
}

/// Cost of one stage of the run.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Stage {
    /// Its name.
    pub name: String,
    /// Elapsed time, seconds.
    pub wall_s: f64,
    /// Time of all processors together, seconds.
    pub cpu_s: f64,
    /// Peak memory of the process up to its end, MiB.
    pub peak_rss_mib: f64,
    /// True if the result of an earlier run was reused.
    pub reused: bool,
}
