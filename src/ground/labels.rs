//! Ground labels of background points, by vote.

use nalgebra::Point2;

use crate::scene::{Image, Point3dId, Reconstruction};

/// Returns the ids of the background points that are ground by their labels, ascending.
///
/// A ground point has at least `min_observations` observations (the paper's four), and more votes for ground than
/// against it (eq. 2 of `docs/maths/ground.md`). A point without votes, or with a tie, is not ground.
///
/// * `vote` – label of an observation: true for ground, false for another label, `None` without one (outside the mask,
///   or in a frame without labels). It is called image by image, ascending by id, so it can load one label map after
///   the other.
pub fn label_points(
    background: &Reconstruction,
    min_observations: usize,
    mut vote: impl FnMut(&Image, Point2<f64>) -> Option<bool>,
) -> Vec<Point3dId> {
    let stable = |id: &Point3dId| background.points.get(id).is_some_and(|p| p.track.len() >= min_observations);
    let mut balance = std::collections::BTreeMap::<Point3dId, i64>::new();
    for image in background.images.values() {
        for observation in &image.observations {
            let Some(id) = observation.point.filter(stable) else { continue };
            match vote(image, observation.pixel) {
                Some(true) => *balance.entry(id).or_default() += 1,
                Some(false) => *balance.entry(id).or_default() -= 1,
                None => {}
            }
        }
    }
    balance.into_iter().filter(|(_, votes)| *votes > 0).map(|(id, _)| id).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Options, drive};

    #[test]
    fn the_majority_of_labels_decides_for_stable_points() {
        let world = drive(&Options::default(), 1);
        let truth = &world.ground_points;
        let is_stable = |id: &Point3dId| world.background.points[id].track.len() >= 4;
        let expected: Vec<_> = truth.iter().copied().filter(is_stable).collect();
        // Every fifth label is missing and every sixteenth is wrong; errors never reach a majority of a track's labels.
        let by_pixel = |image: &Image, pixel: Point2<f64>| {
            let observed = image.observations.iter().find(|o| o.pixel == pixel)?.point?;
            Some(truth.binary_search(&observed).is_ok())
        };
        assert_eq!(label_points(&world.background, 4, by_pixel), expected);
        let mut count = 0;
        let mut with_errors = |image: &Image, pixel: Point2<f64>| {
            count += 1;
            if count % 5 == 0 { None } else { by_pixel(image, pixel).map(|label| label != (count % 16 == 0)) }
        };
        let found = label_points(&world.background, 4, &mut with_errors);
        let wrong = found.iter().filter(|id| expected.binary_search(id).is_err()).count();
        assert!(wrong == 0 && found.len() * 100 > expected.len() * 99, "{} of {}", found.len(), expected.len());
        assert!(label_points(&world.background, 4, |_, _| None).is_empty());
        assert!(label_points(&world.background, 61, |_, _| Some(true)).is_empty());
    }
}
