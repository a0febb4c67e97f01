//! Maps of their own of the views that could not be registered, and how they come to the first map.
//!
//! Behind a gap, after a turn, after a jump no single view may see enough known points for a pose, though all views
//! behind it together do. So the views that are left over grow a map among themselves, as often as there is a pair that
//! starts one. The tracks of which both maps see a part say how the two lie to one another ([`similarity`]), and
//! everything is adjusted together. The two count as one only if that fits: otherwise each view of the other map has a
//! [`Reason`] that says so.

mod similarity;

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::IncrementalMapper;
use crate::camera::Camera;
use crate::features::tracks::{Feature, TrackTable};
use crate::geometry::triangulation;
use crate::mapper::adjustment::Scope;
use crate::mapper::map::{Slot, Table};
use crate::mapper::{Intrinsics, KnownIntrinsics, MapperError, Noise, Reason};
use crate::math::{Rigid3, Sim3, seeded_rng};
use similarity::{Similarity, Tie};

/// Fewer views make no map of their own.
const MIN_VIEWS: usize = 4;
/// Maps of their own that are grown at most: each costs a reconstruction of what is left over.
const MOST_MAPS: usize = 8;
/// Smallest share of the tracks that two maps share which must agree on how they lie: of joints that are found behind a
/// gap one in five is wrong.
const MIN_SHARE: f64 = 0.5;
/// Largest standard deviation of the similarity, as a share of the size of what ties: more is a guess.
const MAX_DEVIATION: f64 = 0.05;
/// Noise of the joined map over that of the worse one alone.
const MAX_NOISE: f64 = 1.5;
/// Share of the other map's views that stay in the joined one.
const MIN_KEPT: f64 = 0.8;

/// A map of views that another one left over, in a frame of its own.
pub struct SubMap {
    /// By view of the whole table.
    poses: Vec<Option<Rigid3>>,
    /// Intrinsics, by camera of the whole table.
    cameras: Vec<Camera>,
    /// Points by the features that show them.
    points: BTreeMap<Feature, Point3<f64>>,
    noise: Noise,
}

impl SubMap {
    /// Of a map that was grown to its end, by view of its own table.
    pub fn of(growth: &IncrementalMapper<'_>) -> Self {
        let map = &growth.map;
        let mut points = BTreeMap::new();
        for track in 0..map.table.tracks.len() {
            let Some(point) = map.point(track) else { continue };
            points.extend(map.observations(track).map(|(slot, ..)| (map.table.tracks[track][slot], point.position)));
        }
        Self { poses: map.poses.clone(), cameras: map.cameras.clone(), points, noise: map.noise() }
    }

    /// The same by view of a larger table of `num_views` views; `views` says which of these it has.
    fn of_larger(self, views: &[usize], num_views: usize) -> Self {
        let mut poses = vec![None; num_views];
        views.iter().zip(&self.poses).for_each(|(&view, pose)| poses[view] = *pose);
        let there = |feature: Feature| Feature { view: views[feature.view as usize] as u32, ..feature };
        let points = self.points.into_iter().map(|(feature, point)| (there(feature), point)).collect();
        Self { poses, points, ..self }
    }

    fn views(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.poses.len()).filter(|&view| self.poses[view].is_some())
    }

    fn num_views(&self) -> usize {
        self.views().count()
    }
}

/// Numbers of tracks that two maps share, of those that agree on their alignment, and of those required.
#[derive(Clone, Copy)]
struct Agreement {
    shared: usize,
    agreeing: usize,
    needed: usize,
}

/// Grows a map of a table with cameras of which so much is known; `None` where nothing starts one.
pub type Grow<'a> = dyn Fn(&TrackTable, &[Camera], &KnownIntrinsics) -> Result<Option<SubMap>, MapperError> + 'a;

