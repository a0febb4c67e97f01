//! From [`Data`] to the context of the template, and from there to text.

use std::collections::BTreeMap;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use minijinja::{AutoEscape, Environment, Value, context};
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::ReportError;
use super::chart::{Bars, Chart, Drawing, FrameState, Level, Line, Tick, significant, ticks};
use super::data::{Data, Fact, Missing, Model, Object};
use super::overlay::{object_colour, spread};
use super::plan::Plan;
use super::summary::{self, Verdict, count, figure, length, percent};
use super::view::{Scene, View, css_colour};
use crate::scene::{Frame, FrameId, GroundPlane, GroundSource, Image, ObjectPose, ScaleMethod, Unit};

const TEMPLATE: &str = include_str!("page/report.html");
const STYLE: &str = include_str!("page/style.css");
const SCRIPTS: [&str; 4] = [
    include_str!("page/errors.js"),
    include_str!("../../third_party/three/three.min.js"),
    include_str!("page/view3d.js"),
    include_str!("page/page.js"),
];
/// Bytes of JPEG in the strip; pictures are left out to keep to it.
const MAX_STRIP_BYTES: usize = 5 << 19;
/// Objects with a line of their own in the charts and a row of frame bars.
const MAX_CHARTED: usize = 16;

/// Fills the template.
pub(super) fn render(data: &Data) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.set_trim_blocks(true);
    environment.set_lstrip_blocks(true);
    environment.add_template("report", TEMPLATE)?;
    Ok(environment.get_template("report")?.render(page_context(data))?)
}

fn page_context(data: &Data) -> Value {
    let names: Vec<String> = data.objects.iter().map(summary::name).collect();
    let view = View::new(data);
    let unit = unit_word(data.unit);
    let scene = view.as_ref().map(|v| Scene::new(data, v, &names));
    let mut notes = scene.as_ref().map(|s| s.omissions(data.frames.len())).unwrap_or_default();
    let strip = strip(data, &mut notes);
    let charts = charts(data, &names, &mut notes);
    let cards: Vec<_> = data.objects.iter().zip(&names).map(|(o, n)| card(data, o, n, view.as_ref(), unit)).collect();
    let times = times(data);
    context! {
        title => &data.title,
        sentence => summary::sentence(data),
        version => &data.version,
        arguments => data.arguments.join(" "),
        input => &data.input,
        figures => key_figures(data),
        warnings => &data.warnings,
        missing => missing(data, &names),
        cards,
        plan => view.as_ref().map(|v| Plan::scene(data, v, unit)),
        scene => scene.as_ref().map(json),
        up_source => view.as_ref().map(|v| v.up_source),
        strip,
        bars => bars(data, &names, &times),
        bar_ticks => bar_ticks(&times),
        span => [times.first(), times.last()],
        readings => json(&charts),
        charts,
        stages => stages(data),
        evaluation => &data.evaluation,
        notes,
        style => Value::from_safe_string(STYLE.to_owned()),
        scripts => SCRIPTS.map(|s| Value::from_safe_string(s.to_owned())).to_vec(),
        policy => policy(),
    }
}

/// What the page may do: run our own scripts, show pictures that it holds itself, and nothing else.
fn policy() -> String {
    let hashes = SCRIPTS.map(|s| format!("'sha256-{}'", STANDARD.encode(Sha256::digest(s.as_bytes()))));
    format!("default-src 'none'; script-src {}; style-src 'unsafe-inline'; img-src data: blob:", hashes.join(" "))
}

/// JSON for a script element: without `<`, which could end it.
fn json(value: &impl Serialize) -> Value {
    let text = serde_json::to_string(value).expect("numbers, strings and lists always serialise");
    Value::from_safe_string(text.replace('<', "\\u003c"))
}

fn unit_word(unit: Unit) -> &'static str {
    match unit {
        Unit::Metre => "m",
        Unit::Background => "units",
    }
}

