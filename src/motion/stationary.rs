//! Test whether a box shows a stationary object, by the points in it (eq. 17 of `docs/maths/motion.md`).

use super::Verdict;

/// Points that have to stand: fewer may be those of the road round a small vehicle.
const MIN_STANDING: usize = 5;
/// Share of the points of which anything is known that may say otherwise.
const MOST_OTHERS: f64 = 0.1;

/// Returns true if the points in a box show a stationary object.
///
/// A point that would float over the ground says nothing of the kind: it may be one of a vehicle that comes nearer.
pub fn shows_standing(points: impl IntoIterator<Item = Verdict>) -> bool {
    let (mut standing, mut others) = (0_usize, 0_usize);
    for verdict in points {
        match verdict {
            Verdict::Stationary => standing += 1,
            Verdict::Moving(_) | Verdict::Floating => others += 1,
            Verdict::Fixed | Verdict::Undetermined => {}
        }
    }
    standing >= MIN_STANDING && others as f64 <= MOST_OTHERS * (standing + others) as f64
}

#[cfg(test)]
mod tests {
    use super::super::Evidence;
    use super::*;

    fn points(standing: usize, others: &[Verdict]) -> Vec<Verdict> {
        [&vec![Verdict::Stationary; standing], others].concat()
    }

    #[test]
    fn what_stands_has_several_points_that_do_and_hardly_any_that_do_not() {
        let moving = Verdict::Moving(Evidence::OffItsLine);
        assert!(shows_standing(points(5, &[])));
        assert!(shows_standing(points(5, &[Verdict::Undetermined, Verdict::Undetermined, Verdict::Fixed])));
        assert!(shows_standing(points(18, &[moving, moving])));
        assert!(!shows_standing(points(4, &[])));
        assert!(!shows_standing(points(17, &[moving, moving])));
    }

    #[test]
    fn what_would_float_may_come_nearer() {
        assert!(!shows_standing(points(6, &[Verdict::Floating; 4])));
    }
}
