//! Masks of a window of the frame.

use super::window::Window;
use crate::scene::{Mask, Rect};

/// Mask of a window of the frame.
pub(super) struct LocalMask {
    pub(super) window: Window,
    pub(super) mask: Mask,
}

impl LocalMask {
    /// Bounding box in the frame.
    pub(super) fn rect(&self) -> Option<Rect> {
        let inner = Rect::from(self.mask.bounding_box()?);
        let [x, y] = [self.window.x0, self.window.y0].map(f64::from);
        Some(inner.moved([x, y]))
    }

    /// Mask in the full frame.
    pub(super) fn in_frame(&self, (width, height): (u32, u32)) -> Mask {
        let mut all = Mask::empty(width, height);
        self.mask.iter().for_each(|(x, y)| all.set(self.window.x0 + x, self.window.y0 + y));
        all
    }
}
