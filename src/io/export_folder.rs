//! Layout of the files exported for other programs.
//!
//! They are in `export/` of an output folder, or in a separate folder.

use std::path::Path;

use super::interchange::colmap;
use super::run_folder::object_id;
use super::{PathRole, RunFolder};

/// Folder of exported files.
#[derive(Clone, Copy, Debug)]
pub struct ExportFolder;

impl ExportFolder {
    /// Command that creates these folders, if they are separate.
    pub const MADE_BY: &str = "tractrix export";
    /// One row per vehicle.
    pub const VEHICLES: &str = "vehicles.csv";
    /// One row per vehicle and frame.
    pub const TRAJECTORIES: &str = "trajectories.csv";
    /// One row per vehicle with a ground track.
    pub const GROUND_TRACKS: &str = "ground-tracks.csv";
    /// One row per vehicle with a ground track and frame.
    pub const GROUND_POSITIONS: &str = "ground-positions.csv";
    /// One row per frame of the camera.
    pub const CAMERA: &str = "camera.csv";
    /// Georeferenced trajectories.
    pub const WAYS_ON_MAP: &str = "trajectories.geojson";
    /// Georeferenced positions, frame by frame.
    pub const PLACES_ON_MAP: &str = "positions.geojson";
    /// Georeferenced trajectories with times, for a globe.
    pub const KML: &str = "trajectories.kml";
    /// Trajectory of the camera.
    pub const GPX: &str = "camera.gpx";
    /// Animated scene.
    pub const SCENE: &str = "scene.glb";
    /// Video annotated with the results.
    pub const VIDEO: &str = "annotated.mp4";
    /// The trajectories with the keys of version 2.
    pub const TRAJECTORIES_V2: &str = "trajectories-v2.json";
    /// Poses in TUM's format.
    pub const TUM: &str = "tum";
    /// Poses in KITTI's format.
    pub const KITTI: &str = "kitti";
    /// Floating car data.
    pub const SUMO: &str = "sumo-fcd.xml";
    /// Cursor on Target events.
    pub const COT: &str = "cot-events.xml";
    /// Tables in levelXData's format.
    pub const LEVELX: &str = "levelx";
    /// levelXData table with one row per vehicle and frame.
    pub const LEVELX_TRACKS: &str = "00_tracks.csv";
    /// levelXData table with one row per vehicle.
    pub const LEVELX_META: &str = "00_tracksMeta.csv";
    /// levelXData table with one row per recording.
    pub const LEVELX_RECORDING: &str = "00_recordingMeta.csv";
    /// COLMAP workspace.
    pub const COLMAP: &str = "colmap";
    /// Images in that workspace.
    pub const IMAGES: &str = "images";
    /// Masks in that workspace.
    pub const MASKS: &str = "masks";
    /// Models in that workspace.
    pub const SPARSE: &str = "sparse";
    /// Description of the reference frame of the poses next to it.
    pub const ABOUT: &str = "about.txt";

    const FILES: [&str; 14] = [
        Self::SUMO,
        Self::COT,
        Self::TRAJECTORIES_V2,
        Self::VEHICLES,
        Self::TRAJECTORIES,
        Self::GROUND_TRACKS,
        Self::GROUND_POSITIONS,
        Self::CAMERA,
        Self::WAYS_ON_MAP,
        Self::PLACES_ON_MAP,
        Self::KML,
        Self::GPX,
        Self::SCENE,
        Self::VIDEO,
    ];

    /// Role of a path of an export, relative to its own folder.
    pub fn place(relative: &Path) -> PathRole {
        let parts: Option<Vec<&str>> = relative.iter().map(|part| part.to_str()).collect();
        match parts.as_deref() {
            Some([RunFolder::STATE, ..]) => PathRole::State,
            Some(parts) => Self::place_of(parts),
            None => PathRole::Elsewhere,
        }
    }

    /// As [`Self::place`], by the components of the path.
    pub(super) fn place_of(parts: &[&str]) -> PathRole {
        match *parts {
            [] => PathRole::Folder,
            [file] if Self::FILES.contains(&file) => PathRole::File,
            [Self::TUM | Self::KITTI | Self::LEVELX | Self::COLMAP] => PathRole::Folder,
            [Self::LEVELX, Self::LEVELX_TRACKS | Self::LEVELX_META | Self::LEVELX_RECORDING] => PathRole::File,
            [Self::TUM | Self::KITTI, file] if is_pose_file(file) => PathRole::File,
            [Self::COLMAP, Self::IMAGES | Self::MASKS | Self::SPARSE] => PathRole::Folder,
            [Self::COLMAP, Self::SPARSE, "0"] => PathRole::Folder,
            [Self::COLMAP, Self::SPARSE, "0", file] if colmap::is_file_name(file) => PathRole::File,
            [Self::COLMAP, Self::IMAGES | Self::MASKS, file] if !file.starts_with('.') => PathRole::File,
            _ => PathRole::Elsewhere,
        }
    }
}

/// `about.txt`, `camera.txt`, `vehicle-3.txt`, `vehicle-3.times.txt`.
fn is_pose_file(file: &str) -> bool {
    let Some(stem) = file.strip_suffix(".txt") else { return false };
    let stem = stem.strip_suffix(".times").unwrap_or(stem);
    file == ExportFolder::ABOUT || stem == "camera" || stem.strip_prefix("vehicle-").and_then(object_id).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_export_has_a_role_and_others_have_none() {
        let place = |path: &str| ExportFolder::place(Path::new(path));
        for file in [
            "vehicles.csv",
            "scene.glb",
            "tum/vehicle-12.txt",
            "kitti/camera.times.txt",
            "kitti/about.txt",
            "levelx/00_tracks.csv",
        ] {
            assert_eq!(place(file), PathRole::File, "{file}");
        }
        for file in ["colmap/images/000001.jpg", "colmap/masks/a.png.png", "colmap/sparse/0/cameras.bin"] {
            assert_eq!(place(file), PathRole::File, "{file}");
        }
        for other in ["notes.txt", "tum/vehicle-01.txt", "colmap/dense/a", "colmap/sparse/1", "colmap/images/a/b.jpg"] {
            assert_eq!(place(other), PathRole::Elsewhere, "{other}");
        }
        assert_eq!((place("colmap/sparse/0"), place(".tractrix/lock")), (PathRole::Folder, PathRole::State));
        assert_eq!(RunFolder::place(Path::new("export/tum/camera.txt")), PathRole::File);
    }
}
