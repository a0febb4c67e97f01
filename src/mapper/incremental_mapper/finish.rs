//! Final adjustments of a map: choice of the intrinsics, review of the views, convergence.

use super::super::view_graph::{self, PairVerdict, Thresholds, ViewGraph};
use super::{IncrementalMapper, MAX_FOCAL_STD};
use crate::geometry::resection::Resection;
use crate::mapper::adjustment::{Freedom, Scope};
use crate::mapper::map::Slot;
use crate::mapper::{MapperError, Reason, focal_length};

impl IncrementalMapper<'_> {
    /// Adjusts the whole map, and removes and re-registers views that contradict the view graph.
    pub fn finish(&mut self) -> Result<(), MapperError> {
        self.correct_pose_outliers()?;
        self.close_loops()?;
        self.adjust_until_converged()?;
        self.review_views()?;
        self.correct_pose_outliers()?;
        if self.has_unregistered {
            self.adjust_until_converged()?;
        }
        self.num_infinite = self.map.reject_infinite_points();
        self.drop_unsupported_views()?;
        self.num_infinite += self.map.reject_infinite_points();
        self.estimate_focal_std()
    }

    /// Estimates the standard deviation of the focal length of the final map.
    fn estimate_focal_std(&mut self) -> Result<(), MapperError> {
        let Some(sigma_px) = self.map.noise() else { return Ok(()) };
        for camera in focal_length::evaluated_cameras(&self.map) {
            // A fixed principal point with an error shifts the focal length.
            let freedom = match self.freedom {
                Freedom::WithPrincipalPoint => Freedom::FocalAndRadial,
                _ => Freedom::WithPrincipalPoint,
            };
            let evidence = focal_length::focal_evidence(&self.map, &[camera], freedom, sigma_px, self.options)?;
            tracing::debug!("focal length of camera {camera}: {evidence:?}");
            self.focal_deviations[camera] = Some(evidence.std(self.map.known.of(camera).focal));
        }
        Ok(())
    }

    /// Adjusts the whole map until its observations converge.
    ///
    /// A last adjustment of the remaining observations puts cameras and points at the minimum of exactly these.
    fn adjust_until_converged(&mut self) -> Result<(), MapperError> {
        self.noise = None;
        self.choose_intrinsics()?;
        // A bound where observations keep changing.
        for _ in 0..3 {
            // Limits of the last round: wide ones would add all outliers again.
            let limits = self.limits();
            self.map.triangulate_all(&limits);
            self.map.update_observations(&limits);
            self.adjust(&Scope::Coarse, self.freedom)?;
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

    /// Chooses the free intrinsics once, if any are unknown, on the points of the grown map.
    fn choose_intrinsics(&mut self) -> Result<(), MapperError> {
        let unknown: Vec<usize> = self.map.unknown_cameras().collect();
        if unknown.is_empty() || self.intrinsics_chosen {
            return Ok(());
        }
        self.noise = self.map.noise();
        let limits = self.limits();
        self.map.update_observations(&limits);
        self.freedom = self.final_freedom(&unknown)?;
        self.intrinsics_chosen = true;
        Ok(())
    }

    /// Intrinsics that the motion determines, the same for all unknown cameras.
    ///
    /// The noise must be known and outliers must be rejected.
    ///
    /// Where the focal length itself is weakly determined, as on a single flight looking straight down, a second
    /// distortion coefficient and the principal point would absorb unmodeled effects (a rolling shutter) and bend the
    /// map: they return to the initial values.
    fn final_freedom(&mut self, unknown: &[usize]) -> Result<Freedom, MapperError> {
        let Some(sigma_px) = self.noise else { return Ok(Freedom::initial(&self.map)) };
        let std = match *unknown {
            [camera] => focal_length::linearized_focal_std(&self.map, camera, sigma_px, self.options)?,
            _ => {
                let freedom = Freedom::FocalAndRadial;
                focal_length::focal_evidence(&self.map, unknown, freedom, sigma_px, self.options)?.fully_correlated
            }
        };
        let known = unknown.iter().map(|&camera| self.map.known.of(camera).focal).fold(0.0, f64::max);
        let std = (std.powi(-2) + known.powi(-2)).sqrt().recip();
        tracing::debug!("focal length known to {:.3} %", 100.0 * std);
        if std <= MAX_FOCAL_STD {
            return Ok(Freedom::WithPrincipalPoint);
        }
        let gain = focal_length::first_radial_gain(&self.map, sigma_px, self.options)?;
        tracing::debug!("gain of the first distortion coefficient: {gain:.1}");
        unknown.iter().for_each(|&camera| self.map.cameras[camera].radial = self.map.guess[camera].radial);
        // The noise was that of other intrinsics.
        self.noise = None;
        // Three standard deviations.
        Ok(if gain > 9.0 { Freedom::FocalAndFirstRadial } else { Freedom::Focal })
    }

    /// Unregisters the views that contradict others, and tries to register them again.
    fn review_views(&mut self) -> Result<(), MapperError> {
        let num_registered = self.map.num_registered();
        // Fewer cannot outvote one.
        if num_registered < 4 {
            return Ok(());
        }
        let graph = ViewGraph::new(&self.map, self.thresholds_of_pairs(), self.seed);
        let verdicts = graph.verdicts(&self.map, None);
        let wrong = view_graph::contradicted(verdicts.clone());
        // If a third is wrong, the wrong ones cannot be identified.
        if wrong.is_empty() || 3 * wrong.len() > num_registered {
            return Ok(());
        }
        self.unregister_views(&wrong);
        self.adjust_globally()?;
        for &view in &wrong {
            let contradicting = contradicting_views(&verdicts, view);
            if self.register_again(view, &contradicting, &graph) {
                self.update_after(view)?;
            }
            tracing::debug!(
                "{} contradicted {} others; registered again: {}",
                self.map.table.views[view].name,
                contradicting.len(),
                self.map.poses[view].is_some()
            );
        }
        Ok(())
    }

    /// Unregisters some views; their points are triangulated again from the other views.
    pub(super) fn unregister_views(&mut self, views: &[usize]) {
        self.has_unregistered = true;
        self.noise = None;
        views.iter().for_each(|&view| self.map.unregister(view));
        let untouched: Vec<bool> =
            self.map.tracks.iter().map(|t| t.iter().all(|f| !views.contains(&(f.view as usize)))).collect();
        self.map.retriangulate(&self.limits(), &untouched);
    }

    /// Thresholds of the agreement between pairs of views and the map.
    ///
    /// Frames of a video are registered next to their neighbors in time, and need less.
    fn thresholds_of_pairs(&self) -> Thresholds {
        let max_error_px = self.options.max_pose_error_px;
        // Four σ and at least half a pixel: a two-view geometry has an error of its own, besides the noise.
        let of_noise = |sigma_px: f64| (4.0 * sigma_px).max(0.5).min(max_error_px);
        let fine_px = self.map.noise().filter(|_| !self.options.ordered).map(of_noise);
        Thresholds { max_error_px, fine_px }
    }

    /// Registers a view from the points of the contradicting views, from all points, or near the interpolated pose.
    ///
    /// The pose with the most points for it is taken, unless as many are against it.
    fn register_again(&mut self, view: usize, contradicting: &[usize], graph: &ViewGraph) -> bool {
        let all = self.map.visible(view);
        let of_contradicting: Vec<Slot> =
            all.iter().copied().filter(|s| self.is_observed_by(s, contradicting)).collect();
        let mut best: Option<(Resection, Vec<Slot>, usize)> = None;
        self.failed[view] = Some(Reason::Contradicted { agreeing: 0, contradicting: 0 });
        let interpolated = self.interpolated(view).filter(|_| self.options.ordered);
        for (slots, start) in [(of_contradicting, None), (all.clone(), None), (all, interpolated)] {
            let found = self.resect(view, &slots, start);
            let Some(found) = found.filter(|r| r.inliers.len() >= self.options.min_resection_inliers) else { continue };
            self.map.poses[view] = Some(found.cam_from_world);
            let (num_for, num_against) = view_graph::balance(&graph.verdicts(&self.map, Some(view)), view);
            self.map.poses[view] = None;
            if num_for > num_against && best.as_ref().is_none_or(|(_, _, most)| num_for > *most) {
                best = Some((found, slots, num_for));
            } else if best.is_none() {
                self.failed[view] = Some(Reason::Contradicted { agreeing: num_for, contradicting: num_against });
            }
        }
        let Some((found, slots, _)) = best else { return false };
        self.set_pose(view, &found, &slots);
        true
    }

    fn is_observed_by(&self, slot: &Slot, views: &[usize]) -> bool {
        self.map.observations(slot.track as usize).any(|(_, view, _)| views.contains(&view))
    }

    /// Unregisters views with too few observations after filtering.
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

/// Views whose pairs with a view contradict it.
fn contradicting_views(verdicts: &[PairVerdict], view: usize) -> Vec<usize> {
    let against = verdicts.iter().filter(|o| o.contradicting > 0 && o.views.contains(&view));
    against.map(|o| o.views[0] + o.views[1] - view).collect()
}
