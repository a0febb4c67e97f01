//! Proportions, size and speed of a vehicle compared with its class.
//!
//! Meters are not known: the vehicle's height over the ground is the unit of its length and of its speed, and vehicles
//! are compared with one another.

use super::class::{self, Class};
use super::{Candidate, Measures, graded, times};
use crate::math::upper_median;
use crate::scene::ReasonKind::{Shape, Size, Speed};
use crate::scene::{Finding, Reason, TimeBase};

/// Maximum factor by which stray points extend the vehicle.
const STRAYS: f64 = 1.25;
/// Factors beyond the limits of the class: doubt, refutation. No vehicle of the class is beyond the second.
const BEYOND: [f64; 2] = [1.0, 2.0];

/// Checks the vehicle's length for its height against its class.
pub(super) fn shape(measures: &Measures, class: &Class) -> Option<Reason> {
    let ratio = measures.in_heights(measures.length?)?;
    // From behind only the width is visible.
    let least = 0.35 * class.lengths_m[0] / class.heights_m[1];
    let most = STRAYS * class.longest_in_heights;
    let text = format!("length {} times its height", times(ratio));
    let odd = || format!("{text}; expected {} to {} for a {}", times(least), times(most), class.name);
    // Factor by which it is outside of the range; 1 or less inside.
    let beyond = (least / ratio).max(ratio / most);
    Some(graded(Shape, beyond, BEYOND, odd).unwrap_or_else(|| Reason::supports(Shape, text)))
}

/// Checks the vehicle's length against its apparent length.
///
/// A view from behind hides the length of the vehicle, but not more, and the less the higher the camera is.
pub(super) fn stretch(measures: &Measures, class: &Class) -> Option<Reason> {
    let stretch = measures.stretch?;
    let from_behind = class.longest_in_heights.min(class.lengths_m[1] / class.height_m);
    let dip_cosine = (1.0 - measures.dip_sine * measures.dip_sine).sqrt();
    // Correct models of few points from above have up to 4.1 (real clips; rendered drives at 26° to 59° downward: 2.1).
    let most = STRAYS * 3.4_f64.max((measures.dip_sine + dip_cosine / from_behind).recip());
    let odd = || format!("model stretched {} times along the line of sight", times(stretch));
    graded(Shape, stretch / most, BEYOND, odd)
}

/// Estimate from one vehicle for the size of the others: meters per unit of the background if it has its class's
/// typical height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SizeReference {
    id: u32,
    meters_per_unit: f64,
    spread: f64,
    /// True if no check of the vehicle alone refutes it.
    is_sound: bool,
}

/// Size reference of every vehicle with a height.
pub(super) fn size_references(
    candidates: &[Candidate],
    measures: &[Measures],
    reasons: &[Vec<Reason>],
) -> Vec<Option<SizeReference>> {
    let size_reference = |k: usize| {
        let class = class::of(&candidates[k].trajectory.class);
        let height = measures[k].height.filter(|height| *height > 0.0)?;
        Some(SizeReference {
            id: candidates[k].trajectory.id.0,
            meters_per_unit: class.height_m / height,
            spread: class.spread(),
            is_sound: reasons[k].iter().all(|reason| reason.finding != Finding::Refutes),
        })
    };
    (0..candidates.len()).map(size_reference).collect()
}

/// Checks the vehicle's size relative to the others against its class.
///
/// The size is supported if at least as many of the others agree with it as contradict it. Two vehicles alone do not
/// show which of them is wrong: both are doubted. The size is refuted if none agrees and two or more contradict it by
/// twice (in logarithms) what both classes allow.
pub(super) fn relative_to_others(k: usize, all: &[Option<SizeReference>]) -> Option<Reason> {
    let own = all[k]?;
    let others: Vec<&SizeReference> =
        all.iter().flatten().filter(|other| other.id != own.id && other.is_sound).collect();
    let beyond = |limit: f64| others.iter().filter(|other| own.contradicts(other, limit)).count();
    let contradict = beyond(1.0);
    let agree = others.len() - contradict;
    let factor = upper_median(others.iter().map(|other| other.meters_per_unit / own.meters_per_unit).collect())?;
    Some(match agree {
        0 if beyond(2.0) > 1 => Reason::refutes(Size, comparison(factor, &others)),
        agree if agree < contradict => {
            Reason::doubts(Size, 1.0, format!("{}: one of them is wrong", comparison(factor, &others)))
        }
        _ => Reason::supports(Size, comparison(factor, &others)),
    })
}

