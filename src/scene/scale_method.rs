//! Table of the methods of estimating a scale ratio, for options, benchmark, charts, report and documents.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Method of estimating a scale ratio; the names are those of the output contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ScaleMethod {
    /// View pair ranking by constant distance to the ground.
    ConstantDistance,
    /// Smallest ray–plane intersection per frame, median over frames.
    Intersection,
    /// Constant distance in all frames, robust least squares.
    #[serde(rename = "least-squares")]
    RobustLeastSquares,
    /// Joint adjustment of vehicle and ground planes.
    Joint,
    /// Reference method: trajectory in any plane.
    OzdenPlane,
    /// Reference method: trajectory perpendicular to the axis about which the vehicle turns.
    OzdenAxis,
    /// Reference method: motion in the direction of the heading.
    OzdenHeading,
    /// Reference method: contact with ground planes weighted by their covariance.
    CameraHeight,
    /// Reference method: translation parallel to one ground plane.
    Yuan,
    /// Reference method: translation parallel to the local ground planes.
    YuanLocal,
}

/// Row of the table of methods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MethodInfo {
    /// Name in files and on the command line.
    pub name: &'static str,
    /// Source.
    pub citation: &'static str,
    /// Assumption on the vehicle, and the data used.
    pub needs: &'static str,
    /// True for methods of the literature that serve as a comparison only: verdicts do not use them.
    pub is_reference: bool,
}

const PAPER: &str = "Bullinger, Bodensteiner, Arens, Stiefelhagen, arXiv:1711.06136, 2017";
const OZDEN_CVPR: &str = "Ozden, Cornelis, Van Eycken, Van Gool, CVPR 2004";
const YUAN: &str = "Yuan, Medioni, CVPR 2006";

// In the order of tables: the paper's baseline and method, the program's own, references.
with_names!(ScaleMethod {
    Intersection = "intersection",
    ConstantDistance = "constant-distance",
    Joint = "joint",
    RobustLeastSquares = "least-squares",
    OzdenPlane = "ozden-plane",
    OzdenAxis = "ozden-axis",
    OzdenHeading = "ozden-heading",
    CameraHeight = "camera-height",
    Yuan = "yuan",
    YuanLocal = "yuan-local",
});

impl ScaleMethod {
    /// Name, source and assumption.
    pub const fn info(self) -> MethodInfo {
        let (citation, needs) = match self {
            Self::ConstantDistance => (PAPER, "constant distance to the local ground planes"),
            Self::Intersection => (PAPER, "lowest point on the local ground planes"),
            Self::RobustLeastSquares => {
                ("this program", "constant distance to the local ground planes, in all frames at once")
            }
            Self::Joint => ("this program", "contact with the local ground planes and level on them; outlines"),
            Self::OzdenPlane => (OZDEN_CVPR, "motion in a plane; paths only"),
            Self::OzdenAxis => (OZDEN_CVPR, "motion in a plane about whose normal it turns; attitudes"),
            Self::OzdenHeading => (OZDEN_CVPR, "motion where it points; attitudes"),
            Self::CameraHeight => {
                ("Song, Chandraker, CVPR 2014", "lowest point on the ground planes and their covariance")
            }
            Self::Yuan => (YUAN, "translation parallel to one ground plane"),
            Self::YuanLocal => (YUAN, "translation parallel to the local ground planes"),
        };
        MethodInfo { name: self.name(), citation, needs, is_reference: self.is_reference() }
    }

    /// Returns true for a method of the literature that serves as a comparison only.
    pub const fn is_reference(self) -> bool {
        !matches!(self, Self::ConstantDistance | Self::Intersection | Self::RobustLeastSquares | Self::Joint)
    }

    /// Position in tables.
    pub fn rank(self) -> usize {
        Self::ALL.iter().position(|method| *method == self).unwrap_or(Self::ALL.len())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_table_has_every_method_by_its_name_in_files() {
        let schema = serde_json::to_value(schemars::schema_for!(ScaleMethod)).unwrap();
        let variants = schema["oneOf"].as_array().unwrap();
        let in_files: BTreeSet<&str> = variants.iter().filter_map(|variant| variant["const"].as_str()).collect();
        let in_table: BTreeSet<&str> = ScaleMethod::ALL.iter().map(|method| method.name()).collect();
        assert_eq!((in_files, in_table.len()), (in_table.clone(), ScaleMethod::ALL.len()));
        for method in ScaleMethod::ALL {
            assert_eq!(serde_json::to_value(method).unwrap(), method.name());
            assert!(!method.info().citation.is_empty() && !method.info().needs.is_empty());
        }
    }
}
