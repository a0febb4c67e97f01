//! Writing of the requested formats.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{ExportError, Format, Need, Results, Target, Units};
use super::{annotate, cot, geojson, gltf, gpx, kml, poses, table, traffic, workspace};
use crate::image::RgbImage;
use crate::io::{ExportFolder, RunFolder, trajectories};
use crate::scene::{Frame, FrameId};
use crate::video::{Frames, Source};

/// The input images of the results.
pub struct Pictures<'a> {
    pub(super) folder: &'a RunFolder,
    source: Result<&'a Source, String>,
    pub(super) on_step: &'a dyn Fn(),
    frames: Option<BTreeSet<FrameId>>,
}

impl<'a> Pictures<'a> {
    /// Input of a run.
    ///
    /// * `source` – the input, opened as by the run, or the reason why it cannot be opened.
    /// * `on_step` – called after every image.
    pub fn new(folder: &'a RunFolder, source: Result<&'a Source, String>, on_step: &'a dyn Fn()) -> Self {
        Self { folder, source, on_step, frames: None }
    }

    /// Restricts the input to the frames of the run, where they are known.
    pub fn of_frames(self, frames: Option<&[Frame]>) -> Self {
        Self { frames: frames.map(|frames| frames.iter().map(|frame| frame.id).collect()), ..self }
    }

    /// The frames of the run, with their images.
    pub(super) fn frames(&self) -> Result<Frames, ExportError> {
        let source = self.source()?;
        Ok(match &self.frames {
            Some(frames) => source.frames_at(frames.clone())?,
            None => source.frames()?,
        })
    }

    pub(super) fn source(&self) -> Result<&'a Source, ExportError> {
        self.source.as_ref().copied().map_err(|reason| ExportError::NoPictures { reason: reason.clone() })
    }

    /// Frames per second, if known.
    pub(super) fn rate(&self) -> Option<f64> {
        let source = self.source.as_ref().ok()?;
        Some(source.info().fps? / f64::from(source.every()))
    }

    /// The error for an input that does not match the results.
    pub(super) fn other(&self, problem: impl Into<String>) -> ExportError {
        let path = self.source.as_ref().map_or_else(|_| PathBuf::new(), |source| source.path().to_owned());
        ExportError::OtherInput { path, problem: problem.into() }
    }

    /// Checks that an image has the size of the run's images.
    pub(super) fn check_size(&self, picture: &RgbImage, results: &Results) -> Result<(), ExportError> {
        let ((width, height), (wanted_width, wanted_height)) = (picture.dimensions(), results.size);
        match (width, height) == results.size {
            true => Ok(()),
            false => {
                Err(self.other(format!("frames of {width}x{height} pixels, expected {wanted_width}x{wanted_height}")))
            }
        }
    }
}

/// A written format.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Written {
    /// Its name.
    pub format: &'static str,
    /// Its files, or its folder.
    pub files: Vec<PathBuf>,
}

/// A skipped format.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SkippedFormat {
    /// Its name.
    pub format: &'static str,
    /// Reason and remedy.
    pub reason: String,
}

/// Exported files.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Exported {
    /// In the order of [`Format::ALL`].
    pub written: Vec<Written>,
    /// Formats that these results do not support.
    pub passed_over: Vec<SkippedFormat>,
}

/// Treatment of formats that the results do not support.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MissingFormats {
    /// Formats requested by name: an unsupported one is an error, and nothing is written.
    ByName,
    /// All formats: unsupported ones are skipped.
    ForAll,
}

/// Writes results in formats; with a `rate`, formats with rows or events have that many per second.
///
/// # Errors
/// A format requested by name that these results do not support, in which case nothing is written; a file that cannot
/// be read or written.
pub fn write(
    results: &Results,
    formats: &[Format],
    missing_formats: MissingFormats,
    rate: Option<f64>,
    pictures: &Pictures,
    target: impl FnOnce() -> Result<Target, ExportError>,
) -> Result<Exported, ExportError> {
    let mut exported = Exported::default();
    let mut possible = Vec::new();
    let sampled = rate.map(|rate| resampled(results, rate)).transpose()?;
    let sampled = sampled.as_ref().unwrap_or(results);
    if missing_formats == MissingFormats::ByName {
        check_form(results, formats, rate)?;
    }
    for &format in formats {
        match obstacle(format, results, pictures) {
            None => possible.push(format),
            Some(error) if missing_formats == MissingFormats::ByName => return Err(error),
            Some(error) => {
                exported.passed_over.push(SkippedFormat { format: format.name(), reason: error.to_string() });
            }
        }
    }
    let target = target()?;
    for format in possible {
        let files = one(format, results, sampled, pictures, &target)?;
        exported.written.push(Written { format: format.name(), files });
    }
    Ok(exported)
}

