//! Reconstructions in any supported format.

mod detect;
#[cfg(test)]
mod properties;

use std::fmt;
use std::path::{Path, PathBuf};

use super::assembly::check_finite;
use super::{bundler, camera_path, colmap, nerfstudio, nvm, openmvg, opensfm, ply};
use crate::io::{FolderError, IoError, Losses, refuse_place_of_results};
use crate::scene::Reconstruction;

pub use detect::detect;

/// Format of a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// COLMAP's text files, a folder.
    ColmapText,
    /// COLMAP's binary files, a folder.
    ColmapBinary,
    /// OpenMVG's `sfm_data.json`.
    OpenMvg,
    /// OpenSfM's `reconstruction.json`, with `tracks.csv` next to it.
    OpenSfm,
    /// nerfstudio's `transforms.json`.
    Nerfstudio,
    /// VisualSFM's `.nvm`.
    Nvm,
    /// Bundler's `bundle.out`.
    Bundler,
    /// A camera trajectory in TUM's or EuRoC's format; read only.
    Tum,
    /// A camera trajectory in KITTI's format; read only.
    Kitti,
    /// Colored points, `.ply`; written only.
    Ply,
}

with_names!(Format {
    ColmapText = "COLMAP (text)",
    ColmapBinary = "COLMAP (binary)",
    OpenMvg = "OpenMVG",
    OpenSfm = "OpenSfM",
    Nerfstudio = "nerfstudio",
    Nvm = "NVM",
    Bundler = "Bundler",
    Tum = "TUM",
    Kitti = "KITTI",
    Ply = "PLY",
});

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Reads a reconstruction for comparing or converting, with any intrinsics, and returns its format.
///
/// # Errors
/// A missing file, no readable format (with the remedy), an error of the format's reader, or numbers so large that
/// values computed from them are not finite.
pub fn read(path: &Path) -> Result<(Reconstruction, Format), IoError> {
    read_with(path, Intrinsics::Required)
}

/// As [`read`], also without intrinsics: such cameras cannot project.
///
/// # Errors
/// As [`read`], except for missing intrinsics.
pub fn read_poses(path: &Path) -> Result<(Reconstruction, Format), IoError> {
    read_with(path, Intrinsics::Optional)
}

/// Requirement of intrinsics: a model without them can be compared, not converted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Intrinsics {
    Required,
    Optional,
}

fn read_with(path: &Path, intrinsics: Intrinsics) -> Result<(Reconstruction, Format), IoError> {
    let (place, format) = detect(path)?;
    let model = match format {
        Format::ColmapText | Format::ColmapBinary => colmap::read_any(&place),
        Format::OpenMvg => openmvg::read_with(&place, intrinsics),
        Format::OpenSfm => opensfm::read(&place),
        Format::Nerfstudio => nerfstudio::read_with(&place, intrinsics),
        Format::Nvm => nvm::read(&place),
        Format::Bundler => bundler::read(&place),
        Format::Tum => camera_path::read_tum(&place),
        Format::Kitti => camera_path::read_kitti(&place),
        Format::Ply => Err(detect::points_alone(&place)),
    }?;
    check_finite(&place, &model)?;
    Ok((model, format))
}

/// Describes the parts of a file that [`read`] skips.
pub fn lost_on_reading(path: &Path, format: Format) -> Vec<String> {
    let Ok((place, _)) = detect(path) else { return Vec::new() };
    let losses = match format {
        Format::ColmapText | Format::ColmapBinary => Losses::default().counted(
            colmap::num_rigs_of_several(&place),
            "rig of several cameras is split into rigs of one camera each",
            "rigs of several cameras are split into rigs of one camera each",
        ),
        Format::OpenSfm => Losses::default().counted(
            opensfm::num_images_skipped(&place),
            "image of a smaller reconstruction in the file is skipped",
            "images of smaller reconstructions in the file are skipped",
        ),
        Format::Bundler if bundler::lists(&place).is_empty() => {
            Losses::default().with("image names are invented: there is no list.txt next to the file".to_owned())
        }
        _ => Losses::default(),
    };
    losses.sentences().to_vec()
}

/// Reads a reconstruction for projecting its points.
///
/// # Errors
/// As [`read`]; a camera that this program cannot project with.
pub fn read_for_geometry(path: &Path) -> Result<(Reconstruction, Format), IoError> {
    let (model, format) = read(path)?;
    colmap::refuse_foreign(path, &model)?;
    Ok((model, format))
}

