//! The formats by name, and what each needs.

use std::fmt;
use std::str::FromStr;

use super::{ExportError, Results};

/// A format, or a set of files that belong together; in the order in which they are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Format {
    /// Tables: vehicles, vehicles frame by frame, the camera.
    Csv,
    /// Ways and places on the map.
    GeoJson,
    /// Ways on a globe, with times.
    Kml,
    /// The camera's way.
    Gpx,
    /// Poses in TUM's form.
    Tum,
    /// Poses in KITTI's form.
    Kitti,
    /// The scene in motion.
    Gltf,
    /// The video with what was found drawn into it.
    Video,
    /// Floating car data of SUMO.
    Sumo,
    /// Tables in the form of levelXData.
    LevelX,
    /// Events of Cursor on Target.
    Cot,
    /// Pictures, masks and the background's model, ready for COLMAP's densification.
    Colmap,
    /// `trajectories.json` with the keys and words of version 2, for scripts written for it. Only by name.
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
    /// Nothing but the output folder.
    Nothing,
    /// Meters and times.
    Meters,
    /// A place on the map.
    Map,
    /// The pictures of the input.
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

    /// Returns true if it can be made of cameras and points alone.
    fn is_of_models(self) -> bool {
        matches!(self, Self::Tum | Self::Kitti | Self::Gltf | Self::Colmap)
    }

    /// Returns true if its rows can be at other times than those of the frames.
    pub fn is_sampled(self) -> bool {
        !matches!(self, Self::Gltf | Self::Video | Self::Colmap | Self::TrajectoriesV2)
    }

    /// Why it cannot be made of these results, if that is so.
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

    /// The formats that a list names: names with commas between them, or `all`.
    ///
    /// # Errors
    /// Which name is none of them, and which there are.
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
