//! Ozden et al.: a vehicle moves in the direction of its heading.
//!
//! K. E. Ozden, K. Cornelis, L. Van Eycken, L. Van Gool, *Reconstructing 3D independent motions using
//! non-accidentalness*, CVPR 2004: at the true scale the direction of motion is constant in the object's own frame. The
//! cost function is ours. With R_m the rotation in the middle of a step, Δ the difference over it, h the direction in
//! the object's frame and l the distance from the rear axle to the reference point (only the rear axle moves in the
//! direction of the heading),
//!
//! ```text
//! w_i = R_mᵀ (Δc_i + r Δv_i − l Δ(R_i h)),    Σ |(I − h hᵀ) w_i|²  →  min over r, h, l,
//! ```
//!
//! by Gauss–Newton from several r, with a wide prior on l, which straight motion leaves undetermined. The smallest
//! share of Σ |w_i|² wins. A step is about half of the vehicle's length: noise dominates over shorter ones.
//!
//! **Assumption**: no side slip. **Blind** where the camera moves along the vehicle's axis and the vehicle does not
//! turn.

use nalgebra::{Matrix3, Matrix4, SMatrix, Vector3, Vector4};

use super::Estimate;
use super::motion::{Motion, positive};
use crate::math::{median, svd3};
use crate::trajectory::{ScaleError, Views};

/// Distance from the rear axle to the center of the vehicle's points, and its standard deviation, as shares of the
/// vehicle's length: 1.3 m of 4.3 m; a center at one of the ends is within the standard deviation.
const AXLE: [f64; 2] = [0.3, 0.35];
/// Bounds of the ratio during the search, as factors of the initial ratio: far beyond all starting values.
const BOUNDS: [f64; 2] = [0.05, 20.0];

/// Ratio of motion along the heading.
pub(super) fn estimate(views: &Views) -> Result<Estimate, ScaleError> {
    let motion = Motion::new(views)?;
    let guess = motion.contact()?;
    let length = guess * motion.length;
    if !(length > 0.0) {
        return Err(ScaleError::Undetermined("the object has no length"));
    }
    let heading = Heading { guess, axle: AXLE.map(|share| share * length), step: step(&motion, length, guess) };
    motion.jackknifed(|motion| heading.solve(motion))
}

/// Frames of a step, at least two and at most a quarter of all: an even number, so that its middle is a frame.
fn step(motion: &Motion, length: f64, guess: f64) -> usize {
    let position = |k: usize| motion.centers[k] + guess * motion.offsets[k];
    let speed = median(motion.pairs(1).map(|(a, b)| (position(b) - position(a)).norm()).collect()).unwrap_or(0.0);
    // Half of the vehicle's length, two frames at a time.
    let wanted = 0.25 * length / speed;
    let most = (motion.len() / 8).max(1);
    2 * if wanted.is_finite() { (wanted.round() as usize).clamp(1, most) } else { most }
}

/// The criterion with its settings.
pub(super) struct Heading {
    /// Initial value of r.
    pub(super) guess: f64,
    /// Prior of l and its standard deviation, units of the background.
    pub(super) axle: [f64; 2],
    /// Frames of a step.
    pub(super) step: usize,
}

/// Step in axes of the object: Δc, Δv, and ΔR, whose product with h is the change of the heading.
struct Step {
    camera: Vector3<f64>,
    offset: Vector3<f64>,
    turn: Matrix3<f64>,
}

#[derive(Clone, Copy)]
struct State {
    ratio: f64,
    direction: Vector3<f64>,
    axle: f64,
}

/// Local minimum.
struct Minimum {
    /// Share of the motion that is not along the direction.
    share: f64,
    state: State,
}

impl Heading {
    pub(super) fn solve(&self, motion: &Motion) -> Result<f64, ScaleError> {
        let steps = self.steps(motion);
        if steps.len() < 5 {
            return Err(ScaleError::Undetermined("too few frames in a row"));
        }
        let starts = [0.5, 0.8, 1.0, 1.25, 2.0].into_iter();
        let found = starts.filter_map(|start| self.from(&steps, start * self.guess));
        let best = found.min_by(|a, b| a.share.total_cmp(&b.share));
        let ratio = best.ok_or(ScaleError::Undetermined("no direction of motion"))?.state.ratio;
        if ratio <= BOUNDS[0] * self.guess || ratio >= BOUNDS[1] * self.guess {
            return Err(ScaleError::Undetermined("the cost is least at the end of the search range"));
        }
        positive(ratio)
    }

