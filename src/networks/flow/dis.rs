//! Dense inverse search: OpenCV's implementation of Kroeger et al., *Fast Optical Flow using Dense Inverse Search*,
//! 2016.

use ::image::{GrayImage, RgbImage};
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, Point2f, Ptr};
use opencv::prelude::*;
use opencv::video::{
    DISOpticalFlow, DISOpticalFlow_PRESET_FAST, DISOpticalFlow_PRESET_MEDIUM, DISOpticalFlow_PRESET_ULTRAFAST,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::parts::{crop, nothing, parts, put};
use super::{Field, FlowEstimator, FlowOptions, at_frame_size, check_sizes, consistent};
use crate::image::{borrowed_gray, gray_from_rgb, resize_gray, scale_to_fit};
use crate::networks::PerceptionError;
use crate::scene::{Flow, Rect};

/// DIS divides its input by powers of two and fails below this side.
const MIN_SIDE: u32 = 32;

/// Quality of DIS; each step costs about five times the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DisPreset {
    /// Few patches, no refinement.
    Ultrafast,
    /// With variational refinement.
    Fast,
    /// With more patches, down to full resolution.
    Medium,
}

/// OpenCV's DIS flow.
pub struct DisFlow {
    options: FlowOptions,
    algorithm: Ptr<DISOpticalFlow>,
}

impl DisFlow {
    /// Sets the algorithm up.
    ///
    /// # Errors
    /// [`PerceptionError::OpenCv`] if OpenCV cannot.
    pub fn new(options: &FlowOptions) -> Result<Self, PerceptionError> {
        let preset = match options.preset {
            DisPreset::Ultrafast => DISOpticalFlow_PRESET_ULTRAFAST,
            DisPreset::Fast => DISOpticalFlow_PRESET_FAST,
            DisPreset::Medium => DISOpticalFlow_PRESET_MEDIUM,
        };
        Ok(Self { options: options.clone(), algorithm: DISOpticalFlow::create(preset)? })
    }

    /// A frame, or a part of one, as DIS takes it.
    ///
    /// * `longer_px` – the longer side of the frame.
    fn prepare(&self, image: &RgbImage, longer_px: u32) -> Result<GrayImage, PerceptionError> {
        let most = u64::from(self.options.max_dimension) * u64::from(image.width().max(image.height()));
        let most = most.div_ceil(u64::from(longer_px.max(1))) as u32;
        let (width, height) = scale_to_fit(image.width(), image.height(), most);
        Ok(resize_gray(&gray_from_rgb(image)?, width.max(MIN_SIDE), height.max(MIN_SIDE))?)
    }

    /// The flow between two pictures of one size, at the size of the estimate, and where it is consistent.
    fn both_ways(&mut self, from: &GrayImage, to: &GrayImage) -> Result<(Field, Vec<bool>), PerceptionError> {
        let forward = self.estimate(from, to)?;
        let backward = self.estimate(to, from)?;
        let ok = consistent(&forward, &backward, &self.options);
        Ok((forward, ok))
    }

    fn estimate(&mut self, from: &GrayImage, to: &GrayImage) -> Result<Field, PerceptionError> {
        let mut flow = Mat::default();
        self.algorithm.calc(&borrowed_gray(from)?, &borrowed_gray(to)?, &mut flow)?;
        let pairs = flow.data_typed::<Point2f>()?.iter().map(|p| [p.x, p.y]);
        Ok(Field::from_pairs(flow.cols() as usize, flow.rows() as usize, pairs))
    }
}

impl FlowEstimator for DisFlow {
    fn flow(&mut self, from: &RgbImage, to: &RgbImage) -> Result<Flow, PerceptionError> {
        check_sizes(from, to)?;
        let (width, height) = from.dimensions();
        if width == 0 || height == 0 {
            return Ok(Flow { width, height, displacement: Vec::new(), consistent: Vec::new() });
        }
        let longer_px = width.max(height);
        let (from, to) = (self.prepare(from, longer_px)?, self.prepare(to, longer_px)?);
        let (forward, ok) = self.both_ways(&from, &to)?;
        Ok(at_frame_size(&forward, &ok, width, height))
    }

