//! At which height of its own a vehicle stands on the ground.
//!
//! The points of a reconstruction do not reach down to the ground: tyres are black and turn. But the outline of the
//! vehicle does. Seen from the side, the lower edge of a mask is the line through the two tyres nearest to the camera,
//! and the tyres stand flush with the body's lower parts, whose points are there. So the ground lies where those
//! points, moved straight down, touch that line.

mod silhouette;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use nalgebra::{Point3, Unit, Vector2, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::silhouette::Silhouette;
#[cfg(test)]
pub(super) use self::silhouette::convex_hull;

use crate::checks::{Checked, OptionError, within};
use crate::math::{centroid, median, quantile, quantile_range};
use crate::scene::{FrameId, Image, Reconstruction};

/// Dimensions of a vehicle's lower body; lengths are shares of the height over which its points spread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ContactOptions {
    /// Observations that a point needs to count.
    #[schemars(extend("unit" = "observations"))]
    pub min_track: usize,
    /// Median absolute deviations from the median beyond which a point does not count, along any axis.
    #[schemars(extend("unit" = "median absolute deviations"))]
    pub max_deviation: f64,
    /// Sine of the most angle between the line of sight, seen from above, and the vehicle's axis, up to which the
    /// vehicle is seen from the front or the rear.
    #[schemars(extend("unit" = "sine"))]
    pub most_end_view: f64,
    /// Fewest frames that show a side, or an end.
    #[schemars(extend("unit" = "frames"))]
    pub min_frames: usize,
    /// Share of the frames that gives the contact: those with the smallest standard deviation.
    #[schemars(extend("unit" = "share"))]
    pub best_share: f64,
    /// Setback of the tires from the lower points of the side, and its standard deviation.
    #[schemars(extend("unit" = "shares of the height: mean, standard deviation"))]
    pub side: [f64; 2],
    /// Distance of the tires from the front or the rear, and its standard deviation.
    #[schemars(extend("unit" = "shares of the height: mean, standard deviation"))]
    pub overhang: [f64; 2],
    /// Height of the lowest points over the ground where no outline shows it, and its standard deviation.
    #[schemars(extend("unit" = "shares of the height: mean, standard deviation"))]
    pub lowest: [f64; 2],
}

impl Default for ContactOptions {
    /// Of rendered sequences with five vehicles; see decisions 6, 13, 19 and 37.
    fn default() -> Self {
        Self {
            min_track: 6,
            max_deviation: 6.0,
            min_frames: 5,
            best_share: 0.5,
            side: [0.04, 0.02],
            most_end_view: 0.26,
            overhang: [0.75, 0.25],
            lowest: [0.17, 0.07],
        }
    }
}

impl ContactOptions {
    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("min_track", self.min_track, 2..=1_000_000)?;
        within("max_deviation", self.max_deviation, 0.1..=1000.0)?;
        within("min_frames", self.min_frames, 1..=1_000_000)?;
        within("best_share", self.best_share, 0.01..=1.0)?;
        within("most_end_view", self.most_end_view, 0.0..=1.0)?;
        check_height("side", self.side)?;
        check_height("overhang", self.overhang)?;
        check_height("lowest", self.lowest)
    }
}

/// A height and its standard deviation, both as shares of the vehicle's own height; known exactly it would outweigh
/// all.
fn check_height(key: &str, [mean, std]: [f64; 2]) -> Checked {
    let inside = |checked: Checked, which| checked.map_err(|e| OptionError::new(key, format!("{which}: {}", e.reason)));
    inside(within(key, mean, -1.0..=1.0), "mean")?;
    inside(within(key, std, 1e-6..=10.0), "the standard deviation")
}

/// The lowest part of the points, which represents the outline on the ground, as a share of the height.
const LOWEST_PART: f64 = 0.3;
/// Share of these up to the outermost of a side: a mirror or a stray point is further out.
const OUTERMOST: f64 = 0.95;
/// Sine of the least angle between the line of sight, seen from above, and the vehicle's axis.
const LEAST_SIDE_VIEW: f64 = 0.5;
/// Distance from the outermost lower points within which the others of that side lie, as a share of the height: noise
/// moves the outermost 0.05 to 0.21 out on rendered cars (decision 37).
const SIDE_DEPTH: f64 = 0.2;

/// Where the ground is, in the frame of a reconstruction whose z axis points up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Its height.
    pub z: f64,
    /// Standard deviation of that.
    pub std: f64,
    /// Frames whose outline shows it; 0 where it is guessed from the lowest points.
    pub num_frames: usize,
}

impl Contact {
    /// The same, as if it were known a thousand times better.
    pub(super) fn known(&self) -> Self {
        Self { std: 1e-3 * self.std, ..*self }
    }
}

