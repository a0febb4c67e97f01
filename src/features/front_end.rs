//! From the frames of a source to tracks, by one of two ways.

use std::collections::BTreeMap;

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::large_frames::AnySizeFrontEnd;
use super::matching::MatchOptions;
use super::picture::Picture;
use super::rootsift::FeatureOptions;
use super::sift_front_end::{Pairing, SiftFrontEnd, SiftOptions};
use super::tracks::TrackTable;
use super::video_front_end::VideoOptions;
use crate::camera::Camera;
use crate::checks::Checked;
use crate::features::FeatureError;
use crate::scene::{Frame, Mask};

/// Front end; `features` other than `auto` overrides it, and unordered frames always use `sift`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum FrontEndOptions {
    /// Points tracked from frame to frame.
    Video(VideoOptions),
    /// SIFT features in every frame, matched between frames.
    Sift(SiftOptions),
}

impl FrontEndOptions {
    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        match self {
            Self::Video(video) => video.check(),
            Self::Sift(sift) => sift.check(),
        }
    }

    /// Descriptor matching.
    pub fn matching(&self) -> &MatchOptions {
        match self {
            Self::Video(video) => &video.matching,
            Self::Sift(sift) => &sift.matching,
        }
    }

    /// For photographs in no order.
    pub fn unordered() -> Self {
        let features = FeatureOptions { max_features: 5000, contrast_threshold: 0.02, ..FeatureOptions::background() };
        Self::Sift(SiftOptions {
            features,
            pairing: Pairing::UNORDERED,
            // With refined positions points of two views help more than they harm.
            min_track_length: 2,
            ..SiftOptions::background()
        })
    }
}

/// Takes frames and gives tracks.
pub enum FrontEnd {
    /// See [`FrontEndOptions::Video`].
    Video(AnySizeFrontEnd),
    /// See [`FrontEndOptions::Sift`].
    Sift(SiftFrontEnd),
}

impl FrontEnd {
    /// Nothing seen yet. `camera` serves to verify matches; a guess will do. Options that [`FrontEndOptions::check`]
    /// refuses may end in a panic.
    pub fn new(options: &FrontEndOptions, camera: Camera) -> Self {
        match options {
            FrontEndOptions::Video(o) => Self::Video(AnySizeFrontEnd::new(o.clone(), camera)),
            FrontEndOptions::Sift(o) => Self::Sift(SiftFrontEnd::new(o.clone(), vec![camera])),
        }
    }

    /// As [`FrontEnd::new`], for photographs of several cameras. A video has one: the first of the list.
    ///
    /// # Errors
    /// [`FeatureError::NoCamera`] if the list is empty.
    pub fn of_cameras(options: &FrontEndOptions, cameras: Vec<Camera>) -> Result<Self, FeatureError> {
        let first = *cameras.first().ok_or(FeatureError::NoCamera { camera: 0, count: 0 })?;
        Ok(match options {
            FrontEndOptions::Video(_) => Self::new(options, first),
            FrontEndOptions::Sift(o) => Self::Sift(SiftFrontEnd::new(o.clone(), cameras)),
        })
    }

    /// Adds the next frame, looking only where the mask is set; the mask has the image's size.
    ///
    /// # Errors
    /// [`FeatureError::MaskSize`] if the mask has not the image's size, [`FeatureError::OpenCv`].
    pub fn push(&mut self, frame: &Frame, picture: &Picture, mask: &Mask) -> Result<(), FeatureError> {
        self.push_of(0, frame, picture, mask)
    }

    /// As [`FrontEnd::push`], of one of several cameras, by its place in the list.
    ///
    /// # Errors
    /// As [`FrontEnd::push`]; [`FeatureError::NoCamera`] if there is no such camera.
    pub fn push_of(
        &mut self,
        camera: usize,
        frame: &Frame,
        picture: &Picture,
        mask: &Mask,
    ) -> Result<(), FeatureError> {
        let (expected, found) = (picture.rgb().dimensions(), (mask.width(), mask.height()));
        if expected != found {
            return Err(FeatureError::MaskSize { name: frame.name.clone(), expected, found });
        }
        match self {
            Self::Video(_) if camera > 0 => Err(FeatureError::NoCamera { camera, count: 1 }),
            Self::Sift(f) if camera >= f.num_cameras() => {
                Err(FeatureError::NoCamera { camera, count: f.num_cameras() })
            }
            Self::Video(f) => f.push(frame, picture, mask),
            Self::Sift(f) => f.push(frame, camera, picture.rgb(), mask),
        }
    }

    /// Takes positions of frames by name, metres in any Cartesian frame: near photographs are matched, too.
    pub fn know_positions(&mut self, positions: BTreeMap<String, Point3<f64>>) {
        match self {
            Self::Video(_) => {}
            Self::Sift(f) => f.know_positions(positions),
        }
    }

    /// The tracks.
    ///
    /// # Errors
    /// [`FeatureError::OpenCv`].
    pub fn finish(self, seed: u64) -> Result<TrackTable, FeatureError> {
        match self {
            Self::Video(f) => Ok(f.finish()),
            Self::Sift(f) => f.finish(seed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::variations;
    use crate::features::Target;
    use crate::image::RgbImage;
    use crate::math::seeded_rng;
    use crate::scene::FrameId;
    use rand::Rng as _;

    /// A smooth random texture that moves to the left.
    fn frames() -> Vec<(Frame, RgbImage)> {
        let mut rng = seeded_rng(1, 0);
        let coarse = RgbImage::from_fn(30, 20, |_, _| ::image::Rgb([rng.random(); 3]));
        let whole = ::image::imageops::resize(&coarse, 150, 100, ::image::imageops::FilterType::Triangle);
        let frame = |k: u32| {
            let frame = Frame { id: FrameId(k), name: format!("{k}.png"), time_s: f64::from(k) };
            (frame, ::image::imageops::crop_imm(&whole, 10 + 2 * k, 10, 120, 80).to_image())
        };
        (0..3).map(frame).collect()
    }

    #[test]
    fn options_that_pass_the_check_do_no_harm() {
        let (frames, mask) = (frames(), Mask::from_fn(120, 80, |x, _| x > 20));
        let mut num_passed = 0;
        let options = crate::sfm::Options::object();
        for options in [options.clone(), options.with_sift(Target::Object)] {
            for (changed, options) in variations(&options.front_end) {
                if options.check().is_err() {
                    continue;
                }
                num_passed += 1;
                let mut front_end = FrontEnd::new(&options, Camera::prior(120, 80));
                let pushed =
                    frames.iter().try_for_each(|(frame, image)| front_end.push(frame, &Picture::new(image), &mask));
                let found = pushed.and_then(|()| front_end.finish(1));
                assert!(found.is_ok(), "{changed}: {:?}", found.err());
            }
        }
        assert!(num_passed > 50, "{num_passed}");
    }
}
