//! Stage `report`: the report page, from the results of all stages.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::background::{self, ModelReport};
use super::{objects, scale, track};
use crate::eval::Evaluation;
use crate::io::{ExportFolder, IoError, atomic, json};
use crate::math::rounding::with_std;
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::reopen::{RunJson, check_input};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::cameras;
use crate::pipeline::inputs::cameras::CameraOrigin;
use crate::pipeline::{Method, Options, Result, Silent, Stage, Workspace};
use crate::report::{self, Data, Fact, Missing, Model, Object, Part, PictureMaker, Pictures};
use crate::scene::{FrameId, Ground, ObjectId, Reconstruction, TrackedObject, Trajectories};
use crate::trajectory::{Views, intersection};
use crate::video::Kind;

/// Rewrites the page of a finished run, with the files added to the folder since.
///
/// # Errors
/// The input was moved or deleted, or the run is not finished.
pub(in crate::pipeline) fn renew(workspace: &Workspace) -> Result<()> {
    let RunJson { arguments, input, options } = RunJson::read(workspace.root())?;
    let options = Options::default().with_tree(&Value::Object(options))?;
    let input = workspace.owned.input().map_or(input.path, |input| input.path);
    check_input(workspace.root(), &input)?;
    let source = cameras::open(&input, &options)?;
    let mut run = Run::new(&options, workspace, &source, &arguments, &Silent);
    run.recall();
    run_stage(&run, &mut Outcome::default())
}

/// Rewrites the page of an output folder, with links to exported files.
///
/// # Errors
/// The input was moved or deleted, the run is not finished, or another run is using the folder.
pub fn link_exports(output: &Path) -> Result<()> {
    renew(&Workspace::open(output)?)
}

/// Writes the page of `tractrix sfm`, the points of the background and its map frame. Its result is models.
///
/// # Errors
/// A file that cannot be read or written.
pub(in crate::pipeline) fn write_models(run: &Run) -> Result<()> {
    let tracked = run.workspace.read_tracked()?;
    let background = run.workspace.read_background()?;
    let reports = objects::reports(run)?;
    // Objects are adjusted with the ground later, if ever.
    let object_models = object_models(&reports, |id| run.workspace.read_as_reconstructed(id))?;
    let nothing = Trajectories::empty();
    background::point_cloud::background(run, &background)?;
    let metric = background::map_frame::write(run, &background)?;
    let data = Data {
        metric: metric.as_ref(),
        objects: objects(&tracked, &reports, &object_models, &nothing, &BTreeMap::new(), |_, _| Vec::new()),
        parts: parts(run, &reports, None),
        ..models(run, &background, &tracked)?
    };
    put_page(run, &data)
}

fn put_page(run: &Run, data: &Data) -> Result<()> {
    let text = report::render(data)?;
    run.workspace.put_file(&run.workspace.report(), |fresh| atomic::write(fresh, text.as_bytes()))
}

/// Data common to all pages: those of a page of models, without objects and files.
fn models<'a>(run: &'a Run, background: &'a Reconstruction, tracked: &[TrackedObject]) -> Result<Data<'a>> {
    let report = background::background_report(run)?;
    Ok(Data {
        title: title(run),
        input: input_facts(run, background)?,
        version: crate::VERSION.to_owned(),
        arguments: run.arguments.iter().map(|argument| without_folders(argument)).collect(),
        time_base: run.info().time_base(),
        frames: run.frames()?,
        missing: missing(&report),
        background: Model { reconstruction: background, unregistered: report.unregistered },
        metric: None,
        ground: None,
        objects: Vec::new(),
        pictures: pictures(run, tracked)?,
        warnings: run.warnings().iter().map(|warning| without_folders(warning)).collect(),
        stages: stages(run),
        evaluation: None,
        parts: Vec::new(),
        is_sfm: true,
    })
}

/// A text with absolute paths reduced to file names: a page may be mailed, and folders exist only on this machine.
fn without_folders(text: &str) -> String {
    let bare = |word: &str| match word.split_once('/') {
        Some((before, path)) if before.is_empty() || before.ends_with(['=', ':', '(', '"', '\'', '`']) => {
            let name = path.trim_end_matches('/').rsplit('/').next().unwrap_or_default();
            format!("{before}{name}")
        }
        _ => word.to_owned(),
    };
    text.split(' ').map(bare).collect::<Vec<_>>().join(" ")
}

