//! Warnings of a run, each with its section of docs/troubleshooting.md.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

/// Declares [`Topic`] from its variants and their sections.
macro_rules! topics {
    ($($name:ident: $anchor:literal,)*) => {
        /// Topic of a warning: a section of docs/troubleshooting.md, by its anchor and in the order of the page.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
        pub enum Topic {
            $(
                #[doc = concat!("Section `", $anchor, "`.")]
                #[serde(rename = $anchor)]
                $name,
            )*
        }

        with_names!(Topic { $($name = $anchor),* });
    };
}

topics! {
    TimeStampsMissing: "time-stamps-missing",
    FramesMissing: "frames-missing",
    FrameNotDecoded: "frame-not-decoded",
    FrameSizeChanges: "frame-size-changes",
    NoFrameRate: "no-frame-rate",
    FrameRateIgnored: "frame-rate-ignored",
    SeveralVideoTracks: "several-video-tracks",
    RepeatedFrames: "repeated-frames",
    InterlacedVideo: "interlaced-video",
    NonSquarePixels: "non-square-pixels",
    ImagesOfOtherKinds: "images-of-other-kinds",
    ImageUnreadable: "image-unreadable",
    ExifUnreadable: "exif-data-unreadable",
    ImageSizeDiffers: "image-size-differs",
    ImagesRotated: "images-rotated",
    ImageOrderDetected: "image-order-detected",
    IntrinsicsDoubtful: "intrinsics-doubtful",
    CalibrationDoesNotFit: "calibration-does-not-fit",
    IntrinsicsIncomplete: "intrinsics-incomplete",
    FocalLengthUncertain: "focal-length-uncertain",
    FocalLengthChanges: "focal-length-changes",
    PlanarScene: "planar-scene",
    ForwardMotion: "forward-motion",
    CameraHovers: "camera-hovers",
    BackgroundNotReconstructed: "background-not-reconstructed",
    FramesNotRegistered: "frames-not-registered",
    NetworksMissing: "networks-missing",
    MasksCoarse: "masks-coarse",
    ModelFindsNoVehicle: "model-finds-no-vehicle",
    NoVehicleTracked: "no-vehicle-tracked",
    DetectionsIgnored: "detections-ignored",
    VehicleSkipped: "vehicle-skipped",
    FramesWithoutMask: "frames-without-a-mask",
    UnknownVehicle: "unknown-vehicle",
    MotionWithoutGround: "motion-without-ground",
    VehicleNotReconstructed: "vehicle-not-reconstructed",
    GivenModelDoesNotFit: "given-model-does-not-fit",
    NoGroundLabels: "no-ground-labels",
    LabelsWithoutGround: "labels-without-ground",
    NoGroundFound: "no-ground-found",
    FramesWithoutGroundPlane: "frames-without-ground-plane",
    NoTrajectory: "no-trajectory",
    ScaleUndetermined: "scale-undetermined",
    NotAdjustedWithGround: "not-adjusted-with-the-ground",
    VehicleRejected: "vehicle-rejected",
    TelemetryUnreadable: "telemetry-unreadable",
    TelemetryDoesNotFit: "telemetry-does-not-fit",
    TelemetryAtAnotherTime: "telemetry-at-another-time",
    TelemetryLinesSkipped: "telemetry-lines-skipped",
    CameraAttitudeIgnored: "camera-attitude-ignored",
    CameraHeightUnusable: "camera-height-unusable",
    MapPointsIgnored: "map-points-ignored",
    KnownLengthUnusable: "known-length-unusable",
    VehicleProportionsOdd: "vehicle-proportions-odd",
    SourcesContradict: "sources-contradict",
    EvaluationNotKept: "evaluation-not-kept",
    SequenceSkipped: "sequence-skipped",
    ExportSkipped: "export-skipped",
    ListChanged: "list-changed",
}

impl Topic {
    /// Warning on this topic.
    pub fn warning(self, text: impl Into<String>) -> Warning {
        Warning { topic: self, text: text.into() }
    }

    /// Line that replaces further warnings on this topic.
    pub fn not_shown(self, num: usize) -> Warning {
        self.warning(format!("{num} more, in run.json"))
    }
}

/// Problem of an input or of a result that exists nevertheless.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Topic, which names the section of docs/troubleshooting.md.
    pub topic: Topic,
    /// Text: `subject: problem; remedy`.
    pub text: String,
}

impl Warning {
    /// The same warning, prefixed with its subject.
    pub fn of(&self, subject: &str) -> Self {
        Self { topic: self.topic, text: format!("{subject}: {}", self.text) }
    }
}

/// Start and end of the reference to the section, after the text.
const REFERENCE: [&str; 2] = [" [troubleshooting: ", "]"];

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [start, end] = REFERENCE;
        write!(f, "{}{start}{}{end}", self.text, self.topic.name())
    }
}

/// Text of a displayed warning, without the reference to its section.
pub fn warning_text(displayed: &str) -> &str {
    split(displayed).map_or(displayed, |(text, _)| text)
}

/// Displayed warnings, at most five on one topic; for each topic with more, a line with the number of the rest.
pub fn first_of_each_topic(displayed: Vec<String>) -> Vec<String> {
    let mut nums = BTreeMap::<Topic, usize>::new();
    let mut is_shown = |warning: &String| {
        let Some(topic) = split(warning).and_then(|(_, anchor)| Topic::ALL.iter().find(|of| of.name() == anchor))
        else {
            return true;
        };
        let num = nums.entry(*topic).or_default();
        *num += 1;
        *num <= MAX_SHOWN
    };
    let mut shown: Vec<String> = displayed.into_iter().filter(|warning| is_shown(warning)).collect();
    let more = nums.into_iter().filter(|(_, num)| *num > MAX_SHOWN);
    shown.extend(more.map(|(topic, num)| topic.not_shown(num - MAX_SHOWN).to_string()));
    shown
}

/// Maximum number of warnings shown on one topic: nobody reads more, and `run.json` has all.
pub const MAX_SHOWN: usize = 5;

/// Text and section of a displayed warning.
fn split(displayed: &str) -> Option<(&str, &str)> {
    let [start, end] = REFERENCE;
    let (text, anchor) = displayed.rsplit_once(start)?;
    Some((text, anchor.strip_suffix(end)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_names_its_section() {
        let warning = Topic::PlanarScene.warning("all points are near one plane").of("background");
        let displayed = warning.to_string();
        assert_eq!(displayed, "background: all points are near one plane [troubleshooting: planar-scene]");
        assert_eq!(warning_text(&displayed), warning.text);
        assert_eq!(warning_text("a [b] c"), "a [b] c");
    }

    #[test]
    fn of_many_warnings_on_one_topic_five_are_shown() {
        let far = |id: u32| Topic::VehicleSkipped.warning(format!("object {id}: skipped: far")).to_string();
        let other = Topic::PlanarScene.warning("flat").to_string();
        let mut all: Vec<String> = (0..5).map(far).collect();
        all.push(other.clone());
        assert_eq!(first_of_each_topic(all.clone()), all);
        let mut shown = all.clone();
        shown.push("2 more, in run.json [troubleshooting: vehicle-skipped]".to_owned());
        all.extend([far(5), far(6)]);
        assert_eq!(first_of_each_topic(all), shown);
        let plain: Vec<String> = (0..7).map(|k| format!("without a section {k}")).collect();
        assert_eq!(first_of_each_topic(plain.clone()), plain);
    }
}
