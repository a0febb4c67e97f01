//! Point tracking in frames that are larger than those for which the options are set.
//!
//! A displacement in a frame of 1280 pixels is three times as large in one of 3840. Each doubling of the longer side
//! beyond 1280 pixels adds a pyramid level, so that the same motion is tracked. Beyond 1920 pixels the patch of a point
//! would contain little more than noise and blur, and the cost grows with the square of the side: larger frames are
//! reduced to 1920, and positions are given in pixels of the frame. A target whose first mask fits in 1920 pixels is
//! small, and keeps its detail.

use super::tracks::TrackTable;
use super::video_front_end::{VideoFrontEnd, VideoOptions};
use crate::camera::Camera;
use crate::features::FeatureError;
use crate::image::{Picture, RgbImage, resize_rgb, scale_to_fit};
use crate::scene::{Frame, Mask};

/// Longer side beyond which the pyramid gets more levels, pixels.
const USUAL_SIDE_PX: u32 = 1280;
/// Maximum longer side of the images in which points are tracked, pixels.
const MAX_SIDE_PX: u32 = 1920;

/// A [`VideoFrontEnd`] for frames of any size.
pub struct AnySizeFrontEnd {
    options: VideoOptions,
    camera: Camera,
    /// Front end of the video, and true if frames are reduced for it.
    front_end: Option<(Box<VideoFrontEnd>, bool)>,
}

impl AnySizeFrontEnd {
    /// Front end without frames; `camera`, of whole frames, serves to verify re-detected points, and a guess suffices.
    pub fn new(options: VideoOptions, camera: Camera) -> Self {
        Self { options, camera, front_end: None }
    }

    /// Adds the next frame; points are tracked only where the mask, of the frame's size, is set.
    ///
    /// # Errors
    /// [`FeatureError::OpenCv`] if OpenCV fails.
    pub fn push(&mut self, frame: &Frame, picture: &Picture, mask: &Mask) -> Result<(), FeatureError> {
        let (options, camera, image) = (&self.options, &self.camera, picture.rgb());
        let (front_end, is_reduced) = self.front_end.get_or_insert_with(|| begin(options, camera, image, mask));
        if !*is_reduced {
            return front_end.push(frame, picture, mask);
        }
        let (width, height) = scale_to_fit(image.width(), image.height(), MAX_SIDE_PX);
        let scale = scale(image.dimensions(), (width, height));
        let smaller = resize_rgb(image, width, height)?;
        front_end.push(frame, &Picture::new(&smaller), &reduced(mask, width, height))?;
        front_end.enlarge_last(scale);
        Ok(())
    }

    /// The tracks.
    pub fn finish(self) -> TrackTable {
        self.front_end.map_or_else(TrackTable::default, |(front_end, _)| front_end.finish())
    }
}

fn begin(options: &VideoOptions, camera: &Camera, image: &RgbImage, mask: &Mask) -> (Box<VideoFrontEnd>, bool) {
    let is_reduced = mask.bounding_box().is_some_and(|b| b.width().max(b.height()) > MAX_SIDE_PX);
    let (mut side, mut camera) = (image.width().max(image.height()), *camera);
    if is_reduced {
        let (width, height) = scale_to_fit(image.width(), image.height(), MAX_SIDE_PX);
        (side, camera) = (side.min(MAX_SIDE_PX), camera.resized(width, height));
    }
    let num_more = (f64::from(side) / f64::from(USUAL_SIDE_PX)).log2().ceil().max(0.0) as i32;
    let options = VideoOptions { pyramid_levels: options.pyramid_levels + num_more, ..options.clone() };
    (Box::new(VideoFrontEnd::new(options, camera)), is_reduced)
}

/// Frame pixels per reduced pixel, across and down.
fn scale(full: (u32, u32), reduced: (u32, u32)) -> [f64; 2] {
    [f64::from(full.0) / f64::from(reduced.0), f64::from(full.1) / f64::from(reduced.1)]
}

/// Mask at a reduced size: set where the pixel at the center is.
fn reduced(mask: &Mask, width: u32, height: u32) -> Mask {
    let [across, down] = scale((mask.width(), mask.height()), (width, height));
    Mask::from_fn(width, height, |x, y| mask.contains((f64::from(x) + 0.5) * across, (f64::from(y) + 0.5) * down))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use crate::scene::FrameId;
    use rand::Rng as _;

    #[test]
    fn positions_are_in_pixels_of_the_whole_frame() {
        const STEP_PX: u32 = 24;
        let mut rng = seeded_rng(1, 0);
        let coarse = RgbImage::from_fn(200, 10, |_, _| ::image::Rgb([rng.random(); 3]));
        let whole = ::image::imageops::resize(&coarse, 4000, 200, ::image::imageops::FilterType::CatmullRom);
        let options = VideoOptions { min_track_length: 3, ..VideoOptions::background() };
        let mut front_end = AnySizeFrontEnd::new(options, Camera::prior(3840, 200));
        for k in 0..3 {
            let picture = ::image::imageops::crop_imm(&whole, STEP_PX * k, 0, 3840, 200).to_image();
            let frame = Frame { id: FrameId(k), name: format!("{k}.png"), time_s: f64::from(k) };
            front_end.push(&frame, &Picture::new(&picture), &Mask::full(3840, 200)).unwrap();
        }
        let table = front_end.finish();
        assert!(table.tracks.len() > 50, "{}", table.tracks.len());
        let mut errors: Vec<f64> = table
            .tracks
            .iter()
            .map(|track| (table.pixel(track[0]).x - table.pixel(track[2]).x - f64::from(2 * STEP_PX)).abs())
            .collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 0.2, "{errors:?}");
        assert!(table.views[0].pixels.iter().any(|p| p.x > 3000.0));
    }
}