/// Times of the frames and the end of the last one, each above the one before.
fn times(data: &Data) -> Vec<f64> {
    let mut times: Vec<f64> = Vec::with_capacity(data.frames.len() + 1);
    for frame in data.frames {
        let last = times.last().copied().unwrap_or(f64::NEG_INFINITY);
        let usable = frame.time_s.is_finite() && frame.time_s > last;
        times.push(if usable {
            frame.time_s
        } else if last.is_finite() {
            last + 1e-3
        } else {
            0.0
        });
    }
    let first = times.first().copied().unwrap_or(0.0);
    let last = times.last().copied().unwrap_or(0.0);
    let step = if times.len() > 1 { (last - first) / (times.len() - 1) as f64 } else { 1.0 };
    times.push(last + step);
    times
}

fn key_figures(data: &Data) -> Vec<Fact> {
    let background = data.background.reconstruction;
    let times = times(data);
    let mut facts = vec![
        Fact::new("video", format!("{:.1} s", times[times.len() - 1] - times[0]))
            .with_note(count(data.frames.len(), "frame")),
        Fact::new("camera known", share(background.images.len(), data.frames.len())).with_note(format!(
            "{} of {}",
            background.images.len(),
            count(data.frames.len(), "frame")
        )),
        Fact::new("vehicles", data.objects.iter().filter(|o| o.trajectory.is_some()).count().to_string())
            .with_note(format!("with a trajectory, of {} seen", data.objects.len())),
        Fact::new("points", thousands(background.points.len())).with_note("in the background"),
    ];
    if let Some(error) = background.mean_reprojection_error_px() {
        facts.push(Fact::new("reprojection error", format!("{error:.2} px")).with_note("mean over the background"));
    }
    let source = data.ground.map(|g| match g.source {
        GroundSource::Masks => ("masks", "given ground labels"),
        GroundSource::Model => ("segmentation", "ground labels from a network"),
        GroundSource::Geometric => ("geometric", "ground guessed: the dominant plane"),
    });
    facts.push(match source {
        Some((value, note)) => Fact::new("ground", value).with_note(note),
        None => Fact::new("ground", "none").with_note("no ground was found"),
    });
    facts.push(match data.unit {
        Unit::Metre => Fact::new("unit", "metre").with_note("the scale is metric"),
        Unit::Background => Fact::new("unit", "arbitrary").with_note("the scale of the scene is not known"),
    });
    facts
}

fn share(part: usize, whole: usize) -> String {
    if whole == 0 { "–".to_owned() } else { format!("{:.0} %", percentage(part, whole)) }
}

/// Rounded, but 100 only for all and 0 only for none.
fn percentage(part: usize, whole: usize) -> f64 {
    let exact = part as f64 / whole as f64 * 100.0;
    if part == whole || part == 0 { exact } else { exact.round().clamp(1.0, 99.0) }
}

/// 12 345 with thin spaces.
fn thousands(n: usize) -> String {
    let digits = n.to_string();
    let groups: Vec<_> = digits.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy).collect();
    groups.join("\u{202f}")
}

/// Everything that is not there, with the reason.
fn missing(data: &Data, names: &[String]) -> Vec<Missing> {
    let mut list = data.missing.clone();
    for (object, name) in data.objects.iter().zip(names).filter(|(o, _)| o.trajectory.is_none()) {
        let reason = object.failure.clone().unwrap_or_else(|| "no reason was recorded".to_owned());
        let what = format!("{name}, seen in {}: no trajectory", count(object.visible.len(), "frame"));
        list.push(Missing { what, reason });
    }
    list.extend(unregistered("Background", &data.background));
    for (object, name) in data.objects.iter().zip(names) {
        list.extend(object.model.iter().flat_map(|m| unregistered(name, m)));
    }
    list
}

