//! Progress of a run: shown by the terminal, optional for users of the library.

use crate::pipeline::{Instances, Options, Stage, Workspace};
use crate::video::{self, Info, Position};

/// Receiver of the progress of a run.
pub trait Progress: Sync {
    /// Announces the plan, before the first stage.
    fn plan(&self, _: &Plan) {}
    /// Begins a stage, with `total` steps where the number is known. The same name again begins the next part of the
    /// stage, whose steps are counted from 0. The phase `input` precedes the first stage.
    fn begin(&self, _stage: &str, _total: Option<u64>) {}
    /// Counts a finished step.
    fn step(&self) {}
    /// Sets the number of finished steps. Never decreases: smaller numbers are ignored.
    fn reach(&self, _done: u64) {}
    /// Shows a note that is neither a warning nor an error.
    fn note(&self, _: &str) {}
    /// Ends the stage.
    fn end(&self) {}
    /// Skips a stage whose results an earlier run left.
    fn skip(&self, _stage: &str) {}
    /// Returns true if the run is to stop at the next unit of work: a frame, an object, a stage. Finished work is kept.
    fn is_stopped(&self) -> bool {
        false
    }
}

/// Progress receiver that ignores everything.
pub struct Silent;

impl Progress for Silent {}

/// Progress receiver that shows nothing, and stops when another one does.
pub(in crate::pipeline) struct Muted<'a>(pub(in crate::pipeline) &'a dyn Progress);

impl Progress for Muted<'_> {
    fn is_stopped(&self) -> bool {
        self.0.is_stopped()
    }
}

/// The stages up to a goal, in order, with their expected durations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// Ascending.
    pub stages: Vec<Planned>,
}

/// A planned stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planned {
    /// The stage.
    pub stage: Stage,
    /// Expected duration, seconds: that of an earlier run in the same folder; else the typical one, scaled by the pace
    /// of the stages with a known duration.
    pub expected_s: f64,
}

impl Plan {
    /// Creates the plan before the first frame is read.
    pub(in crate::pipeline) fn new(workspace: &Workspace, options: &Options, info: &Info, goal: Stage) -> Self {
        let stages: Vec<Stage> = Stage::ALL.into_iter().filter(|stage| *stage <= goal).collect();
        let before = |stage: Stage| workspace.marker(stage).map(|marker| marker.cost.wall_s);
        let usual = |stage: Stage| usual_s(stage, options, info);
        let known = stages.iter().filter_map(|&stage| Some((before(stage)?, usual(stage))));
        let (took, usually) = known.fold((0.0, 0.0), |(a, b), (x, y)| (a + x, b + y));
        let pace = if took > 0.0 && usually > 0.0 { took / usually } else { 1.0 };
        let planned =
            |stage: Stage| Planned { stage, expected_s: before(stage).unwrap_or_else(|| pace * usual(stage)) };
        Self { stages: stages.into_iter().map(planned).collect() }
    }
}

/// Typical duration of a stage, seconds, on two cores of 2020. Mainly the ratios matter: the terminal corrects the pace
/// during the run.
fn usual_s(stage: Stage, options: &Options, info: &Info) -> f64 {
    let frames = num_frames(&options.video, info);
    let megapixels = f64::from(info.width) * f64::from(info.height) * 1e-6;
    let with_model = matches!(options.instances, Instances::Model(_));
    let found_by_default = options.instances == Instances::Vehicles;
    let is_looked_for = options.instances != Instances::None;
    let with_ground_model = matches!(options.ground_labels, crate::pipeline::GroundLabels::Model(_));
    let (per_frame, per_megapixel) = match stage {
        Stage::Frames => (0.0, 0.01),
        Stage::Segment if found_by_default || with_model => (0.1, 0.02),
        Stage::Features => (0.0, 0.15),
        Stage::Motion if is_looked_for => (0.0, 0.08),
        Stage::Track if found_by_default => (0.2, 0.1),
        Stage::Track if with_model => (0.0, 0.08),
        Stage::Track => (0.0, 0.02),
        Stage::Follow => (0.0, 0.05),
        Stage::Background | Stage::Objects => (0.03, 0.0),
        Stage::Ground if with_ground_model => (0.3, 0.0),
        Stage::Scale => (0.005, 0.0),
        Stage::Ground | Stage::Metric => (0.002, 0.0),
        Stage::Report => (0.01, 0.0),
        Stage::Segment | Stage::Motion => (0.0, 0.0),
    };
    frames * (per_frame + per_megapixel * megapixels)
}

/// Number of frames that the options select, by the metadata: 300 for a video whose container does not state it.
fn num_frames(options: &video::Options, info: &Info) -> f64 {
    // Number of frames assumed for a video whose container does not state it.
    let all = f64::from(info.num_frames.unwrap_or(300));
    let index = |position: Position| match position {
        Position::Frame(index) => f64::from(index),
        Position::Seconds(seconds) => info.fps.map_or(all, |fps| seconds * fps),
    };
    let first = options.start.map_or(0.0, index);
    let end = options.end.map_or(all, index).min(all);
    ((end - first) / f64::from(options.every.max(1))).max(1.0)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::pipeline::{Cost, Marker};
    use crate::video::Kind;

    fn info() -> Info {
        Info {
            kind: Kind::Video,
            width: 1000,
            height: 1000,
            source_width: 1000,
            source_height: 1000,
            stored_width: 1000,
            stored_height: 1000,
            video_track: Some(0),
            fps: None,
            num_frames: Some(100),
            rotation_deg: 0,
            exif_focal_px: None,
        }
    }

    #[test]
    fn an_earlier_run_sets_the_pace() {
        let folder = tempfile::tempdir().unwrap();
        let workspace = Workspace::open(folder.path()).unwrap();
        let plan = |goal| Plan::new(&workspace, &Options::default(), &info(), goal);
        let fresh = plan(Stage::Report);
        assert_eq!(fresh.stages.iter().map(|planned| planned.stage).collect::<Vec<_>>(), Stage::ALL);
        assert_eq!(plan(Stage::Track).stages.len(), 6);
        let expected = |plan: &Plan, stage| plan.stages.iter().find(|p| p.stage == stage).unwrap().expected_s;
        let wall_s = 4.0 * expected(&fresh, Stage::Features);
        let marker = Marker {
            fingerprint: String::new(),
            cost: Cost { wall_s, ..Cost::default() },
            warnings: Vec::new(),
            figures: BTreeMap::new(),
            outputs: Vec::new(),
        };
        workspace.set_marker(Stage::Features, &marker).unwrap();
        let again = plan(Stage::Report);
        assert_eq!(expected(&again, Stage::Features), wall_s);
        let ratio = expected(&again, Stage::Background) / expected(&fresh, Stage::Background);
        assert!((ratio - 4.0).abs() < 1e-12, "{ratio}");
    }
}
