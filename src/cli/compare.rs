//! `tractrix compare A B`: reconstructions of the same images, held against one another or against the truth.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::common::{lossy, named};
use super::output::{Failure, Form, show};
use super::paired_times::{self, Times};
use crate::eval::comparison::{Comparison, Cost, LengthUnit, MatchBy, Side, compare};
use crate::io::interchange::model::{self, Format};
use crate::io::{IoError, RunFolder, Sequence, atomic, json as json_file, refuse_place_of_results};
use crate::report::comparison as page;
use crate::scene::{CameraId, Image, ImageId, Reconstruction};

/// Compare reconstructions of the same images, in any supported format
///
/// The truth, otherwise the first model, defines frame and unit. Every other model is aligned by a robust similarity
/// transform and compared image by image. Exit code 1 if nothing can be compared.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// COLMAP folders, output folders of `tractrix run` (their background), or other supported formats
    #[arg(value_name = "MODEL", required = true)]
    pub(super) models: Vec<PathBuf>,
    /// Ground truth or reference: a sequence (scene.json, in meters), or a reconstruction
    #[arg(long, value_name = "TRUTH")]
    pub(super) truth: Option<PathBuf>,
    /// Criterion by which images are matched: `name` (with folders), `stem` (without folders and extension), or `order`
    /// (position in the order of names)
    #[arg(long, value_name = "WHAT", value_parser = named::<MatchBy>, default_value = "name")]
    pub(super) match_by: MatchBy,
    /// Time of the reference minus that of the models, seconds; for camera paths (TUM, EuRoC), matched by time
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_hyphen_values = true)]
    pub(super) time_offset: f64,
    /// Label of a model, in the order given; may be repeated
    #[arg(long = "label", value_name = "TEXT")]
    pub(super) labels: Vec<String>,
    /// Also write a page with all camera paths and point clouds in one view
    #[arg(long, value_name = "FILE.html")]
    pub(super) page: Option<PathBuf>,
    /// Replace an existing page
    #[arg(long, requires = "page")]
    pub(super) overwrite: bool,
}

/// Compares, prints the figures, and writes the page if one is asked for.
pub(super) fn run(args: &Args, arguments: &[std::ffi::OsString], form: Form) -> Result<(), Failure> {
    check(args)?;
    let mut sides = sides(args)?;
    let unit = match args.truth.as_deref().map(is_sequence) {
        Some(true) => LengthUnit::Metre,
        _ => LengthUnit::Reference,
    };
    let others = sides.split_off(1);
    let reference = sides.remove(0);
    let comparison = compare(&reference, &others, unit, args.match_by);
    if let Some(path) = &args.page {
        let models = std::iter::once(&reference.model).chain(others.iter().map(|side| &side.model)).collect();
        let arguments = lossy(arguments);
        let text = page::render(&page::Data { comparison: &comparison, models, arguments })?;
        atomic::write(path, text.as_bytes())?;
    }
    let mut value = json!(comparison);
    let failure = (!comparison.has_result()).then(|| why_not(&comparison));
    if let Some(message) = &failure {
        value["error"] = json!({ "message": message });
    }
    show(form, &value, || comparison.to_string())?;
    failure.map_or(Ok(()), |message| Err(Failure::Partial(anyhow::anyhow!(message))))
}

fn check(args: &Args) -> Result<(), Failure> {
    args.page.as_deref().map_or(Ok(()), refuse_place_of_results)?;
    if args.models.len() + usize::from(args.truth.is_some()) < 2 {
        return Err(Failure::Usage("only one model given; give a second one, or --truth".into()));
    }
    if args.labels.len() > args.models.len() {
        let (labels, models) = (args.labels.len(), args.models.len());
        return Err(Failure::Usage(format!("--label: given {labels} times for {models} models")));
    }
    match &args.page {
        Some(page) if page.exists() && !args.overwrite => {
            Err(Failure::Usage(format!("{}: exists; --overwrite replaces it", page.display())))
        }
        _ => Ok(()),
    }
}

/// The truth, if there is one, and the models in the order given.
fn sides(args: &Args) -> Result<Vec<Side>, Failure> {
    let mut names = short_names(&args.models);
    for (name, label) in names.iter_mut().zip(&args.labels) {
        name.clone_from(label);
    }
    let (mut sides, mut timed) = (Vec::new(), Vec::new());
    for (path, name) in args.models.iter().zip(names) {
        let (model, format) = read(path, args)?;
        timed.push((format, paired_times::times(path, format, &model)));
        sides.push(Side { name, model, cost: cost(path)? });
    }
    if let Some(truth) = &args.truth {
        let model = if is_sequence(truth) {
            let sequence = Sequence::open(truth)?;
            sides.iter_mut().for_each(|side| name_as_in(&sequence, &mut side.model));
            timed.insert(0, (Format::ColmapText, None));
            model_of(&sequence)
        } else {
            let (model, format) = read(truth, args)?;
            timed.insert(0, (format, paired_times::times(truth, format, &model)));
            model
        };
        sides.insert(0, Side { name: "truth".into(), model, cost: None });
    }
    if args.match_by == MatchBy::Name {
        pair_by_time(&mut sides, &timed, args.time_offset);
    }
    Ok(sides)
}

/// A model; warns of parts that are skipped, and refuses to pair images by names that are none.
fn read(path: &Path, args: &Args) -> Result<(Reconstruction, Format), Failure> {
    let (model, format) = model::read_poses(path)?;
    let lost = model::lost_on_reading(path, format);
    if let (Format::Bundler, MatchBy::Order, [first, ..]) = (format, args.match_by, &lost[..]) {
        return Err(Failure::Usage(format!("{}: {first}; --match-by order would pair any images", path.display())));
    }
    for loss in lost {
        tracing::info!("{}: {loss}", path.display());
    }
    Ok((model, format))
}