/// The unregistered frames of a model, gathered by reason.
fn unregistered(name: &str, model: &Model) -> Vec<Missing> {
    let mut by_reason: BTreeMap<&str, Vec<u32>> = BTreeMap::new();
    for (frame, reason) in &model.unregistered {
        by_reason.entry(reason).or_default().push(frame.0);
    }
    let entry = |(reason, frames): (&str, Vec<u32>)| {
        let what = format!("{name}: {} not registered ({})", count(frames.len(), "frame"), ranges(&frames));
        Missing { what, reason: reason.to_owned() }
    };
    by_reason.into_iter().map(entry).collect()
}

/// "3–7, 9" of ascending numbers; the middle of a long list is left out.
fn ranges(numbers: &[u32]) -> String {
    let runs: Vec<String> = numbers
        .chunk_by(|a, b| a.checked_add(1) == Some(*b))
        .map(|run| match run {
            [one] => one.to_string(),
            [first, .., last] => format!("{first}–{last}"),
            [] => String::new(),
        })
        .collect();
    if runs.len() > 8 {
        return format!("{}, …, {}", runs[..5].join(", "), runs[runs.len() - 1]);
    }
    runs.join(", ")
}

/// A vehicle's card.
#[derive(Debug, Serialize)]
struct Card {
    id: u32,
    name: String,
    colour: String,
    verdict: Verdict,
    badge: &'static str,
    /// Why the scale is degenerate, or why there is no trajectory.
    reason: Option<String>,
    facts: Vec<Fact>,
    alternatives: Vec<Alternative>,
    plan: Option<Plan>,
}

/// What another method says of the scale ratio.
#[derive(Debug, Serialize)]
struct Alternative {
    method: String,
    ratio: String,
    deviation: String,
    chosen: bool,
}

fn card(data: &Data, object: &Object, name: &str, view: Option<&View>, unit: &str) -> Card {
    let verdict = Verdict::of(object);
    let scale = object.trajectory.map(|t| &t.scale);
    let reason = match scale {
        Some(scale) if scale.degenerate => scale.reason.clone().or(Some("no reason was recorded".to_owned())),
        Some(_) => None,
        None => object.failure.clone(),
    };
    Card {
        id: object.id.0,
        name: name.to_owned(),
        colour: css_colour(object_colour(object.id)),
        verdict,
        badge: verdict.label(),
        reason,
        facts: facts(data, object),
        alternatives: alternatives(object),
        plan: view.and_then(|v| Plan::object(object, v, unit)),
    }
}

fn facts(data: &Data, object: &Object) -> Vec<Fact> {
    let registered = object.model.as_ref().map_or(0, |m| m.reconstruction.images.len());
    let placed = object.trajectory.map_or(0, |t| t.poses.len());
    let mut facts = vec![
        Fact::new("detection confidence", percent_whole(object.confidence)),
        Fact::new("frames placed / visible", format!("{placed} / {}", object.visible.len()))
            .with_note(format!("{registered} registered on the vehicle")),
    ];
    if let Some(model) = &object.model {
        let points = thousands(model.reconstruction.points.len());
        let error = model.reconstruction.mean_reprojection_error_px();
        let fact = Fact::new("points", points);
        facts.push(match error {
            Some(e) => fact.with_note(format!("{e:.2} px reprojection error")),
            None => fact,
        });
    }
    let Some(trajectory) = object.trajectory else { return facts };
    let scale = &trajectory.scale;
    let ratio = match (scale.std, summary::relative_std(scale)) {
        (Some(std), Some(relative)) => {
            format!("{} ± {} ({})", figure(scale.ratio, 4), figure(std, 2), percent(relative))
        }
        _ => figure(scale.ratio, 4),
    };
    facts.push(Fact::new("scale ratio r", ratio).with_note(scale.method.name()));
    facts.push(
        Fact::new("path length", length(summary::path_length(trajectory), data.unit)).with_note(duration(object)),
    );
    let mut speeds: Vec<f64> = summary::speeds(trajectory).into_iter().map(|(_, v)| v).collect();
    if data.unit == Unit::Metre && !speeds.is_empty() {
        let median = super::view::quantile(&mut speeds, 0.5);
        let top = super::view::quantile(&mut speeds, 0.95);
        let kmh = |v: f64| format!("{} km/h", figure(v * 3.6, 3));
        facts.push(
            Fact::new("speed, median", format!("{} m/s = {}", figure(median, 3), kmh(median)))
                .with_note(format!("95 % of the time below {}", kmh(top))),
        );
    }
    facts
}

