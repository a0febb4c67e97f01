//! Warnings of a run, each with its section of docs/troubleshooting.md.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Declares [`Topic`] from its variants and their sections.
macro_rules! topics {
    ($($name:ident: $anchor:literal,)*) => {
        /// Topic of a warning: a section of docs/troubleshooting.md, by its anchor and in the order of the page.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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
}

/// Problem of an input or a result that exists nevertheless.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Topic, which names the section of docs/troubleshooting.md.
    pub topic: Topic,
    /// Text: `subject: problem; remedy`.
    pub text: String,
}

impl Warning {
    /// The same warning with its subject in front.
    pub fn of(&self, subject: &str) -> Self {
        Self { topic: self.topic, text: format!("{subject}: {}", self.text) }
    }
}

/// Start and end of the reference to the section, behind the text.
const REFERENCE: [&str; 2] = [" [troubleshooting: ", "]"];

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [start, end] = REFERENCE;
        write!(f, "{}{start}{}{end}", self.text, self.topic.name())
    }
}

/// Text of a displayed warning, without the reference to its section.
pub fn warning_text(displayed: &str) -> &str {
    let [start, end] = REFERENCE;
    match displayed.rsplit_once(start) {
        Some((text, anchor)) if anchor.ends_with(end) => text,
        _ => displayed,
    }
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
}