    fn flow_near(&mut self, from: &RgbImage, to: &RgbImage, boxes: &[Rect]) -> Result<Flow, PerceptionError> {
        check_sizes(from, to)?;
        let (width, height) = from.dimensions();
        let mut flow = nothing((width, height));
        for part in parts(boxes, (width, height)) {
            let prepared = |image: &RgbImage| self.prepare(&crop(image, part), width.max(height));
            let (from, to) = (prepared(from)?, prepared(to)?);
            let (forward, ok) = self.both_ways(&from, &to)?;
            put(&mut flow, part, &forward, &ok);
        }
        Ok(flow)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A texture that is smooth enough to be followed, moved by (dx, dy).
    fn texture(width: u32, height: u32, dx: f32, dy: f32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let (u, v) = (x as f32 - dx, y as f32 - dy);
            let wave = |a: f32, b: f32, c: f32| ((u * a + v * b + c).sin() + 1.0) * 42.0;
            ::image::Rgb([(wave(0.31, 0.17, 0.0) + wave(-0.11, 0.23, 1.0) + wave(0.05, -0.07, 2.0)) as u8; 3])
        })
    }

    #[test]
    fn a_moved_texture_is_followed() {
        let (from, to) = (texture(160, 120, 0.0, 0.0), texture(160, 120, 3.0, -2.0));
        let options = FlowOptions { preset: DisPreset::Medium, ..FlowOptions::default() };
        let flow = DisFlow::new(&options).unwrap().flow(&from, &to).unwrap();
        let [dx, dy] = flow.at(80, 60);
        assert!((dx - 3.0).abs() < 0.3 && (dy + 2.0).abs() < 0.3, "{dx} {dy}");
        let share = flow.consistent.iter().filter(|&&c| c).count() as f64 / flow.consistent.len() as f64;
        assert!(share > 0.9, "{share}");
    }

    #[test]
    fn flow_near_a_box_is_that_of_the_frame_and_elsewhere_there_is_none() {
        let (from, to) = (texture(400, 300, 0.0, 0.0), texture(400, 300, 3.0, -2.0));
        let options = FlowOptions { preset: DisPreset::Medium, ..FlowOptions::default() };
        let near = Rect { x0: 60.0, y0: 60.0, x1: 120.0, y1: 110.0 };
        let mut dis = DisFlow::new(&options).unwrap();
        let flow = dis.flow_near(&from, &to, &[near]).unwrap();
        let [dx, dy] = flow.at(90, 85);
        assert!((dx - 3.0).abs() < 0.3 && (dy + 2.0).abs() < 0.3, "{dx} {dy}");
        assert!(flow.is_consistent(90, 85) && !flow.is_consistent(300, 200) && flow.consistent.len() == 400 * 300);
        // A larger frame is shrunk as a whole frame would be.
        let small = FlowOptions { max_dimension: 200, ..options };
        let [dx, dy] = DisFlow::new(&small).unwrap().flow_near(&from, &to, &[near]).unwrap().at(90, 85);
        assert!((dx - 3.0).abs() < 0.6 && (dy + 2.0).abs() < 0.6, "{dx} {dy}");
        assert!(!dis.flow_near(&from, &to, &[]).unwrap().consistent.contains(&true));
    }

    #[test]
    fn any_size_works_and_different_sizes_are_an_error() {
        let mut dis = DisFlow::new(&FlowOptions::default()).unwrap();
        for (width, height) in [(0, 0), (1, 1), (7, 200), (33, 31)] {
            let image = texture(width, height, 0.0, 0.0);
            let flow = dis.flow(&image, &image).unwrap();
            assert_eq!(flow.displacement.len(), (width * height) as usize);
        }
        let error = dis.flow(&texture(8, 8, 0.0, 0.0), &texture(9, 8, 0.0, 0.0)).unwrap_err();
        assert!(matches!(error, PerceptionError::SizeMismatch { .. }));
    }
}
