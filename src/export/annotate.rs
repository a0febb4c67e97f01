//! The video with the results drawn into it: masks, identities, speeds and trajectories on the ground.
//!
//! Every chosen frame of the input is decoded once, drawn into and encoded; none is kept. The path of a vehicle is the
//! line of its centers, projected to the ground along the normal of its local plane and into the frame's camera: thick
//! for the past, thin for the future.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::Path;

use nalgebra::{Point2, Point3};

use super::facts::raw_speed;
use super::results::FRAMES_PER_S;
use super::units::KM_H;
use super::write::Pictures;
use super::{ExportError, RegisteredFrame, Results};
use crate::ffi::ffmpeg::{Encoder, FfmpegError};
use crate::image::{Canvas, Plate, RgbImage};
use crate::io::{IoError, RunFolder, masks};
use crate::math::rounding::with_std;
use crate::report::{object_colour, overlay};
use crate::scene::{Frame, FrameId, GroundTrack, Mask, Motion, ObjectId, ObjectPose, ObjectTrajectory, TimeBase};

/// Line width of a vehicle's past path, as a share of the image's shorter side.
const LINE: f64 = 0.006;

/// Writes the annotated video.
///
/// # Errors
/// An input that is missing, does not match the results, or cannot be decoded at all; an encoder failure.
pub(super) fn write(path: &Path, results: &Results, pictures: &Pictures) -> Result<(), ExportError> {
    let annotator = Annotator::new(results);
    let encode = |source: FfmpegError| ExportError::Encode { path: path.to_owned(), source };
    let mut encoder: Option<Encoder> = None;
    let mut start_s = 0.0;
    for next in pictures.frames()? {
        // A frame that cannot be decoded was reported by the run; here it is skipped.
        let Ok((frame, picture)) = next else { continue };
        pictures.check_size(&picture, results)?;
        let masks = masks_of(pictures.folder, &frame, picture.dimensions())?;
        let drawn = annotator.draw(&picture, &frame, &masks)?;
        if encoder.is_none() {
            start_s = results.seconds(frame.time_s);
            let rate = pictures.rate().unwrap_or(FRAMES_PER_S);
            encoder = Some(Encoder::create(path, drawn.dimensions(), rate).map_err(encode)?);
        }
        if let Some(encoder) = &mut encoder {
            encoder.add(&drawn, results.seconds(frame.time_s) - start_s).map_err(encode)?;
        }
        (pictures.on_step)();
    }
    let encoder = encoder.ok_or_else(|| pictures.other("no frame can be decoded"))?;
    encoder.finish().map_err(encode)?;
    let synced = File::open(path).and_then(|file| file.sync_all());
    Ok(synced.map_err(IoError::system("synchronise", path))?)
}

/// The masks of one frame, ascending by id.
pub(super) fn masks_of(
    folder: &RunFolder,
    frame: &Frame,
    size: (u32, u32),
) -> Result<Vec<(ObjectId, Mask)>, ExportError> {
    let ids: BTreeSet<ObjectId> = RunFolder::ids_in(&folder.tracks());
    let paths = ids.into_iter().filter_map(|id| Some((id, folder.find_mask(id, &[&frame.name])?)));
    paths.map(|(id, path)| Ok((id, masks::read_mask(&path, size)?))).collect()
}

/// Draws the results into images.
struct Annotator<'a> {
    results: &'a Results,
    views: BTreeMap<&'a str, &'a RegisteredFrame>,
    /// The paths on the ground, in the background's frame.
    paths: BTreeMap<ObjectId, Vec<Point3<f64>>>,
}

impl<'a> Annotator<'a> {
    fn new(results: &'a Results) -> Self {
        let paths = results.trajectories.objects.iter().map(|object| (object.id, path_on_ground(results, object)));
        let views = results.views.iter().map(|view| (view.frame.name.as_str(), view)).collect();
        Self { results, views, paths: paths.collect() }
    }

