//! Given models: reconstructions of other programs, in every format that `io::model` reads.
//!
//! Poses and points are used unchanged. An image belongs to the frame of its name, and is converted to that frame's
//! pixels: it may be the frame before resizing or rotation, or the undistorted frame. Other images are rejected.
//! Reprojection errors are recomputed, since their definition differs between programs.

mod images;
mod names;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::cameras;
use crate::features::Target;
use crate::io::RunFolder;
use crate::io::interchange::model::{self, Format};
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::background::model_report::ModelReport;
use crate::pipeline::{PipelineError, Result};
use crate::scene::{CameraId, Frame, ImageId, Reconstruction, Warning};
use images::Pictures;

/// Hash of all files of a model.
///
/// # Errors
/// As [`model::detect`], or a file that cannot be read.
pub(in crate::pipeline) fn fingerprint(path: &Path) -> Result<String> {
    let (place, format) = model::detect(path)?;
    fingerprint::of_files(&model::files_read(&place, format))
}

/// Path of a model in the given folder or at the given file; the given path if there is none.
pub(in crate::pipeline) fn place(path: &Path) -> PathBuf {
    model::detect(path).map_or_else(|_| path.to_owned(), |(place, _)| place)
}

/// A given model with the ids and names of our frames. The stage `frames` must be done.
///
/// # Errors
/// The errors of the format's reader; intrinsics that cannot project; [`PipelineError::Options`] if no image is a
/// frame, if images are not the frames, or if no frame observes a point.
pub(in crate::pipeline) fn read(path: &Path, target: Target, run: &Run) -> Result<(Reconstruction, ModelReport)> {
    let frames = run.frames()?;
    let turns = |id| run.source.quarter_turns(id);
    let info = run.info();
    let pictures = Pictures {
        frame: (info.width, info.height),
        source: (info.source_width, info.source_height),
        lens: cameras::given(run)?.first().copied(),
        turns: &turns,
    };
    let (model, remarks) = placed(path, target, frames, &pictures)?;
    let absent = frames.iter().filter(|frame| !model.images.contains_key(&ImageId::from(frame.id)));
    let mut report = ModelReport {
        given: true,
        num_visible: frames.len(),
        num_registered: model.images.len(),
        unregistered: absent.map(|frame| (frame.id, "not in the given model".to_owned())).collect(),
        remarks,
        ..ModelReport::default()
    };
    report.describe_points(&model);
    Ok((model, report))
}

/// The model at a path, converted to the frames, and notes for the report.
fn placed(
    path: &Path,
    target: Target,
    frames: &[Frame],
    pictures: &Pictures,
) -> Result<(Reconstruction, Vec<Warning>)> {
    let (place, format) = model::detect(path)?;
    check_place(path, &place, target)?;
    let (model, _) = model::read_for_geometry(&place)?;
    let unstated = without_size(&place, format, &model);
    let (mut model, mut remarks) = names::with_frame_ids(path, model, frames)?;
    remarks.extend(images::fit(path, &mut model, &unstated, pictures)?);
    // The ground and the scale ratio depend on points.
    if model.points.is_empty() {
        return Err(PipelineError::Options(format!(
            "{}: no 3D point is observed in any frame; ground and scale need points; give a model with points and \
             their observations (OpenSfM: tracks.csv next to it; nerfstudio has none: give the COLMAP model it was \
             made from)",
            path.display()
        )));
    }
    model.renew_errors();
    Ok((model, remarks))
}

/// An output folder represents its background, which is no object's model.
fn check_place(path: &Path, place: &Path, target: Target) -> Result<()> {
    let folder = RunFolder::at(path);
    if target == Target::Background || place != folder.background() {
        return Ok(());
    }
    let path = path.display();
    Err(PipelineError::Options(format!(
        "{path}: an output folder stands for its background model, but a vehicle's model is needed; give \
         {path}/objects/1, or that of another vehicle"
    )))
}