fn percent_whole(fraction: f64) -> String {
    if fraction.is_finite() { format!("{:.0} %", fraction * 100.0) } else { "–".to_owned() }
}

fn duration(object: &Object) -> String {
    let poses = object.trajectory.map_or(&[][..], |t| &t.poses);
    match (poses.first(), poses.last()) {
        (Some(a), Some(b)) => format!("{:.2} s to {:.2} s", a.time_s, b.time_s),
        _ => "no frame".to_owned(),
    }
}

/// What every method says, if more than one does.
fn alternatives(object: &Object) -> Vec<Alternative> {
    let Some(trajectory) = object.trajectory else { return Vec::new() };
    let scale = &trajectory.scale;
    if scale.alternatives.keys().all(|method| *method == scale.method) {
        return Vec::new();
    }
    let entry = |(method, ratio): (&ScaleMethod, &f64)| {
        let difference = ratio / scale.ratio - 1.0;
        let sign = if difference < 0.0 { "−" } else { "+" };
        Alternative {
            method: method.name().to_owned(),
            ratio: figure(*ratio, 4),
            deviation: format!("{sign}{}", percent(difference.abs())),
            chosen: *method == scale.method,
        }
    };
    scale.alternatives.iter().map(entry).collect()
}

/// A picture of the strip.
#[derive(Debug, Serialize)]
struct Picture {
    frame: u32,
    time: f64,
    clock: String,
    name: String,
    width: u32,
    height: u32,
    jpeg: String,
    labels: Vec<PictureLabel>,
}

#[derive(Debug, Serialize)]
struct PictureLabel {
    id: u32,
    colour: String,
    left: f64,
    top: f64,
}

fn strip(data: &Data, notes: &mut Vec<String>) -> Vec<Picture> {
    let total: usize = data.strip.iter().map(|t| t.jpeg.len()).sum();
    let limit = if total > MAX_STRIP_BYTES { data.strip.len() * MAX_STRIP_BYTES / total } else { data.strip.len() };
    let chosen = spread(data.strip.len(), limit.max(1));
    if chosen.len() < data.frames.len() && !chosen.is_empty() {
        notes.push(format!("The frame strip shows {} of {} frames, evenly spread.", chosen.len(), data.frames.len()));
    }
    let picture = |i: usize| {
        let thumbnail = &data.strip[i];
        let frame = data.frames.iter().find(|f| f.id == thumbnail.frame);
        let time = frame.map_or(0.0, |f| f.time_s);
        let label = |l: &super::Label| PictureLabel {
            id: l.object.0,
            colour: css_colour(object_colour(l.object)),
            left: (l.x * 1000.0).round() / 10.0,
            top: (l.y * 1000.0).round() / 10.0,
        };
        Picture {
            frame: thumbnail.frame.0,
            time,
            clock: format!("{time:.2} s"),
            name: frame.map_or_else(String::new, |f| f.name.clone()),
            width: thumbnail.width,
            height: thumbnail.height,
            jpeg: STANDARD.encode(&thumbnail.jpeg),
            labels: thumbnail.labels.iter().map(label).collect(),
        }
    };
    chosen.into_iter().map(picture).collect()
}