fn title(run: &Run) -> String {
    run.input().file_name().map_or_else(|| "input".into(), |name| name.to_string_lossy().into_owned())
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let tracked = run.workspace.read_tracked()?;
    let background = run.workspace.read_background()?;
    let reports = objects::reports(run)?;
    let object_models = object_models(&reports, |id| run.workspace.read_object(id))?;
    let trajectories = run.workspace.read_trajectories()?;
    let ground = run.workspace.read_ground()?;
    let failures = scale::results(run)?.failures;
    let evaluation = evaluation(run)?;
    let data = Data {
        metric: trajectories.metric.as_ref(),
        ground: Some(&ground),
        objects: objects(&tracked, &reports, &object_models, &trajectories, &failures, |id, model| {
            ratio_per_frame(run, &background, model, &ground, id)
        }),
        evaluation: evaluation.as_ref(),
        parts: parts(run, &reports, Some(&trajectories)),
        is_sfm: false,
        ..models(run, &background, &tracked)?
    };
    outcome.outputs.push(run.workspace.report());
    put_page(run, &data)
}

/// The objects that have a model.
fn with_model(reports: &BTreeMap<ObjectId, ModelReport>) -> impl Iterator<Item = ObjectId> {
    reports.iter().filter(|(_, report)| report.failure.is_none()).map(|(id, _)| *id)
}

fn object_models(
    reports: &BTreeMap<ObjectId, ModelReport>,
    read: impl Fn(ObjectId) -> Result<Reconstruction, IoError>,
) -> Result<BTreeMap<ObjectId, Reconstruction>> {
    with_model(reports).map(|id| Ok((id, read(id)?))).collect()
}

fn objects<'a>(
    tracked: &'a [TrackedObject],
    reports: &BTreeMap<ObjectId, ModelReport>,
    models: &'a BTreeMap<ObjectId, Reconstruction>,
    trajectories: &'a Trajectories,
    failures: &BTreeMap<ObjectId, String>,
    ratios: impl Fn(ObjectId, &Reconstruction) -> Vec<(FrameId, f64)>,
) -> Vec<Object<'a>> {
    let object = |tracked: &'a TrackedObject| {
        let report = reports.get(&tracked.id);
        let unregistered = report.map(|report| report.unregistered.clone()).unwrap_or_default();
        let failure = report.and_then(|report| report.failure.clone());
        let trajectory = trajectories.objects.iter().find(|trajectory| trajectory.id == tracked.id);
        Object {
            id: tracked.id,
            // A vehicle's size may have corrected its class.
            class: trajectories.class_of(tracked.id).unwrap_or(&tracked.class).to_owned(),
            confidence: tracked.confidence,
            tracked: Some(tracked),
            visible: tracked.frames.clone(),
            model: models.get(&tracked.id).map(|reconstruction| Model { reconstruction, unregistered }),
            trajectory,
            ground_track: trajectories.ground_track(tracked.id),
            ratio_per_frame: models.get(&tracked.id).map(|model| ratios(tracked.id, model)).unwrap_or_default(),
            failure: failures.get(&tracked.id).cloned().or(failure),
        }
    };
    tracked.iter().map(object).collect()
}

/// Scale ratio of an object by its ground contact in each single frame; empty if there is none.
fn ratio_per_frame(
    run: &Run,
    background: &Reconstruction,
    model: &Reconstruction,
    ground: &Ground,
    id: ObjectId,
) -> Vec<(FrameId, f64)> {
    let views = Views::new(background, model, &scale::planes(ground, id), &run.options.scale);
    intersection(&views).map(|found| found.per_frame).unwrap_or_default()
}

/// Evaluation of this result, if there is one.
fn evaluation(run: &Run) -> Result<Option<Evaluation>> {
    let path = run.workspace.evaluation();
    Ok(if path.exists() { Some(json::read(&path)?) } else { None })
}