/// Cameras without an image size in the file: NVM and Bundler store no sizes; those of images next to the file are
/// read.
fn without_size(place: &Path, format: Format, model: &Reconstruction) -> BTreeSet<CameraId> {
    if !matches!(format, Format::Nvm | Format::Bundler) {
        return BTreeSet::new();
    }
    let is_alone = |name: &str| !place.with_file_name("").join(name).is_file();
    model.images.values().filter(|image| is_alone(&image.name)).map(|image| image.camera).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::testing::in_repository;
    use crate::scene::FrameId;

    fn frames(names: &[&str]) -> Vec<Frame> {
        let frame = |(k, name): (u32, &&str)| Frame { id: FrameId(k), name: (*name).to_owned(), time_s: 0.0 };
        (0..).zip(names).map(frame).collect()
    }

    fn golden() -> (Reconstruction, Vec<Frame>, (u32, u32)) {
        let mut model =
            crate::io::interchange::colmap::read(&in_repository("tests/golden/models/colmap_text")).unwrap();
        // Frames have one size; the golden model has two cameras.
        let first = *model.cameras.values().next().unwrap();
        model.cameras.values_mut().for_each(|camera| *camera = camera.resized(first.width, first.height));
        let names: Vec<&str> = model.images.values().map(|image| image.name.as_str()).collect();
        let frames = frames(&names);
        (model, frames, (first.width, first.height))
    }

    fn given(path: &Path, frames: &[Frame], size: (u32, u32)) -> Result<Reconstruction, String> {
        let pictures = Pictures { frame: size, source: size, lens: None, turns: &|_| Some(0) };
        placed(path, Target::Object, frames, &pictures).map(|(model, _)| model).map_err(|error| error.to_string())
    }

    #[test]
    fn every_format_gives_the_model_that_colmap_gives() {
        let folder = tempfile::tempdir().unwrap();
        let (mut model, frames, size) = golden();
        // Common content of all formats: one focal length, the principal point at the center, no distortion.
        for camera in model.cameras.values_mut() {
            *camera = crate::camera::Camera::with_focal(size.0, size.1, camera.focal[0]);
        }
        model.camera_forms.clear();
        let write = |name: &str, format| {
            let path = folder.path().join(name);
            model::write(&path, &model, format).unwrap();
            path
        };
        let expected = given(&write("colmap", Format::ColmapText), &frames, size).unwrap();
        assert_eq!(expected.images.keys().map(|id| id.0).collect::<Vec<_>>(), [1, 2, 3]);
        std::fs::create_dir_all(folder.path().join("project/sparse/0")).unwrap();
        write("project/sparse/0", Format::ColmapBinary);
        for (path, what) in [
            (folder.path().join("project"), "a folder above sparse/0"),
            (write("sfm_data.json", Format::OpenMvg), "OpenMVG"),
            (write("reconstruction.json", Format::OpenSfm), "OpenSfM"),
            (write("model.nvm", Format::Nvm), "NVM"),
            (write("bundle.out", Format::Bundler), "Bundler"),
        ] {
            let found = given(&path, &frames, size).unwrap_or_else(|error| panic!("{what}: {error}"));
            assert_eq!(found.points.len(), expected.points.len(), "{what}");
            for (id, image) in &expected.images {
                let own = &found.images[id];
                assert_eq!(own.name, image.name, "{what}");
                let apart = own.cam_from_world * image.cam_from_world.inverse();
                assert!(apart.rotation.angle() < 1e-7 && apart.translation.norm() < 1e-6, "{what}: {apart:?}");
                let (lens, other) = (found.camera_of(own).parameters(), expected.camera_of(image).parameters());
                assert!(lens.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-6), "{what}: {lens:?}");
            }
            for (own, point) in found.points.values().zip(expected.points.values()) {
                assert!((own.position - point.position).norm() < 1e-6, "{what}");
                assert!((own.error_px - point.error_px).abs() < 1e-3, "{what}: {} {}", own.error_px, point.error_px);
            }
        }
    }

    #[test]
    fn models_without_points_or_of_a_background_are_rejected_with_a_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let (model, frames, size) = golden();
        let path = folder.path().join("transforms.json");
        model::write(&path, &model, Format::Nerfstudio).unwrap();
        let said = given(&path, &frames, size).unwrap_err();
        assert!(said.contains("transforms.json: no 3D point") && said.contains("COLMAP model"), "{said}");
        let out = folder.path().join("out");
        model::write(&out.join("background"), &model, Format::ColmapText).unwrap();
        let said = given(&out, &frames, size).unwrap_err();
        assert!(said.contains("out/objects/1"), "{said}");
    }

    #[test]
    fn changed_files_change_the_fingerprint() {
        let folder = tempfile::tempdir().unwrap();
        let (model, ..) = golden();
        let [project, json] = ["project", "reconstruction.json"].map(|name| folder.path().join(name));
        model::write(&project.join("sparse/0"), &model, Format::ColmapText).unwrap();
        model::write(&json, &model, Format::OpenSfm).unwrap();
        for (path, file) in [
            (&project, project.join("sparse/0/points3D.txt")),
            (&json, json.clone()),
            (&json, folder.path().join("tracks.csv")),
        ] {
            let before = fingerprint(path).unwrap();
            assert_eq!(before, fingerprint(path).unwrap());
            let text = std::fs::read_to_string(&file).unwrap();
            std::fs::write(&file, text + "\n").unwrap();
            assert_ne!(before, fingerprint(path).unwrap(), "{}", file.display());
        }
    }
}
