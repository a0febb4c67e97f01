//! Drivability of the trajectory.

use super::measures::Jump;
use super::{HALF, Measures, graded, percent, times};
use crate::scene::Reason;
use crate::scene::ReasonKind::Path;

/// Limits of the ratio of the path's length to that of the smoothed one: doubt, refutation.
const ZIGZAG: [f64; 2] = [1.25, 2.0];

pub(super) fn reasons(measures: &Measures) -> Vec<Reason> {
    // The noise of a path within one vehicle height is not evidence.
    if measures.in_heights(measures.reach).is_none_or(|reach| reach < 1.0) {
        return Vec::new();
    }
    let odd = [zigzag(measures), jitter(measures), backwards(measures), jumps(measures), turns(measures)];
    let odd: Vec<Reason> = odd.into_iter().flatten().collect();
    match odd.is_empty() {
        true => vec![Reason::supports(Path, "smooth path along its heading")],
        false => odd,
    }
}

fn zigzag(measures: &Measures) -> Option<Reason> {
    let [raw, smooth] = measures.path_lengths;
    let ratio = raw / smooth;
    graded(Path, ratio, ZIGZAG, || format!("zigzag: path {} times as long as the smoothed one", times(ratio)))
}

fn jitter(measures: &Measures) -> Option<Reason> {
    let jitter = measures.jitter?;
    let heights = measures.in_heights(jitter)?;
    let text = || format!("positions deviate from a smooth trajectory by {} of its height", percent(heights));
    // Jitter that is small compared with a step does not mask the motion.
    if jitter < 0.25 * measures.step { None } else { graded(Path, heights, [0.3, 1.0], text) }
}

fn jumps(measures: &Measures) -> Option<Reason> {
    let Jump { beyond, frames: [before, after] } = measures.jump;
    let heights = measures.in_heights(beyond)?;
    let text = || format!("jumps by {} vehicle heights between frames {before} and {after}", times(heights));
    // A vehicle is two to three of its heights long.
    if beyond < measures.step { None } else { graded(Path, heights, [1.5, 6.0], text) }
}

fn turns(measures: &Measures) -> Option<Reason> {
    let Jump { beyond, frames: [before, after] } = measures.turn;
    let text = || {
        format!(
            "turns by {:.0}° between frames {before} and {after}, unlike before and after: its model is folded or \
             flipped there",
            beyond.to_degrees()
        )
    };
    // Correct models turn by up to 0.06 rad, folded or flipped ones by 0.35 and more.
    graded(Path, beyond, [0.17, 0.52], text)
}

fn backwards(measures: &Measures) -> Option<Reason> {
    let Some(share) = measures.backwards else {
        return Some(Reason::doubts(Path, HALF, "heading unknown: its directions of motion cancel"));
    };
    let text = || format!("moves backward, against its heading, in {} of its path", percent(share));
    // Vehicles do reverse: this is never a refutation.
    match share {
        s if s > 0.2 => Some(Reason::doubts(Path, 1.0, text())),
        s if s > 0.05 => Some(Reason::doubts(Path, HALF, text())),
        _ => None,
    }
}