/// Files next to the page: those of a page of models come first.
fn parts(run: &Run, reports: &BTreeMap<ObjectId, ModelReport>, all: Option<&Trajectories>) -> Vec<Part> {
    let folder = &run.workspace;
    let part =
        |object, path: PathBuf, holds: &str| Part { object, path: link(folder.root(), &path), holds: holds.into() };
    let mut parts = vec![
        part(None, folder.background(), "cameras and points of the background, as a COLMAP model"),
        part(None, folder.background_points(), "background points, for viewing"),
        part(None, folder.run_json(), "options, cost and warnings of the run"),
    ];
    let model = "cameras and points, as a COLMAP model";
    let Some(trajectories) = all else {
        parts.extend(with_model(reports).map(|id| part(Some(id), folder.as_reconstructed(id), model)));
        return parts;
    };
    parts.extend([
        part(None, folder.trajectories(), "trajectories, frame by frame"),
        part(None, folder.ground(), "ground points, and the local ground plane of every vehicle and frame"),
        part(None, folder.tracks(), "vehicle masks"),
    ]);
    if folder.evaluation().exists() {
        parts.push(part(None, folder.evaluation(), "comparison with the ground truth"));
    }
    parts.extend(exported(&folder.exports()).into_iter().map(|(path, holds)| part(None, path, &holds)));
    for id in with_model(reports) {
        parts.push(part(Some(id), folder.object(id), model));
        parts.push(part(Some(id), folder.as_reconstructed(id), "the same before adjustment with the ground"));
    }
    let points = |id| part(Some(id), folder.object_points(id), "points along the trajectory, for viewing");
    parts.extend(trajectories.objects.iter().map(|trajectory| points(trajectory.id)));
    parts
}

/// Files of `tractrix export`, by name, with their size and the programs that open them.
fn exported(folder: &Path) -> Vec<(PathBuf, String)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<(PathBuf, String)> = entries
        .filter_map(|entry| {
            let opens = opened_by(&entry.file_name().to_string_lossy())?;
            let size = entry.metadata().ok().filter(std::fs::Metadata::is_file).map(|file| file.len());
            let said = size.map_or_else(String::new, |bytes| format!(" ({} kB)", bytes.div_ceil(1000)));
            Some((entry.path(), format!("exported: {opens}{said}")))
        })
        .collect();
    found.sort();
    found
}

/// Purpose of an export; `None` for an unknown name.
fn opened_by(name: &str) -> Option<&'static str> {
    if name == ExportFolder::COT {
        return Some("events of Cursor on Target, for TAK");
    }
    Some(match name.rsplit_once('.').map_or(name, |(_, extension)| extension) {
        "csv" => "table, for spreadsheets, pandas and R",
        "geojson" => "georeferenced positions, for QGIS and GDAL",
        "kml" => "georeferenced positions with times, for Google Earth",
        "gpx" => "camera path, for GPS programs",
        "json" => "trajectories with the keys of version 2, for older scripts",
        "glb" => "animated scene, for Blender and glTF viewers",
        "mp4" => "video with ids, speeds and paths, for any player",
        "tum" | "kitti" => "poses, for evo",
        "xml" => "floating car data, for SUMO",
        "levelx" => "tracks in the form of levelXData",
        "colmap" => "COLMAP workspace, for densification",
        _ => return None,
    })
}

/// The link from the page to a file or folder next to it.
fn link(root: &Path, path: &Path) -> String {
    let relative = path.strip_prefix(root).unwrap_or(path);
    let names: Vec<_> = relative.iter().map(|name| name.to_string_lossy()).collect();
    let end = if relative.extension().is_some() { "" } else { "/" };
    names.join("/") + end
}

fn missing(background: &ModelReport) -> Vec<Missing> {
    let what = "the background".to_owned();
    background.failure.iter().map(|reason| Missing { what: what.clone(), reason: reason.clone() }).collect()
}

/// Film, strip and portraits. They depend on input and masks alone and are kept, since the page is rewritten after an
/// evaluation or an export.
fn pictures(run: &Run, tracked: &[TrackedObject]) -> Result<Pictures> {
    let folder = run.folder(Stage::Track);
    let kept = folder.join("pictures.bin");
    if kept.is_file() {
        return intermediate::read(&kept);
    }
    let ids: Vec<_> = run.frames()?.iter().map(|frame| frame.id).collect();
    let film = folder.join("film.mp4");
    let mut maker = PictureMaker::new(&ids, &film);
    // A frame that cannot be decoded is skipped: the stage that needed it has reported it.
    for (frame, picture) in run.source.frames_at(maker.wanted())?.flatten() {
        let masks = track::masks_of(run, tracked, &frame)?;
        let masks: Vec<_> = masks.iter().map(|(id, mask)| (*id, mask)).collect();
        maker.push(frame.id, &picture, &masks)?;
    }
    let made = maker.finish()?;
    intermediate::write(&kept, &made)?;
    atomic::remove(&film)?;
    Ok(made)
}