fn obstacle(format: Format, results: &Results, pictures: &Pictures) -> Option<ExportError> {
    let of_pictures = || (format.need() == Need::Pictures).then(|| pictures.source().err()).flatten();
    format.obstacle(results).or_else(of_pictures)
}

/// Refuses formats to which a rate or units do not apply.
fn check_form(results: &Results, formats: &[Format], rate: Option<f64>) -> Result<(), ExportError> {
    if let Some(format) = formats.iter().find(|format| rate.is_some() && !format.is_sampled()) {
        let text = format!("--rate: {format} has the frames of the input; export it without --rate");
        return Err(ExportError::Obstacle(text));
    }
    let has_units = |format: &Format| matches!(format, Format::Csv | Format::GeoJson);
    match results.units == Units::default() || formats.iter().any(has_units) {
        true => Ok(()),
        false => Err(ExportError::Obstacle(
            "--units: only csv and geojson have units to choose; add one of them to --format, or leave out --units"
                .into(),
        )),
    }
}

fn resampled(results: &Results, rate: f64) -> Result<Results, ExportError> {
    if !results.clock().has_seconds() {
        let text = "--rate: the images have no times; run again with --fps RATE";
        return Err(ExportError::Obstacle(text.into()));
    }
    results.resampled(rate).ok_or_else(|| {
        let text = format!("--rate {rate}: more than 3.6 million rows for one vehicle; give a lower rate");
        ExportError::Obstacle(text)
    })
}

