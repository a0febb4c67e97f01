//! `tractrix convert IN OUT`: a reconstruction in another format.

use std::path::PathBuf;

use anyhow::Context;

use crate::io::model::{self, Format};

/// Converts a reconstruction between COLMAP text, COLMAP binary, OpenMVG (reading) and PLY points (writing).
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// COLMAP folder, output folder of `tractrix run` (its background), or OpenMVG's sfm_data.json
    #[arg(value_name = "IN")]
    pub input: PathBuf,
    /// Folder to write a COLMAP model into, or a file ending in .ply for the points alone
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Format to write; by default .ply by its name, binary from COLMAP text, text from all else
    #[arg(long, value_enum)]
    pub to: Option<To>,
    /// Replace files that are there
    #[arg(long)]
    pub overwrite: bool,
}

/// A format that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum To {
    /// cameras.txt, images.txt, points3D.txt
    ColmapText,
    /// cameras.bin, images.bin, points3D.bin
    ColmapBinary,
    /// Coloured points
    Ply,
}

/// Converts and says what was written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let reconstruction = model::read(&args.input)?;
    let from = model::detect(&args.input).context("what was just read has no format any more")?;
    let format = match args.to {
        Some(To::ColmapText) => Format::ColmapText,
        Some(To::ColmapBinary) => Format::ColmapBinary,
        Some(To::Ply) => Format::Ply,
        None => model::format_for(from, &args.output),
    };
    model::check_target(&args.input, &args.output, format, args.overwrite)?;
    model::write(&args.output, &reconstruction, format)?;
    let (images, points) = (reconstruction.images.len(), reconstruction.points.len());
    tracing::info!("{from} to {format}: {images} images, {points} points in {}", args.output.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::io::colmap;

    fn convert(input: &Path, output: &Path, to: Option<To>) -> anyhow::Result<()> {
        run(&Args { input: input.into(), output: output.into(), to, overwrite: false })
    }

    #[test]
    fn a_model_goes_through_every_format() {
        let Some(data) = std::env::var_os("TRACTRIX_DATA").map(PathBuf::from) else {
            eprintln!("skipped: TRACTRIX_DATA is not set");
            return;
        };
        let folder = tempfile::tempdir().unwrap();
        let original = data.join("interchange/right_curve/colmap_object_bin");
        let [text, binary, points] = ["text", "binary", "points.ply"].map(|name| folder.path().join(name));
        convert(&original, &text, None).unwrap();
        convert(&text, &binary, None).unwrap();
        assert!(binary.join("cameras.bin").is_file() && text.join("cameras.txt").is_file());
        assert_eq!(colmap::read(&binary).unwrap(), colmap::read(&original).unwrap());
        convert(&binary, &points, None).unwrap();
        assert!(std::fs::metadata(&points).unwrap().len() > 27 * 2128);
        let openmvg = data.join("interchange/right_curve/openmvg_background_sfm_data.json");
        convert(&openmvg, &folder.path().join("out/background"), None).unwrap();
        // An output folder counts as its background.
        assert_eq!(model::read(&folder.path().join("out")).unwrap().images.len(), 60);
    }

    #[test]
    fn what_cannot_be_read_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let error = convert(folder.path(), &folder.path().join("out"), None).unwrap_err().to_string();
        assert!(error.contains("neither a COLMAP folder"), "{error}");
        assert!(convert(&folder.path().join("gone"), folder.path(), None).unwrap_err().to_string().contains("gone"));
    }
}
