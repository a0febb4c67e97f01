//! Forecast of a run's remaining time.
//!
//! Every stage has an expected time. How much longer or shorter than that the finished stages took sets the pace, and
//! the stage under way is judged by its own steps as well: `T` seconds after its begin at the share `f` of its steps,
//! with the expectation `P`, its whole time is `(C P + T) / (C + f)`. At the beginning that is the expectation, at the
//! end what it took, and in between one slow step cannot make it explode, as the plain `T / f` does. Between two steps
//! nothing is learned, and the rest counts down. A stage of several parts is judged by the part under way, for which
//! there is what the earlier parts left of `P`.

use crate::pipeline::{Plan, Stage};

/// Weight `C` of the expectation, as a share of the stage.
const EXPECTATION: f64 = 0.5;
/// Expected seconds that must be over before the pace counts as much as the expectation.
const PACE_AFTER_S: f64 = 10.0;

/// Expected times of a run's stages.
#[derive(Clone, Debug, Default)]
pub(super) struct Forecast {
    /// Stages that are not over, with their expected seconds.
    open: Vec<(Stage, f64)>,
    num_stages: usize,
    /// Expected and elapsed seconds of the stages that are over.
    expected_s: f64,
    elapsed_s: f64,
}

/// Progress of a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Position {
    pub(super) stage: Stage,
    /// Seconds since it began.
    pub(super) elapsed_s: f64,
    /// Seconds of its earlier parts.
    pub(super) before_s: f64,
    /// Seconds from the begin of the part under way to its last step.
    pub(super) part_s: f64,
    /// Share of the steps of this part that is done, where they are known.
    pub(super) share: Option<f64>,
}

impl Forecast {
    pub(super) fn new(plan: &Plan) -> Self {
        let open: Vec<_> = plan.stages.iter().map(|planned| (planned.stage, planned.expected_s)).collect();
        Self { num_stages: open.len(), open, ..Self::default() }
    }

    /// Which stage of how many this is, from 1; `None` for one that is not planned.
    pub(super) fn index(&self, stage: Stage) -> Option<(usize, usize)> {
        let index = Stage::ALL.into_iter().position(|other| other == stage)? + 1;
        (index <= self.num_stages).then_some((index, self.num_stages))
    }

    /// A stage is over; it took `elapsed_s`, or nothing because an earlier run had done it.
    pub(super) fn finish(&mut self, stage: Stage, elapsed_s: Option<f64>) {
        let Some(at) = self.open.iter().position(|(other, _)| *other == stage) else { return };
        let (_, expected_s) = self.open.remove(at);
        if let Some(elapsed_s) = elapsed_s {
            self.expected_s += expected_s;
            self.elapsed_s += elapsed_s;
        }
    }

    /// Seconds until the end of the last stage; `None` where nothing was planned.
    pub(super) fn left_s(&self, position: &Position) -> Option<f64> {
        let (_, expected_s) = self.open.iter().find(|(stage, _)| *stage == position.stage)?;
        let here_s = left_of_stage_s(self.pace() * expected_s, position);
        let later_s: f64 = self.open.iter().filter(|(stage, _)| *stage > position.stage).map(|(_, s)| s).sum();
        Some(here_s + self.pace() * later_s)
    }

    fn pace(&self) -> f64 {
        (PACE_AFTER_S + self.elapsed_s) / (PACE_AFTER_S + self.expected_s)
    }
}

fn left_of_stage_s(expected_s: f64, position: &Position) -> f64 {
    let Position { elapsed_s, before_s, part_s, share, .. } = *position;
    let Some(share) = share else { return (expected_s - elapsed_s).max(0.0) };
    let rest_s = (expected_s - before_s).max(0.0);
    // Where nothing is left of the expectation, the steps alone count.
    let weight = if rest_s > 0.0 { EXPECTATION } else { 0.0 };
    let whole_s = if weight + share > 0.0 { (weight * rest_s + part_s) / (weight + share) } else { 0.0 };
    let since_step_s = elapsed_s - before_s - part_s;
    (whole_s * (1.0 - share) - since_step_s).max(0.0)
}