/// Names images by time where one side of a pair is a camera path, which has no names.
fn pair_by_time(sides: &mut [Side], timed: &[(Format, Option<Times>)], offset_s: f64) {
    let ([reference, others @ ..], [(of_reference, Some(reference_times)), timed @ ..]) = (sides, timed) else {
        return;
    };
    for (side, (format, times)) in others.iter_mut().zip(timed) {
        let is_path = *of_reference == Format::Tum || *format == Format::Tum;
        if let Some(times) = times.as_ref().filter(|_| is_path) {
            paired_times::rename((&reference.model, reference_times), &mut side.model, times, offset_s);
        }
    }
}

fn is_sequence(path: &Path) -> bool {
    path.join("scene.json").is_file()
}

/// The true cameras of a sequence.
fn model_of(sequence: &Sequence) -> Reconstruction {
    let camera = CameraId(1);
    let image = |frame: &crate::io::SequenceFrame| {
        let image =
            Image { name: frame.name.clone(), camera, cam_from_world: frame.cam_from_world, observations: Vec::new() };
        (ImageId::from(frame.id), image)
    };
    Reconstruction {
        cameras: [(camera, sequence.camera)].into(),
        images: sequence.frames.iter().map(image).collect(),
        ..Reconstruction::default()
    }
}

/// Calls images as the sequence does: those of a video are numbered.
fn name_as_in(sequence: &Sequence, model: &mut Reconstruction) {
    for image in model.images.values_mut() {
        if let Some(frame) = sequence.frame_named(&image.name) {
            image.name.clone_from(&frame.name);
        }
    }
}

/// The last parts of paths, as few as tell them apart.
fn short_names(paths: &[PathBuf]) -> Vec<String> {
    let parts = |path: &Path, count: usize| {
        let parts: Vec<_> = path.components().map(|c| c.as_os_str().to_string_lossy()).collect();
        parts[parts.len().saturating_sub(count)..].join("/")
    };
    let longest = paths.iter().map(|path| path.components().count()).max().unwrap_or(1).max(1);
    let names = |count| paths.iter().map(|path| parts(path, count)).collect::<Vec<_>>();
    let are_distinct =
        |names: &Vec<String>| names.iter().collect::<std::collections::BTreeSet<_>>().len() == names.len();
    (1..=longest).map(names).find(are_distinct).unwrap_or_else(|| names(longest))
}

/// Cost of a reconstruction: from a `cost.json` with external measurements, in its folder or the one above; otherwise,
/// of an output folder, from its run.json.
fn cost(path: &Path) -> Result<Option<Cost>, IoError> {
    let measured = path.ancestors().take(2).map(|folder| folder.join("cost.json")).find(|file| file.is_file());
    let run = RunFolder::at(path).run_json();
    match measured {
        Some(file) => json_file::read(&file).map(Some),
        None if run.is_file() => Ok(cost_of_run(&json_file::read(&run)?)),
        None => Ok(None),
    }
}

/// The sum over stages of a run, and the largest memory of any.
fn cost_of_run(document: &Value) -> Option<Cost> {
    let stages = document.get("stages")?.as_object()?;
    let figures = |key: &str| stages.values().filter_map(|s| s.get(key)?.as_f64()).collect::<Vec<_>>();
    let sum = |key: &str| figures(key).iter().sum::<f64>();
    (!stages.is_empty()).then(|| Cost {
        cpu_s: sum("cpu_s"),
        wall_s: sum("wall_s"),
        peak_rss_mib: figures("peak_rss_mib").into_iter().fold(0.0, f64::max),
    })
}

/// Why nothing could be compared, and what may help.
fn why_not(comparison: &Comparison) -> String {
    let Some(other) = comparison.others.first() else { return "no second model".into() };
    let reason = other.alignment.as_ref().err().unwrap_or("unknown reason");
    let (Some(ours), Some(theirs)) = (other.only_in_reference.first(), other.only_in_other.first()) else {
        return format!("nothing to compare: {reason}");
    };
    if let Some(time_s) = theirs.strip_prefix(paired_times::UNPAIRED) {
        return format!(
            "nothing to compare: {reason}. No times agree ({ours} s in {}, {time_s} s in {}); give --time-offset, or \
             --match-by order for paths with a pose for every pose of the other",
            comparison.reference.name, other.subject.name
        );
    }
    format!(
        "nothing to compare: {reason}. If images have different names ('{ours}' in {}, '{theirs}' in {}): --match-by \
         stem ignores folders and extensions, --match-by order pairs them by the order of their names",
        comparison.reference.name, other.subject.name
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_as_short_as_tells_them_apart() {
        let names = |paths: &[&str]| short_names(&paths.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(names(&["a/ours", "b/colmap"]), ["ours", "colmap"]);
        assert_eq!(names(&["a/x/sparse/0", "b/y/sparse/0"]), ["x/sparse/0", "y/sparse/0"]);
        assert_eq!(names(&["a", "a"]), ["a", "a"]);
    }

    #[test]
    fn the_cost_of_a_run_is_that_of_its_stages() {
        let stage = |cpu: f64, peak: f64| json!({ "cpu_s": cpu, "wall_s": 1.0, "peak_rss_mib": peak });
        let run = json!({ "stages": { "input": stage(2.0, 100.0), "sfm": stage(3.5, 80.0) } });
        assert_eq!(cost_of_run(&run), Some(Cost { cpu_s: 5.5, wall_s: 2.0, peak_rss_mib: 100.0 }));
        assert_eq!(cost_of_run(&json!({})), None);
    }
}
