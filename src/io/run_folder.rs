//! Layout of a run's output folder.
//!
//! Single definition of the layout: the pipeline writes, and `evaluate`, the report, the benchmark and a user of the
//! library read through it. Everything named here except [`RunFolder::STATE`] is public and described in
//! `docs/formats.md`; nothing public depends on the content of that folder.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::interchange::colmap;
use super::owned_folder::PathRole;
use super::{ExportFolder, IoError, ground, masks, tracks, trajectories};
use crate::scene::{Frame, Ground, ObjectId, Reconstruction, TrackedObject, Trajectories};

/// Output folder of a run, which need not exist yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFolder {
    root: PathBuf,
}

const BACKGROUND: &str = "background";
const OBJECTS: &str = "objects";
const AS_RECONSTRUCTED: &str = "as-reconstructed";
const TRACKS: &str = "tracks";
const POINT_CLOUDS: &str = "ply";
const EXPORTS: &str = "export";
const DOCUMENTS: [&str; 6] =
    ["run.json", "tracks.json", "ground.json", "trajectories.json", "report.html", "evaluation.json"];

impl RunFolder {
    /// Folder of the data for resuming a run: lock, manifest, markers, intermediate results.
    pub const STATE: &str = ".tractrix";

    /// Command that creates these folders, as named in their manifests.
    pub const MADE_BY: &str = "tractrix run";

    /// Returns the output folder at `root`.
    pub fn at(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// Root of the folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Input, arguments and cost of the run.
    pub fn run_json(&self) -> PathBuf {
        self.root.join("run.json")
    }

    /// COLMAP model of the background.
    pub fn background(&self) -> PathBuf {
        self.root.join(BACKGROUND)
    }

    /// Ground points and local planes.
    pub fn ground(&self) -> PathBuf {
        self.root.join("ground.json")
    }

    /// Trajectories of the objects.
    pub fn trajectories(&self) -> PathBuf {
        self.root.join("trajectories.json")
    }

    /// Report page.
    pub fn report(&self) -> PathBuf {
        self.root.join("report.html")
    }

    /// Metrics of an evaluation against ground truth, if there was one.
    pub fn evaluation(&self) -> PathBuf {
        self.root.join("evaluation.json")
    }

    /// Folder of all object models.
    pub fn objects(&self) -> PathBuf {
        self.root.join(OBJECTS)
    }

    /// COLMAP model of an object, to which its trajectory refers.
    pub fn object(&self, id: ObjectId) -> PathBuf {
        self.objects().join(id.to_string())
    }

    /// Folder of all object models from structure from motion.
    pub fn all_as_reconstructed(&self) -> PathBuf {
        self.root.join(AS_RECONSTRUCTED)
    }

    /// COLMAP model of an object from structure from motion, before its adjustment with the ground.
    pub fn as_reconstructed(&self, id: ObjectId) -> PathBuf {
        self.all_as_reconstructed().join(id.to_string())
    }

    /// Folder of all masks.
    pub fn tracks(&self) -> PathBuf {
        self.root.join(TRACKS)
    }

    /// Tracked objects.
    pub fn tracked(&self) -> PathBuf {
        self.root.join("tracks.json")
    }

    /// Mask of an object in one frame.
    pub fn mask(&self, id: ObjectId, frame: &Frame) -> PathBuf {
        self.tracks().join(id.to_string()).join(Self::mask_name(frame))
    }

    /// Name of an image's mask: COLMAP's convention, which distinguishes `a.jpg` and `a.png`.
    pub fn mask_name(frame: &Frame) -> String {
        format!("{}.png", frame.name)
    }

    /// Mask of an object in the image with one of these names, the first that exists.
    pub fn find_mask(&self, id: ObjectId, names: &[&str]) -> Option<PathBuf> {
        let folder = self.tracks().join(id.to_string());
        names.iter().find_map(|name| masks::find(&folder, name))
    }

    /// Folder of point clouds.
    pub fn point_clouds(&self) -> PathBuf {
        self.root.join(POINT_CLOUDS)
    }

    /// Points of the background.
    pub fn background_points(&self) -> PathBuf {
        self.point_clouds().join("background.ply")
    }

    /// Points of an object in every frame of its trajectory.
    pub fn object_points(&self, id: ObjectId) -> PathBuf {
        self.point_clouds().join(format!("object-{id}.ply"))
    }

    /// Folder of exports for other programs.
    pub fn exports(&self) -> PathBuf {
        self.root.join(EXPORTS)
    }

    /// Reads the background model.
    ///
    /// # Errors
    /// [`IoError`] if it is missing or damaged; the same for all readers here.
    pub fn read_background(&self) -> Result<Reconstruction, IoError> {
        colmap::read(&self.background())
    }

    /// Reads the model of an object.
    ///
    /// # Errors
    /// As [`Self::read_background`].
    pub fn read_object(&self, id: ObjectId) -> Result<Reconstruction, IoError> {
        colmap::read(&self.object(id))
    }

    /// Reads the model of an object from structure from motion.
    ///
    /// # Errors
    /// As [`Self::read_background`].
    pub fn read_as_reconstructed(&self, id: ObjectId) -> Result<Reconstruction, IoError> {
        colmap::read(&self.as_reconstructed(id))
    }

    /// Reads the trajectories.
    ///
    /// # Errors
    /// As [`Self::read_background`].
    pub fn read_trajectories(&self) -> Result<Trajectories, IoError> {
        trajectories::read(&self.trajectories())
    }

    /// Reads the tracked objects.
    ///
    /// # Errors
    /// As [`Self::read_background`].
    pub fn read_tracked(&self) -> Result<Vec<TrackedObject>, IoError> {
        tracks::read(&self.tracked())
    }

    /// Reads ground points and planes.
    ///
    /// # Errors
    /// As [`Self::read_background`].
    pub fn read_ground(&self) -> Result<Ground, IoError> {
        ground::read(&self.ground())
    }

    /// Ids of the objects that have a model or masks, ascending.
    pub fn object_ids(&self) -> BTreeSet<ObjectId> {
        [self.objects(), self.tracks()].iter().flat_map(|folder| Self::ids_in(folder)).collect()
    }

    /// Ids in the names of a folder's entries.
    pub fn ids_in(folder: &Path) -> BTreeSet<ObjectId> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| object_id(entry.file_name().to_str()?)).collect()
    }

    /// Role of a path in a run's output folder, relative to it.
    pub fn place(relative: &Path) -> PathRole {
        let parts: Option<Vec<&str>> = relative.iter().map(|part| part.to_str()).collect();
        let Some(parts) = parts else { return PathRole::Elsewhere };
        match parts[..] {
            [] => PathRole::Folder,
            [Self::STATE, ..] => PathRole::State,
            [name] if DOCUMENTS.contains(&name) => PathRole::File,
            [BACKGROUND | OBJECTS | AS_RECONSTRUCTED | TRACKS | POINT_CLOUDS] => PathRole::Folder,
            [OBJECTS | AS_RECONSTRUCTED | TRACKS, id] if object_id(id).is_some() => PathRole::Folder,
            [BACKGROUND, file] if colmap::is_file_name(file) => PathRole::File,
            [OBJECTS | AS_RECONSTRUCTED, id, file] if object_id(id).is_some() && colmap::is_file_name(file) => {
                PathRole::File
            }
            [TRACKS, id, file] if object_id(id).is_some() && file.ends_with(".png") => PathRole::File,
            [POINT_CLOUDS, file] if is_point_cloud(file) => PathRole::File,
            [EXPORTS, ref below @ ..] => ExportFolder::place_of(below),
            _ => PathRole::Elsewhere,
        }
    }
}

