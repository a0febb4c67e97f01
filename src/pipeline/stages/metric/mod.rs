//! Stage `metric`: metres per unit from all sources, and the trajectories in metres and on the map.
//!
//! The stage `scale` stores the trajectories in units of the background. This stage rewrites `trajectories.json` with
//! the same trajectories and their metric values. Without a source of metres it reports the reason, and all other
//! values are unchanged.

mod aligned;
mod dates;
mod ground_tracks;
mod placed;
mod sources;
mod vehicles;

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde_json::{Value, json};

use super::scale::{self, ScaleResults};
use crate::math::median;
use crate::math::rounding::{figure, percent, significant};
use crate::metric::{Fused, Source, frame_on_ground, frame_on_map, fuse};
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::{alignment, attitude, hovering, telemetry as log};
use crate::pipeline::{MetricOptions, Options, Result, TelemetryChoice};
use crate::scene::{
    Dates, FrameId, GroundTrack, Metric, MetricFrame, MetricVerdict, ObjectId, ObjectTrajectory, Reconstruction, Topic,
    Trajectories, sources_in_words,
};
use crate::trajectory::BodyOnGround;
pub use dates::of_log as dates_of_log;
use placed::Placing;
use sources::Ground;
pub(in crate::pipeline) use vehicles::Size;

/// Inputs of this stage alone: the metric options, and the content of telemetry files.
pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let MetricOptions { telemetry, time_offset, utc_offset, camera_height, map_points, scale, known_lengths, .. } =
        &run.options.metric;
    let is_looked_for = *telemetry != TelemetryChoice::None;
    Ok(json!({
        "telemetry": { "is_looked_for": is_looked_for, "files": log::fingerprints(run) },
        "time_offset": time_offset,
        "utc_offset": utc_offset,
        "camera_height": camera_height,
        "map_points": map_points.as_deref().and_then(|path| fingerprint::of_content(path).ok()),
        "scale": scale,
        "known_lengths": known_lengths,
    }))
}

/// Reads the given telemetry, to report errors in it before any work.
///
/// # Errors
/// [`TelemetryError`](crate::telemetry::TelemetryError) names the file and the remedy.
pub(in crate::pipeline) fn check(options: &Options) -> Result<()> {
    hovering::check_map_points(&options.metric)?;
    match &options.metric.telemetry {
        TelemetryChoice::File(path) => Ok(log::telemetry_of(path, options.memory()).map(drop)?),
        TelemetryChoice::Auto | TelemetryChoice::None => Ok(()),
    }
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let background = run.workspace.read_background()?;
    let trajectories = scale::in_units(run)?;
    let ScaleResults { sizes, bodies, pose_covariances, .. } = scale::results(run)?;
    let (found, known) = match background.is_empty() {
        true => unknown("no background", None),
        false => find(run, &background, &trajectories, &sizes, &bodies, outcome)?,
    };
    describe(&found, outcome);
    let Trajectories { unit, mut objects, mut ground_tracks, .. } = trajectories;
    vehicles::correct_classes(&mut objects, &sizes, known);
    vehicles::doubt_sizes(&mut objects, &sizes, known, outcome);
    ground_tracks = scale::ground_tracks::decided(ground_tracks, &objects);
    vehicles::correct_classes_on_ground(&mut ground_tracks, &mut objects, &bodies, known, &background);
    let is_placed = !objects.is_empty() || !ground_tracks.is_empty();
    let nominal = match found.frame {
        None if is_placed => Some(nominal_frame(&Ground::of(run, &background)?, &background, &objects, &ground_tracks)),
        _ => None,
    };
    if let Some(frame) = found.frame.as_ref().or(nominal.as_ref()) {
        let movements =
            run.workspace.read_tracked()?.into_iter().map(|object| (object.id, object.movement.state)).collect();
        let (frame, times) = ((frame, nominal.is_some()), run.info().time_base());
        let placing = Placing::new(&background, frame, &pose_covariances, times, movements);
        for trajectory in &mut objects {
            placing.fill(trajectory);
            let size = sizes.get(&trajectory.id).filter(|_| !placing.is_nominal);
            trajectory.dimensions = size.map(|size| vehicles::in_metres(size, placing.frame));
        }
        ground_tracks = ground_tracks::fill(&placing, ground_tracks, &bodies, outcome);
    }
    outcome.figure("num_ground_tracks", ground_tracks.len());
    let all = Trajectories { unit, metric: Some(found), objects, ground_tracks };
    // Earlier exports contain the previous metric values.
    run.workspace.remove(&run.workspace.exports())?;
    let path = run.workspace.trajectories();
    run.workspace.put_file(&path, |fresh| crate::io::trajectories::write(fresh, &all))?;
    outcome.outputs.push(path);
    Ok(())
}

/// Metric result, and the logarithm of meters per unit without typical vehicle sizes with its standard deviation.
type MetricResult = (Metric, Option<(f64, f64)>);

fn unknown(reason: &str, dates: Option<Dates>) -> MetricResult {
    (Metric { reason: Some(reason.to_owned()), dates, ..Metric::default() }, None)
}