    fn steps(&self, motion: &Motion) -> Vec<Step> {
        let middle = |first: usize| {
            let wanted = motion.times[first] + (self.step / 2) as f64;
            (first..motion.len()).find(|k| motion.times[*k] >= wanted - 0.25)
        };
        let step = |(first, last): (usize, usize)| {
            let axes = motion.rotations[middle(first)?].transpose();
            Some(Step {
                camera: axes * (motion.centers[last] - motion.centers[first]),
                offset: axes * (motion.offsets[last] - motion.offsets[first]),
                turn: axes * (motion.rotations[last] - motion.rotations[first]),
            })
        };
        motion.pairs(self.step).filter_map(step).collect()
    }

    /// Local minimum from one start.
    fn from(&self, steps: &[Step], ratio: f64) -> Option<Minimum> {
        let mut state = State { ratio, direction: main_direction(steps, ratio)?, axle: 0.0 };
        // Limit on the iterations: convergence takes fewer than ten.
        for _ in 0..30 {
            let tangents = tangents(&state.direction)?;
            let change = self.round(steps, &state, &tangents)?;
            let [low, high] = BOUNDS.map(|bound| bound * self.guess);
            state.ratio = (state.ratio + change[0]).clamp(low, high);
            let turned = state.direction + tangents[0] * change[1] + tangents[1] * change[2];
            state.direction = turned.normalize();
            state.axle += change[3];
            if change[0].abs() < 1e-9 * self.guess {
                break;
            }
        }
        let [across, all] = squares(steps, &state);
        let share = across / all;
        share.is_finite().then_some(Minimum { share, state })
    }

    /// Change of r, of the direction along its two tangents, and of l.
    fn round(&self, steps: &[Step], state: &State, tangents: &[Vector3<f64>; 2]) -> Option<Vector4<f64>> {
        let h = state.direction;
        let across = Matrix3::identity() - h * h.transpose();
        let (mut normal, mut gradient) = (Matrix4::zeros(), Vector4::zeros());
        for step in steps {
            let (turn, w) = (step.turn * h, step.along(state));
            let residual = across * w;
            let of_tangent = |t: &Vector3<f64>| -(h * w.dot(t) + t * w.dot(&h));
            let columns = [across * step.offset, of_tangent(&tangents[0]), of_tangent(&tangents[1]), -(across * turn)];
            let jacobian = SMatrix::<f64, 3, 4>::from_columns(&columns);
            normal += jacobian.transpose() * jacobian;
            gradient += jacobian.transpose() * residual;
        }
        let variance = squares(steps, state)[0] / (2.0 * steps.len() as f64 - 4.0);
        let [mean, std] = self.axle;
        normal[(3, 3)] += variance / (std * std);
        gradient[3] += variance / (std * std) * (state.axle - mean);
        let damped = normal + Matrix4::identity() * (1e-12 * normal.trace());
        let change = -damped.lu().solve(&gradient)?;
        change.iter().all(|number| number.is_finite()).then_some(change)
    }
}

impl Step {
    /// w of the state.
    fn along(&self, state: &State) -> Vector3<f64> {
        self.camera + state.ratio * self.offset - state.axle * (self.turn * state.direction)
    }
}

/// Σ |w − h hᵀ w|² and Σ |w|².
fn squares(steps: &[Step], state: &State) -> [f64; 2] {
    let sums = steps.iter().map(|step| {
        let w = step.along(state);
        let along = w.dot(&state.direction);
        [(w - state.direction * along).norm_squared(), w.norm_squared()]
    });
    sums.fold([0.0, 0.0], |[a, b], [c, d]| [a + c, b + d])
}

/// Principal direction of the steps at a ratio, oriented forward.
fn main_direction(steps: &[Step], ratio: f64) -> Option<Vector3<f64>> {
    let w = |step: &Step| step.camera + ratio * step.offset;
    let scatter: Matrix3<f64> = steps.iter().map(|step| w(step) * w(step).transpose()).sum();
    let direction = svd3(scatter)?.u?.column(0).into_owned();
    let forward: f64 = steps.iter().map(|step| w(step).dot(&direction)).sum();
    Some(if forward < 0.0 { -direction } else { direction })
}

/// Two unit vectors perpendicular to a direction and to each other.
fn tangents(direction: &Vector3<f64>) -> Option<[Vector3<f64>; 2]> {
    let axis = Vector3::ith(direction.iamin(), 1.0);
    let first = direction.cross(&axis).try_normalize(0.0)?;
    Some([first, direction.cross(&first)])
}