/// The objects that charts show: those with the most poses, in the order of their ids.
fn charted<'d>(data: &'d Data, names: &'d [String]) -> Vec<(&'d Object<'d>, &'d String)> {
    let mut objects: Vec<_> = data.objects.iter().zip(names).collect();
    let weight = |o: &Object| (o.trajectory.map_or(0, |t| t.poses.len()), o.visible.len());
    objects.sort_by_key(|(o, _)| (std::cmp::Reverse(weight(o)), o.id));
    objects.truncate(MAX_CHARTED);
    objects.sort_by_key(|(o, _)| o.id);
    objects
}

fn bars(data: &Data, names: &[String], times: &[f64]) -> Vec<Bars> {
    if data.frames.is_empty() {
        return Vec::new();
    }
    let states = |visible: &dyn Fn(FrameId) -> bool, model: Option<&Model>| -> Vec<FrameState> {
        let images = model.map_or_else(|| vec![None; data.frames.len()], |m| m.images(data.frames));
        let state = |frame: &Frame, image: Option<&Image>| match (image, visible(frame.id)) {
            (Some(_), _) => FrameState::Registered,
            (None, true) => FrameState::Missing,
            (None, false) => FrameState::Absent,
        };
        data.frames.iter().zip(images).map(|(f, i)| state(f, i)).collect()
    };
    let background = states(&|_| true, Some(&data.background));
    let mut rows = vec![Bars::new("Background".into(), "var(--camera)".into(), &background, times)];
    for (object, name) in charted(data, names) {
        let states = states(&|f| object.visible.binary_search(&f).is_ok(), object.model.as_ref());
        rows.push(Bars::new(name.clone(), css_colour(object_colour(object.id)), &states, times));
    }
    rows
}

fn bar_ticks(times: &[f64]) -> Vec<Tick> {
    ticks((times[0], times[times.len() - 1])).0
}

fn charts(data: &Data, names: &[String], notes: &mut Vec<String>) -> Vec<Drawing> {
    let times = times(data);
    let span = (times[0], times[times.len() - 1]);
    let objects = charted(data, names);
    if objects.len() < data.objects.len() {
        notes.push(format!(
            "The charts show {} of {} vehicles: those seen longest.",
            objects.len(),
            data.objects.len()
        ));
    }
    let unit = unit_word(data.unit);
    [
        camera_height(data, unit),
        object_heights(data, &objects, unit),
        speeds(data, &objects),
        ratios(&objects),
        reprojection(data, &objects),
    ]
    .iter()
    .filter_map(|chart| chart.draw(span))
    .collect()
}

fn object_line(object: &Object, name: &str, points: Vec<(f64, f64)>, dots: bool) -> Line {
    Line { label: name.to_owned(), colour: css_colour(object_colour(object.id)), points, dots }
}

/// Height of the camera over the local planes: their median, where several objects have one.
fn camera_height(data: &Data, unit: &str) -> Chart {
    let mut planes: BTreeMap<FrameId, Vec<&GroundPlane>> = BTreeMap::new();
    for ((_, frame), plane) in data.ground.iter().flat_map(|g| &g.planes) {
        planes.entry(*frame).or_default().push(plane);
    }
    let height = |(frame, image): (&Frame, Option<&Image>)| {
        let center = image?.cam_from_world.center();
        let mut heights: Vec<f64> = planes.get(&frame.id)?.iter().map(|p| p.signed_distance(center)).collect();
        Some((frame.time_s, super::view::quantile(&mut heights, 0.5)))
    };
    let points = data.frames.iter().zip(data.background.images(data.frames)).filter_map(height).collect();
    Chart {
        title: "Height of the camera over the ground".into(),
        caption:
            "Distance from the camera to the local ground plane beside the vehicles. The method lives on its change: \
                  at constant height the scale of a vehicle is hard to see."
                .into(),
        unit: unit.into(),
        lines: vec![Line { label: "Camera".into(), colour: "var(--camera)".into(), points, dots: false }],
        levels: Vec::new(),
        from_zero: false,
    }
}