fn stages(run: &Run) -> Vec<report::Stage> {
    let stage = |record: &crate::pipeline::StageRecord| report::Stage {
        name: record.stage.name().to_owned(),
        wall_s: record.marker.cost.wall_s,
        cpu_s: record.marker.cost.cpu_s,
        peak_rss_mib: record.marker.cost.peak_rss_mib,
        reused: record.reused,
    };
    run.records.iter().map(stage).collect()
}

fn input_facts(run: &Run, background: &Reconstruction) -> Result<Vec<Fact>> {
    let info = run.info();
    let kind = match info.kind {
        Kind::Video => "video file",
        Kind::Folder => "folder of images",
    };
    let mut facts = vec![
        Fact::new("Input", kind).with_note(format!("SHA-256 {}", run.content)),
        Fact::new("Frame size", format!("{} × {}", info.width, info.height)),
    ];
    let method = Method::of(run.options);
    if method != Method::Default {
        facts.push(Fact::new("Method", method.name()).with_note("published method without additions, docs/paper.md"));
    }
    if (info.source_width, info.source_height) != (info.width, info.height) {
        facts.push(Fact::new("Source size", format!("{} × {}", info.source_width, info.source_height)));
    }
    if (info.stored_width, info.stored_height) != (info.source_width, info.source_height) {
        let stored = format!("{} × {}", info.stored_width, info.stored_height);
        facts.push(Fact::new("Stored size", stored).with_note("pixels were not square"));
    }
    if let Some(fps) = info.fps {
        facts.push(Fact::new("Nominal rate", format!("{fps:.3} frames/s")));
    }
    if info.rotation_deg != 0 {
        facts.push(Fact::new("Rotation applied", format!("{}°", info.rotation_deg)));
    }
    let origin = match cameras::first(run)?.origin {
        CameraOrigin::Given if run.options.intrinsics_std.is_fixed() => "given",
        CameraOrigin::Given => "given, adjusted with the background",
        CameraOrigin::Exif => "from EXIF, refined with the background",
        CameraOrigin::Log => "from the log, refined with the background",
        CameraOrigin::Guess => "estimated with the background",
    };
    // Without a reconstructed background, only the camera is available at first.
    let found = background.cameras.values().next().filter(|_| !background.images.is_empty());
    if let Some(camera) = found {
        let focal = match background::focal_deviation(run)? {
            Some(share) => format!("{} px", with_std(camera.mean_focal(), share * camera.mean_focal())),
            None => format!("{:.1} px", camera.mean_focal()),
        };
        facts.push(Fact::new("Focal length", focal).with_note(origin));
    }
    if background.cameras.len() > 1 {
        facts.push(
            Fact::new("Cameras", background.cameras.len().to_string()).with_note("focal length of the first one"),
        );
    }
    Ok(facts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::FrontEndKind;

    #[test]
    fn options_of_run_json_are_read_back() {
        let mut options = Options { seed: 7, ..Options::default() };
        options.objects.front_end.kind = FrontEndKind::Sift;
        options.background.mapper.max_starts = 2;
        for options in [Options::default(), options] {
            let input = serde_json::json!({ "path": "clip.mp4" });
            let document =
                serde_json::json!({ "arguments": [], "input": input, "options": options.to_json(), "warnings": [] });
            let read: RunJson = serde_json::from_value(document).unwrap();
            let read = Options::default().with_tree(&serde_json::Value::Object(read.options)).unwrap();
            assert_eq!(read, options);
        }
    }

    #[test]
    fn the_page_has_no_folders_of_this_machine() {
        let text = without_folders("/opt/bin/tractrix run /home/me/a.mp4 --output out/a --masks=/home/me/masks/");
        assert_eq!(text, "tractrix run a.mp4 --output out/a --masks=masks");
        assert_eq!(without_folders("/home/me/a.mp4: 25 km/h [1/240]"), "a.mp4: 25 km/h [1/240]");
    }

    #[test]
    fn exports_say_what_opens_them() {
        let names =
            ["vehicles.csv", "trajectories.geojson", "trajectories.kml", "camera.gpx", "scene.glb", "annotated.mp4"];
        assert!(
            names
                .into_iter()
                .chain(["sumo-fcd.xml", "tum", "kitti", "levelx", "cot-events.xml", "colmap"])
                .all(|name| opened_by(name).is_some())
        );
        assert_eq!(opened_by("notes.txt"), None);
        assert!(exported(Path::new("folder not found")).is_empty());
    }
}