/// A time that is left, in words, as coarse as it is known.
pub(super) fn in_words(left_s: f64) -> String {
    let (seconds, minutes) = (left_s.ceil() as u64, (left_s / 60.0).ceil() as u64);
    match minutes {
        _ if seconds <= 5 => "a few seconds left".to_owned(),
        0 | 1 => format!("about {} s left", seconds.next_multiple_of(10)),
        2..=89 => format!("about {minutes} min left"),
        _ => format!("about {} h {:02} min left", minutes / 60, minutes % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Planned;

    fn forecast() -> Forecast {
        let planned = |(stage, expected_s)| Planned { stage, expected_s };
        let stages = [(Stage::Frames, 10.0), (Stage::Segment, 60.0), (Stage::Track, 40.0)].map(planned);
        Forecast::new(&Plan { stages: stages.to_vec() })
    }

    fn at(stage: Stage, elapsed_s: f64, share: f64) -> Position {
        Position { stage, elapsed_s, before_s: 0.0, part_s: elapsed_s, share: Some(share) }
    }

    #[test]
    fn without_a_step_the_rest_counts_down_and_never_rises() {
        let forecast = forecast();
        let left_s = |elapsed_s| {
            let waiting = Position { elapsed_s, part_s: 0.0, ..at(Stage::Segment, 0.0, 0.0) };
            forecast.left_s(&waiting).unwrap()
        };
        assert_eq!((left_s(0.0), left_s(10.0), left_s(60.0), left_s(300.0)), (100.0, 90.0, 40.0, 40.0));
    }

    #[test]
    fn the_next_part_has_what_is_left_of_the_expectation() {
        let forecast = forecast();
        let part = |before_s, part_s, share| {
            let elapsed_s = before_s + part_s;
            forecast.left_s(&Position { stage: Stage::Segment, elapsed_s, before_s, part_s, share: Some(share) })
        };
        assert_eq!((part(20.0, 0.0, 0.0), part(20.0, 20.0, 0.5)), (Some(80.0), Some(60.0)));
        assert_eq!((part(70.0, 0.0, 0.0), part(70.0, 5.0, 0.5)), (Some(40.0), Some(45.0)));
    }

    #[test]
    fn a_run_as_expected_counts_down() {
        let mut forecast = forecast();
        assert_eq!(forecast.left_s(&at(Stage::Frames, 0.0, 0.0)), Some(110.0));
        forecast.finish(Stage::Frames, Some(10.0));
        assert_eq!(forecast.left_s(&at(Stage::Segment, 30.0, 0.5)), Some(70.0));
        assert_eq!(forecast.index(Stage::Segment), Some((2, 3)));
        assert_eq!(forecast.left_s(&at(Stage::Report, 1.0, 0.5)), None);
    }

    #[test]
    fn what_was_done_before_sets_no_pace_and_a_slow_machine_does() {
        let mut forecast = forecast();
        forecast.finish(Stage::Frames, None);
        assert_eq!(forecast.left_s(&at(Stage::Segment, 0.0, 0.0)), Some(100.0));
        forecast.finish(Stage::Segment, Some(600.0));
        let left_s = forecast.left_s(&at(Stage::Track, 0.0, 0.0)).unwrap();
        assert!((300.0..400.0).contains(&left_s), "{left_s}");
    }

    #[test]
    fn steps_of_unequal_length_do_not_make_the_time_explode() {
        let mut forecast = forecast();
        forecast.finish(Stage::Frames, Some(10.0));
        forecast.finish(Stage::Segment, Some(60.0));
        // One of nine vehicles takes half of the time: the plain rate would promise nine times that.
        let largest =
            (0..=20).map(|s| forecast.left_s(&at(Stage::Track, f64::from(s), 0.0)).unwrap()).fold(0.0, f64::max);
        assert!(largest <= 80.0, "{largest}");
        let end = forecast.left_s(&at(Stage::Track, 39.0, 1.0)).unwrap();
        assert_eq!(end, 0.0);
    }

    #[test]
    fn times_are_as_coarse_as_they_are_known() {
        assert_eq!((in_words(2.0), in_words(12.0)), ("a few seconds left".to_owned(), "about 20 s left".to_owned()));
        assert_eq!(in_words(330.0), "about 6 min left");
        assert_eq!(in_words(3.0 * 3600.0 - 1.0), "about 3 h 00 min left");
    }
}
