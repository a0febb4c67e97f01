//! Data types shared by all modules: frames, masks, flow, detections, reconstructions, ground, trajectories.
//!
//! Values only: this module does not access files and has no algorithms of its own.

mod boxes;
mod flow;
mod focal_change;
mod frame;
mod ground;
mod ground_track;
mod mask;
mod mesh;
mod metric;
mod position;
mod reconstruction;
mod scale_method;
mod tracked;
mod trajectory;
mod verdict;
mod warning;

pub use boxes::{BoxDetection, DetectionSource, Rect};
pub use flow::Flow;
pub use focal_change::FocalChange;
pub use frame::{Frame, FrameId, ObjectId, TimeBase, Timed, clock_in_seconds};
pub use ground::{Ground, GroundPlane, GroundSource, PlaneBasis};
pub use ground_track::{
    ContactError, GroundPosition, GroundTrack, GroundTrackMethod, GroundTrackTrust, GroundTrackVerdict, NoContact,
};
pub use mask::{BoundingBox, Detection, LabelMap, MAX_MASK_PIXELS, Mask, TRUNCATION_PX};
pub use mesh::TriangleMesh;
pub use metric::{
    ClockZone, Dates, Dimensions, Estimate, MapOrigin, MapPlace, Metric, MetricAxes, MetricContradiction, MetricFrame,
    MetricPose, MetricShare, MetricStd, MetricVerdict, Motion, Travel, sources_in_words,
};
pub use position::Position;
pub use reconstruction::{
    CameraForm, CameraId, Image, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement,
};
pub use scale_method::{MethodInfo, ScaleMethod};
pub use tracked::{
    DetectionCounts, Gap, IdentityEvidence, Movement, MovementFinding, Outline, TrackedObject, UnmergedTrack,
};
pub use trajectory::{
    BodyCenter, CameraPathRatio, ModelState, ObjectPose, ObjectTrajectory, Ratios, Reference, References,
    ScaleEstimate, ScaleShares, ScaleSupport, StationaryVehicles, Trajectories, Unit,
};
pub use verdict::{Finding, Reason, ReasonKind, Trust, Verdict};
pub use warning::{MAX_SHOWN, Topic, Warning, first_of_each_topic, warning_text};
