//! Limits of coordinates.

use crate::scene::Reconstruction;

/// Maximum coordinate, in any unit. In meters it is a tenth of a light year; beyond it squares and cubes of distances
/// lose their meaning and finally overflow.
pub const LARGEST: f64 = 1e15;

/// Returns true if a coordinate is finite and within the limit.
pub fn is_sensible(coordinate: &f64) -> bool {
    coordinate.abs() <= LARGEST
}

/// Returns true if a ratio of lengths is positive, finite and within the limit.
pub fn is_sensible_ratio(ratio: f64) -> bool {
    (1.0 / LARGEST..=LARGEST).contains(&ratio)
}

/// Describes the first part of a model beyond the limit.
pub fn beyond(model: &Reconstruction) -> Option<String> {
    let images = model.images.iter().filter(|(_, image)| !image.cam_from_world.translation.iter().all(is_sensible));
    let points = model.points.iter().filter(|(_, point)| !point.position.iter().all(is_sensible));
    let mut found =
        images.map(|(id, _)| format!("image {}", id.0)).chain(points.map(|(id, _)| format!("point {}", id.0)));
    found.next().map(|part| format!("{part} is more than {LARGEST:e} units away"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_coordinates_are_refused_and_large_ones_accepted() {
        assert!([0.0, -4.0e6, 1e-300, 1e15].iter().all(is_sensible));
        assert!(![f64::NAN, f64::INFINITY, -1e16].iter().any(is_sensible));
        assert!(is_sensible_ratio(1e-9) && ![0.0, -1.0, 1e-16, 1e308, f64::NAN].iter().any(|r| is_sensible_ratio(*r)));
        let mut model = crate::io::testing::odd_model();
        assert_eq!(beyond(&model), None);
        model.points.values_mut().next().unwrap().position.y = -1e200;
        assert_eq!(beyond(&model).as_deref(), Some("point 1 is more than 1e15 units away"));
    }
}
