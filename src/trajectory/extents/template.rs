//! Shapes of vehicle bodies for their outlines: convex hulls of a few corners.
//!
//! Coordinates are shares: of the length, forward from the center; of the width, from the center plane; and of the
//! height of the roof above the ground. The lower body, roofs and hoods of cars are between those of drawings of
//! current cars and of the six car bodies of the rendered sequences (docs/maths/extents.md). Mirrors belong to the
//! outline, but not to the width.

use nalgebra::Vector3;

use crate::trajectory::Body;

/// A pair of corners: forward position, half of the distance between the two, height above the ground.
type Rib = [f64; 3];

/// Shape of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Template {
    ribs: &'static [Rib],
}

/// The common lower part of cars: tires, sills, bumpers and waist, and mirrors.
macro_rules! car {
    ($($rib:expr),+ $(,)?) => {
        Template {
            ribs: &[
                [0.35, 0.48, 0.01],
                [-0.36, 0.48, 0.01],
                [0.49, 0.37, 0.18],
                [0.49, 0.37, 0.37],
                [0.43, 0.48, 0.20],
                [0.41, 0.46, 0.55],
                [0.20, 0.50, 0.55],
                [-0.20, 0.50, 0.55],
                [-0.44, 0.47, 0.20],
                [-0.42, 0.48, 0.61],
                [-0.49, 0.35, 0.19],
                [-0.49, 0.36, 0.53],
                [0.17, 0.59, 0.66],
                $($rib),+
            ],
        }
    };
}

const SALOON: Template = car!([-0.46, 0.36, 0.73], [-0.27, 0.34, 0.96], [0.05, 0.34, 0.97], [0.47, 0.28, 0.52]);
const HATCHBACK: Template = car!([-0.47, 0.35, 0.69], [-0.38, 0.35, 0.95], [0.05, 0.34, 0.97], [0.47, 0.28, 0.52]);
const VAN: Template =
    car!([-0.47, 0.43, 0.62], [-0.45, 0.38, 0.97], [0.15, 0.39, 0.98], [0.31, 0.44, 0.77], [0.47, 0.33, 0.52]);
const BOX: Template = Template {
    ribs: &[
        [0.42, 0.47, 0.0],
        [-0.42, 0.47, 0.0],
        [0.5, 0.46, 0.12],
        [-0.5, 0.48, 0.15],
        [0.49, 0.46, 0.97],
        [-0.5, 0.48, 0.98],
        [0.44, 0.5, 0.1],
        [0.44, 0.49, 1.0],
        [-0.48, 0.5, 0.15],
        [-0.48, 0.49, 1.0],
    ],
};
const TWO_WHEELER: Template = Template {
    ribs: &[
        [0.35, 0.06, 0.0],
        [-0.35, 0.06, 0.0],
        [0.5, 0.06, 0.25],
        [-0.5, 0.08, 0.3],
        [-0.2, 0.3, 0.6],
        [0.2, 0.5, 0.9],
        [0.1, 0.2, 1.0],
    ],
};

/// Possible shapes of a vehicle by its kind of body.
pub(super) fn of_body(body: Body) -> &'static [Template] {
    match body {
        Body::Car => &[SALOON, HATCHBACK, VAN, BOX],
        Body::Long => &[BOX],
        Body::TwoWheeler => &[TWO_WHEELER],
    }
}

impl Template {
    /// Corners of both sides.
    pub(super) fn corners(&self) -> Vec<Vector3<f64>> {
        let sides = |[x, y, z]: &Rib| [Vector3::new(*x, *y, *z), Vector3::new(*x, -*y, *z)];
        self.ribs.iter().flat_map(sides).collect()
    }
}
