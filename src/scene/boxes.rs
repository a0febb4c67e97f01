//! Bounding boxes, and detections that consist of one.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::BoundingBox;

/// Axis-aligned box in an image; corners in pixels, the center of the upper left pixel at (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rect {
    /// Left side.
    pub x0: f64,
    /// Upper side.
    pub y0: f64,
    /// Right side.
    pub x1: f64,
    /// Lower side.
    pub y1: f64,
}

impl Rect {
    /// Smallest box that contains all points; `None` without points.
    pub fn around<'a>(points: impl IntoIterator<Item = &'a Point2<f64>>) -> Option<Self> {
        let of_point = |point: &Point2<f64>| Self { x0: point.x, y0: point.y, x1: point.x, y1: point.y };
        points.into_iter().map(of_point).reduce(|a, b| a.union(&b))
    }

    /// Width, pixels; 0 for an inverted box.
    pub fn width(&self) -> f64 {
        (self.x1 - self.x0).max(0.0)
    }

    /// Height, pixels; 0 for an inverted box.
    pub fn height(&self) -> f64 {
        (self.y1 - self.y0).max(0.0)
    }

    /// Center, pixels.
    pub fn center(&self) -> [f64; 2] {
        [0.5 * (self.x0 + self.x1), 0.5 * (self.y0 + self.y1)]
    }

    /// Longer side, pixels.
    pub fn extent_px(&self) -> f64 {
        self.width().max(self.height())
    }

    /// Area, square pixels.
    pub fn area_px2(&self) -> f64 {
        self.width() * self.height()
    }

    /// Returns true if a point is in the box; its right and lower sides are outside.
    pub fn contains(&self, x: f64, y: f64) -> bool {
        (self.x0..self.x1).contains(&x) && (self.y0..self.y1).contains(&y)
    }

    /// Intersection of two boxes; its area is zero if they do not overlap.
    #[must_use]
    pub fn intersection(&self, other: &Self) -> Self {
        Self {
            x0: self.x0.max(other.x0),
            y0: self.y0.max(other.y0),
            x1: self.x1.min(other.x1),
            y1: self.y1.min(other.y1),
        }
    }

    /// Smallest box that contains both.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        Self {
            x0: self.x0.min(other.x0),
            y0: self.y0.min(other.y0),
            x1: self.x1.max(other.x1),
            y1: self.y1.max(other.y1),
        }
    }

    /// Intersection over union, 0 to 1.
    pub fn iou(&self, other: &Self) -> f64 {
        let common = self.intersection(other).area_px2();
        let all = self.area_px2() + other.area_px2() - common;
        if all > 0.0 { common / all } else { 0.0 }
    }

    /// The box enlarged on every side by a share of its longer side.
    #[must_use]
    pub fn grown(&self, share: f64) -> Self {
        let margin = share * self.extent_px();
        Self { x0: self.x0 - margin, y0: self.y0 - margin, x1: self.x1 + margin, y1: self.y1 + margin }
    }

    /// The same box in an image resized by a horizontal and a vertical factor.
    pub fn scaled(&self, [across, down]: [f64; 2]) -> Self {
        Self { x0: across * self.x0, y0: down * self.y0, x1: across * self.x1, y1: down * self.y1 }
    }

    /// The box translated by a vector, pixels.
    #[must_use]
    pub fn moved(&self, [dx, dy]: [f64; 2]) -> Self {
        Self { x0: self.x0 + dx, y0: self.y0 + dy, x1: self.x1 + dx, y1: self.y1 + dy }
    }

    /// The box clipped to an image.
    #[must_use]
    pub fn clipped(&self, width: u32, height: u32) -> Self {
        self.intersection(&Self { x0: 0.0, y0: 0.0, x1: f64::from(width), y1: f64::from(height) })
    }
}

impl From<BoundingBox> for Rect {
    fn from(found: BoundingBox) -> Self {
        let [x0, y0, x1, y1] = [found.x0, found.y0, found.x1, found.y1].map(f64::from);
        Self { x0, y0, x1, y1 }
    }
}

/// Source of a detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DetectionSource {
    /// A network that assigns a class.
    Detector,
    /// Motion relative to the background.
    Motion,
}

/// Detection in one frame, as a box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoxDetection {
    /// Class name; `vehicle` for a detection by motion alone.
    pub class: String,
    /// Confidence, 0 to 1.
    pub confidence: f64,
    /// Bounding box.
    pub rect: Rect,
    /// Source of the detection.
    pub finder: DetectionSource,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_overlap_by_their_areas() {
        let a = Rect { x0: 0.0, y0: 0.0, x1: 4.0, y1: 2.0 };
        let b = Rect { x0: 2.0, y0: 0.0, x1: 6.0, y1: 2.0 };
        assert_eq!(a.iou(&b), 4.0 / 12.0);
        assert_eq!(a.union(&b), Rect { x1: 6.0, ..a });
        let apart = Rect { x0: 9.0, y0: 5.0, x1: 10.0, y1: 6.0 };
        assert_eq!((a.iou(&apart), a.intersection(&apart).area_px2()), (0.0, 0.0));
        assert!(a.contains(3.9, 0.0) && !a.contains(4.0, 0.0));
    }

    #[test]
    fn grown_boxes_are_cut_at_the_border() {
        let a = Rect { x0: 1.0, y0: 1.0, x1: 5.0, y1: 3.0 };
        assert_eq!(a.grown(0.5), Rect { x0: -1.0, y0: -1.0, x1: 7.0, y1: 5.0 });
        assert_eq!(a.grown(0.5).clipped(6, 4), Rect { x0: 0.0, y0: 0.0, x1: 6.0, y1: 4.0 });
    }
}
