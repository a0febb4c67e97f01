//! `tractrix convert IN OUT`: a reconstruction in another format.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::frame;
use super::output::{Failure, Form, show};
use crate::io::interchange::database::{self, Features};
use crate::io::interchange::model::{self, Format};
use crate::io::{Losses, atomic};
use crate::math::rounding::counted;
use crate::pipeline;
use crate::scene::Reconstruction;

/// Convert a reconstruction between COLMAP (text, binary), OpenMVG, OpenSfM, nerfstudio, NVM and Bundler
///
/// PLY receives its points, a COLMAP database its features and matches.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// COLMAP folder, output folder of `tractrix run` (its background), or file of another program (docs/formats.md)
    #[arg(value_name = "IN")]
    pub(super) input: PathBuf,
    /// Folder for a COLMAP model, or a file whose name gives the format: NAME.ply, NAME.nvm, NAME.db, bundle.out,
    /// sfm_data.json, reconstruction.json or transforms.json
    #[arg(value_name = "OUT")]
    pub(super) output: PathBuf,
    /// Output format [default: by the name; otherwise binary from COLMAP text, text from others]
    #[arg(long, value_enum)]
    pub(super) to: Option<To>,
    /// Frame of the output; all but world need the output folder of a run in which meters are known
    ///
    /// OUT gets a file frame.json next to it, or OUT.frame.json, with axes, origin, EPSG code and standard deviations.
    #[arg(long, value_enum, value_name = "FRAME", default_value_t)]
    pub(super) frame: TargetFrame,
    /// Replace existing files
    #[arg(long)]
    pub(super) overwrite: bool,
}

/// Frame of a converted model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum TargetFrame {
    /// That of the input
    #[default]
    World,
    /// Meters, z up
    Metric,
    /// Meters east, north, up; needs --telemetry in the run
    Enu,
    /// Easting, northing and height of the UTM zone; needs --telemetry in the run
    Utm,
}

/// A format that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum To {
    /// cameras.txt, images.txt, points3D.txt, rigs.txt, frames.txt
    ColmapText,
    /// cameras.bin, images.bin, points3D.bin, rigs.bin, frames.bin
    ColmapBinary,
    /// Features, matches and two-view geometry, input of COLMAP's mapper; of an output folder all tracked features
    ColmapDatabase,
    /// sfm_data.json
    Openmvg,
    /// reconstruction.json, and tracks.csv next to it
    Opensfm,
    /// transforms.json, and sparse_pc.ply next to it
    Nerfstudio,
    /// VisualSFM's .nvm
    Nvm,
    /// bundle.out, and list.txt next to it
    Bundler,
    /// Colored points
    Ply,
}

/// Output of a conversion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Target {
    Model(Format),
    Database,
}

impl From<To> for Target {
    fn from(to: To) -> Self {
        Self::Model(match to {
            To::ColmapText => Format::ColmapText,
            To::ColmapBinary => Format::ColmapBinary,
            To::ColmapDatabase => return Self::Database,
            To::Openmvg => Format::OpenMvg,
            To::Opensfm => Format::OpenSfm,
            To::Nerfstudio => Format::Nerfstudio,
            To::Nvm => Format::Nvm,
            To::Bundler => Format::Bundler,
            To::Ply => Format::Ply,
        })
    }
}

impl Target {
    /// Output that was requested, or otherwise that of the output's name.
    fn of(args: &Args, from: Format, model: &Reconstruction) -> anyhow::Result<Self> {
        let is_database = args.output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("db"));
        Ok(match args.to {
            Some(to) => to.into(),
            None if is_database => Self::Database,
            None => Self::Model(model::format_for(from, &args.output, model)?),
        })
    }

    fn name(self) -> String {
        match self {
            Self::Model(format) => format.to_string(),
            Self::Database => "COLMAP (database)".to_owned(),
        }
    }

    fn files(self, output: &Path) -> Vec<PathBuf> {
        match self {
            Self::Model(format) => model::files_of(output, format),
            Self::Database => vec![output.to_owned()],
        }
    }

    fn write(self, args: &Args, model: &Reconstruction, from: Format) -> anyhow::Result<Losses> {
        let losses = match self {
            Self::Model(format) => model::write(&args.output, model, format)?,
            Self::Database => write_database(&args.input, &args.output, model)?,
        };
        Ok(model::lost_on_reading(&args.input, from).into_iter().fold(losses, Losses::with))
    }

    fn num_images(self, model: &Reconstruction) -> usize {
        // Points alone go to PLY.
        if self == Self::Model(Format::Ply) { 0 } else { model.images.len() }
    }
}

/// The model's features and matches; of an output folder all that its run followed.
fn write_database(input: &Path, output: &Path, model: &Reconstruction) -> anyhow::Result<Losses> {
    let own = Features::of(model);
    let Some(found) = pipeline::found_features(input)? else { return Ok(database::write(output, model, &own)?) };
    let losses = match own.clone().joined(found) {
        Some(all) => database::write(output, model, &all)?,
        None => database::write(output, model, &own)?.with(
            "further features of the run are skipped: the model in its folder is not the one that the run made"
                .to_owned(),
        ),
    };
    Ok(losses)
}

/// Result of a conversion.
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
    /// Data that the format cannot hold.
    losses: Vec<String>,
}

impl Conversion {
    fn as_text(&self) -> String {
        let points = counted(self.num_points, "point");
        let what = match self.num_images {
            0 => points,
            images => format!("{}, {points}", counted(images, "image")),
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
    let (mut reconstruction, from) = model::read(&args.input)?;
    let target = Target::of(args, from, &reconstruction)?;
    let mut files = target.files(&args.output);
    let placed = frame::of(args.frame, &args.input)?;
    if let Some(placed) = &placed {
        reconstruction.transform(&placed.target_from_world);
        files.push(frame::file_of(&args.output));
    }
    model::check_target(&args.input, &args.output, &files, args.overwrite)?;
    let losses = target.write(args, &reconstruction, from)?;
    if let Some(placed) = &placed {
        atomic::write_json(&frame::file_of(&args.output), &placed.described)?;
    }
    Ok(Conversion {
        input: args.input.clone(),
        from: from.to_string(),
        output: args.output.clone(),
        to: target.name(),
        num_images: target.num_images(&reconstruction),
        num_points: reconstruction.points.len(),
        files,
        losses: losses.sentences().to_vec(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::interchange::colmap;
    use crate::io::testing::in_repository;

    fn convert(input: &Path, output: &Path, to: Option<To>) -> anyhow::Result<Conversion> {
        super::convert(&Args {
            input: input.into(),
            output: output.into(),
            to,
            frame: TargetFrame::World,
            overwrite: false,
        })
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
        let database = folder.path().join("database.db");
        let converted = convert(&binary, &database, None).unwrap();
        assert!(converted.to == "COLMAP (database)" && converted.files == [database.as_path()]);
        assert!(std::fs::read(&database).unwrap().starts_with(b"SQLite format 3"));
        let openmvg = in_repository("tests/golden/models/openmvg/sfm_data.json");
        convert(&openmvg, &folder.path().join("out/background"), None).unwrap();
        // An output folder counts as its background.
        assert_eq!(model::read(&folder.path().join("out")).unwrap().0.images.len(), 3);
    }

    #[test]
    fn what_cannot_be_read_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let error = convert(folder.path(), &folder.path().join("out"), None).unwrap_err().to_string();
        assert!(error.contains("no model in the folder; give a COLMAP folder"), "{error}");
        assert!(convert(&folder.path().join("gone"), folder.path(), None).unwrap_err().to_string().contains("gone"));
    }
}
