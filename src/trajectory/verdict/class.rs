//! Typical and extreme lengths and heights of vehicles by class.
//!
//! Typical values are the means of the annotated vehicles of KITTI (Geiger, Lenz, Urtasun: Are we ready for autonomous
//! driving?, CVPR 2012): cars 3.88 × 1.63 × 1.53 m, vans 5.08 × 1.90 × 2.21 m, lorries 10.11 × 2.59 × 3.25 m, trams
//! 16.09 × 2.54 × 3.53 m, cyclists 1.76 × 0.60 × 1.74 m. The upper limits are those of EU directive 96/53/EC (4 m high,
//! 12 m for a rigid vehicle, 13.5 m for a bus, 18.75 m for an articulated one or one with a trailer). The lower limits,
//! and both limits for cars, are manufacturers' data: the shortest cars sold are 2.5 m long, the longest 5.8 m, their
//! heights 1.15 to 2.1 m; buses of 18.75 m are 2.9 m high, lorries of that length 3 m and more.

/// Typical sizes of a class, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Class {
    /// Its name in messages.
    pub(super) name: &'static str,
    /// Typical height.
    pub(super) height_m: f64,
    /// Minimum and maximum height.
    pub(super) heights_m: [f64; 2],
    /// Minimum and maximum length.
    pub(super) lengths_m: [f64; 2],
    /// Maximum length in heights of the same vehicle: the longest of a class are not the lowest.
    pub(super) longest_in_heights: f64,
}

/// Typical sizes of a class, by its name in a detector's list.
pub(super) fn of(name: &str) -> Class {
    let (name, height_m, heights_m, lengths_m, longest_in_heights) = match name {
        "car" => ("car", 1.53, [1.15, 2.1], [2.5, 5.8], 5.0),
        "van" => ("van", 2.21, [1.6, 3.1], [3.6, 7.5], 4.7),
        // Detectors classify pickups as lorries, too.
        "truck" | "lorry" | "trailer" | "caravan" => ("lorry", 2.6, [1.6, 4.0], [4.5, 18.75], 6.3),
        "bus" => ("bus", 3.1, [2.3, 4.4], [5.5, 18.75], 6.5),
        "motorcycle" | "motor" | "motorbike" | "bicycle" | "rider" => ("two-wheeler", 1.6, [0.9, 2.1], [1.4, 2.7], 3.0),
        "train" | "tram" => ("tram", 3.53, [2.8, 4.6], [8.0, 400.0], 133.0),
        "person" | "pedestrian" | "people" => ("person", 1.7, [0.9, 2.1], [0.3, 1.2], 1.2),
        _ => ("vehicle", 1.7, [0.9, 4.4], [1.4, 18.75], 6.5),
    };
    Class { name, height_m, heights_m, lengths_m, longest_in_heights }
}

impl Class {
    /// Maximum factor between its height and the typical one, in either direction.
    pub(super) fn spread(&self) -> f64 {
        let [least, most] = self.heights_m;
        (most / self.height_m).max(self.height_m / least)
    }
}
