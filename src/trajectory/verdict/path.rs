//! Drivability of the trajectory.

use super::measures::Jump;
use super::{Measures, percent, times};
use crate::scene::Reason;
use crate::scene::ReasonKind::Path;

/// A path within this many heights of the vehicle goes nowhere: its noise says nothing by itself.
const GOES_NOWHERE: f64 = 1.0;
/// Ratio of the path's length to that of the smoothed one.
const ZIGZAG: [f64; 2] = [1.25, 2.0];
/// Distance of a place from the smooth path, in heights of the vehicle; it counts where it is also this share
/// of a step.
const JITTER: [f64; 2] = [0.3, 1.0];
const JITTER_OF_STEP: f64 = 0.25;
/// Share of the way that leads backwards. Vehicles do back up, so it never refutes.
const BACKWARDS: [f64; 2] = [0.05, 0.2];
/// Length of a step beyond those next to it, in heights of the vehicle; a vehicle is two to three of them long.
const JUMP: [f64; 2] = [1.5, 6.0];
/// Turn from one frame to the next beyond those next to it, radians. Vehicles that are right have up to 0.06, those
/// whose model is folded or turned over 0.35 and more.
const TURN: [f64; 2] = [0.17, 0.52];

/// * `is_contradicted` – another method contradicts the scale.
pub(super) fn reasons(measures: &Measures, is_contradicted: bool) -> Vec<Reason> {
    if measures.in_heights(measures.reach).is_none_or(|reach| reach < GOES_NOWHERE) {
        return if is_contradicted { noise(measures).into_iter().collect() } else { Vec::new() };
    }
    let odd = [zigzag(measures), jitter(measures), backwards(measures), jumps(measures), turns(measures)];
    let odd: Vec<Reason> = odd.into_iter().flatten().collect();
    match odd.is_empty() {
        true => vec![Reason::supports(Path, "smooth path along its heading")],
        false => odd,
    }
}

/// Doubt about a trajectory that is its own noise: no motion confirms a scale that another method contradicts.
fn noise(measures: &Measures) -> Option<Reason> {
    let [way, smooth] = measures.way;
    let longer = way / smooth;
    let said = || {
        format!(
            "trajectory within its noise (path {} times as long as the smoothed one), and the scale is contradicted",
            times(longer)
        )
    };
    (longer > ZIGZAG[0]).then(|| Reason::doubts(Path, 1.0, said()))
}

fn zigzag(measures: &Measures) -> Option<Reason> {
    let [way, smooth] = measures.way;
    let longer = way / smooth;
    graded(longer, ZIGZAG, || format!("zigzag: path {} times as long as the smoothed one", times(longer)))
}

fn jitter(measures: &Measures) -> Option<Reason> {
    let jitter = measures.jitter?;
    let heights = measures.in_heights(jitter)?;
    let said = || format!("positions deviate from a smooth trajectory by {} of its height", percent(heights));
    if jitter < JITTER_OF_STEP * measures.step { None } else { graded(heights, JITTER, said) }
}

fn jumps(measures: &Measures) -> Option<Reason> {
    let Jump { beyond, frames: [before, after] } = measures.jump;
    let heights = measures.in_heights(beyond)?;
    let said = || format!("jumps by {} vehicle heights between frames {before} and {after}", times(heights));
    if beyond < measures.step { None } else { graded(heights, JUMP, said) }
}

fn turns(measures: &Measures) -> Option<Reason> {
    let Jump { beyond, frames: [before, after] } = measures.turn;
    let said = || {
        format!(
            "turns by {:.0}° between frames {before} and {after}, unlike before and after: its model is folded or \
             flipped there",
            beyond.to_degrees()
        )
    };
    graded(beyond, TURN, said)
}

fn backwards(measures: &Measures) -> Option<Reason> {
    let Some(share) = measures.backwards else {
        return Some(Reason::doubts(Path, 0.5, "heading unknown: its directions of motion cancel"));
    };
    let said = || format!("moves backward, against its heading, in {} of its path", percent(share));
    match share {
        s if s > BACKWARDS[1] => Some(Reason::doubts(Path, 1.0, said())),
        s if s > BACKWARDS[0] => Some(Reason::doubts(Path, 0.5, said())),
        _ => None,
    }
}

/// Doubted beyond the first limit, refuted beyond the second.
fn graded(value: f64, [doubts, refutes]: [f64; 2], said: impl Fn() -> String) -> Option<Reason> {
    match value {
        v if v > refutes => Some(Reason::refutes(Path, said())),
        v if v > doubts => Some(Reason::doubts(Path, 1.0, said())),
        _ => None,
    }
}