    fn draw(&self, picture: &RgbImage, frame: &Frame, masks: &[(ObjectId, Mask)]) -> Result<RgbImage, ExportError> {
        let side = f64::from(picture.width().min(picture.height()));
        let mut canvas = Canvas::new(picture)?;
        // The ground track takes precedence over a rejected trajectory.
        for object in self.results.trajectories.objects.iter().filter(|object| self.is_shown(object)) {
            let Ok(now) = object.poses.binary_search_by_key(&frame.id, |pose| pose.frame) else { continue };
            self.draw_path(&mut canvas, (object.id, &self.paths[&object.id]), (frame, now), (side, 1))?;
        }
        for track in &self.results.trajectories.ground_tracks {
            if self.ground_track(track.id, frame.id).is_none() {
                continue;
            }
            let Ok(now) = track.positions.binary_search_by_key(&frame.id, |at| at.frame) else { continue };
            let path: Vec<_> = track.positions.iter().map(|at| Point3::from(at.position)).collect();
            self.draw_path(&mut canvas, (track.id, &path), (frame, now), (side, 2))?;
        }
        let mut ground = canvas.finish()?;
        put_in_front(&mut ground, picture, masks);
        let borrowed: Vec<_> = masks.iter().map(|(id, mask)| (*id, mask)).collect();
        let mut canvas = Canvas::new(&overlay(&ground, &borrowed))?;
        // Height of a capital letter, as a share of the image's shorter side.
        let capital_px = (0.021 * side).max(7.0);
        self.draw_labels(&mut canvas, frame, masks, capital_px)?;
        let lower_left = Point2::new(0.0, f64::from(picture.height()));
        let (time, capital_px) = (self.time(frame, masks), 0.8 * capital_px);
        let plate = canvas.plate(&time, lower_left, capital_px)?;
        canvas.words(&time, &plate, capital_px, [24, 24, 28])?;
        Ok(canvas.finish()?)
    }

    /// Draws a label above each mask, the lowest first; a label that would overlap another is moved above it.
    fn draw_labels(
        &self,
        canvas: &mut Canvas,
        frame: &Frame,
        masks: &[(ObjectId, Mask)],
        capital_px: f64,
    ) -> Result<(), ExportError> {
        let mut boxes: Vec<_> = masks.iter().filter_map(|(id, mask)| Some((*id, mask.bounding_box()?))).collect();
        boxes.sort_by_key(|(id, found)| (Reverse(found.y1), *id));
        let mut plates: Vec<Plate> = Vec::new();
        for (id, found) in boxes {
            let text = self.label(id, frame.id);
            let mut lower_left = Point2::new(f64::from(found.x0), f64::from(found.y0) - 0.3 * capital_px);
            let mut plate = canvas.plate(&text, lower_left, capital_px)?;
            // One attempt per plate: each moves the label up at most once.
            for _ in 0..plates.len() {
                let Some(other) = plates.iter().find(|other| plate.overlaps(other)) else { break };
                lower_left.y = other.top;
                plate = canvas.plate(&text, lower_left, capital_px)?;
            }
            canvas.words(&text, &plate, capital_px, object_colour(id))?;
            plates.push(plate);
        }
        Ok(())
    }

    /// Draws the path of a vehicle whose `now`-th position is in the frame.
    ///
    /// * `every` – step between drawn segments: 2 for a dashed line.
    fn draw_path(
        &self,
        canvas: &mut Canvas,
        (id, path): (ObjectId, &[Point3<f64>]),
        (frame, now): (&Frame, usize),
        (side, every): (f64, usize),
    ) -> Result<(), ExportError> {
        let Some(view) = self.views.get(frame.name.as_str()) else { return Ok(()) };
        let in_camera: Vec<_> = path.iter().map(|point| view.cam_from_world * *point).collect();
        // Share of the vehicle's distance: lines closer to the camera's center would cross the image.
        let nearest = 0.02 * in_camera[now].z.max(0.0);
        let colour = object_colour(id);
        for (index, ends) in in_camera.windows(2).enumerate().step_by(every) {
            let [from, to] = [ends[0], ends[1]]
                .map(|point| (point.z > nearest).then(|| view.camera.pixel_from_cam(point)).flatten());
            let width_px = if index < now { LINE * side } else { 0.4 * LINE * side };
            if let (Some(from), Some(to)) = (from, to) {
                canvas.line(from, to, colour, width_px.round() as i32)?;
            }
        }
        Ok(())
    }

