//! What the charts and the frame bars show.

use std::collections::BTreeMap;

use super::{times, unit_word};
use crate::report::chart::{Bars, Chart, Drawing, FrameState, Level, Line, Tick, ticks};
use crate::report::data::{Data, Model, Object};
use crate::report::overlay::{css_colour, object_colour};
use crate::report::summary;
use crate::report::view::quantile;
use crate::scene::{Frame, FrameId, GroundPlane, Image, ObjectPose, Unit};

/// Objects with a line of their own in the charts and a row of frame bars.
const MAX_CHARTED: usize = 16;

/// The objects that charts show: those with the most poses, in the order of their ids.
fn charted<'d>(data: &'d Data, names: &'d [String]) -> Vec<(&'d Object<'d>, &'d String)> {
    let mut objects: Vec<_> = data.objects.iter().zip(names).collect();
    let weight = |o: &Object| (o.trajectory.map_or(0, |t| t.poses.len()), o.visible.len());
    objects.sort_by_key(|(o, _)| (std::cmp::Reverse(weight(o)), o.id));
    objects.truncate(MAX_CHARTED);
    objects.sort_by_key(|(o, _)| o.id);
    objects
}

pub(super) fn bars(data: &Data, names: &[String], times: &[f64]) -> Vec<Bars> {
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

pub(super) fn bar_ticks(times: &[f64]) -> Vec<Tick> {
    ticks((times[0], times[times.len() - 1])).0
}

pub(super) fn charts(data: &Data, names: &[String], notes: &mut Vec<String>) -> Vec<Drawing> {
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
        Some((frame.time_s, quantile(&mut heights, 0.5)))
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
