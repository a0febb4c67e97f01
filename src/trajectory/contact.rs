//! Height of the ground relative to a vehicle, from its contact points.
//!
//! The points of a reconstruction do not reach down to the ground: tires are black and turn. But the outline of the
//! vehicle does. In a side view the lower edge of a mask is the line through the two tires nearest to the camera, and
//! the tires are flush with the lower parts of the body, which have points. The ground is therefore at the height at
//! which those points, moved vertically down, touch that line.

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

/// Dimensions of a vehicle's lower body; lengths are shares of the vertical extent of its points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ContactOptions {
    /// Minimum number of observations of a point that is used.
    #[schemars(extend("unit" = "observations"))]
    pub min_track: usize,
    /// Median absolute deviations from the median, along any axis, beyond which a point is not used.
    #[schemars(extend("unit" = "median absolute deviations"))]
    pub max_deviation: f64,
    /// Sine of the maximum horizontal angle between the line of sight and the vehicle's axis for a view of the front or
    /// the rear.
    #[schemars(extend("unit" = "sine"))]
    pub most_end_view: f64,
    /// Minimum number of frames that show a side, or an end.
    #[schemars(extend("unit" = "frames"))]
    pub min_frames: usize,
    /// Share of the frames used for the contact: those with the smallest standard deviation.
    #[schemars(extend("unit" = "share"))]
    pub best_share: f64,
    /// Setback of the tires from the lower points of the side, and its standard deviation.
    #[schemars(extend("unit" = "shares of the height: mean, standard deviation"))]
    pub side: [f64; 2],
    /// Distance of the tires from the front or the rear, and its standard deviation.
    #[schemars(extend("unit" = "shares of the height: mean, standard deviation"))]
    pub overhang: [f64; 2],
    /// Height of the lowest points above the ground where no outline determines it, and its standard deviation.
    #[schemars(extend("unit" = "shares of the height: mean, standard deviation"))]
    pub lowest: [f64; 2],
}

impl Default for ContactOptions {
    /// From rendered sequences with five vehicles; see decisions 6, 13, 19 and 37.
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
    /// Rejects unusable values.
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

/// Checks a height and its standard deviation, both as shares of the vehicle's height. A standard deviation of zero
/// would outweigh everything else.
fn check_height(key: &str, [mean, std]: [f64; 2]) -> Checked {
    let inside = |checked: Checked, which| checked.map_err(|e| OptionError::new(key, format!("{which}: {}", e.reason)));
    inside(within(key, mean, -1.0..=1.0), "mean")?;
    inside(within(key, std, 1e-6..=10.0), "the standard deviation")
}

/// Share of the height, from the bottom, whose points represent the outline on the ground.
const LOWEST_PART: f64 = 0.3;
/// Quantile of these points that is the outermost of a side: a mirror or a stray point is farther out.
const OUTERMOST: f64 = 0.95;
/// Sine of the minimum horizontal angle between the line of sight and the vehicle's axis for a side view.
const LEAST_SIDE_VIEW: f64 = 0.5;
/// Maximum distance of the points of a side from the outermost lower points, as a share of the height: noise moves the
/// outermost 0.05 to 0.21 outward on rendered cars (decision 37).
const SIDE_DEPTH: f64 = 0.2;

/// Height of the ground in the frame of a reconstruction whose z axis points up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The height.
    pub z: f64,
    /// Its standard deviation.
    pub std: f64,
    /// Frames whose outline determines it; 0 where it is assumed from the lowest points.
    pub num_frames: usize,
}

impl Contact {
    /// The same with a thousandth of the standard deviation.
    pub(super) fn known(&self) -> Self {
        Self { std: 1e-3 * self.std, ..*self }
    }
}

/// Reliable points, for extent and outline.
pub(super) fn solid_points(object: &Reconstruction, options: &ContactOptions) -> Vec<Point3<f64>> {
    // For an object that is visible for a moment only, the points observed longest are the best available.
    let longest = object.points.values().map(|point| point.track.len()).max().unwrap_or(0);
    let min_track = options.min_track.min(longest);
    object.solid_points(min_track, options.max_deviation)
}

/// Estimates the height of the ground under a vehicle; `None` for a model without reliable points.
///
/// * `object` – the reconstruction, z axis up.
/// * `forward` – the vehicle's forward direction; without it only the lowest points are used.
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
    let low_points: Vec<Point3<f64>> = points.iter().filter(|p| p.z < limit).copied().collect();
    let center = centroid(&points);
    let view =
        LowerEdge { object, low_points: &low_points, middle: Point3::new(center.x, center.y, low), extent, options };
    let ahead = forward.and_then(|forward| Vector3::new(forward.x, forward.y, 0.0).try_normalize(1e-3));
    let lowest = Contact { z: low - options.lowest[0] * extent, std: options.lowest[1] * extent, num_frames: 0 };
    let Some(ahead) = ahead else { return Some(lowest) };
    let seen: Vec<(&Image, &Silhouette)> =
        object.images.iter().filter_map(|(id, image)| Some((image, silhouettes.get(&id.frame())?))).collect();
    let seen = view.unoccluded(seen);
    let across = Vector3::new(-ahead.y, ahead.x, 0.0);
    let sine = |view_direction: &Vector2<f64>| view_direction.perp(&ahead.xy()).abs();
    // The two tires of the visible side, else those of the front or the rear.
    let shows_side = |view_direction: &Vector2<f64>| sine(view_direction) >= LEAST_SIDE_VIEW;
    let shows_end = |view_direction: &Vector2<f64>| sine(view_direction) <= options.most_end_view;
    let of_side = view.below_tires(&seen, shows_side, [&ahead, &across], options.side);
    let of_end = || view.below_tires(&seen, shows_end, [&across, &ahead], options.overhang);
    Some(of_side.or_else(|| of_end().filter(|contact| contact.std <= lowest.std)).unwrap_or(lowest))
}

