//! The last adjustments of a map, and what they depend on.

use super::super::view_graph::{self, PairVerdict, Thresholds, ViewGraph};
use super::{IncrementalMapper, LOOSE};
use crate::geometry::resection::Resection;
use crate::mapper::adjustment::{Freedom, Scope};
use crate::mapper::map::Slot;
use crate::mapper::{MapperError, Reason, focal_length};

impl IncrementalMapper<'_> {
    /// Adjusts everything on all points, and takes out and tries again what contradicts the view graph.
    pub fn finish(&mut self) -> Result<(), MapperError> {
        self.mend_leaps()?;
        self.close_loops()?;
        self.adjust_until_settled()?;
        self.review_views()?;
        self.mend_leaps()?;
        if self.reviewed {
            self.adjust_until_settled()?;
        }
        self.num_infinite = self.map.reject_infinite_points();
        self.drop_unsupported_views()?;
        self.num_infinite += self.map.reject_infinite_points();
        self.judge_focal_length()
    }

    /// Estimates the standard deviation of the focal length of the final map.
    fn judge_focal_length(&mut self) -> Result<(), MapperError> {
        let Some(sigma_px) = self.map.noise() else { return Ok(()) };
        for camera in focal_length::asked_cameras(&self.map) {
            // A principal point that is held and off shifts the focal length.
            let freedom = match self.freedom {
                Freedom::WithPrincipalPoint => Freedom::FocalAndRadial,
                _ => Freedom::WithPrincipalPoint,
            };
            let evidence = focal_length::focal_evidence(&self.map, &[camera], freedom, sigma_px, self.options)?;
            tracing::debug!("focal length of camera {camera}: {evidence:?}");
            self.focal_deviations[camera] = Some(evidence.deviation(self.map.known.of(camera).focal));
        }
        Ok(())
    }

    /// Adjusts everything on all points, until observations stop changing; then again on those that are left, so
    /// that cameras and points lie at the minimum of exactly what is kept.
    fn adjust_until_settled(&mut self) -> Result<(), MapperError> {
        self.noise = None;
        self.decide_lens()?;
        // A bound where observations keep changing.
        for _ in 0..3 {
            // At those of the last round: at wide limits all outliers would come back.
            let limits = self.limits();
            self.map.triangulate_all(&limits);
            self.map.update_observations(&limits);
            self.adjust(&Scope::Roughly, self.freedom)?;
            self.noise = self.map.noise();
            let limits = self.limits();
            let changed = self.map.update_observations(&limits);
            // Converged: hardly an observation changes.
            if changed as f64 <= 0.002 * self.map.num_observations() as f64 {
                break;
            }
        }
        self.adjust(&Scope::Everything, self.freedom).map(drop)
    }

    /// Decides once which intrinsics are adjusted, where any are looked for, on the points of the map as it grew.
    fn decide_lens(&mut self) -> Result<(), MapperError> {
        let unknown: Vec<usize> = self.map.unknown_cameras().collect();
        if unknown.is_empty() || self.lens_decided {
            return Ok(());
        }
        self.noise = self.map.noise();
        let limits = self.limits();
        self.map.update_observations(&limits);
        self.freedom = self.final_freedom(&unknown)?;
        self.lens_decided = true;
        Ok(())
    }

    /// Which intrinsics the motion determines, of all cameras that are looked for alike, once the noise is known and
    /// wrong points are gone.
    ///
    /// Where the focal length itself is loosely held, as on a single flight looking straight down, a second coefficient
    /// of distortion and the principal point would take up what the model of the camera leaves out (the shutter that
    /// rolls down the picture), and bend the map: they go back to the guess.
    fn final_freedom(&mut self, unknown: &[usize]) -> Result<Freedom, MapperError> {
        let Some(sigma_px) = self.noise else { return Ok(Freedom::at_first(&self.map)) };
        let deviation = match *unknown {
            [camera] => focal_length::focal_deviation_here(&self.map, camera, sigma_px, self.options)?,
            _ => {
                let freedom = Freedom::FocalAndRadial;
                focal_length::focal_evidence(&self.map, unknown, freedom, sigma_px, self.options)?.together
            }
        };
        let known = unknown.iter().map(|&camera| self.map.known.of(camera).focal).fold(0.0, f64::max);
        let deviation = (deviation.powi(-2) + known.powi(-2)).sqrt().recip();
        tracing::debug!("focal length known to {:.3} %", 100.0 * deviation);
        if deviation <= LOOSE {
            return Ok(Freedom::WithPrincipalPoint);
        }
        let gain = focal_length::first_radial_gain(&self.map, sigma_px, self.options)?;
        tracing::debug!("gain of the first distortion coefficient: {gain:.1}");
        unknown.iter().for_each(|&camera| self.map.cameras[camera].radial = self.map.guess[camera].radial);
        // The noise was that of another lens.
        self.noise = None;
        // Three standard deviations.
        Ok(if gain > 9.0 { Freedom::FocalAndFirstRadial } else { Freedom::Focal })
    }

    /// Takes out the views that contradict the others, and tries them again on what speaks against them.
    fn review_views(&mut self) -> Result<(), MapperError> {
        let num_registered = self.map.num_registered();
        // Fewer cannot outvote one.
        if num_registered < 4 {
            return Ok(());
        }
        let graph = ViewGraph::new(&self.map, self.thresholds_of_pairs(), self.seed);
        let opinions = graph.opinions(&self.map, None);
        let wrong = view_graph::contradicted(opinions.clone());
        // Where a third is wrong, nobody knows which.
        if wrong.is_empty() || 3 * wrong.len() > num_registered {
            return Ok(());
        }
        self.take_out(&wrong);
        self.adjust_globally()?;
        for &view in &wrong {
            let accusers = accusers_of(&opinions, view);
            if self.register_again(view, &accusers, &graph) {
                self.settle(view)?;
            }
            tracing::debug!(
                "{} contradicted {} others; registered again: {}",
                self.map.table.views[view].name,
                accusers.len(),
                self.map.poses[view].is_some()
            );
        }
        Ok(())
    }

    /// Takes out some views; the points that they took part in are triangulated again from the others.
    pub(super) fn take_out(&mut self, views: &[usize]) {
        self.reviewed = true;
        self.noise = None;
        views.iter().for_each(|&view| self.map.unregister(view));
        let untouched: Vec<bool> =
            self.map.tracks.iter().map(|t| t.iter().all(|f| !views.contains(&(f.view as usize)))).collect();
        self.map.retriangulate(&self.limits(), &untouched);
    }

    /// Required agreement of pairs of views with the map. Frames of a video are registered next to their neighbors in
    /// time, and need less.
    fn thresholds_of_pairs(&self) -> Thresholds {
        let max_error_px = self.options.max_pose_error_px;
        // Four σ and at least half a pixel: a two-view geometry has an error of its own, besides the noise.
        let of_noise = |sigma_px: f64| (4.0 * sigma_px).max(0.5).min(max_error_px);
        let fine_px = self.map.noise().filter(|_| !self.options.ordered).map(of_noise);
        Thresholds { max_error_px, fine_px }
    }

    /// Tries the points that the accusers see, then all, then the pose between the neighbours in time; the pose for
    /// which most speaks is taken, unless as much speaks against it.
    fn register_again(&mut self, view: usize, accusers: &[usize], graph: &ViewGraph) -> bool {
        let all = self.map.visible(view);
        let of_accusers: Vec<Slot> = all.iter().copied().filter(|s| self.is_seen_by(s, accusers)).collect();
        let mut best: Option<(Resection, Vec<Slot>, usize)> = None;
        self.failed[view] = Some(Reason::Contradicted { agreeing: 0, contradicting: 0 });
        let between = self.interpolated(view).filter(|_| self.options.ordered);
        for (slots, start) in [(of_accusers, None), (all.clone(), None), (all, between)] {
            let found = self.resect(view, &slots, start);
            let Some(found) = found.filter(|r| r.inliers.len() >= self.options.min_resection_inliers) else { continue };
            self.map.poses[view] = Some(found.cam_from_world);
            let (agreeing, contradicting) = view_graph::balance(&graph.opinions(&self.map, Some(view)), view);
            self.map.poses[view] = None;
            if agreeing > contradicting && best.as_ref().is_none_or(|(_, _, most)| agreeing > *most) {
                best = Some((found, slots, agreeing));
            } else if best.is_none() {
                self.failed[view] = Some(Reason::Contradicted { agreeing, contradicting });
            }
        }
        let Some((found, slots, _)) = best else { return false };
        self.set_pose(view, &found, &slots);
        true
    }

    fn is_seen_by(&self, slot: &Slot, views: &[usize]) -> bool {
        self.map.observations(slot.track as usize).any(|(_, view, _)| views.contains(&view))
    }

    /// Takes out views that filtering has left with too few observations to hold a pose.
    pub(super) fn drop_unsupported_views(&mut self) -> Result<(), MapperError> {
        let support = self.map.num_observations_of_views();
        let is_weak = |&view: &usize| support[view] < self.options.min_resection_inliers;
        let weak: Vec<usize> = self.map.registered().filter(is_weak).collect();
        if weak.is_empty() {
            return Ok(());
        }
        for view in weak {
            let (_, visible) = self.map.visibility(view);
            self.failed[view] = Some(Reason::NoPose { visible, inliers: support[view] });
            self.map.unregister(view);
        }
        self.map.update_observations(&self.limits());
        self.adjust(&Scope::Everything, self.freedom).map(drop)
    }
}

/// Views whose pairs with a view speak against it.
fn accusers_of(opinions: &[PairVerdict], view: usize) -> Vec<usize> {
    let against = opinions.iter().filter(|o| o.contradicting > 0 && o.views.contains(&view));
    against.map(|o| o.views[0] + o.views[1] - view).collect()
}
