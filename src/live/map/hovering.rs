//! Maps of a camera that does not translate: on the ground of the previous map, or in a frame of its own, with the
//! ground estimated from all sources (`ground::hovering`).

use std::sync::Arc;

use super::super::Purpose;
use super::super::georeference::Georeference;
use super::super::window::Snapshot;
use super::{Found, MIN_POINTS, Mapper, NoMap, on_plane};
use crate::features::TrackTable;
use crate::ground::{HoveringGround, hovering_ground};
use crate::mapper::{self, HoveringCamera, RotatingCamera};
use crate::math::Rigid3;
use crate::pipeline::{Station, camera_by_map_points, on_map_points, stated_tilts};
use crate::scene::Reconstruction;

/// Error of tilt and focal length below which the frame is not replaced, radians: the typical slope of a street.
const GOOD: f64 = 0.02;
/// Rotation from the first view above which a camera has turned, radians: the precision of a stated inclination.
const TURNED: f64 = 0.0175;
/// Maximum ratio of the new error to the old one to begin a new frame: every change moves all positions.
const BETTER: f64 = 0.5;

/// A camera that does not translate, in a frame of its own.
struct Hover {
    model: Reconstruction,
    focal_std: f64,
    ground: HoveringGround,
    on_map: Option<Arc<Georeference>>,
}

impl Hover {
    /// Standard deviation of the tilt, radians, with that of the focal length as a share: both are errors of distances.
    fn error(&self) -> f64 {
        self.ground.tilt_std.hypot(self.focal_std)
    }
}

/// State of a local frame while the camera does not translate.
pub(super) struct Hovering {
    pub(super) ground: HoveringGround,
    /// As of [`Hover::error`].
    error: f64,
    /// Standard deviation of the focal length as a share before it began.
    focal_std_before: f64,
    /// True if the frame began with it, and has its origin at the camera.
    pub(super) is_own: bool,
}

impl Mapper {
    /// The next map of a camera that does not translate; `None` where no view has a pose in the last one.
    pub(super) fn still_hovering(
        &mut self,
        snapshot: &Snapshot,
        table: &TrackTable,
        rotations: &RotatingCamera,
    ) -> Option<Found> {
        let Hovering { ground, error, .. } = self.hovering.as_ref()?;
        if snapshot.purpose != Purpose::Revision
            && *error > GOOD
            && let Ok(better) = self.hover(snapshot, table)
            && better.error() < BETTER * error
        {
            return Some(self.begin_own_frame(better));
        }
        self.on_ground(snapshot, table, rotations, ground)
    }

    /// The map on a ground that is known in the frame of the last map; `None` where no view has a pose in it.
    fn on_ground(
        &self,
        snapshot: &Snapshot,
        table: &TrackTable,
        rotations: &RotatingCamera,
        ground: &HoveringGround,
    ) -> Option<Found> {
        let known: Vec<Option<Rigid3>> =
            table.views.iter().map(|view| snapshot.poses.get(&view.image.frame()).copied()).collect();
        let poses = on_plane::completed(&known, rotations);
        let model = on_plane::model(table, &self.camera, &poses, ground, self.last.as_ref());
        let is_enough = known.iter().any(Option::is_some) && model.points.len() >= MIN_POINTS;
        is_enough.then_some(Found { model, focal_std: self.focal_std(), is_continued: true })
    }

    /// The first map of a camera that does not translate, on the ground of the last map or in a new frame.
    pub(super) fn begin_hovering(
        &mut self,
        snapshot: &Snapshot,
        table: &TrackTable,
        rotations: &RotatingCamera,
    ) -> Result<Found, NoMap> {
        if let Some(ground) = &self.held.plane
            && let Some(found) = self.on_ground(snapshot, table, rotations, ground)
        {
            let (ground, focal_std_before) = (ground.clone(), self.known.focal);
            self.hovering = Some(Hovering { ground, error: 0.0, focal_std_before, is_own: false });
            return Ok(found);
        }
        let found = self.hover(snapshot, table)?;
        Ok(self.begin_own_frame(found))
    }

    /// The camera as one that does not translate, in a frame of its own.
    fn hover(&self, snapshot: &Snapshot, table: &TrackTable) -> Result<Hover, NoMap> {
        let is_first = self.first == snapshot.frames.first().map(|frame| frame.id);
        let mut metric = self.options.metric.clone();
        if self.has_turned && !is_first {
            // They do not refer to the views of this window.
            (metric.camera_pitch, metric.map_points) = (None, None);
        }
        // The same points of the map are not independent evidence.
        let before = self.hovering.as_ref().map_or(self.known.focal, |hovering| hovering.focal_std_before);
        let (camera, focal_std) = camera_by_map_points(&metric, table, &self.camera, before);
        let found = mapper::hovering_camera(table, &camera, focal_std, &snapshot.lines);
        let HoveringCamera { rotations, camera, focal_std, by_lines } = found.ok_or(NoMap::Inclination)?;
        let poses = rotations.model(table, &camera);
        let on_map = on_map_points(&metric, &poses, focal_std).map_err(|error| NoMap::MapPoints(error.to_string()))?;
        let log = self.georeferencer.as_ref();
        let station = log.and_then(|log| log.station(&poses, &snapshot.frames, &metric).ok());
        let vertical = station.as_ref().and_then(Station::vertical);
        let tilts = stated_tilts(&poses, &metric, by_lines.as_ref(), vertical, on_map.as_ref());
        // The heading of stationary vehicles is unknown.
        let vehicles: Vec<_> = snapshot.vehicles.iter().filter(|seen| on_plane::moves(seen, &poses)).cloned().collect();
        let ground = hovering_ground(&poses, &vehicles, tilts, focal_std).ok_or(NoMap::Inclination)?;
        let model = on_plane::model(table, &camera, &rotations.poses, &ground, None);
        let (found, needed) = (model.points.len(), MIN_POINTS);
        if found < needed {
            return Err(NoMap::Points { found, needed });
        }
        let utc_start_s = log.zip(station).and_then(|(log, station)| log.utc_start_s(&station, &metric));
        let on_map = on_map.map(|found| Arc::new(Georeference::on_map(found, utc_start_s)));
        Ok(Hover { model, focal_std, ground, on_map })
    }

    /// Records a rotation of the camera away from its first view.
    pub(super) fn note_turns(&mut self, model: &Reconstruction) {
        let mut rotations = model.images.values().map(|image| image.cam_from_world.rotation);
        let Some(first) = self.held.rotation.or_else(|| rotations.next()) else { return };
        self.held.rotation = Some(first);
        self.has_turned |= rotations.any(|rotation| rotation.angle_to(&first) > TURNED);
    }

    /// Begins a new local frame for a camera that does not translate.
    fn begin_own_frame(&mut self, found: Hover) -> Found {
        let error = found.error();
        let Hover { model, focal_std, ground, on_map } = found;
        self.restart();
        self.held.on_map = on_map;
        let focal_std_before = self.hovering.as_ref().map_or(self.known.focal, |hovering| hovering.focal_std_before);
        self.hovering = Some(Hovering { ground, error, focal_std_before, is_own: true });
        self.known.focal = focal_std;
        Found { model, focal_std: self.focal_std(), is_continued: false }
    }
}
