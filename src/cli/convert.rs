//! `tractrix convert IN OUT`: a reconstruction in another format.

use std::path::PathBuf;

use serde::Serialize;

use super::output::{Failure, Form, show};
use crate::io::model::{self, Format};

/// Converts a reconstruction between COLMAP text, COLMAP binary, OpenMVG (reading) and PLY points (writing).
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// COLMAP folder, output folder of `tractrix run` (its background), or OpenMVG's sfm_data.json
    #[arg(value_name = "IN")]
    pub(super) input: PathBuf,
    /// Folder to write a COLMAP model into, or a file ending in .ply for the points alone
    #[arg(value_name = "OUT")]
    pub(super) output: PathBuf,
    /// Format to write; by default .ply by its name, binary from COLMAP text, text from all else
    #[arg(long, value_enum)]
    pub(super) to: Option<To>,
    /// Replace files that are there
    #[arg(long)]
    pub(super) overwrite: bool,
}

/// A format that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum To {
    /// cameras.txt, images.txt, points3D.txt
    ColmapText,
    /// cameras.bin, images.bin, points3D.bin
    ColmapBinary,
    /// Coloured points
    Ply,
}

/// What was converted.
#[derive(Debug, Serialize)]
struct Conversion {
    input: PathBuf,
    from: String,
    output: PathBuf,
    to: String,
    num_images: usize,
    num_points: usize,
}

impl Conversion {
    fn as_text(&self) -> String {
        let what = match self.num_images {
            0 => format!("{} points", self.num_points),
            images => format!("{images} images, {} points", self.num_points),
        };
        format!("{} to {}: {what}\n{}\n", self.from, self.to, self.output.display())
    }
}

/// Converts and says what was written.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let conversion = convert(args)?;
    show(form, &conversion, || conversion.as_text())
}

fn convert(args: &Args) -> anyhow::Result<Conversion> {
    let (reconstruction, from) = model::read(&args.input)?;
    let format = match args.to {
        Some(To::ColmapText) => Format::ColmapText,
        Some(To::ColmapBinary) => Format::ColmapBinary,
        Some(To::Ply) => Format::Ply,
        None => model::format_for(from, &args.output),
    };
    model::check_target(&args.input, &args.output, format, args.overwrite)?;
    model::write(&args.output, &reconstruction, format)?;
    Ok(Conversion {
        input: args.input.clone(),
        from: from.to_string(),
        output: args.output.clone(),
        to: format.to_string(),
        // Points alone go to PLY.
        num_images: if format == Format::Ply { 0 } else { reconstruction.images.len() },
        num_points: reconstruction.points.len(),
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::io::colmap;
    use crate::io::testing::in_repository;

    fn convert(input: &Path, output: &Path, to: Option<To>) -> anyhow::Result<Conversion> {
        super::convert(&Args { input: input.into(), output: output.into(), to, overwrite: false })
    }

    #[test]
    fn a_model_goes_through_every_format() {
        let folder = tempfile::tempdir().unwrap();
        let original = in_repository("tests/golden/models/colmap_binary");
        let [text, binary, points] = ["text", "binary", "points.ply"].map(|name| folder.path().join(name));
        assert_eq!(convert(&original, &text, None).unwrap().num_points, 12);
        convert(&text, &binary, None).unwrap();
        assert!(binary.join("cameras.bin").is_file() && text.join("cameras.txt").is_file());
        assert_eq!(colmap::read(&binary).unwrap(), colmap::read(&original).unwrap());
        convert(&binary, &points, None).unwrap();
        assert!(std::fs::metadata(&points).unwrap().len() > 27 * 12);
        let openmvg = in_repository("tests/golden/models/openmvg/sfm_data.json");
        convert(&openmvg, &folder.path().join("out/background"), None).unwrap();
        // An output folder counts as its background.
        assert_eq!(model::read(&folder.path().join("out")).unwrap().0.images.len(), 3);
    }

    #[test]
    fn what_cannot_be_read_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let error = convert(folder.path(), &folder.path().join("out"), None).unwrap_err().to_string();
        assert!(error.contains("neither a COLMAP folder"), "{error}");
        assert!(convert(&folder.path().join("gone"), folder.path(), None).unwrap_err().to_string().contains("gone"));
    }
}
