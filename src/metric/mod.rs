//! Metric scale of the background's frame, and its georeferenced pose.
//!
//! A monocular reconstruction has an arbitrary unit of length. The logarithm of metres per unit is estimated by several
//! sources, each with a standard deviation: a receiver's fixes along the camera's path ([`align_to_fixes`], which also
//! gives position and north), a known height or length ([`Measured`]), and typical vehicle sizes ([`vehicle_sizes`]).
//! [`fuse`] weights them by their inverse variances, tests them against one another and reports the kind of evidence of
//! the result.
//!
//! `metric` is a frame of axes east, north and up in metres if a receiver gave it, otherwise one with the z axis up.
//! `docs/maths/metric.md` derives the equations. This room is arithmetic on values.

/// Lets serde read and write a type by its `FromStr` and `Display`: with
/// `#[serde(try_from = "String", into = "String")]`, it is a text in files.
macro_rules! text_in_files {
    ($name:ident, $error:ident) => {
        impl TryFrom<String> for $name {
            type Error = $error;

            fn try_from(text: String) -> Result<Self, $error> {
                text.parse()
            }
        }

        impl From<$name> for String {
            fn from(value: $name) -> Self {
                value.to_string()
            }
        }
    };
}

pub mod align;
mod attitude;
mod camera_path;
mod fix;
mod fusion;
mod known;
mod level;
mod map_points;
mod measured;
mod placing;
mod utc_offset;
mod vehicles;

pub use align::{Alignment, Gravity, Offset, Orientation, Refusal, Support, align_to_fixes};
pub use attitude::{metric_from_cam, orientation};
pub use camera_path::{CameraPath, DRIFT};
pub use fix::PositionFix;
pub use fusion::{Fused, Kind, Source, fuse};
pub use known::{KnownLength, KnownLengthError};
pub use level::{Level, frame_on_ground, frame_on_map};
pub use map_points::{MapPoint, MapPointsError, camera_over_map, focal_over_map};
pub use measured::{Measured, MeasuredError, TimeOffset, TimeOffsetError};
pub use placing::{ObservedPoint, in_metres, metric_pose, place_std_m};
pub use utc_offset::{UtcOffset, UtcOffsetError};
pub use vehicles::{
    Dimension, Extent, OddVehicle, Oddity, VehicleClass, VehicleSizes, contradicted_sizes, is_car_by_size,
    vehicle_sizes,
};
