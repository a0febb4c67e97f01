//! Content of the charts and the frame bars.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use crate::eval::comparison::error_of_image;
use crate::report::chart::{Bars, Chart, Drawing, FrameState, Level, Line};
use crate::report::data::{Data, Model, Object};
use crate::report::measure;
use crate::report::metres::Ruler;
use crate::report::motion::{self, Quantity};
use crate::report::overlay::{css_colour, object_colour};
use crate::report::timeline::Timeline;
use crate::scene::{Frame, FrameId, GroundPlane, GroundTrack, Image, ObjectId, ObjectPose, ObjectTrajectory, TimeBase};

/// Maximum number of vehicles with a raw line next to the smoothed one; more raw lines would occlude one another.
const MAX_RAW: usize = 3;
/// Color of the camera's lines.
const CAMERA: &str = "var(--camera)";

/// The objects with a separate line in the charts and a row of frame bars: the 16 with the most poses, by id.
fn charted<'d>(data: &'d Data, names: &'d [String]) -> Vec<(&'d Object<'d>, &'d String)> {
    let mut objects: Vec<_> = data.objects.iter().zip(names).collect();
    let weight = |o: &Object| (o.trajectory.map_or(0, |t| t.poses.len()), o.visible.len());
    objects.sort_by_key(|(o, _)| (Reverse(weight(o)), o.id));
    // Maximum number of objects with a separate line in the charts and a row of frame bars.
    objects.truncate(16);
    objects.sort_by_key(|(o, _)| o.id);
    objects
}

/// Registered frames of the background and of every vehicle.
pub(super) fn bars(data: &Data, timeline: &Timeline, names: &[String]) -> Vec<Bars> {
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
    let mut rows = vec![Bars::new("Background".into(), CAMERA.into(), &background, timeline)];
    for (object, name) in charted(data, names) {
        let states = states(&|f| object.visible.binary_search(&f).is_ok(), object.model.as_ref());
        rows.push(Bars::new(name.clone(), css_colour(object_colour(object.id)), &states, timeline));
    }
    rows
}

/// All non-empty charts.
pub(super) fn charts(data: &Data, timeline: &Timeline, names: &[String], notes: &mut Vec<String>) -> Vec<Drawing> {
    let objects = charted(data, names);
    if objects.len() < data.objects.len() {
        let (shown, all) = (objects.len(), data.objects.len());
        notes.push(format!("The charts show {shown} of {all} vehicles, those visible longest."));
    }
    let charts = Charts { data, timeline, objects };
    let [speeds, accelerations, headings] = charts.motion();
    let all = [speeds, accelerations, headings, charts.camera_height(), charts.object_heights(), charts.ratios()];
    all.iter().chain(&[charts.reprojection()]).filter_map(|chart| chart.draw(timeline)).collect()
}

/// Returns true if a ground track's displacement exceeds 3σ: charts of stationary vehicles show noise.
fn has_moved(track: &GroundTrack) -> bool {
    let displacement = track.travel.as_ref().map(|travel| travel.displacement_units);
    // Minimum significant displacement, in standard deviations.
    displacement.is_some_and(|displacement| displacement.value > 3.0 * displacement.std)
}

/// Input of all charts.
struct Charts<'d> {
    data: &'d Data<'d>,
    timeline: &'d Timeline,
    objects: Vec<(&'d Object<'d>, &'d String)>,
}