/// Writes one format and returns its files. Rows and events come from `sampled`, everything else from `results`.
fn one(
    format: Format,
    results: &Results,
    sampled: &Results,
    pictures: &Pictures,
    target: &Target,
) -> Result<Vec<PathBuf>, ExportError> {
    use ExportFolder as Names;
    type Writer = fn(&Path, &Results) -> Result<(), ExportError>;
    let several = |files: &[(&str, Writer, &Results)]| {
        files.iter().map(|(name, write, of)| target.put_file(name, |path| write(path, of))).collect()
    };
    let path = match format {
        Format::Csv => {
            return several(&[
                (Names::VEHICLES, table::vehicles, results),
                (Names::TRAJECTORIES, table::trajectories, sampled),
                (Names::GROUND_TRACKS, table::ground_tracks, results),
                (Names::GROUND_POSITIONS, table::ground_positions, sampled),
                (Names::CAMERA, table::camera, sampled),
            ]);
        }
        Format::GeoJson => {
            return several(&[
                (Names::WAYS_ON_MAP, geojson::write_trajectories, results),
                (Names::PLACES_ON_MAP, geojson::write_positions, sampled),
            ]);
        }
        Format::Kml => target.put_file(Names::KML, |path| kml::write(path, sampled)),
        Format::Gpx => target.put_file(Names::GPX, |path| gpx::write(path, sampled)),
        Format::Sumo => target.put_file(Names::SUMO, |path| traffic::write_sumo(path, sampled)),
        Format::Cot => target.put_file(Names::COT, |path| cot::write(path, sampled)),
        Format::TrajectoriesV2 => target
            .put_file(Names::TRAJECTORIES_V2, |path| Ok(trajectories::write_version_2(path, &results.trajectories)?)),
        Format::Tum => target.put_folder(Names::TUM, |path| poses::write_tum(path, sampled)),
        Format::LevelX => target.put_folder(Names::LEVELX, |path| traffic::write_levelx(path, sampled)),
        Format::Kitti => target.put_folder(Names::KITTI, |path| poses::write_kitti(path, sampled)),
        Format::Gltf => {
            let models = gltf::models(pictures.folder, results)?;
            target.put_file(Names::SCENE, |path| gltf::write(path, results, &models))
        }
        Format::Video => target.put_file(Names::VIDEO, |path| annotate::write(path, results, pictures)),
        Format::Colmap => target.put_folder(Names::COLMAP, |path| workspace::write(path, results, pictures)),
    };
    Ok(vec![path?])
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::export::testing::{results_of, with_metres, write_run};
    use crate::io::interchange::colmap;
    use crate::io::masks;
    use crate::synthetic::showcase::{Showcase, showcase};
    use crate::synthetic::write_clip;
    use crate::video::Options;

    /// An output folder, and its input video.
    fn run(folder: &Path, found: &Showcase) -> (RunFolder, Source) {
        let run = RunFolder::at(folder.join("out"));
        write_run(run.root(), &results_of(found));
        for frame in &found.frames {
            for (id, mask) in found.masks(frame.id) {
                masks::write_mask(&run.mask(id, frame), &mask).unwrap();
            }
        }
        let path = folder.join("clip.avi");
        let pictures: Vec<_> = found.frames.iter().map(|frame| found.picture(frame.id)).collect();
        write_clip(&path, 15, &pictures).unwrap();
        (run, Source::open(&path, &Options::default()).unwrap())
    }

    fn bytes_below(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut all = BTreeMap::new();
        for entry in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            match entry.is_dir() {
                true if entry.ends_with(RunFolder::STATE) => {}
                true => all.extend(bytes_below(&entry)),
                false => drop(all.insert(entry.clone(), std::fs::read(&entry).unwrap())),
            }
        }
        all
    }

    #[test]
    fn exports_are_reproducible_and_foreign_files_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let found = showcase(12, 1);
        let (run, source) = run(folder.path(), &found);
        let results = with_metres(results_of(&found));
        let pictures = Pictures::new(&run, Ok(&source), &|| ());
        let into = folder.path().join("exported");
        let all = || {
            let target = || Ok(Target::at(&into, &[("OUT", run.root())])?);
            write(&results, &Format::ALL, MissingFormats::ForAll, None, &pictures, target)
        };
        let exported = all().unwrap();
        assert_eq!((exported.written.len(), exported.passed_over.len()), (Format::ALL.len(), 0));
        assert!(exported.written.iter().flat_map(|written| &written.files).all(|file| file.exists()));
        let first = bytes_below(&into);
        all().unwrap();
        let again = bytes_below(&into);
        // Videos of one process are visually identical frame by frame, not bit by bit; those of two runs are.
        let is_other = |path: &&PathBuf| !path.ends_with("annotated.mp4") && first.get(*path) != again.get(*path);
        let others: Vec<&PathBuf> = again.keys().filter(is_other).collect();
        assert!(others.is_empty() && first.len() == again.len(), "the same results give the same bytes: {others:?}");
        let model = colmap::read(&into.join("colmap/sparse/0")).unwrap();
        assert_eq!(model.images.len(), results.views.len());
        let frame = &results.views[3].frame;
        let mask = masks::read_mask(&into.join("colmap/masks").join(RunFolder::mask_name(frame)), (960, 540)).unwrap();
        let car = &found.masks(frame.id)[0].1;
        assert_eq!((mask.intersection_px2(car), mask.get(2, 2)), (0, true));
        std::fs::remove_dir_all(&into).unwrap();
        std::fs::create_dir(&into).unwrap();
        std::fs::write(into.join("vehicles.csv"), "mine").unwrap();
        let refused = all().unwrap_err();
        assert!(
            matches!(&refused, ExportError::Folder(error) if error.is_wrong_use())
                && refused.to_string().contains("vehicles.csv"),
            "{refused}"
        );
        assert_eq!(std::fs::read_to_string(into.join("vehicles.csv")).unwrap(), "mine");
    }

    #[test]
    fn unsupported_formats_are_refused_with_a_remedy_before_writing() {
        let folder = tempfile::tempdir().unwrap();
        let found = showcase(12, 1);
        let (run, _) = run(folder.path(), &found);
        let results = Results::read(&run, Some(&found.frames)).unwrap();
        let pictures = Pictures::new(&run, Err("clip.avi: no such file".into()), &|| ());
        let into = folder.path().join("exported");
        let refused = |formats: &[Format]| {
            let target = || Ok(Target::at(&into, &[])?);
            write(&results, formats, MissingFormats::ByName, None, &pictures, target).unwrap_err().to_string()
        };
        let map = refused(&[Format::Csv, Format::Kml]);
        assert!(map.contains("--format kml") && map.contains("--telemetry"), "{map}");
        assert!(refused(&[Format::Video]).contains("--input"));
        assert!(!into.exists());
        let exported =
            write(&results, &Format::ALL, MissingFormats::ForAll, None, &pictures, || Ok(Target::at(&into, &[])?))
                .unwrap();
        let passed: Vec<_> = exported.passed_over.iter().map(|left| left.format).collect();
        assert_eq!(passed, ["geojson", "kml", "gpx", "video", "sumo", "levelx", "cot", "colmap"]);
        assert!(into.join("scene.glb").is_file() && !into.join("camera.gpx").exists());
        std::fs::remove_file(run.trajectories()).unwrap();
        let models = Results::read(&run, None).unwrap();
        let refused = Format::Csv.obstacle(&models).unwrap().to_string();
        assert!(refused.contains("trajectories.json is missing"), "{refused}");
        assert!(Format::Colmap.obstacle(&models).is_none() && Format::Tum.obstacle(&models).is_none());
    }
}