impl SizeReference {
    /// Returns true if another reference contradicts it: by a factor beyond that of both classes to the power of
    /// `limit`.
    fn contradicts(&self, other: &Self, limit: f64) -> bool {
        // In addition to the factors of the classes, the visible tops differ.
        let allowed = self.spread * other.spread * 1.3;
        (other.meters_per_unit / self.meters_per_unit).ln().abs() > limit * allowed.ln()
    }
}

/// Comparison in words; `factor` is the size relative to the class, by the sizes of the others.
fn comparison(factor: f64, others: &[&SizeReference]) -> String {
    let reference = match others {
        [one] => format!("vehicle {}", one.id),
        many => format!("{} other vehicles", many.len()),
    };
    let (factor, size) = if factor >= 1.0 { (factor, "large") } else { (factor.recip(), "small") };
    format!("{} times as {size} as usual for its class, relative to {reference}", times(factor))
}

/// Checks the vehicle's speed, measured with its own height.
pub(super) fn speed(measures: &Measures, class: &Class, time_base: TimeBase) -> Option<Reason> {
    let heights = measures.in_heights(measures.speed.filter(|_| time_base == TimeBase::Seconds)?)?;
    let speed_m_s = heights * class.height_m;
    let text = format!("speed {} vehicle heights per second", times(heights));
    let odd = || format!("{text}, about {} km/h for a {}", times(3.6 * speed_m_s), class.name);
    // Speeds that are rare, and that do not occur on roads.
    Some(graded(Speed, speed_m_s, [60.0, 140.0], odd).unwrap_or_else(|| Reason::supports(Speed, text)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_much_longer_than_their_apparent_length_are_doubted() {
        let finding = |name: &str, stretch: f64, dip_sine: f64| {
            let measures = Measures { stretch: Some(stretch), dip_sine, ..Measures::default() };
            super::stretch(&measures, &class::of(name)).map(|reason| reason.finding)
        };
        for (class, stretch, dip_sine, finds) in [
            ("car", 4.5, 0.0, None),
            ("car", 6.0, 0.0, Some(Finding::Doubts)),
            ("car", 10.0, 0.0, Some(Finding::Refutes)),
            ("vehicle", 8.0, 0.0, None),
            ("vehicle", 12.0, 0.0, Some(Finding::Doubts)),
            ("vehicle", 27.0, 0.0, Some(Finding::Refutes)),
            ("car", 4.1, 0.98, None),
            ("bus", 5.0, 0.98, Some(Finding::Doubts)),
            ("vehicle", 9.0, 0.98, Some(Finding::Refutes)),
        ] {
            assert_eq!(finding(class, stretch, dip_sine), finds, "{class} {stretch} {dip_sine}");
        }
    }

    #[test]
    fn vehicles_much_longer_than_high_are_doubted() {
        let finding = |class: &str, length: f64| {
            let measures = Measures { height: Some(2.0), length: Some(2.0 * length), ..Measures::default() };
            shape(&measures, &class::of(class)).unwrap().finding
        };
        for (class, length, finds) in [
            ("car", 4.5, Finding::Supports),
            ("car", 6.5, Finding::Doubts),
            ("car", 13.0, Finding::Refutes),
            ("bus", 6.5, Finding::Supports),
            ("object", 6.5, Finding::Supports),
            ("object", 8.9, Finding::Doubts),
            ("object", 17.0, Finding::Refutes),
            ("car", 0.4, Finding::Doubts),
        ] {
            assert_eq!(finding(class, length), finds, "{class} {length}");
        }
    }
}
