//! Where a run is between its beginning and its end, and how that is reported.

use std::time::Instant;

use serde_json::{Value, json};

use super::forecast::{Forecast, Position, in_words};
use crate::pipeline::{Plan, Stage};

/// Stages that a run has finished, and the current one.
pub(super) struct StageProgress {
    started: Instant,
    forecast: Forecast,
    current: Option<Current>,
}

/// The stage under way.
struct Current {
    name: String,
    /// `None` for what comes before the first stage.
    stage: Option<Stage>,
    started: Instant,
    /// Begin of the part under way, and its last step.
    part_started: Instant,
    stepped: Instant,
    done: u64,
    total: Option<u64>,
}

/// News of a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event {
    /// It begins.
    Begins,
    /// It goes on.
    GoesOn,
    /// It is over.
    Ends,
    /// An earlier run had done it.
    DoneBefore,
}

/// Progress of a run at a moment.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Moment {
    pub(super) name: String,
    pub(super) event: Event,
    /// Which stage of how many, from 1; `None` before the first one.
    pub(super) index: Option<(usize, usize)>,
    pub(super) done: u64,
    pub(super) total: Option<u64>,
    /// Since the stage began, seconds.
    pub(super) stage_s: f64,
    /// Since the run began, seconds.
    pub(super) elapsed_s: f64,
    /// Until its end, seconds, as far as that can be determined.
    pub(super) left_s: Option<f64>,
}

impl StageProgress {
    pub(super) fn new() -> Self {
        Self { started: Instant::now(), forecast: Forecast::default(), current: None }
    }

    pub(super) fn plan(&mut self, plan: &Plan) {
        *self = Self { forecast: Forecast::new(plan), ..Self::new() };
    }

    /// A stage begins, or its next part does.
    pub(super) fn begin(&mut self, name: &str, total: Option<u64>) -> Option<Moment> {
        let is_new = self.current.as_ref().is_none_or(|current| current.name != name);
        let now = Instant::now();
        let started = match &self.current {
            Some(current) if !is_new => current.started,
            _ => now,
        };
        let (part_started, stepped, stage) = (now, now, Stage::named(name));
        self.current = Some(Current { name: name.to_owned(), stage, started, part_started, stepped, done: 0, total });
        self.moment(if is_new { Event::Begins } else { Event::GoesOn })
    }

    pub(super) fn step(&mut self) -> u64 {
        let done = self.current.as_ref().map_or(0, |current| current.done);
        self.reach(done + 1)
    }

    /// So many steps are done, or more were before, and never more than there are; gives how many.
    pub(super) fn reach(&mut self, done: u64) -> u64 {
        let Some(current) = &mut self.current else { return done };
        let done = done.min(current.total.unwrap_or(u64::MAX));
        if done > current.done {
            (current.done, current.stepped) = (done, Instant::now());
        }
        current.done
    }

    pub(super) fn end(&mut self) -> Option<Moment> {
        let current = self.current.as_ref()?;
        if let Some(stage) = current.stage {
            self.forecast.finish(stage, Some(current.started.elapsed().as_secs_f64()));
        }
        let moment = self.moment(Event::Ends);
        self.current = None;
        moment
    }

    /// A stage is left out because an earlier run had done it.
    pub(super) fn skip(&mut self, name: &str) -> Option<Moment> {
        self.begin(name, None);
        if let Some(stage) = Stage::named(name) {
            self.forecast.finish(stage, None);
        }
        let moment = self.moment(Event::DoneBefore);
        self.current = None;
        moment
    }