fn object_heights(data: &Data, objects: &[(&Object, &String)], unit: &str) -> Chart {
    let line = |(object, name): &(&Object, &String)| {
        let height = |pose: &ObjectPose| {
            let plane = data.ground?.planes.get(&(object.id, pose.frame))?;
            Some((pose.time_s, plane.signed_distance(pose.position.into())))
        };
        let points = object.trajectory.iter().flat_map(|t| &t.poses).filter_map(height).collect();
        object_line(object, name, points, false)
    };
    Chart {
        title: "Height of the vehicles over the ground".into(),
        caption:
            "From each vehicle's centre to its local ground plane. A vehicle keeps its height, so a level line speaks \
                  for the scale ratio; a slope or a step speaks against it."
                .into(),
        unit: unit.into(),
        lines: objects.iter().map(line).collect(),
        levels: Vec::new(),
        from_zero: false,
    }
}

fn speeds(data: &Data, objects: &[(&Object, &String)]) -> Chart {
    let metric = data.unit == Unit::Metre;
    let factor = if metric { 3.6 } else { 1.0 };
    let line = |(object, name): &(&Object, &String)| {
        let speeds = object.trajectory.map(summary::speeds).unwrap_or_default();
        object_line(object, name, speeds.into_iter().map(|(t, v)| (t, v * factor)).collect(), false)
    };
    let relative =
        "The scale of the scene is not known, so only the shape of the curve tells something, not its numbers.";
    let caption = "Along the trajectory, from frame to frame, not smoothed.";
    Chart {
        title: "Speed".into(),
        caption: if metric { caption.into() } else { format!("{caption} {relative}") },
        unit: if metric { "km/h".into() } else { "units/s".into() },
        lines: objects.iter().map(line).collect(),
        levels: Vec::new(),
        from_zero: true,
    }
}

fn ratios(objects: &[(&Object, &String)]) -> Chart {
    let with_ratios: Vec<_> = objects.iter().filter(|(o, _)| !o.ratio_per_frame.is_empty()).collect();
    let line = |(object, name): &&(&Object, &String)| {
        let time = |frame: FrameId| {
            let poses = &object.trajectory?.poses;
            poses.iter().find(|p| p.frame == frame).map(|p| p.time_s)
        };
        let points = object.ratio_per_frame.iter().filter_map(|&(f, r)| Some((time(f)?, r))).collect();
        object_line(object, name, points, true)
    };
    let level = |(object, _): &&(&Object, &String)| {
        let scale = &object.trajectory?.scale;
        Some(Level { value: scale.ratio, std: scale.std, colour: css_colour(object_colour(object.id)) })
    };
    Chart {
        title: "Scale ratio per frame".into(),
        caption:
            "Dots: what the contact of the vehicle with the ground says in each frame alone (intersection). Line: the \
                  ratio in use, with a band of one standard deviation where it is known."
                .into(),
        unit: "r".into(),
        lines: with_ratios.iter().map(line).collect(),
        levels: with_ratios.iter().filter_map(level).collect(),
        from_zero: false,
    }
}

fn reprojection(data: &Data, objects: &[(&Object, &String)]) -> Chart {
    let errors = |model: &Model| -> Vec<(f64, f64)> {
        let error = |(frame, image): (&Frame, Option<&Image>)| {
            Some((frame.time_s, summary::reprojection_error(model.reconstruction, image?)?))
        };
        data.frames.iter().zip(model.images(data.frames)).filter_map(error).collect()
    };
    let background = Line {
        label: "Background".into(),
        colour: "var(--camera)".into(),
        points: errors(&data.background),
        dots: false,
    };
    let line = |(object, name): &(&Object, &String)| {
        let points = object.model.as_ref().map(&errors).unwrap_or_default();
        object_line(object, name, points, false)
    };
    Chart {
        title: "Reprojection error".into(),
        caption: "Mean distance between where points are seen and where the reconstruction puts them, per frame."
            .into(),
        unit: "px".into(),
        lines: std::iter::once(background).chain(objects.iter().map(line)).collect(),
        levels: Vec::new(),
        from_zero: true,
    }
}