    fn trajectory(&self, id: ObjectId) -> Option<&ObjectTrajectory> {
        self.results.trajectories.objects.iter().find(|object| object.id == id)
    }

    /// Returns true if a trajectory is drawn: all except rejected ones of vehicles with a ground track.
    fn is_shown(&self, object: &ObjectTrajectory) -> bool {
        !object.is_ruled_out() || self.results.trajectories.ground_track(object.id).is_none()
    }

    /// The ground track of a vehicle whose trajectory is not drawn in a frame.
    fn ground_track(&self, id: ObjectId, frame: FrameId) -> Option<&GroundTrack> {
        let is_placed =
            |object: &ObjectTrajectory| object.poses.binary_search_by_key(&frame, |pose| pose.frame).is_ok();
        let is_drawn = self.trajectory(id).is_some_and(|object| self.is_shown(object) && is_placed(object));
        self.results.trajectories.ground_track(id).filter(|_| !is_drawn)
    }

    /// `3 car 54 ± 2 km/h`; `3 car ground 54 ± 6 km/h` by a ground track.
    fn label(&self, id: ObjectId, frame: FrameId) -> String {
        if let Some(track) = self.ground_track(id, frame) {
            let now = track.positions.binary_search_by_key(&frame, |at| at.frame).ok();
            let motion = now.and_then(|now| track.positions[now].metric?.motion);
            let speed = motion.as_ref().map(km_h).unwrap_or_default();
            return format!("{id} {} ground {speed}", track.class).trim_end().to_owned();
        }
        let Some(object) = self.trajectory(id) else { return id.to_string() };
        let name = format!("{id} {}", object.class);
        if object.is_ruled_out() {
            return format!("{name} ?");
        }
        let now = object.poses.binary_search_by_key(&frame, |pose| pose.frame).ok();
        let speed = now.and_then(|now| self.speed(&object.poses, now));
        speed.map_or(name.clone(), |speed| format!("{name} {speed}"))
    }

    fn speed(&self, poses: &[ObjectPose], now: usize) -> Option<String> {
        if let Some(motion) = poses[now].metric.and_then(|metric| metric.motion) {
            return Some(km_h(&motion));
        }
        let is_known = self.results.metric_frame().is_none() && self.results.time_base == TimeBase::Seconds;
        raw_speed(poses, now).filter(|_| is_known).map(|speed| format!("{speed:.2} units/s"))
    }

    /// `frame 12  0.40 s`, and the meaning of the question mark where there is one.
    fn time(&self, frame: &Frame, masks: &[(ObjectId, Mask)]) -> String {
        let is_ground = |id: ObjectId| self.ground_track(id, frame.id).is_some();
        let is_doubted = |(id, _): &(ObjectId, Mask)| {
            !is_ground(*id) && self.trajectory(*id).is_some_and(ObjectTrajectory::is_ruled_out)
        };
        let doubts = if masks.iter().any(is_doubted) { "   ? rejected" } else { "" };
        let grounds = if masks.iter().any(|(id, _)| is_ground(*id)) { "   ground: without 3D model" } else { "" };
        let doubts = format!("{doubts}{grounds}");
        match self.results.time_base {
            TimeBase::Seconds => format!("frame {}  {:.2} s{doubts}", frame.id.0, frame.time_s),
            TimeBase::Frames => format!("frame {}{doubts}", frame.id.0),
        }
    }
}

