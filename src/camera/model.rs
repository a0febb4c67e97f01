//! Camera models of files, by their COLMAP names (`src/colmap/sensor/models.h`).
//!
//! [`Camera`] covers the pinhole models with up to three radial and two tangential coefficients. For the others only
//! name and number of parameters are known, so that files using them can be passed through or rejected by name.

use super::{Camera, HigherTerms};

macro_rules! models {
    ($($(#[$doc:meta])* $variant:ident = $id:literal, $name:literal, $params:literal;)*) => {
        /// A camera model.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Model {
            $($(#[$doc])* $variant,)*
        }

        with_names!(Model { $($variant = $name),* });

        impl Model {
            /// Model id in COLMAP's binary files.
            pub fn id(self) -> i32 {
                match self { $(Self::$variant => $id,)* }
            }

            /// Number of parameters.
            pub fn num_params(self) -> usize {
                match self { $(Self::$variant => $params,)* }
            }
        }
    };
}

models! {
    /// f, cx, cy.
    SimplePinhole = 0, "SIMPLE_PINHOLE", 3;
    /// fx, fy, cx, cy.
    Pinhole = 1, "PINHOLE", 4;
    /// f, cx, cy, k.
    SimpleRadial = 2, "SIMPLE_RADIAL", 4;
    /// f, cx, cy, k1, k2.
    Radial = 3, "RADIAL", 5;
    /// fx, fy, cx, cy, k1, k2, p1, p2.
    OpenCv = 4, "OPENCV", 8;
    /// fx, fy, cx, cy, k1, k2, k3, k4 of the angle.
    OpenCvFisheye = 5, "OPENCV_FISHEYE", 8;
    /// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6.
    FullOpenCv = 6, "FULL_OPENCV", 12;
    /// fx, fy, cx, cy, omega.
    Fov = 7, "FOV", 5;
    /// f, cx, cy, k of the angle.
    SimpleRadialFisheye = 8, "SIMPLE_RADIAL_FISHEYE", 4;
    /// f, cx, cy, k1, k2 of the angle.
    RadialFisheye = 9, "RADIAL_FISHEYE", 5;
    /// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1.
    ThinPrismFisheye = 10, "THIN_PRISM_FISHEYE", 12;
    /// fx, fy, cx, cy, k0 to k5, p0, p1, s0 to s3.
    RadTanThinPrismFisheye = 11, "RAD_TAN_THIN_PRISM_FISHEYE", 16;
    /// f, cx, cy, k.
    SimpleDivision = 12, "SIMPLE_DIVISION", 4;
    /// fx, fy, cx, cy, k.
    Division = 13, "DIVISION", 5;
    /// f, cx, cy.
    SimpleFisheye = 14, "SIMPLE_FISHEYE", 3;
    /// fx, fy, cx, cy.
    Fisheye = 15, "FISHEYE", 4;
    /// fx, fy, cx, cy, alpha, beta.
    Eucm = 16, "EUCM", 6;
    /// Width and height of the image of the whole sphere.
    Equirectangular = 17, "EQUIRECTANGULAR", 2;
}

impl Model {
    /// Model with this name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// Model with this id.
    pub fn by_id(id: i32) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.id() == id)
    }

    /// Smallest model that represents a camera: with a single focal length if the camera has one.
    pub fn of(camera: &Camera) -> Self {
        let smallest = [Self::SimplePinhole, Self::SimpleRadial, Self::Radial, Self::Pinhole, Self::OpenCv];
        smallest.into_iter().find(|model| model.params_of(camera).is_some()).unwrap_or(Self::FullOpenCv)
    }

    /// Returns true if a pinhole with radial and tangential distortion cannot represent the model.
    pub fn is_foreign(self) -> bool {
        self.places().is_none()
    }

    /// Index in [`Camera::parameters`] of each parameter covered by [`Camera`]; a single focal length is fx.
    fn places(self) -> Option<&'static [usize]> {
        Some(match self {
            Self::SimplePinhole => &[0, 2, 3],
            Self::Pinhole => &[0, 1, 2, 3],
            Self::SimpleRadial => &[0, 2, 3, 4],
            Self::Radial => &[0, 2, 3, 4, 5],
            Self::OpenCv => &[0, 1, 2, 3, 4, 5, 6, 7],
            Self::FullOpenCv => &[0, 1, 2, 3, 4, 5, 6, 7, 8],
            _ => return None,
        })
    }

    /// Camera from parameters of this model; `None` if their number is wrong or [`Camera`] does not cover the model.
    pub fn camera(self, width: u32, height: u32, params: &[f64]) -> Option<Camera> {
        let places = self.places().filter(|_| params.len() == self.num_params())?;
        let (covered, others) = params.split_at(places.len());
        let mut all = [0.0; 9];
        covered.iter().zip(places).for_each(|(value, place)| all[*place] = *value);
        if !places.contains(&1) {
            all[1] = all[0];
        }
        Camera::prior(width, height).with_parameters(&all).filter(|_| others.iter().all(|value| *value == 0.0))
    }

    /// Parameters of a camera in this model; `None` if the model lacks one of them.
    pub fn params_of(self, camera: &Camera) -> Option<Vec<f64>> {
        let all = camera.parameters();
        let mut params: Vec<f64> = self.places()?.iter().map(|place| all[*place]).collect();
        params.resize(self.num_params(), 0.0);
        let back = self.camera(camera.width, camera.height, &params)?;
        // Numbers that are not finite come back as they are, too, and are refused by who writes them.
        let same = back.parameters().iter().zip(&all).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()));
        same.then_some(params)
    }

    /// Pinhole with the focal lengths and principal point of a model that [`Camera`] does not cover.
    ///
    /// It is accurate at the image center only.
    pub fn pinhole_part(self, width: u32, height: u32, params: &[f64]) -> Camera {
        let plain = Camera::prior(width, height);
        let (focal, principal) = match (self, params) {
            (Self::Equirectangular, _) => ([f64::from(width) / std::f64::consts::TAU; 2], plain.principal),
            (
                Self::SimpleRadialFisheye | Self::RadialFisheye | Self::SimpleDivision | Self::SimpleFisheye,
                &[f, cx, cy, ..],
            ) => ([f; 2], [cx, cy]),
            (_, &[fx, fy, cx, cy, ..]) => ([fx, fy], [cx, cy]),
            _ => (plain.focal, plain.principal),
        };
        Camera { focal, principal, higher: HigherTerms::ZERO, ..plain }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_written_as_the_smallest_model_that_holds_it() {
        let cases: [(&[f64], Model); 7] = [
            (&[5.0, 5.0, 4.0, 3.0], Model::SimplePinhole),
            (&[5.0, 5.5, 4.0, 3.0], Model::Pinhole),
            (&[5.0, 5.0, 4.0, 3.0, 0.1], Model::SimpleRadial),
            (&[5.0, 5.0, 4.0, 3.0, 0.0, 0.1], Model::Radial),
            (&[5.0, 5.5, 4.0, 3.0, 0.1], Model::OpenCv),
            (&[5.0, 5.0, 4.0, 3.0, 0.1, 0.2, 0.3, 0.4], Model::OpenCv),
            (&[5.0, 5.0, 4.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5], Model::FullOpenCv),
        ];
        for (values, expected) in cases {
            let camera = Camera::prior(8, 6).with_parameters(values).unwrap();
            assert_eq!(Model::of(&camera), expected, "{values:?}");
            let params = expected.params_of(&camera).unwrap();
            assert_eq!(params.len(), expected.num_params());
            assert_eq!(expected.camera(8, 6, &params), Some(camera));
        }
    }

    #[test]
    fn what_a_camera_does_not_cover_is_none() {
        assert_eq!(Model::FullOpenCv.camera(8, 6, &[1.0; 12]), None, "k4 to k6 divide");
        assert_eq!(Model::Pinhole.camera(8, 6, &[1.0; 3]), None);
        for model in Model::ALL.iter().filter(|model| model.is_foreign()) {
            assert_eq!(model.camera(8, 6, &vec![1.0; model.num_params()]), None);
            let part = model.pinhole_part(8, 6, &vec![2.0; model.num_params()]);
            assert!(part.focal[0] > 0.0, "{}", model.name());
        }
        assert_eq!((Model::by_id(17), Model::by_id(18)), (Some(Model::Equirectangular), None));
        assert_eq!(Model::by_name("FOV"), Some(Model::Fov));
    }
}
