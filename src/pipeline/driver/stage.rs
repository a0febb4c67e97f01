//! The stages of a run: their order, and their names in files and messages.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The stages of a run, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stage {
    /// List of frames and their times.
    Frames,
    /// Instances in every frame.
    Segment,
    /// Tracks of image points on the background.
    Features,
    /// Structure from motion of the background.
    Background,
    /// Points and objects that move against the background.
    Motion,
    /// One mask per object and frame.
    Track,
    /// Tracks of image points on every object.
    Follow,
    /// Structure from motion of every object.
    Objects,
    /// Ground points and local planes.
    Ground,
    /// Scale ratios and trajectories.
    Scale,
    /// Trajectories in metres and on the map.
    Metric,
    /// Report page.
    Report,
}

with_names!(Stage {
    Frames = "frames",
    Segment = "segment",
    Features = "features",
    Background = "background",
    Motion = "motion",
    Track = "track",
    Follow = "follow",
    Objects = "objects",
    Ground = "ground",
    Scale = "scale",
    Metric = "metric",
    Report = "report",
});

impl Stage {
    /// The stages whose results this one reads.
    pub fn after(self) -> &'static [Self] {
        use Stage::{
            Background, Features, Follow, Frames, Ground, Metric, Motion, Objects, Report, Scale, Segment, Track,
        };
        match self {
            Frames => &[],
            Segment => &[Frames],
            Features => &[Frames, Segment],
            Background => &[Features],
            Motion => &[Segment, Background],
            Track => &[Segment, Motion],
            Follow => &[Track],
            Objects => &[Follow, Background],
            Ground => &[Background, Objects],
            Scale => &[Ground],
            Metric => &[Scale],
            Report => &[Metric],
        }
    }

    /// This stage and all that depend on it, directly or not.
    pub fn and_dependents(self) -> Vec<Self> {
        let mut found = vec![self];
        for stage in Self::ALL {
            if !found.contains(&stage) && stage.after().iter().any(|before| found.contains(before)) {
                found.push(stage);
            }
        }
        found
    }

    /// Returns the stage with a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|stage| stage.name() == name)
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.name().fmt(f)
    }
}