fn find(
    run: &Run,
    background: &Reconstruction,
    trajectories: &Trajectories,
    sizes: &BTreeMap<ObjectId, Size>,
    bodies: &BTreeMap<ObjectId, BodyOnGround>,
    outcome: &mut Outcome,
) -> Result<MetricResult> {
    let mut ground = Ground::of(run, background)?;
    let telemetry = log::find(run, outcome);
    if let Some(telemetry) = &telemetry {
        let vertical = attitude::vertical(run, &alignment::registered(background, run.frames()?), telemetry, outcome);
        ground.take_vertical(vertical, outcome);
    }
    let (aligned, height) = match background.points.is_empty() {
        true => aligned::hovering(run, background, &ground, telemetry.as_ref(), outcome)?,
        false => {
            if run.options.metric.map_points.is_some() {
                let text = "--map-points ignored: the camera translates; give --telemetry";
                outcome.warn(Topic::MapPointsIgnored.warning(text));
            }
            let align = |telemetry| aligned::align(run, background, &ground, telemetry, outcome);
            (telemetry.as_ref().and_then(align), None)
        }
    };
    let dates = dates::find(run, telemetry.as_ref(), aligned.as_ref());
    let mut sources: Vec<Source> = aligned.iter().filter_map(|aligned| aligned.source.clone()).chain(height).collect();
    sources.extend(sources::measured(run, &ground, outcome));
    let of_all = vehicles::sizes_of_all(trajectories, sizes, bodies, background);
    sources.extend(vehicles::known(run, &of_all, outcome));
    let known = fuse(&sources).map(|fused| (fused.scale.ln(), fused.std / fused.scale));
    // If the camera translates, vehicles without a usable trajectory are far, occluded or truncated.
    let typical_sizes = match background.points.is_empty() {
        true => vehicles::typical_sizes_on_ground(&trajectories.ground_tracks, bodies, background),
        false => vehicles::typical_sizes(trajectories, sizes),
    };
    typical_sizes.warn(outcome);
    sources.extend(vehicles::source_of(&typical_sizes));
    let Some(fused) = fuse(&sources) else {
        let reason = "no source of scale: no matching telemetry, no known length, no vehicle of a class with known \
                      sizes; give --telemetry FILE, --camera-height METERS, --known-length ID:length=METERS or --scale \
                      METERS";
        return Ok(unknown(reason, dates));
    };
    warn_of_contradictions(&fused, outcome);
    let frame = match &aligned {
        Some(aligned) => frame_on_map(&fused, &aligned.alignment, aligned.map.origin),
        None => frame_on_ground(&fused, &ground.level(background)),
    };
    let time_offset_s = aligned.as_ref().and_then(|aligned| aligned.clock_offset_s);
    let metric = Metric {
        verdict: fused.verdict,
        reason: Some(sentence(&fused, &frame)),
        frame: Some(frame),
        shares: fused.shares,
        contradictions: fused.contradictions.into_iter().chain(typical_sizes.contradictions()).collect(),
        time_offset_s,
        time_offset_std_s: time_offset_s.and(aligned.as_ref()).map(|aligned| aligned.alignment.offset_std_s),
        dates,
    };
    Ok((metric, known))
}

/// Assumed median distance from camera to vehicle of a result without metres: between a dashcam's 10 m and a drone's 50
/// m. Lengths in units hardly depend on it: it sets how sharply a vehicle may turn, within the decades over which the
/// smoother searches.
const NOMINAL_DISTANCE_M: f64 = 20.0;

/// A frame of nominal scale, in which trajectories are smoothed if metres are unknown.
fn nominal_frame(
    ground: &Ground,
    background: &Reconstruction,
    objects: &[ObjectTrajectory],
    ground_tracks: &[GroundTrack],
) -> MetricFrame {
    let distance = |(frame, position): (FrameId, [f64; 3])| {
        let center = background.images.get(&frame.into())?.cam_from_world.center();
        Some((Point3::from(position) - center).norm())
    };
    let poses = objects.iter().flat_map(|object| &object.poses).map(|pose| (pose.frame, pose.position));
    let contacts = ground_tracks.iter().filter(|_| objects.is_empty()).flat_map(|track| &track.positions);
    let contacts = contacts.map(|at| (at.frame, at.position));
    let distances: Vec<f64> =
        poses.chain(contacts).filter_map(distance).filter(|d| d.is_finite() && *d > 0.0).collect();
    let scale = median(distances).map_or(1.0, |distance| NOMINAL_DISTANCE_M / distance);
    frame_on_ground(&Fused::of_scale(scale, 0.0), &ground.level(background))
}

/// The sources of the metric scale, and its uncertainty.
fn sentence(fused: &Fused, frame: &MetricFrame) -> String {
    let basis = match (fused.verdict, &fused.shares[..]) {
        (MetricVerdict::PriorOnly, [_]) => "scale from typical vehicle sizes only (no measurement given)".to_owned(),
        (MetricVerdict::Unknown, _) => "scale unknown".to_owned(),
        (_, shares) => format!("scale from {}", sources_in_words(shares)),
    };
    let discord = if fused.contradictions.is_empty() { "" } else { "; sources contradict one another" };
    let std = percent(frame.log_scale_std());
    format!("{basis}: ±{std} (1σ), the same factor for every length and speed{discord}")
}

fn warn_of_contradictions(fused: &Fused, outcome: &mut Outcome) {
    for contradiction in &fused.contradictions {
        outcome.warn(Topic::SourcesContradict.warning(format!(
            "{} contradicts the other sources of scale: {} times their meters per unit ({} standard deviations); check \
             it",
            contradiction.source,
            figure(contradiction.ratio),
            significant(contradiction.deviations, 2)
        )));
    }
}

fn describe(metric: &Metric, outcome: &mut Outcome) {
    if let Some(reason) = &metric.reason {
        tracing::info!("{reason}");
        outcome.figure("reason", reason.as_str());
    }
    outcome.figure("verdict", metric.verdict.name());
    if let Some(frame) = &metric.frame {
        outcome.figure("scale", frame.scale);
        outcome.figure("scale_std", frame.std.scale);
        outcome.figure("shares", json!(metric.shares));
    }
}
