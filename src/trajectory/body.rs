//! Assumptions on the contact with the ground, by the class of a vehicle.

use super::ContactOptions;

/// Width over length: small cars have 0.61, cars 0.41, delivery vans 0.39, lorries 0.31, buses 0.21.
pub(super) const WIDTH_PER_LENGTH: f64 = 0.42;
/// Standard deviation of the logarithm of width over length.
pub(super) const WIDTH_STD: f64 = 0.3;
/// Height over width: cars have 0.83, small cars and off-road vehicles 0.9 to 1, buses and lorries 1.2 to 1.3.
pub(super) const HEIGHT_PER_WIDTH: f64 = 0.9;

/// Kinds of bodies, which differ in the positions of their tires.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Body {
    /// Cars, vans, and vehicles of unknown class.
    #[default]
    Car,
    /// Lorries, buses and trailers: axles far from the ends, open frames, skirts.
    Long,
    /// Motorcycles and bicycles: two narrow tires in the center plane.
    TwoWheeler,
}

impl Body {
    /// Body of a class, by its name in a detector (COCO) or in the data set.
    pub fn of_class(class: &str) -> Self {
        match class {
            "truck" | "bus" | "train" | "lorry" | "trailer" => Self::Long,
            "motorcycle" | "bicycle" | "motorbike" => Self::TwoWheeler,
            _ => Self::Car,
        }
    }

    /// Options for this body, from those of a car. Values that were not measured get a large standard deviation.
    pub(super) fn contact(self, car: &ContactOptions) -> ContactOptions {
        let wider = |[mean, std]: [f64; 2], factor: f64| [mean, factor * std];
        match self {
            Self::Car => *car,
            Self::Long => {
                ContactOptions { side: wider(car.side, 2.0), lowest: [0.15, 0.12], overhang: [0.7, 0.4], ..*car }
            }
            Self::TwoWheeler => {
                ContactOptions { side: wider(car.side, 2.0), lowest: [0.1, 0.12], overhang: [0.2, 0.15], ..*car }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_without_measurements_have_larger_stds() {
        let car = ContactOptions::default();
        assert_eq!(Body::of_class("car").contact(&car), car);
        assert_eq!(Body::of_class("vehicle"), Body::Car);
        for class in ["bus", "truck", "motorcycle", "bicycle"] {
            let other = Body::of_class(class).contact(&car);
            assert!(other.check().is_ok() && other.side[1] > car.side[1] && other.lowest[1] > car.lowest[1], "{class}");
        }
    }
}