pub(super) fn object_id(name: &str) -> Option<ObjectId> {
    name.parse().ok().filter(|id: &u32| *id > 0 && id.to_string() == name).map(ObjectId)
}

fn is_point_cloud(file: &str) -> bool {
    let of_object = file.strip_prefix("object-").and_then(|rest| rest.strip_suffix(".ply")).and_then(object_id);
    file == "background.ply" || of_object.is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::FrameId;

    #[test]
    fn every_path_of_a_run_has_a_role_and_others_have_none() {
        let folder = RunFolder::at("out");
        let frame = Frame { id: FrameId(3), name: "000003.jpg".into(), time_s: 0.0 };
        let id = ObjectId(12);
        let files = [
            folder.run_json(),
            folder.ground(),
            folder.trajectories(),
            folder.report(),
            folder.evaluation(),
            folder.background().join("cameras.txt"),
            folder.object(id).join("images.bin"),
            folder.as_reconstructed(id).join("points3D.txt"),
            folder.mask(id, &frame),
            folder.background_points(),
            folder.object_points(id),
            folder.exports().join("vehicles.csv"),
        ];
        for file in files {
            assert_eq!(RunFolder::place(file.strip_prefix("out").unwrap()), PathRole::File, "{}", file.display());
        }
        for folder in [folder.background(), folder.object(id), folder.tracks(), folder.point_clouds()] {
            assert_eq!(RunFolder::place(folder.strip_prefix("out").unwrap()), PathRole::Folder, "{}", folder.display());
        }
        for other in
            ["notes.txt", "objects/my_models", "objects/007", "tracks/gps/t.gpx", "ply/scan.ply", "background/a"]
        {
            assert_eq!(RunFolder::place(Path::new(other)), PathRole::Elsewhere, "{other}");
        }
        assert_eq!(RunFolder::place(Path::new(".tractrix/lock")), PathRole::State);
    }
}
