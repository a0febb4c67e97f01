//! Reconstructions in whatever supported format they come.

use std::fmt;
use std::path::{Path, PathBuf};

use super::{FolderError, IoError, RunFolder, colmap, openmvg, ply};
use crate::scene::Reconstruction;

/// A format of reconstructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// COLMAP's text files, a folder.
    ColmapText,
    /// COLMAP's binary files, a folder.
    ColmapBinary,
    /// OpenMVG's `sfm_data.json`.
    OpenMvg,
    /// Coloured points, `.ply`.
    Ply,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::ColmapText => "COLMAP (text)",
            Self::ColmapBinary => "COLMAP (binary)",
            Self::OpenMvg => "OpenMVG",
            Self::Ply => "PLY",
        })
    }
}

/// The format of what is at `path`; `None` if it is none that this program reads. An output folder of `tractrix run`
/// counts as its background.
pub fn detect(path: &Path) -> Option<Format> {
    if path.join("cameras.bin").exists() {
        Some(Format::ColmapBinary)
    } else if path.join("cameras.txt").exists() {
        Some(Format::ColmapText)
    } else if colmap::is_model(&RunFolder::at(path).background()) {
        detect(&RunFolder::at(path).background())
    } else if path.is_file() && has_extension(path, "json") {
        Some(Format::OpenMvg)
    } else {
        None
    }
}

/// Reads a reconstruction and says in which format it came: a COLMAP folder, an output folder of `tractrix run` (its
/// background), or OpenMVG's JSON.
///
/// # Errors
/// Nothing there, no format that is read, or what the format's reader says.
pub fn read(path: &Path) -> Result<(Reconstruction, Format), IoError> {
    std::fs::metadata(path).map_err(IoError::system("read", path))?;
    let unknown = "is neither a COLMAP folder, nor an output folder, nor OpenMVG's sfm_data.json";
    let format = detect(path).ok_or_else(|| IoError::content(path, unknown))?;
    let model = match format {
        Format::OpenMvg => openmvg::read(path),
        _ if colmap::is_model(path) => colmap::read(path),
        _ => RunFolder::at(path).read_background(),
    }?;
    Ok((model, format))
}

/// Writes a reconstruction. To PLY go its points alone.
///
/// # Errors
/// A format that is only read, or what the format's writer says.
pub fn write(path: &Path, model: &Reconstruction, format: Format) -> Result<(), IoError> {
    match format {
        Format::ColmapText => colmap::write_text(path, model),
        Format::ColmapBinary => colmap::write_binary(path, model),
        Format::Ply => {
            let points: Vec<_> = model.points.values().map(|p| (p.position, p.rgb)).collect();
            ply::write_points(path, &points)
        }
        Format::OpenMvg => Err(IoError::Unsupported {
            path: path.into(),
            what: "writing OpenMVG's format".into(),
            cure: "write a COLMAP model instead".into(),
        }),
    }
}

/// Looks whether a reconstruction may be written: no file is written through a link or over the one that is read, and
/// over others only if `overwrite` is set.
///
/// # Errors
/// [`FolderError`] says what is in the way.
pub fn check_target(input: &Path, output: &Path, format: Format, overwrite: bool) -> Result<(), FolderError> {
    let is_same =
        |a: &Path, b: &Path| std::fs::canonicalize(a).is_ok_and(|a| std::fs::canonicalize(b).is_ok_and(|b| a == b));
    let files = files_of(output, format);
    if is_same(input, output) || files.iter().any(|file| is_same(input, file)) {
        return Err(FolderError::OwnInput { flag: "IN".to_owned(), input: input.to_owned() });
    }
    for file in &files {
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

/// The files that a reconstruction is written to.
fn files_of(output: &Path, format: Format) -> Vec<PathBuf> {
    let [text, binary] = [&colmap::FILES[..3], &colmap::FILES[3..]];
    match format {
        Format::ColmapText => text.iter().map(|name| output.join(name)).collect(),
        Format::ColmapBinary => binary.iter().map(|name| output.join(name)).collect(),
        Format::Ply | Format::OpenMvg => vec![output.to_owned()],
    }
}

/// The format in which a conversion from `from` to `to` writes, if none is asked for: PLY by the name, else the other
/// COLMAP form than the one read, text first.
pub fn format_for(from: Format, to: &Path) -> Format {
    match from {
        _ if has_extension(to, "ply") => Format::Ply,
        Format::ColmapText => Format::ColmapBinary,
        _ => Format::ColmapText,
    }
}

fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension))
}
