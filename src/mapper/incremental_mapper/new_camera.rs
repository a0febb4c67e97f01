//! Registration of the first view of a camera with unknown focal length in an existing map.
//!
//! Three points determine a pose for any focal length, but only the right one has many inliers. So resection is tried
//! at several focal lengths, up to two prior standard deviations to either side, and again near the best one. The
//! adjustment that follows refines it.

use super::{IncrementalMapper, MAX_FOCAL_STD};
use crate::camera::Camera;
use crate::geometry::resection::{self, PixelsAndPoints, Resection};
use crate::mapper::map::Slot;
use crate::math::seeded_rng;

/// Number of focal lengths on either side of the initial one.
const STEPS: i32 = 6;

impl IncrementalMapper<'_> {
    /// Number of registered views of a view's camera; `None` if its focal length is known well enough for resection.
    pub(super) fn num_views_of_uncertain_camera(&self, view: usize) -> Option<usize> {
        let camera = self.map.table.views[view].camera;
        (self.map.known.of(camera).focal > MAX_FOCAL_STD).then(|| self.map.num_views_of_cameras()[camera])
    }

    /// Registers the first view of such a camera with the focal length that has the most inliers.
    pub(super) fn register_with_focal(&mut self, view: usize) -> bool {
        let visible = self.map.visible(view);
        let camera = self.map.table.views[view].camera;
        let guess = self.map.guess[camera];
        let found = self.pose_and_focal(view, &visible, &guess);
        let (found, scaled) = found.map_or((None, guess), |(resection, camera)| (Some(resection), camera));
        self.map.cameras[camera] = scaled;
        let registered = self.accept(view, &visible, found);
        if !registered {
            self.map.cameras[camera] = guess;
        }
        registered
    }

    fn pose_and_focal(&self, view: usize, visible: &[Slot], guess: &Camera) -> Option<(Resection, Camera)> {
        let prior_std = self.map.known.of(self.map.table.views[view].camera).focal;
        let step = 2.0 * prior_std / f64::from(STEPS);
        let (pixels, points) = self.map.pixels_and_points(visible);
        let at = |change: f64| {
            let camera = Camera { focal: guess.focal.map(|f| f * change.exp()), ..*guess };
            let data = PixelsAndPoints { camera: &camera, pixels: &pixels, points: &points };
            let mut rng = seeded_rng(self.seed, view as u64);
            let found = resection::estimate(&data, self.options.max_pose_error_px, &mut rng)?;
            Some((change, found, camera))
        };
        // The most inliers; of equals, the focal length nearest to the initial one.
        let best = |changes: Vec<f64>| {
            changes.into_iter().filter_map(at).max_by(|(a, found_a, _), (b, found_b, _)| {
                found_a.inliers.len().cmp(&found_b.inliers.len()).then(b.abs().total_cmp(&a.abs()))
            })
        };
        let (rough, ..) = best((-STEPS..=STEPS).map(|k| f64::from(k) * step).collect())?;
        let fine = (-2..=2).map(|k| rough + f64::from(k) * step / 3.0).collect();
        best(fine).map(|(_, found, camera)| (found, camera))
    }
}