/// `54 ± 2 km/h`.
fn km_h(motion: &Motion) -> String {
    format!("{} km/h", with_std(KM_H * motion.speed_m_s, KM_H * motion.speed_std_m_s))
}

/// Restores the masked pixels over the drawing on the ground.
fn put_in_front(drawn: &mut RgbImage, picture: &RgbImage, masks: &[(ObjectId, Mask)]) {
    for (x, y) in masks.iter().flat_map(|(_, mask)| mask.iter()) {
        drawn.put_pixel(x, y, *picture.get_pixel(x, y));
    }
}

/// The centers of a vehicle projected to the ground. A frame without a plane uses that of the nearest frame with one;
/// without any plane the centers stay unchanged.
fn path_on_ground(results: &Results, object: &ObjectTrajectory) -> Vec<Point3<f64>> {
    let planes: Vec<_> = match &results.ground {
        Some(ground) => ground.planes.iter().filter(|((id, _), _)| *id == object.id).collect(),
        None => Vec::new(),
    };
    let on_ground = |pose: &ObjectPose| {
        let center = Point3::from(pose.position);
        let nearest = planes.iter().min_by_key(|((_, frame), _)| frame.0.abs_diff(pose.frame.0));
        nearest.map_or(center, |(_, plane)| center - plane.normal * plane.signed_distance(center))
    };
    object.poses.iter().map(on_ground).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{results_of, with_metres};
    use crate::synthetic::showcase::{CAR, showcase};

    #[test]
    fn path_is_on_the_ground_and_the_car_has_a_speed() {
        let found = showcase(12, 1);
        let results = with_metres(results_of(&found));
        let annotator = Annotator::new(&results);
        let object = &results.trajectories.objects[0];
        let frame = found.frames.iter().find(|frame| frame.id == object.poses[4].frame).unwrap();
        let plane = results.ground.as_ref().unwrap().planes[&(CAR, frame.id)];
        assert!(plane.signed_distance(annotator.paths[&CAR][4]).abs() < 1e-9);
        assert!(plane.signed_distance(Point3::from(object.poses[4].position)) > 0.1);
        assert_eq!(annotator.label(CAR, frame.id), "1 car 28.8 ± 1.4 km/h");
        assert_eq!(annotator.label(ObjectId(9), frame.id), "9");
        let picture = found.picture(frame.id);
        let masks = vec![found.masks(frame.id).swap_remove(0)];
        let drawn = annotator.draw(&picture, frame, &masks).unwrap();
        let tinted = overlay(&picture, &[(CAR, &masks[0].1)]);
        let is_in_front = |(x, y)| drawn.get_pixel(x, y) == tinted.get_pixel(x, y);
        assert!(masks[0].1.iter().all(is_in_front), "the path is drawn behind the car");
        let changed = drawn.pixels().zip(picture.pixels()).filter(|(a, b)| a != b).count();
        assert!(changed > 2000 && changed < 960 * 540 / 2, "{changed}");
    }

    #[test]
    fn speeds_without_meters_are_in_units_and_rejected_trajectories_are_labeled() {
        let found = showcase(12, 1);
        let results = results_of(&found);
        let annotator = Annotator::new(&results);
        let frame = results.trajectories.objects[0].poses[3].frame;
        assert!(annotator.label(CAR, frame).ends_with(" units/s"), "{}", annotator.label(CAR, frame));
        assert!(annotator.label(ObjectId(2), frame).ends_with(" ?"), "{}", annotator.label(ObjectId(2), frame));
        let shown = &found.frames[frame.0 as usize];
        let masks = [CAR, ObjectId(2)].map(|id| (id, Mask::empty(4, 4)));
        assert!(annotator.time(shown, &masks).ends_with("? rejected"));
        assert!(!annotator.time(shown, &masks[..1]).contains('?'));
    }
}
