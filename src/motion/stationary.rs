//! Test for a stationary object in a box, by the points in it (eq. 17 of `docs/maths/motion.md`).

use super::Verdict;

/// Minimum number of static points: fewer may be those of the road around a small vehicle.
const MIN_STATIC: usize = 5;
/// Maximum share of moving or floating points among those with a known state.
const MAX_OTHERS: f64 = 0.1;

/// Returns true if the points in a box show a stationary object.
///
/// A point that floats over the ground is no evidence for it: it may be on an approaching vehicle.
pub fn shows_stationary(points: impl IntoIterator<Item = Verdict>) -> bool {
    let (mut stationary, mut others) = (0_usize, 0_usize);
    for verdict in points {
        match verdict {
            Verdict::Stationary => stationary += 1,
            Verdict::Moving(_) | Verdict::Floating => others += 1,
            Verdict::Fixed | Verdict::Undetermined => {}
        }
    }
    stationary >= MIN_STATIC && others as f64 <= MAX_OTHERS * (stationary + others) as f64
}

#[cfg(test)]
mod tests {
    use super::super::Evidence;
    use super::*;

    fn points(stationary: usize, others: &[Verdict]) -> Vec<Verdict> {
        [&vec![Verdict::Stationary; stationary], others].concat()
    }

    #[test]
    fn a_stationary_object_has_several_static_points_and_hardly_any_others() {
        let moving = Verdict::Moving(Evidence::OffItsLine);
        assert!(shows_stationary(points(5, &[])));
        assert!(shows_stationary(points(5, &[Verdict::Undetermined, Verdict::Undetermined, Verdict::Fixed])));
        assert!(shows_stationary(points(18, &[moving, moving])));
        assert!(!shows_stationary(points(4, &[])));
        assert!(!shows_stationary(points(17, &[moving, moving])));
    }

    #[test]
    fn an_object_with_floating_points_may_approach() {
        assert!(!shows_stationary(points(6, &[Verdict::Floating; 4])));
    }
}
