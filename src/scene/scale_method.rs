//! The methods of estimating a scale ratio: the table that options, benchmark, charts, report and documents follow.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Method of estimating a scale ratio; the names are those of the contract.
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
    /// Adjustment of vehicle and ground planes.
    Joint,
}

/// Row of the table of methods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MethodInfo {
    /// Name in files and on the command line.
    pub name: &'static str,
    /// Source.
    pub citation: &'static str,
    /// Assumption on the vehicle, and the data that it is compared with.
    pub needs: &'static str,
}

const PAPER: &str = "Bullinger, Bodensteiner, Arens, Stiefelhagen, arXiv:1711.06136, 2017";

impl ScaleMethod {
    /// Every method, in the order of tables: the paper's baseline and method, the program's own.
    pub const ALL: [Self; 4] = [Self::Intersection, Self::ConstantDistance, Self::Joint, Self::RobustLeastSquares];

    /// Name, source and assumption.
    pub const fn info(self) -> MethodInfo {
        let (name, citation, needs) = match self {
            Self::ConstantDistance => ("constant-distance", PAPER, "constant distance to the local ground planes"),
            Self::Intersection => ("intersection", PAPER, "lowest point on the local ground planes"),
            Self::RobustLeastSquares => {
                ("least-squares", "this program", "constant distance to the local ground planes, in all frames at once")
            }
            Self::Joint => {
                ("joint", "this program", "contact with the local ground planes and level on them; outlines")
            }
        };
        MethodInfo { name, citation, needs }
    }

    /// The name in files and on the command line.
    pub const fn name(self) -> &'static str {
        self.info().name
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
