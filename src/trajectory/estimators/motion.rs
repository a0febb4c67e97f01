//! Motion of a camera and of the observed object: the data of the estimators that use whole trajectories.
//!
//! With the object's reference point o, the center of its points, and
//!
//! ```text
//! v_i = R_i(b)ᵀ R_i(o) (o − c_i(o)),    o_i(r) = c_i + r v_i,
//! ```
//!
//! a wrong ratio r′ = k r gives the path (1 − k) c + k o: every wrong path is a blend of the true one and the camera's.
//! All criteria require a property that the blend lacks, and are blind where the camera's own path has it.

use nalgebra::{Matrix3, Point3, Vector3};

use super::Estimate;
use crate::math::{JACKKNIFE_GROUPS, centroid, jackknife_groups, jackknife_std, median, quantile, quantile_range};
use crate::trajectory::{ScaleError, View, Views};

/// Minimum number of frames: two for each group of the jackknife.
const MIN_FRAMES: usize = 2 * JACKKNIFE_GROUPS;

/// Size of a vector below which it is rounding, relative to the distance from camera to object: model files may be in
/// single precision.
const ROUNDING: f64 = 1e-6;

/// Motion of camera and object over frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Motion {
    /// t_i: frame indices in units of the median step, ascending.
    pub(super) times: Vec<f64>,
    /// c_i: camera centers.
    pub(super) centers: Vec<Vector3<f64>>,
    /// v_i: from the camera to the reference point, in axes of the background and units of the object.
    pub(super) offsets: Vec<Vector3<f64>>,
    /// R_i(b)ᵀ R_i(o): rotations from the object's axes to those of the background.
    pub(super) rotations: Vec<Matrix3<f64>>,
    /// n_i: normals of the local planes.
    pub(super) normals: Vec<Vector3<f64>>,
    /// h_i: heights of the camera over the planes.
    pub(super) heights: Vec<f64>,
    /// Standard deviations of the planes' heights.
    pub(super) height_stds: Vec<f64>,
    /// Smallest n · v of a frame over all points of the object.
    pub(super) lowest: Vec<f64>,
    /// Height of the object over the plane of the middle frame: between the 2 and 98 % quantiles of its points.
    pub(super) object_height: f64,
    /// Length of the object: twice the distance from the reference point within which 95 % of its points are.
    pub(super) length: f64,
}

impl Motion {
    /// Motion of the object in its views.
    ///
    /// # Errors
    /// [`ScaleError`] for too few views or no points.
    pub(super) fn new(views: &Views) -> Result<Self, ScaleError> {
        views.require(MIN_FRAMES)?;
        let middle = centroid(&views.points);
        let mut motion = Self { length: length(&views.points, &middle), ..Self::default() };
        let offsets = |view: &View| -> Vec<f64> { views.points.iter().map(|point| view.offset(point)).collect() };
        for view in &views.views {
            let rotation = view.background_from_object;
            let lowest = offsets(view).into_iter().reduce(f64::min);
            motion.times.push(f64::from(view.frame.0));
            motion.centers.push(view.center_in_background.coords);
            motion.offsets.push(rotation * (middle - view.center_in_object));
            motion.rotations.push(rotation.to_rotation_matrix().into_inner());
            motion.normals.push(rotation * view.normal_in_object);
            motion.heights.push(view.camera_height);
            motion.height_stds.push(view.height_std);
            motion.lowest.push(lowest.unwrap_or(f64::NAN));
        }
        let levels = quantile_range(&mut offsets(&views.views[views.views.len() / 2]), 0.02);
        motion.object_height = levels.map_or(0.0, |[low, high]| high - low);
        let step = median(motion.times.windows(2).map(|pair| pair[1] - pair[0]).collect()).unwrap_or(1.0);
        motion.times.iter_mut().for_each(|time| *time /= step);
        Ok(motion)
    }

    pub(super) fn len(&self) -> usize {
        self.times.len()
    }