/// The points that count for extent and outline.
pub(super) fn solid_points(object: &Reconstruction, options: &ContactOptions) -> Vec<Point3<f64>> {
    // Of an object that is seen for a moment there is nothing better than what is seen longest.
    let longest = object.points.values().map(|point| point.track.len()).max().unwrap_or(0);
    let min_track = options.min_track.min(longest);
    object.solid_points(min_track, options.max_deviation)
}

/// Finds the ground under a vehicle; `None` for a model without points that count.
///
/// * `object` – the reconstruction, z axis up.
/// * `forward` – the vehicle's forward direction; without it only the lowest points are left to go by.
pub fn contact(
    object: &Reconstruction,
    silhouettes: &BTreeMap<FrameId, Silhouette>,
    forward: Option<Unit<Vector3<f64>>>,
    options: &ContactOptions,
) -> Option<Contact> {
    let points = solid_points(object, options);
    let mut heights: Vec<f64> = points.iter().map(|p| p.z).collect();
    let [low, high] = quantile_range(&mut heights, 0.01)?;
    let extent = high - low;
    let limit = low + LOWEST_PART * extent;
    let feet: Vec<Point3<f64>> = points.iter().filter(|p| p.z < limit).copied().collect();
    let center = centroid(&points);
    let view = LowerEdge { object, feet: &feet, middle: Point3::new(center.x, center.y, low), extent, options };
    let ahead = forward.and_then(|forward| Vector3::new(forward.x, forward.y, 0.0).try_normalize(1e-3));
    let lowest = Contact { z: low - options.lowest[0] * extent, std: options.lowest[1] * extent, num_frames: 0 };
    let Some(ahead) = ahead else { return Some(lowest) };
    let seen: Vec<(&Image, &Silhouette)> =
        object.images.iter().filter_map(|(id, image)| Some((image, silhouettes.get(&id.frame())?))).collect();
    let seen = view.not_hidden(seen);
    let across = Vector3::new(-ahead.y, ahead.x, 0.0);
    let sine = |sight: &Vector2<f64>| sight.perp(&ahead.xy()).abs();
    // The two tires of the side that is seen, else those of the front or the rear.
    let shows_side = |sight: &Vector2<f64>| sine(sight) >= LEAST_SIDE_VIEW;
    let shows_end = |sight: &Vector2<f64>| sine(sight) <= options.most_end_view;
    let of_side = view.below_tyres(&seen, shows_side, [&ahead, &across], options.side);
    let of_end = || view.below_tyres(&seen, shows_end, [&across, &ahead], options.overhang);
    Some(of_side.or_else(|| of_end().filter(|contact| contact.std <= lowest.std)).unwrap_or(lowest))
}

/// Lower edge of an object in every frame.
struct LowerEdge<'a> {
    object: &'a Reconstruction,
    /// The lowest points.
    feet: &'a [Point3<f64>],
    /// The middle of the vehicle, as low as its points go.
    middle: Point3<f64>,
    /// The height over which its points spread.
    extent: f64,
    options: &'a ContactOptions,
}