/// A row of the table of stages.
#[derive(Debug, Serialize)]
struct StageRow {
    name: String,
    wall: String,
    cpu: String,
    memory: String,
    /// CPU time as a percentage of the longest stage.
    share: f64,
    reused: bool,
}

fn stages(data: &Data) -> Value {
    let longest = data.stages.iter().map(|s| s.cpu_s).fold(0.0, f64::max).max(1e-9);
    let seconds = |s: f64| if s < 100.0 { format!("{s:.1}") } else { format!("{s:.0}") };
    let row = |s: &super::Stage| StageRow {
        name: s.name.clone(),
        wall: seconds(s.wall_s),
        cpu: seconds(s.cpu_s),
        memory: format!("{:.0}", s.peak_rss_mib),
        share: significant(s.cpu_s / longest * 100.0, 3),
        reused: s.reused,
    };
    let sum = |of: fn(&super::Stage) -> f64| seconds(data.stages.iter().map(of).sum());
    let peak = data.stages.iter().map(|s| s.peak_rss_mib).fold(0.0, f64::max);
    context! {
        rows => data.stages.iter().map(row).collect::<Vec<_>>(),
        wall => sum(|s| s.wall_s),
        cpu => sum(|s| s.cpu_s),
        memory => format!("{peak:.0}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn the_page_is_self_contained() {
        let world = testing::world();
        let page = render(&world.data()).unwrap();
        for mark in ["src=\"http", "href=\"http", "src='http", "@import url(http"] {
            assert!(!page.contains(mark), "{mark}");
        }
        assert_eq!(page.matches("<script").count(), page.matches("</script>").count());
        for script in SCRIPTS {
            assert!(!script.contains("</script") && !script.contains("<!--"));
        }
    }

    #[test]
    fn hostile_names_are_escaped() {
        let mut world = testing::world();
        let evil = "</script><img src=x onerror=alert(1)>\"'";
        world.title = evil.into();
        world.class = evil.into();
        world.frames[0].name = evil.into();
        world.warnings = vec![evil.into()];
        let page = render(&world.data()).unwrap();
        assert!(!page.contains("<img src=x"), "escaped wherever it stands");
        assert!(page.contains("&lt;img src=x"));
    }

    #[test]
    fn a_run_that_found_nothing_has_a_page_too() {
        let empty = crate::scene::Reconstruction::default();
        let data = testing::nothing(&empty);
        let page = render(&data).unwrap();
        assert!(page.contains("Nothing could be reconstructed"));
    }

    #[test]
    fn the_strip_keeps_to_its_budget() {
        let mut world = testing::world();
        let heavy = super::super::Thumbnail {
            frame: FrameId(0),
            width: 4,
            height: 3,
            jpeg: vec![7; 1 << 20],
            labels: Vec::new(),
        };
        world.strip = vec![heavy; 20];
        let mut notes = Vec::new();
        assert_eq!(strip(&world.data(), &mut notes).len(), 2);
        assert_eq!(notes.len(), 1);
    }

    #[test]
    fn frames_are_written_as_ranges() {
        assert_eq!(ranges(&[1, 2, 3, 7, 9, 10]), "1–3, 7, 9–10");
        assert_eq!(ranges(&[]), "");
        let every_other: Vec<_> = (0..40).step_by(2).collect();
        assert_eq!(ranges(&every_other), "0, 2, 4, 6, 8, …, 38");
        assert_eq!(ranges(&[u32::MAX]), u32::MAX.to_string());
    }

    #[test]
    fn the_vendored_script_is_the_one_its_readme_names() {
        let hash: String = Sha256::digest(SCRIPTS[1]).iter().map(|b| format!("{b:02x}")).collect();
        assert!(include_str!("../../third_party/three/README.md").contains(&hash));
    }

    #[test]
    fn numbers_are_grouped() {
        assert_eq!(thousands(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(thousands(12), "12");
    }
}
