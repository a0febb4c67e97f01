//! `tractrix convert IN OUT`: a reconstruction in another format.

use std::path::PathBuf;

use serde::Serialize;

use super::output::{Failure, Form, show};
use crate::io::model::{self, Format};

/// Converts a reconstruction between COLMAP (text, binary), OpenMVG, OpenSfM, nerfstudio, NVM and Bundler; to PLY go
/// its points.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// A COLMAP folder, an output folder of `tractrix run` (its background), or a file of another program (see
    /// docs/formats.md)
    #[arg(value_name = "IN")]
    pub(super) input: PathBuf,
    /// Folder to write a COLMAP model into, or a file: NAME.ply, NAME.nvm, bundle.out, sfm_data.json,
    /// reconstruction.json or transforms.json says the format by its name
    #[arg(value_name = "OUT")]
    pub(super) output: PathBuf,
    /// Format to write; by default what the name says, else binary from COLMAP text, text from all else
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
    /// sfm_data.json
    Openmvg,
    /// reconstruction.json, and tracks.csv beside it
    Opensfm,
    /// transforms.json, and sparse_pc.ply beside it
    Nerfstudio,
    /// VisualSFM's .nvm
    Nvm,
    /// bundle.out, and list.txt beside it
    Bundler,
    /// Coloured points
    Ply,
}

impl From<To> for Format {
    fn from(to: To) -> Self {
        match to {
            To::ColmapText => Self::ColmapText,
            To::ColmapBinary => Self::ColmapBinary,
            To::Openmvg => Self::OpenMvg,
            To::Opensfm => Self::OpenSfm,
            To::Nerfstudio => Self::Nerfstudio,
            To::Nvm => Self::Nvm,
            To::Bundler => Self::Bundler,
            To::Ply => Self::Ply,
        }
    }
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
    /// The files that were written.
    files: Vec<PathBuf>,
    /// What the format had no place for.
    losses: Vec<String>,
}

impl Conversion {
    fn as_text(&self) -> String {
        let what = match self.num_images {
            0 => format!("{} points", self.num_points),
            images => format!("{images} images, {} points", self.num_points),
        };
        let beside = self.files.iter().filter(|file| !file.starts_with(&self.output));
        let beside: String = beside.map(|file| format!("{}\n", file.display())).collect();
        let losses: String = self.losses.iter().map(|loss| format!("{loss}\n")).collect();
        format!("{} to {}: {what}\n{}\n{beside}{losses}", self.from, self.to, self.output.display())
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
        Some(to) => to.into(),
        None => model::format_for(from, &args.output, &reconstruction)?,
    };
    model::check_target(&args.input, &args.output, format, args.overwrite)?;
    let losses = model::write(&args.output, &reconstruction, format)?;
    Ok(Conversion {
        input: args.input.clone(),
        from: from.to_string(),
        output: args.output.clone(),
        to: format.to_string(),
        // Points alone go to PLY.
        num_images: if format == Format::Ply { 0 } else { reconstruction.images.len() },
        num_points: reconstruction.points.len(),
        files: model::files_of(&args.output, format),
        losses: losses.sentences().to_vec(),
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
        let nameless = convert(&binary, &folder.path().join("model.json"), None).unwrap_err().to_string();
        assert!(nameless.contains("--to") && nameless.contains("sfm_data.json"), "{nameless}");
        for name in ["sfm_data.json", "reconstruction.json", "transforms.json", "points.nvm", "bundle.out"] {
            let there = folder.path().join(format!("there/{name}"));
            let converted = convert(&binary, &there, None).unwrap();
            assert!(converted.files.iter().all(|file| file.is_file()) && !converted.losses.is_empty(), "{name}");
            let back = folder.path().join(format!("back from {}", name.replace('.', "-")));
            convert(&there, &back, None).unwrap();
            assert_eq!(colmap::read(&back).unwrap().images.len(), 3, "{name}");
            assert!(convert(&binary, &there, None).unwrap_err().to_string().contains("--overwrite"), "{name}");
        }
        let openmvg = in_repository("tests/golden/models/openmvg/sfm_data.json");
        convert(&openmvg, &folder.path().join("out/background"), None).unwrap();
        // An output folder counts as its background.
        assert_eq!(model::read(&folder.path().join("out")).unwrap().0.images.len(), 3);
    }

    #[test]
    fn what_cannot_be_read_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let error = convert(folder.path(), &folder.path().join("out"), None).unwrap_err().to_string();
        assert!(error.contains("holds no model; give a COLMAP folder"), "{error}");
        assert!(convert(&folder.path().join("gone"), folder.path(), None).unwrap_err().to_string().contains("gone"));
    }
}
