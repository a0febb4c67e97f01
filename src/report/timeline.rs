//! Times of a run and their display: in seconds where the input has times, else in frames.

use super::data::{Data, Fact};
use super::ticks::{Tick, ticks, whole_ticks};
use super::words::count;
use crate::scene::{FrameId, TimeBase};

/// Times of all frames.
#[derive(Clone, Debug)]
pub(super) struct Timeline {
    pub base: TimeBase,
    ids: Vec<FrameId>,
    /// Times of the frames and of the end of the last one, strictly ascending.
    times: Vec<f64>,
}

impl Timeline {
    pub fn new(data: &Data) -> Self {
        let base = data.time_base;
        let of = |frame: &crate::scene::Frame| match base {
            TimeBase::Seconds => frame.time_s,
            TimeBase::Frames => f64::from(frame.id.0),
        };
        let times = rising(data.frames.iter().map(of));
        Self { base, ids: data.frames.iter().map(|f| f.id).collect(), times }
    }

    /// The timeline of `num_frames` frames without a rate.
    #[cfg(test)]
    pub fn of_frames(num_frames: u32) -> Self {
        let times = rising((0..num_frames).map(f64::from));
        Self { base: TimeBase::Frames, ids: (0..num_frames).map(FrameId).collect(), times }
    }

    /// The time of a frame; `None` if it is no frame of the run.
    pub fn of(&self, frame: FrameId) -> Option<f64> {
        self.ids.binary_search(&frame).ok().map(|i| self.times[i])
    }

    /// One time per frame, and the end of the last one.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// From the first frame to the end of the last.
    pub fn span(&self) -> (f64, f64) {
        (self.times[0], self.times[self.times.len() - 1])
    }

    /// Label of a frame's time: "3.60 s", "frame 36".
    pub fn stamp(&self, frame: FrameId) -> String {
        match (self.base, self.of(frame)) {
            (TimeBase::Seconds, Some(time)) => format!("{time:.2} s"),
            _ => format!("frame {}", frame.0),
        }
    }

    /// Label of a range of frames: "0.40 s to 3.60 s", "frames 4 to 36".
    pub fn range(&self, first: FrameId, last: FrameId) -> String {
        match self.base {
            TimeBase::Seconds => format!("{} to {}", self.stamp(first), self.stamp(last)),
            TimeBase::Frames => format!("frames {} to {}", first.0, last.0),
        }
    }

    /// Label of the range between two indices of the list.
    pub fn range_at(&self, first: usize, last: usize) -> String {
        self.range(self.ids[first], self.ids[last])
    }

    /// Length of the input.
    pub fn length(&self) -> Fact {
        let frames = count(self.ids.len(), "frame");
        let (start, end) = self.span();
        match self.base {
            TimeBase::Seconds => Fact::new("length", format!("{:.1} s", end - start)).with_note(frames),
            TimeBase::Frames => Fact::new("length", frames).with_note("frame rate unknown"),
        }
    }

    /// Ticks of a time axis, with their unit.
    pub fn ticks(&self) -> Vec<Tick> {
        match self.base {
            TimeBase::Seconds => labelled(ticks(self.span()).0, |_, label| format!("{label} s")),
            // The first tick names the unit of the others.
            TimeBase::Frames => labelled(whole_ticks(self.span()), |k, label| match k {
                0 => format!("frame {label}"),
                _ => label,
            }),
        }
    }

    /// The unit of speeds, for lengths in a unit.
    pub fn speed_unit(&self, length: &str) -> String {
        match self.base {
            TimeBase::Seconds => format!("{length} per second"),
            TimeBase::Frames => format!("{length} per frame"),
        }
    }
}

fn labelled(ticks: Vec<Tick>, label: impl Fn(usize, String) -> String) -> Vec<Tick> {
    ticks.into_iter().enumerate().map(|(k, tick)| Tick { at: tick.at, label: label(k, tick.label) }).collect()
}

/// Strictly ascending times, followed by the end of the last frame. A time that is not finite or does not ascend is
/// replaced by one shortly after its predecessor.
fn rising(given: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut times: Vec<f64> = Vec::new();
    for time in given {
        let next = match times.last() {
            Some(&last) if time.is_finite() && time > last => time,
            // Each has a distinct time.
            Some(&last) => last + 1e-3,
            None if time.is_finite() => time,
            None => 0.0,
        };
        times.push(next);
    }
    let first = times.first().copied().unwrap_or(0.0);
    let last = times.last().copied().unwrap_or(0.0);
    let step = if times.len() > 1 { (last - first) / (times.len() - 1) as f64 } else { 1.0 };
    times.push(last + step);
    times
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn times_rise_whatever_is_given() {
        let times = rising([f64::NAN, 1.0, 0.5, f64::INFINITY, 2.0].into_iter());
        assert!(times.windows(2).all(|w| w[0] < w[1]) && times.iter().all(|t| t.is_finite()), "{times:?}");
        assert_eq!(times.len(), 6);
        assert_eq!(rising(std::iter::empty()), [1.0]);
    }

    #[test]
    fn without_a_rate_everything_is_counted_in_frames() {
        let mut world = testing::world();
        world.time_base = TimeBase::Frames;
        let timeline = Timeline::new(&world.data());
        assert_eq!(timeline.span(), (0.0, 60.0));
        assert_eq!(timeline.stamp(FrameId(36)), "frame 36");
        assert_eq!(timeline.range(FrameId(4), FrameId(36)), "frames 4 to 36");
        assert_eq!(
            (timeline.length().value.as_str(), timeline.speed_unit("units").as_str()),
            ("60 frames", "units per frame")
        );
        let labels: Vec<String> = timeline.ticks().into_iter().map(|t| t.label).collect();
        assert_eq!(labels, ["frame 0", "20", "40", "60"]);
        world.frames.truncate(2);
        let labels: Vec<String> = Timeline::new(&world.data()).ticks().into_iter().map(|t| t.label).collect();
        assert_eq!(labels, ["frame 0", "1", "2"], "there is no half frame");
    }

    #[test]
    fn with_times_everything_is_said_in_seconds() {
        let mut world = testing::world();
        world.frames[3].time_s = f64::NAN;
        let data = world.data();
        let timeline = Timeline::new(&data);
        assert!(timeline.stamp(FrameId(3)).ends_with(" s") && !timeline.stamp(FrameId(3)).contains("NaN"));
        assert!(timeline.ticks().iter().all(|t| t.label.ends_with(" s")));
        assert_eq!(timeline.of(FrameId(999)), None);
    }
}