/// Lower edge of an object in every frame.
struct LowerEdge<'a> {
    object: &'a Reconstruction,
    /// The lowest points.
    low_points: &'a [Point3<f64>],
    /// Horizontal center of the vehicle, at the height of its lowest points.
    middle: Point3<f64>,
    /// Vertical extent of its points.
    extent: f64,
    options: &'a ContactOptions,
}

impl LowerEdge<'_> {
    /// Systematic error of the lower edge of a mask in all frames, pixels: shadows.
    const MASK_PX: f64 = 1.0;

    /// Frames whose outline contains the lowest points, which are occluded in the others; all if these are too few.
    fn unoccluded<'a>(&self, seen: Vec<(&'a Image, &'a Silhouette)>) -> Vec<(&'a Image, &'a Silhouette)> {
        let shows_low_points = |(image, outline): &&(&Image, &Silhouette)| {
            let camera = self.object.camera_of(image);
            let pixel = |point: &&Point3<f64>| camera.pixel_from_cam(image.cam_from_world * **point);
            let is_inside = |point: &&Point3<f64>| pixel(point).is_some_and(|p| outline.contains(p, Self::MASK_PX));
            let num_inside = self.low_points.iter().filter(is_inside).count();
            // Minimum share of the lowest points inside an outline without occlusion.
            num_inside as f64 >= 0.9 * self.low_points.len() as f64
        };
        let clear: Vec<_> = seen.iter().filter(shows_low_points).copied().collect();
        if clear.len() >= self.options.min_frames { clear } else { seen }
    }

    /// Ground below two tires, in the frames that show them; `None` if these are too few.
    ///
    /// The tires are on a line along the first axis. Along the second axis they are set back from the points of that
    /// side by a share of the height. The frames with the smallest standard deviation determine the ground: those with
    /// a flat line of sight, for which the setback hardly matters, and near ones.
    fn below_tires(
        &self,
        seen: &[(&Image, &Silhouette)],
        shows: impl Fn(&Vector2<f64>) -> bool,
        [line, away]: [&Vector3<f64>; 2],
        [setback, setback_std]: [f64; 2],
    ) -> Option<Contact> {
        let mut found: Vec<(f64, f64)> = Vec::new();
        let sides = [*away, -away].map(|back| (self.side(&-back, line), back));
        for (image, outline) in seen {
            let Some(view_direction) = self.view_direction(image).filter(&shows) else { continue };
            let (low_points, back) = &sides[usize::from(view_direction.dot(&away.xy()) < 0.0)];
            let below = |setback: f64| self.ground(image, outline, line, low_points, &(back * (setback * self.extent)));
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

    /// Lowest points of the side, or end, that faces a direction and is parallel to a line, without those near corners.
    ///
    /// The outermost of them alone would be displaced by noise, by more than the setback of the tires.
    fn side(&self, outward: &Vector3<f64>, line: &Vector3<f64>) -> Vec<Point3<f64>> {
        let outermost = |direction: &Vector3<f64>| {
            let mut offsets: Vec<f64> = self.low_points.iter().map(|point| direction.dot(&point.coords)).collect();
            quantile(&mut offsets, OUTERMOST).unwrap_or(f64::NEG_INFINITY)
        };
        let edges = [*outward, *line, -line].map(|direction| (direction, outermost(&direction)));
        let depth = |point: &Point3<f64>, k: usize| (edges[k].1 - edges[k].0.dot(&point.coords)) / self.extent;
        let all: Vec<Point3<f64>> =
            self.low_points.iter().filter(|point| depth(point, 0) <= SIDE_DEPTH).copied().collect();
        let is_inside = |point: &&Point3<f64>| [1, 2].iter().all(|k| depth(point, *k) > SIDE_DEPTH);
        let middle: Vec<Point3<f64>> = all.iter().filter(is_inside).copied().collect();
        // Minimum number of points away from the corners to locate a side.
        if middle.len() >= 10 { middle } else { all }
    }

    /// Horizontal unit direction from the camera to the vehicle.
    fn view_direction(&self, image: &Image) -> Option<Vector2<f64>> {
        let view_direction = self.middle - image.cam_from_world.center();
        Vector2::new(view_direction.x, view_direction.y).try_normalize(f64::EPSILON)
    }

    /// Height at which the low points, moved by `shift`, touch the outline's lower edge, which is parallel to `axis`.
    fn ground(
        &self,
        image: &Image,
        silhouette: &Silhouette,
        axis: &Vector3<f64>,
        low_points: &[Point3<f64>],
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
        let touching = |point: &Point3<f64>| {
            let level = Point3::new(point.x, point.y, 0.0);
            -plane.dot(&(image.cam_from_world * (level + shift)).coords) / slope
        };
        median(low_points.iter().map(touching).collect()).filter(|z| z.is_finite())
    }
}