    /// Pairs of frames that are `step` median steps apart.
    pub(super) fn pairs(&self, step: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        (0..self.len()).filter_map(move |first| {
            let wanted = self.times[first] + step as f64;
            let second = (first + 1..self.len().min(first + step + 1)).find(|&k| self.times[k] >= wanted - 0.5)?;
            (self.times[second] <= wanted + 0.5).then_some((first, second))
        })
    }

    /// Ratio by contact of the lowest points, the median over the frames; the other criteria search around it.
    pub(super) fn contact(&self) -> Result<f64, ScaleError> {
        let ratios = self.heights.iter().zip(&self.lowest).map(|(height, lowest)| -height / lowest);
        let ratios = ratios.filter(|ratio| ratio.is_finite() && *ratio > 0.0).collect();
        median(ratios).ok_or(ScaleError::NoIntersection { num_views: self.len() })
    }

    /// Median distance from camera to object, in units of the object.
    pub(super) fn distance(&self) -> f64 {
        median(self.offsets.iter().map(Vector3::norm).collect()).unwrap_or(0.0)
    }

    /// r that minimizes Σ |a_i + r b_i|², for vectors (or components) linear in r: r = −Σ a · b / Σ b · b.
    ///
    /// Noise of b biases r towards 0, as in every regression with errors in the variables.
    pub(super) fn least_squares<const D: usize>(&self, terms: &[[[f64; D]; 2]]) -> Result<f64, ScaleError> {
        let dot = |x: &[f64; D], y: &[f64; D]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let ab: f64 = terms.iter().map(|[a, b]| dot(a, b)).sum();
        let bb: f64 = terms.iter().map(|[_, b]| dot(b, b)).sum();
        let rounding = ROUNDING * self.distance();
        if !(bb > rounding * rounding * terms.len() as f64) {
            return Err(ScaleError::Undetermined("the motion leaves nothing to compare"));
        }
        positive(-ab / bb)
    }

    /// The motion without the frames of a range.
    fn without(&self, removed: std::ops::Range<usize>) -> Self {
        let mut rest = self.clone();
        for numbers in [&mut rest.times, &mut rest.heights, &mut rest.height_stds, &mut rest.lowest] {
            numbers.drain(removed.clone());
        }
        for vectors in [&mut rest.centers, &mut rest.offsets, &mut rest.normals] {
            vectors.drain(removed.clone());
        }
        rest.rotations.drain(removed);
        rest
    }

    /// Estimate with its standard deviation by a jackknife of log r.
    ///
    /// # Errors
    /// [`ScaleError`] if the motion, or that of a part of the clip, leaves the ratio undetermined.
    pub(super) fn jackknifed(&self, of: impl Fn(&Self) -> Result<f64, ScaleError>) -> Result<Estimate, ScaleError> {
        let ratio = of(self)?;
        let groups = jackknife_groups(self.len());
        let logs: Result<Vec<f64>, ScaleError> = groups.map(|group| Ok(of(&self.without(group))?.ln())).collect();
        let logs = logs.map_err(|_| ScaleError::Undetermined("no solution without a part of the clip"))?;
        Ok(Estimate::new(ratio, jackknife_std(&logs).map(|std| ratio * std)))
    }
}

/// The ratio, if it is positive and finite.
pub(super) fn positive(ratio: f64) -> Result<f64, ScaleError> {
    match ratio.is_finite() && ratio > 0.0 {
        true => Ok(ratio),
        false => Err(ScaleError::Undetermined("the solution is not positive")),
    }
}

/// Vectors minus their mean.
pub(super) fn centered(vectors: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mean = vectors.iter().sum::<Vector3<f64>>() / vectors.len() as f64;
    vectors.iter().map(|vector| vector - mean).collect()
}

/// Length of an object: twice the quantile of its points' distances from their center, which excludes stray points.
fn length(points: &[Point3<f64>], middle: &Point3<f64>) -> f64 {
    let mut distances: Vec<f64> = points.iter().map(|point| (point - middle).norm()).collect();
    2.0 * quantile(&mut distances, 0.95).unwrap_or(0.0)
}