    /// Progress of the current stage; `None` between stages.
    pub(super) fn moment(&self, event: Event) -> Option<Moment> {
        let current = self.current.as_ref()?;
        let share = current.total.filter(|total| *total > 0).map(|total| current.done as f64 / total as f64);
        let elapsed_s = current.started.elapsed().as_secs_f64();
        let before_s = (current.part_started - current.started).as_secs_f64();
        let part_s = (current.stepped - current.part_started).as_secs_f64();
        let left_s = |stage| self.forecast.left_s(&Position { stage, elapsed_s, before_s, part_s, share });
        Some(Moment {
            name: current.name.clone(),
            event,
            index: current.stage.and_then(|stage| self.forecast.index(stage)),
            done: current.done,
            total: current.total,
            stage_s: elapsed_s,
            elapsed_s: self.started.elapsed().as_secs_f64(),
            left_s: current.stage.and_then(left_s),
        })
    }
}

impl Moment {
    /// `stage 5 of 9`; nothing before the first one.
    pub(super) fn place(&self) -> String {
        self.index.map_or_else(String::new, |(index, of)| format!("stage {index} of {of}"))
    }

    /// For people.
    pub(super) fn line(&self) -> String {
        let name = &self.name;
        match self.event {
            Event::Begins => format!("{name:<10} {}", self.place()).trim_end().to_owned(),
            Event::GoesOn => {
                let steps = self.total.map(|total| format!("{} of {total}", self.done));
                let steps = steps.unwrap_or_else(|| format!("{:.0} s so far", self.stage_s));
                let left = self.left_s.map(|left_s| format!(", {}", in_words(left_s))).unwrap_or_default();
                format!("{name:<10} {steps}{left}")
            }
            Event::Ends => format!("{name:<10} {:.1} s", self.stage_s),
            Event::DoneBefore => format!("{name:<10} up to date"),
        }
    }

    /// For programs.
    pub(super) fn json(&self) -> Value {
        let event = match self.event {
            Event::Begins => "begins",
            Event::GoesOn => "goes-on",
            Event::Ends => "ends",
            Event::DoneBefore => "done-before",
        };
        json!({
            "stage": self.name,
            "event": event,
            "index": self.index.map(|(index, _)| index),
            "of": self.index.map(|(_, of)| of),
            "done": self.done,
            "total": self.total,
            "elapsed_s": rounded(self.elapsed_s),
            "left_s": self.left_s.map(rounded),
        })
    }
}

/// Milliseconds are enough.
fn rounded(seconds: f64) -> f64 {
    (seconds * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Planned;

    fn course() -> StageProgress {
        let planned = |stage| Planned { stage, expected_s: 1000.0 };
        let mut course = StageProgress::new();
        course.plan(&Plan { stages: [Stage::Frames, Stage::Segment].map(planned).to_vec() });
        course
    }

    #[test]
    fn a_run_is_told_from_stage_to_stage() {
        let mut course = course();
        assert_eq!(course.begin("input", None).unwrap().line(), "input");
        assert!(course.end().is_some() && course.moment(Event::GoesOn).is_none());
        assert_eq!(course.skip("frames").unwrap().line(), "frames     up to date");
        assert_eq!(course.begin("segment", Some(40)).unwrap().line(), "segment    stage 2 of 2");
        assert_eq!((course.step(), course.reach(10), course.reach(4)), (1, 10, 10));
        let moment = course.moment(Event::GoesOn).unwrap();
        assert_eq!(moment.line(), "segment    10 of 40, about 9 min left");
        let json = moment.json();
        assert_eq!(
            (&json["index"], &json["of"], &json["done"], &json["total"]),
            (&json!(2), &json!(2), &json!(10), &json!(40))
        );
        assert!(course.end().unwrap().line().ends_with(" s"));
    }

    #[test]
    fn the_next_part_of_a_stage_is_no_new_stage() {
        let mut course = course();
        course.begin("segment", None);
        assert_eq!(course.begin("segment", Some(3)).unwrap().event, Event::GoesOn);
        assert_eq!((course.reach(2), course.step(), course.step(), course.reach(146)), (2, 3, 3, 3));
        let moment = course.begin("segment", Some(2)).unwrap();
        assert_eq!((moment.event, moment.done, moment.total), (Event::GoesOn, 0, Some(2)));
    }
}