/// Writes a reconstruction and returns the losses of the format. PLY gets its points only.
///
/// # Errors
/// A format that is read only, or an error of the format's writer.
pub fn write(path: &Path, model: &Reconstruction, format: Format) -> Result<Losses, IoError> {
    match format {
        Format::ColmapText => colmap::write_text(path, model).map(|()| Losses::default()),
        Format::ColmapBinary => colmap::write_binary(path, model).map(|()| Losses::default()),
        Format::OpenMvg => openmvg::write(path, model),
        Format::OpenSfm => opensfm::write(path, model),
        Format::Nerfstudio => nerfstudio::write(path, model),
        Format::Nvm => nvm::write(path, model),
        Format::Bundler => bundler::write(path, model),
        Format::Tum | Format::Kitti => {
            let what = format!("writing a camera path in {format} format");
            Err(IoError::unsupported(path, what, "write a COLMAP model instead"))
        }
        Format::Ply => {
            let points: Vec<_> = model.points.values().map(|p| (p.position, p.rgb)).collect();
            let losses = Losses::default().counted(
                model.images.len(),
                "camera skipped: the format stores points only",
                "cameras skipped: the format stores points only",
            );
            ply::write_points(path, &points).map(|()| losses)
        }
    }
}

/// Checks that `files` may be written, at or in `output`: never through a link or over the input, and over other files
/// only if `overwrite` is set.
///
/// # Errors
/// [`FolderError`] with the obstacle.
pub fn check_target(input: &Path, output: &Path, files: &[PathBuf], overwrite: bool) -> Result<(), FolderError> {
    let is_same =
        |a: &Path, b: &Path| std::fs::canonicalize(a).is_ok_and(|a| std::fs::canonicalize(b).is_ok_and(|b| a == b));
    if is_same(input, output) || files.iter().any(|file| is_same(input, file)) {
        return Err(FolderError::OwnInput { flag: "IN".to_owned(), input: input.to_owned() });
    }
    for file in files {
        refuse_place_of_results(file)?;
        let Ok(found) = std::fs::symlink_metadata(file) else { continue };
        let shown = || file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if found.file_type().is_symlink() {
            return Err(FolderError::Link { path: output.to_owned(), link: shown() });
        }
        if !overwrite {
            return Err(FolderError::Exists { path: file.clone() });
        }
    }
    Ok(())
}

/// Files to which a reconstruction is written.
pub fn files_of(output: &Path, format: Format) -> Vec<PathBuf> {
    match format {
        Format::ColmapText => colmap::TEXT_FILES.iter().map(|name| output.join(name)).collect(),
        Format::ColmapBinary => colmap::BINARY_FILES.iter().map(|name| output.join(name)).collect(),
        Format::OpenSfm => opensfm::files(output).into(),
        Format::Nerfstudio => nerfstudio::files(output).into(),
        Format::Bundler => bundler::files(output).into(),
        Format::Ply | Format::OpenMvg | Format::Nvm | Format::Tum | Format::Kitti => vec![output.to_owned()],
    }
}

/// Files read for a model at a path from [`detect`]: the whole COLMAP folder, or the files that exist.
pub fn files_read(place: &Path, format: Format) -> Vec<PathBuf> {
    let beside = match format {
        Format::OpenSfm => opensfm::files(place)[1..].to_vec(),
        Format::Bundler => bundler::lists(place).to_vec(),
        _ => Vec::new(),
    };
    let beside = beside.into_iter().filter(|file| file.is_file());
    std::iter::once(place.to_owned()).chain(beside).collect()
}

/// Default output format of a conversion of a model in the format `from` to `to`: the one implied by the name,
/// otherwise the other COLMAP form than the input's. Text is preferred if it can represent the names of the images.
///
/// # Errors
/// A file whose name implies no format: an unknown ending, or JSON, which three formats use.
pub fn format_for(from: Format, to: &Path, model: &Reconstruction) -> Result<Format, IoError> {
    let named = |name: &str| to.file_name().is_some_and(|n| n.eq_ignore_ascii_case(name));
    let ends = |extension: &str| to.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
    let by_name = [
        (ends("ply"), Format::Ply),
        (ends("nvm"), Format::Nvm),
        (ends("out"), Format::Bundler),
        (named("sfm_data.json"), Format::OpenMvg),
        (named("reconstruction.json"), Format::OpenSfm),
        (named("transforms.json"), Format::Nerfstudio),
    ];
    Ok(if let Some((_, format)) = by_name.into_iter().find(|(is_named, _)| *is_named) {
        format
    } else if ends("json") {
        return Err(IoError::unsupported(
            to,
            "JSON file of unknown format",
            "name it sfm_data.json (OpenMVG), reconstruction.json (OpenSfM) or transforms.json (nerfstudio), or give \
             the format with --to",
        ));
    } else if to.extension().is_some_and(is_ending) && !to.is_dir() {
        return Err(IoError::unsupported(
            to,
            "output of unknown format",
            "name it NAME.ply, NAME.nvm, NAME.db, bundle.out, sfm_data.json, reconstruction.json or transforms.json, \
             or a folder without an ending for COLMAP; or give the format with --to",
        ));
    } else if from == Format::ColmapText || colmap::check_text_names(to, model).is_err() {
        Format::ColmapBinary
    } else {
        Format::ColmapText
    })
}

/// Returns true if the end of a name is a file extension (`obj`, `e57`) and not part of a folder's name (`2026`,
/// `v2.1`).
fn is_ending(extension: &std::ffi::OsStr) -> bool {
    let text = extension.to_string_lossy();
    text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.chars().all(char::is_alphanumeric)
}