impl LowerEdge<'_> {
    /// By how many pixels the lower edge of a mask is off, in all frames alike: shadows.
    const MASK_PX: f64 = 1.0;

    /// The frames in which the lowest points lie within the outline, which in others something before them has cut; all
    /// where these are too few.
    fn not_hidden<'a>(&self, seen: Vec<(&'a Image, &'a Silhouette)>) -> Vec<(&'a Image, &'a Silhouette)> {
        let shows_feet = |(image, outline): &&(&Image, &Silhouette)| {
            let camera = self.object.camera_of(image);
            let pixel = |foot: &&Point3<f64>| camera.pixel_from_cam(image.cam_from_world * **foot);
            let is_inside = |foot: &&Point3<f64>| pixel(foot).is_some_and(|p| outline.contains(p, Self::MASK_PX));
            let num_inside = self.feet.iter().filter(is_inside).count();
            // Share of the lowest points that lie within an outline which shows them.
            num_inside as f64 >= 0.9 * self.feet.len() as f64
        };
        let clear: Vec<_> = seen.iter().filter(shows_feet).copied().collect();
        if clear.len() >= self.options.min_frames { clear } else { seen }
    }

    /// The ground below two tyres on a line along the first axis, which stand back along the second from the points of
    /// that side by a share of the height, in the frames that show them; `None` where these are too few. The surest of
    /// them say it: those that look flat, so that the setback hardly matters, and from near.
    fn below_tyres(
        &self,
        seen: &[(&Image, &Silhouette)],
        shows: impl Fn(&Vector2<f64>) -> bool,
        [line, away]: [&Vector3<f64>; 2],
        [setback, setback_std]: [f64; 2],
    ) -> Option<Contact> {
        let mut found: Vec<(f64, f64)> = Vec::new();
        let sides = [*away, -away].map(|back| (self.side(&-back, line), back));
        for (image, outline) in seen {
            let Some(sight) = self.sight(image).filter(&shows) else { continue };
            let (feet, back) = &sides[usize::from(sight.dot(&away.xy()) < 0.0)];
            let below = |setback: f64| self.ground(image, outline, line, feet, &(back * (setback * self.extent)));
            let (Some(z), Some(other)) = (below(setback), below(setback + setback_std)) else { continue };
            let pixel =
                (self.middle - image.cam_from_world.center()).norm() / self.object.camera_of(image).mean_focal();
            found.push((z, (other - z).hypot(Self::MASK_PX * pixel)));
        }
        let num_frames = found.len();
        found.sort_by(|a, b| a.1.total_cmp(&b.1));
        found.truncate(((self.options.best_share * num_frames as f64).ceil() as usize).max(self.options.min_frames));
        let (heights, stds): (Vec<f64>, Vec<f64>) = found.into_iter().unzip();
        let z = median(heights).filter(|_| num_frames >= self.options.min_frames)?;
        Some(Contact { z, std: median(stds)?, num_frames })
    }

    /// The lowest points of the side, or the end, that faces a direction and runs along a line, without those around
    /// its corners. The outermost of them alone would be where noise has moved them, further than tires are set back.
    fn side(&self, outward: &Vector3<f64>, line: &Vector3<f64>) -> Vec<Point3<f64>> {
        let outermost = |direction: &Vector3<f64>| {
            let mut offsets: Vec<f64> = self.feet.iter().map(|foot| direction.dot(&foot.coords)).collect();
            quantile(&mut offsets, OUTERMOST).unwrap_or(f64::NEG_INFINITY)
        };
        let edges = [*outward, *line, -line].map(|direction| (direction, outermost(&direction)));
        let depth = |foot: &Point3<f64>, k: usize| (edges[k].1 - edges[k].0.dot(&foot.coords)) / self.extent;
        let all: Vec<Point3<f64>> = self.feet.iter().filter(|foot| depth(foot, 0) <= SIDE_DEPTH).copied().collect();
        let is_inside = |foot: &&Point3<f64>| [1, 2].iter().all(|k| depth(foot, *k) > SIDE_DEPTH);
        let middle: Vec<Point3<f64>> = all.iter().filter(is_inside).copied().collect();
        // Fewest points of a side away from its corners that say where it is.
        if middle.len() >= 10 { middle } else { all }
    }

    /// Unit direction from the camera to the vehicle, seen from above.
    fn sight(&self, image: &Image) -> Option<Vector2<f64>> {
        let sight = self.middle - image.cam_from_world.center();
        Vector2::new(sight.x, sight.y).try_normalize(f64::EPSILON)
    }

    /// The height at which the feet, moved by `shift`, touch the outline's lower edge, which runs along `axis`.
    fn ground(
        &self,
        image: &Image,
        silhouette: &Silhouette,
        axis: &Vector3<f64>,
        feet: &[Point3<f64>],
        shift: &Vector3<f64>,
    ) -> Option<f64> {
        let camera = self.object.camera_of(image);
        let undistorted = |point: Point3<f64>| {
            let p = image.cam_from_world * point;
            (p.z > 0.0).then(|| Vector2::new(p.x / p.z, p.y / p.z))
        };
        let step = 1e-3 * (self.middle - image.cam_from_world.center()).norm();
        let along = undistorted(self.middle + axis * step)? - undistorted(self.middle - axis * step)?;
        let down = undistorted(self.middle - Vector3::z() * step)? - undistorted(self.middle)?;
        let across = Vector2::new(-along.y, along.x).try_normalize(f64::EPSILON)?;
        let u = if across.dot(&down) < 0.0 { -across } else { across };
        let corners = silhouette.hull.iter().map(|corner| u.dot(&camera.normalized_from_pixel(*corner)));
        let support = corners.fold(f64::NEG_INFINITY, f64::max) + Silhouette::BORDER_PX / camera.mean_focal();
        // u · (x, y) / z = support is linear in the height: the plane through the camera and the edge.
        let plane = Vector3::new(u.x, u.y, -support);
        let slope = plane.dot(&(image.cam_from_world.rotation * Vector3::z()));
        let touching = |foot: &Point3<f64>| {
            let level = Point3::new(foot.x, foot.y, 0.0);
            -plane.dot(&(image.cam_from_world * (level + shift)).coords) / slope
        };
        median(feet.iter().map(touching).collect()).filter(|z| z.is_finite())
    }
}