impl IncrementalMapper<'_> {
    /// Grows maps of the views that are left over, and joins to this one those that fit.
    pub fn join_left_over(&mut self, grow: &Grow<'_>) -> Result<(), MapperError> {
        let mut apart: Vec<(SubMap, Agreement)> = Vec::new();
        for _ in 0..MOST_MAPS {
            let Some(sub) = self.grow_left_over(&apart, grow)? else { break };
            match self.join(&sub)? {
                Ok(()) => self.join_again(&mut apart)?,
                Err(agreement) => apart.push((sub, agreement)),
            }
        }
        for (sub, agreement) in &apart {
            self.state_apart(sub, *agreement);
        }
        Ok(())
    }

    /// The largest map of views that neither this map nor one of those that stay apart holds.
    fn grow_left_over(&self, apart: &[(SubMap, Agreement)], grow: &Grow<'_>) -> Result<Option<SubMap>, MapperError> {
        let is_held =
            |view: usize| self.map.poses[view].is_some() || apart.iter().any(|(s, _)| s.poses[view].is_some());
        let num_views = self.map.poses.len();
        let is_open = |&view: &usize| !is_held(view) && self.map.visibility(view).0 > 0;
        let open: Vec<usize> = (0..num_views).filter(is_open).collect();
        if open.len() < MIN_VIEWS {
            return Ok(None);
        }
        let found = grow(&table_of(&self.map.table, &open), &self.map.cameras, &self.known_by_now())?;
        Ok(found.filter(|sub| sub.num_views() >= MIN_VIEWS).map(|sub| sub.of_larger(&open, num_views)))
    }

    /// Returns true if this map has a view of a camera.
    fn has_camera(&self, camera: usize) -> bool {
        self.map.registered().any(|view| self.map.table.views[view].camera == camera)
    }

    /// Intrinsics known once this map exists: those of its own cameras stay fixed.
    fn known_by_now(&self) -> KnownIntrinsics {
        let known = |camera| if self.has_camera(camera) { Intrinsics::FIXED } else { self.map.known.of(camera) };
        KnownIntrinsics::from((0..self.map.cameras.len()).map(known).collect::<Vec<_>>())
    }

    /// Tries again to align sub-maps that did not fit before the map grew.
    fn join_again(&mut self, apart: &mut Vec<(SubMap, Agreement)>) -> Result<(), MapperError> {
        let mut still = Vec::new();
        for (sub, _) in std::mem::take(apart) {
            if let Err(agreement) = self.join(&sub)? {
                still.push((sub, agreement));
            }
        }
        *apart = still;
        Ok(())
    }

    /// Joins another map to this one, if enough ties both and the result fits; leaves this one as it is otherwise.
    fn join(&mut self, sub: &SubMap) -> Result<Result<(), Agreement>, MapperError> {
        let ties = self.ties(sub);
        let needed = self.options.min_resection_inliers.max((MIN_SHARE * ties.len() as f64).ceil() as usize);
        let mut rng = seeded_rng(self.seed, sub.views().next().unwrap_or(0) as u64);
        let found = similarity::estimate(&ties, self.options.max_pose_error_px, &mut rng);
        let agreeing = found.as_ref().map_or(0, |found| found.inliers.len());
        let agreement = Agreement { shared: ties.len(), agreeing, needed };
        tracing::debug!(
            "sub-map of {} views; {agreeing} of {} shared points agree, deviation {:?}",
            sub.num_views(),
            ties.len(),
            found.as_ref().map(|found| found.deviation)
        );
        let enough = |found: &Similarity| found.inliers.len() >= needed && found.deviation <= MAX_DEVIATION;
        let Some(found) = found.filter(enough) else { return Ok(Err(agreement)) };
        let tracks: Vec<usize> = found.inliers.iter().map(|&i| ties[i].track).collect();
        let mut joined = self.clone();
        joined.take_over(sub, &found.first_from_other, &tracks)?;
        if !joined.holds(sub, self.map.noise()) || joined.num_explained() <= self.num_explained() {
            return Ok(Err(agreement));
        }
        *self = joined;
        Ok(Ok(()))
    }

    /// Tracks of which both maps see a part.
    fn ties<'b>(&'b self, sub: &'b SubMap) -> Vec<Tie<'b>> {
        let (map, tracks) = (&self.map, &self.map.table.tracks);
        let view_of = |feature: Feature, cam_from_world: &'b Rigid3, cameras: &'b [Camera]| triangulation::View {
            camera: &cameras[map.table.views[feature.view as usize].camera],
            cam_from_world,
            pixel: map.table.pixel(feature),
            whitening: map.table.whitening(feature),
        };
        let tie = |track: usize| {
            let features = &tracks[track];
            let in_other = features.iter().find_map(|feature| sub.points.get(feature).copied());
            let counts = |feature: &&Feature| in_other.is_none() || sub.points.contains_key(feature);
            let seen_by_other: Vec<_> = features
                .iter()
                .filter(counts)
                .filter_map(|&feature| {
                    let pose = sub.poses[feature.view as usize].as_ref()?;
                    Some(view_of(feature, pose, &sub.cameras))
                })
                .collect();
            let in_first = map.point(track);
            let is_active = |slot: usize| in_first.is_none_or(|point| point.active[slot]);
            let seen_by_first: Vec<_> = (0..features.len())
                .filter(|&slot| is_active(slot))
                .filter_map(|slot| {
                    let pose = map.poses[features[slot].view as usize].as_ref()?;
                    Some(view_of(features[slot], pose, &map.cameras))
                })
                .collect();
            let in_first = in_first.map(|point| point.position);
            let is_tied = !seen_by_first.is_empty() && !seen_by_other.is_empty();
            (is_tied && (in_first.is_some() || in_other.is_some())).then_some(Tie {
                track,
                in_first,
                in_other,
                seen_by_first,
                seen_by_other,
            })
        };
        (0..tracks.len()).filter_map(tie).collect()
    }

    /// Takes another map's views over and adjusts everything; `tracks` are those that tie the two.
    pub(super) fn take_over(
        &mut self,
        sub: &SubMap,
        first_from_other: &Sim3,
        tracks: &[usize],
    ) -> Result<(), MapperError> {
        for camera in 0..sub.cameras.len() {
            if !self.has_camera(camera) {
                self.map.cameras[camera] = sub.cameras[camera];
            }
        }
        for view in sub.views() {
            let pose = sub.poses[view].map(|pose| first_from_other.transform_camera(&pose));
            (self.map.poses[view], self.failed[view], self.refused[view]) = (pose, None, None);
        }
        let of_other = |track: usize| {
            let slots = self.map.table.tracks[track].iter().enumerate();
            slots.filter(|(_, f)| sub.poses[f.view as usize].is_some()).map(move |(slot, _)| (track, slot))
        };
        let seen: Vec<(usize, usize)> = tracks.iter().flat_map(|&track| of_other(track)).collect();
        self.map.activate(seen.into_iter().map(|(track, slot)| Slot { track: track as u32, slot: slot as u32 }));
        self.noise = Noise::Unknown;
        let limits = self.limits();
        self.map.triangulate_all(&limits);
        self.adjust(&Scope::Everything, self.freedom)?;
        self.map.update_observations(&limits);
        self.finish()
    }

    /// Returns true if the merged map explains both maps about as well as they did alone.
    fn holds(&self, sub: &SubMap, noise_before: Noise) -> bool {
        let sigma = |noise: Noise| match noise {
            Noise::Measured { sigma_px } => sigma_px,
            Noise::Unknown => f64::INFINITY,
        };
        let kept = sub.views().filter(|&view| self.map.poses[view].is_some()).count();
        let is_of_both = |track: &usize| {
            let (mut ours, mut theirs) = (false, false);
            for (_, view, _) in self.map.observations(*track) {
                *(if sub.poses[view].is_some() { &mut theirs } else { &mut ours }) = true;
            }
            ours && theirs
        };
        let num_common = (0..self.map.table.tracks.len()).filter(is_of_both).count();
        let noise = sigma(self.map.noise());
        tracing::debug!(
            "sub-map merged: {kept} of {} views, {num_common} common points, {noise:.3} px, {:.0} observations \
             explained",
            sub.num_views(),
            self.num_explained()
        );
        kept as f64 >= MIN_KEPT * sub.num_views() as f64
            && num_common >= self.options.min_resection_inliers
            && noise <= MAX_NOISE * sigma(noise_before).max(sigma(sub.noise))
    }

    fn state_apart(&mut self, sub: &SubMap, agreement: Agreement) {
        let views: Vec<usize> = sub.views().filter(|&view| self.map.poses[view].is_none()).collect();
        let [Some(&first), Some(&last)] = [views.first(), views.last()] else { return };
        let ends = [first, last].map(|view| self.map.table.views[view].name.clone());
        let Agreement { shared, agreeing, needed } = agreement;
        for &view in &views {
            let ends = ends.clone();
            self.apart[view] = Some(Reason::OwnMap { ends, views: views.len(), shared, agreeing, needed });
        }
    }
}

/// The table of some views only, given in ascending order.
fn table_of(table: &Table<'_>, views: &[usize]) -> TrackTable {
    let mut index = vec![None; table.views.len()];
    (0u32..).zip(views).for_each(|(k, &view)| index[view] = Some(k));
    let kept = |feature: &Feature| Some(Feature { view: index[feature.view as usize]?, ..*feature });
    let tracks = table.tracks.iter().map(|track| track.iter().filter_map(kept).collect::<Vec<_>>());
    TrackTable {
        views: views.iter().map(|&view| table.views[view].clone()).collect(),
        tracks: tracks.filter(|track| track.len() >= 2).collect(),
    }
}
