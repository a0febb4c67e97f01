//! Front end: from frames and masks to tracks, by point tracking or by feature matching.

use std::collections::BTreeMap;

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Target;
use super::large_frames::AnySizeFrontEnd;
use super::matching::MatchOptions;
use super::sift_front_end::{SiftFrontEnd, SiftOptions};
use super::tracks::TrackTable;
use super::video_front_end::VideoOptions;
use crate::camera::Camera;
use crate::checks::{Checked, under};
use crate::features::FeatureError;
use crate::image::Picture;
use crate::scene::{Frame, Mask};

/// Kind of front end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FrontEndKind {
    /// Points tracked from frame to frame.
    Video,
    /// SIFT features in every frame, matched between frames.
    Sift,
}

/// Front end and the options of both kinds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FrontEndOptions {
    /// Front end; `features` other than `auto` overrides it, and unordered frames always use `sift`.
    pub kind: FrontEndKind,
    /// Options of the kind `video`.
    pub video: VideoOptions,
    /// Options of the kind `sift`.
    pub sift: SiftOptions,
}

impl FrontEndOptions {
    /// Options for a target in a video.
    pub fn of(target: Target) -> Self {
        Self { kind: FrontEndKind::Video, video: VideoOptions::of(target), sift: SiftOptions::of(target) }
    }

    /// Rejects options that are out of range.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        under("video", self.video.check())?;
        under("sift", self.sift.check())
    }

    /// Descriptor matching.
    pub fn matching(&self) -> &MatchOptions {
        match self.kind {
            FrontEndKind::Video => &self.video.matching,
            FrontEndKind::Sift => &self.sift.matching,
        }
    }
}

/// Front end that receives frames and returns tracks.
pub enum FrontEnd {
    /// See [`FrontEndKind::Video`].
    Video(AnySizeFrontEnd),
    /// See [`FrontEndKind::Sift`].
    Sift(SiftFrontEnd),
}

impl FrontEnd {
    /// Front end without frames; `camera` serves to verify matches, and a guess suffices.
    ///
    /// Options that [`FrontEndOptions::check`] rejects may cause a panic.
    pub fn new(options: &FrontEndOptions, camera: Camera) -> Self {
        match options.kind {
            FrontEndKind::Video => Self::Video(AnySizeFrontEnd::new(options.video.clone(), camera)),
            FrontEndKind::Sift => Self::Sift(SiftFrontEnd::new(options.sift.clone(), vec![camera])),
        }
    }

    /// As [`FrontEnd::new`], for photographs of several cameras; a video has one: the first of the list.
    ///
    /// # Errors
    /// [`FeatureError::NoCamera`] if the list is empty.
    pub fn of_cameras(options: &FrontEndOptions, cameras: Vec<Camera>) -> Result<Self, FeatureError> {
        let first = *cameras.first().ok_or(FeatureError::NoCamera { camera: 0, count: 0 })?;
        Ok(match options.kind {
            FrontEndKind::Video => Self::new(options, first),
            FrontEndKind::Sift => Self::Sift(SiftFrontEnd::new(options.sift.clone(), cameras)),
        })
    }

    /// Adds the next frame; features are detected only where the mask, of the image's size, is set.
    ///
    /// [`FeatureError::MaskSize`] if the mask does not have the image's size, [`FeatureError::OpenCv`].
    pub fn push(&mut self, frame: &Frame, picture: &Picture, mask: &Mask) -> Result<(), FeatureError> {
        self.push_of(0, frame, picture, mask)
    }

    /// As [`FrontEnd::push`], of one of several cameras, by its index in the list.
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

    /// Sets positions of frames by name, meters in any Cartesian frame: near photographs are matched, too.
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
        for (kind, group) in [(FrontEndKind::Video, "/video"), (FrontEndKind::Sift, "/sift")] {
            let options = FrontEndOptions { kind, ..FrontEndOptions::of(Target::Object) };
            for (changed, options) in variations(&options) {
                if !changed.starts_with(group) || options.check().is_err() {
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