impl Charts<'_> {
    /// A line per object.
    fn lines(&self, points: impl Fn(&Object) -> Vec<(f64, f64)>) -> Vec<Line> {
        let line = |(object, name): &(&Object, &String)| Line {
            label: (*name).clone(),
            colour: css_colour(object_colour(object.id)),
            points: points(object),
            ..Line::default()
        };
        self.objects.iter().map(line).collect()
    }

    /// A value per pose of an object.
    fn per_pose(&self, object: &Object, value: impl Fn(&ObjectPose) -> Option<f64>) -> Vec<(f64, f64)> {
        let point = |pose: &ObjectPose| Some((self.timeline.of(pose.frame)?, value(pose)?));
        object.trajectory.iter().flat_map(|t| &t.poses).filter_map(point).collect()
    }

    fn plane(&self, object: ObjectId, frame: FrameId) -> Option<&GroundPlane> {
        self.data.ground?.planes.get(&(object, frame))
    }

    /// One line per vehicle: local planes of different vehicles differ, so that their mean would jump whenever a
    /// vehicle enters or leaves.
    fn camera_height(&self) -> Chart {
        let images = self.data.background.images(self.data.frames);
        let images: BTreeMap<FrameId, &Image> =
            self.data.frames.iter().zip(images).filter_map(|(f, i)| Some((f.id, i?))).collect();
        let height = |object: &Object, frame: FrameId, image: &Image| {
            let plane = self.plane(object.id, frame)?;
            let height = plane.signed_distance(image.cam_from_world.center());
            Some((self.timeline.of(frame)?, self.ruler().factor * height))
        };
        let points = |object: &Object| images.iter().filter_map(|(f, image)| height(object, *f, image)).collect();
        Chart {
            title: "Camera height above ground".into(),
            caption: "From the camera to the local ground plane near each vehicle. The change of this height \
                 determines the scale of a vehicle's trajectory; with constant height the scale is poorly determined."
                .into(),
            unit: self.ruler().unit.into(),
            lines: self.lines(points),
            ..Chart::default()
        }
    }

    fn object_heights(&self) -> Chart {
        let height = |id: ObjectId, pose: &ObjectPose| {
            Some(self.ruler().factor * self.plane(id, pose.frame)?.signed_distance(pose.position.into()))
        };
        Chart {
            title: "Vehicle height above ground".into(),
            caption:
                "From each vehicle's center to its local ground plane. A vehicle keeps its height: a level line is \
                 evidence for the scale ratio, a slope or step evidence against it."
                    .into(),
            unit: self.ruler().unit.into(),
            lines: self.lines(|object| self.per_pose(object, |pose| height(object.id, pose))),
            ..Chart::default()
        }
    }

    fn ruler(&self) -> Ruler {
        Ruler::of(self.data.metric)
    }

    /// Speed, acceleration and heading; the first from raw positions, and the others empty, where meters are unknown.
    fn motion(&self) -> [Chart; 3] {
        let chart = |title: &str, unit: &str, caption: &str, quantity| Chart {
            title: title.into(),
            caption: caption.into(),
            unit: unit.into(),
            lines: self.smoothed(quantity),
            from_zero: matches!(quantity, Quantity::Speed),
            ..Chart::default()
        };
        let num_shown = self.measured().count();
        let thin = if num_shown > MAX_RAW { "" } else { " Thin line: raw frame-to-frame speed." };
        let hidden = if num_shown < self.objects.iter().filter(|(o, _)| o.trajectory.is_some()).count() {
            " Rejected vehicles are left out."
        } else {
            ""
        };
        let caption = format!("Signed speed along the heading.{thin} Band: ±1σ including scale.{hidden}");
        let speeds = chart("Speed", "km/h", &caption, Quantity::Speed);
        let accelerations = chart(
            "Acceleration",
            "m/s²",
            "Along the heading: negative when braking. Band: ±1σ.",
            Quantity::Acceleration,
        );
        let headings = chart(
            "Heading",
            "degrees",
            "Clockwise from the top of the plan; values continue below 0 and above 360 where a vehicle turns through \
             it. Band: ±1σ.",
            Quantity::Heading,
        );
        let is_known = speeds.lines.iter().any(|line| !line.points.is_empty());
        [if is_known { speeds } else { self.raw_speeds() }, accelerations, headings]
    }

    /// Vehicles with a usable motion, by their trajectories or moving ground tracks; if there are none, all with a
    /// trajectory.
    fn measured(&self) -> impl Iterator<Item = &(&Object<'_>, &String)> {
        let is_sure = |object: &Object| match object.answering_track() {
            Some(track) => has_moved(track),
            None => object.trajectory.is_some_and(|found| !found.is_ruled_out()),
        };
        let none = !self.objects.iter().any(|(object, _)| is_sure(object));
        self.objects.iter().filter(move |(object, _)| none && object.trajectory.is_some() || is_sure(object))
    }

    /// A line with its band per object.
    fn smoothed(&self, quantity: Quantity) -> Vec<Line> {
        let with_raw = self.measured().count() <= MAX_RAW;
        let line = |(object, name): &(&Object, &String)| {
            let readings = motion::readings(self.data, object, quantity);
            let at = |r: &motion::Reading| self.timeline.of(r.frame);
            let band = readings.iter().filter_map(|r| Some((at(r)?, r.value - r.std, r.value + r.std)));
            Line {
                points: readings.iter().filter_map(|r| Some((at(r)?, r.value))).collect(),
                raw: readings.iter().filter(|_| with_raw).filter_map(|r| Some((at(r)?, r.raw?))).collect(),
                band: band.collect(),
                label: (*name).clone(),
                colour: css_colour(object_colour(object.id)),
                dots: false,
            }
        };
        self.measured().map(line).collect()
    }

    fn raw_speeds(&self) -> Chart {
        let title = match self.timeline.base {
            TimeBase::Seconds => "Speed",
            TimeBase::Frames => "Distance from frame to frame",
        };
        let ruler = self.ruler();
        let scaled = |(time, speed): (f64, f64)| (time, ruler.factor * speed);
        let speeds = |t: &ObjectTrajectory| measure::speeds(t, self.timeline).into_iter().map(scaled).collect();
        let caption = match self.data.metric.and_then(crate::report::metres::frame) {
            Some(_) => "Along the trajectory, from frame to frame, not smoothed.",
            None => {
                "Along the trajectory, from frame to frame, not smoothed. The unit is arbitrary: only the shape of the \
                 curve is meaningful."
            }
        };
        Chart {
            title: title.into(),
            caption: caption.into(),
            unit: self.timeline.speed_unit(ruler.unit),
            lines: self.lines(|object| object.trajectory.map(speeds).unwrap_or_default()),
            from_zero: true,
            ..Chart::default()
        }
    }

    fn ratios(&self) -> Chart {
        let with_ratios = || self.objects.iter().filter(|(o, _)| !o.ratio_per_frame.is_empty());
        let points = |object: &Object| {
            object.ratio_per_frame.iter().filter_map(|&(f, r)| Some((self.timeline.of(f)?, r))).collect()
        };
        let level = |(object, _): &(&Object, &String)| {
            let scale = &object.trajectory?.scale;
            Some(Level { value: scale.ratio, std: scale.std, colour: css_colour(object_colour(object.id)) })
        };
        Chart {
            title: "Scale ratio per frame".into(),
            caption: "Dots: ratio from the contact with the ground in each frame alone (method intersection). Line: \
                 the ratio in use, with a band of one standard deviation where known."
                .into(),
            unit: "r".into(),
            lines: self.lines(points).into_iter().map(|line| Line { dots: true, ..line }).collect(),
            levels: with_ratios().filter_map(level).collect(),
            from_zero: false,
        }
    }

    fn reprojection(&self) -> Chart {
        let errors = |model: &Model| -> Vec<(f64, f64)> {
            let error = |(frame, image): (&Frame, Option<&Image>)| {
                Some((self.timeline.of(frame.id)?, error_of_image(model.reconstruction, image?)?))
            };
            self.data.frames.iter().zip(model.images(self.data.frames)).filter_map(error).collect()
        };
        let background = Line {
            label: "Background".into(),
            colour: CAMERA.into(),
            points: errors(&self.data.background),
            ..Line::default()
        };
        let objects = self.lines(|object| object.model.as_ref().map(&errors).unwrap_or_default());
        Chart {
            title: "Reprojection error".into(),
            caption: "Mean distance between observed and reprojected points, per frame.".into(),
            unit: "px".into(),
            lines: std::iter::once(background).chain(objects).collect(),
            from_zero: true,
            ..Chart::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    /// The planes of a false detection do not affect the height over the car's own planes.
    #[test]
    fn a_false_vehicle_does_not_move_the_height_over_another() {
        let mut world = testing::world();
        let height = |world: &testing::World| {
            let data = world.data();
            let timeline = Timeline::new(&data);
            let names = world.names();
            let charts = Charts { data: &data, timeline: &timeline, objects: charted(&data, &names) };
            charts.camera_height().lines.into_iter().map(|l| l.points).collect::<Vec<_>>()
        };
        let car = world.trajectory.id;
        world.ground.planes.retain(|(id, _), _| *id == car);
        let before = height(&world);
        assert!(!before[0].is_empty() && before[1].is_empty());
        for frame in [FrameId(20), FrameId(21)] {
            let mut plane = world.ground.planes[&(car, frame)];
            plane.point -= 100.0 * plane.normal;
            world.ground.planes.insert((ObjectId(2), frame), plane);
        }
        let after = height(&world);
        assert_eq!((&after[0], after[1].len()), (&before[0], 2));
    }
}
