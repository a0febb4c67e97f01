//! Export formats by name, and their requirements.

use std::fmt;
use std::str::FromStr;

use super::{ExportError, Results};

/// An export format of one or several files; in the order of writing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Format {
    /// Tables: vehicles, vehicles frame by frame, the camera.
    Csv,
    /// Georeferenced trajectories and positions.
    GeoJson,
    /// Trajectories on a globe, with times.
    Kml,
    /// The camera's trajectory.
    Gpx,
    /// Poses in TUM's format.
    Tum,
    /// Poses in KITTI's format.
    Kitti,
    /// The animated scene.
    Gltf,
    /// The video with the results drawn into it.
    Video,
    /// Floating car data of SUMO.
    Sumo,
    /// Tables in the format of levelXData.
    LevelX,
    /// Events of Cursor on Target.
    Cot,
    /// Images, masks and the background's model, ready for COLMAP's densification.
    Colmap,
    /// `trajectories.json` with the keys and words of version 2, for scripts written for it; only by name.
    TrajectoriesV2,
}

with_names!(Format {
    Csv = "csv",
    GeoJson = "geojson",
    Kml = "kml",
    Gpx = "gpx",
    Tum = "tum",
    Kitti = "kitti",
    Gltf = "gltf",
    Video = "video",
    Sumo = "sumo",
    LevelX = "levelx",
    Cot = "cot",
    Colmap = "colmap",
    TrajectoriesV2 = "trajectories-v2",
});

/// Requirement of a format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Only the output folder.
    Nothing,
    /// Meters and times.
    Meters,
    /// Georeferenced positions.
    Map,
    /// The images of the input.
    Pictures,
}

impl Format {
    /// Requirement.
    pub fn need(self) -> Need {
        match self {
            Self::Csv | Self::Tum | Self::Kitti | Self::Gltf | Self::TrajectoriesV2 => Need::Nothing,
            Self::GeoJson | Self::Kml | Self::Gpx | Self::Cot => Need::Map,
            Self::Video | Self::Colmap => Need::Pictures,
            Self::Sumo | Self::LevelX => Need::Meters,
        }
    }

    /// Returns true if cameras and points suffice.
    fn is_of_models(self) -> bool {
        matches!(self, Self::Tum | Self::Kitti | Self::Gltf | Self::Colmap)
    }

    /// Returns true if its rows can be resampled to other times than those of the frames.
    pub fn is_sampled(self) -> bool {
        !matches!(self, Self::Gltf | Self::Video | Self::Colmap | Self::TrajectoriesV2)
    }

    /// Reason why these results do not support the format, if any.
    pub fn obstacle(self, results: &Results) -> Option<ExportError> {
        let obstacle = |text: &str| Some(ExportError::Obstacle(format!("--format {self}: {text}")));
        match self {
            _ if results.views.is_empty() => {
                obstacle("the background was not reconstructed, so nothing has a position")
            }
            _ if !results.has_trajectories && !self.is_of_models() => obstacle(
                "no trajectories (trajectories.json is missing); run `tractrix run` into this folder, or export \
                 colmap, gltf, tum or kitti",
            ),
            _ if self.need() == Need::Meters
                && !(results.metric_frame().is_some() && results.clock().has_seconds()) =>
            {
                Some(ExportError::NoMeters { wanted: format!("--format {self}") })
            }
            _ if self.need() == Need::Map && results.map().is_none() => obstacle(&format!(
                "no georeferenced positions ({}); run again with --telemetry FILE, then export again",
                results.why_no_map()
            )),
            Self::Cot if results.clock().utc_start_s().is_none() => Some(ExportError::NoUtc),
            _ => None,
        }
    }

    /// Parses a comma-separated list of format names, or `all`.
    ///
    /// # Errors
    /// The unknown name, and the list of known ones.
    pub fn listed(list: &str) -> Result<Vec<Self>, String> {
        if list.trim() == "all" {
            return Ok(Self::ALL.into_iter().filter(|format| *format != Self::TrajectoriesV2).collect());
        }
        let mut formats = list.split(',').map(str::parse).collect::<Result<Vec<Self>, String>>()?;
        formats.sort_unstable();
        formats.dedup();
        Ok(formats)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|format| format.name() == text.trim());
        found.ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("'{}': unknown format; expected {names}, or all", text.trim())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read_and_unknown_names_are_refused_with_the_list() {
        assert!(Format::ALL.is_sorted(), "the table has the order of the formats");
        assert_eq!(Format::listed("video, csv,csv"), Ok(vec![Format::Csv, Format::Video]));
        assert_eq!(Format::listed("all").unwrap().len(), Format::ALL.len() - 1);
        assert_eq!(Format::listed("trajectories-v2"), Ok(vec![Format::TrajectoriesV2]));
        for wrong in ["", "xlsx", "csv,", "CSV", "csv,all"] {
            let refusal = Format::listed(wrong).unwrap_err();
            assert!(
                refusal.contains(
                    "csv, geojson, kml, gpx, tum, kitti, gltf, video, sumo, levelx, cot, colmap, trajectories-v2"
                ),
                "{refusal}"
            );
        }
    }
}
