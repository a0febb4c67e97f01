//! The window of Lucas-Kanade.

use super::LANES;

/// Size of the window compared around a point, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub width: usize,
    pub height: usize,
}

impl Window {
    /// Window equivalent to a square of `2 radius + 1` pixels a side: about as many pixels, in rows of whole vectors.
    ///
    /// Tracking takes half the time, with equal success.
    ///
    /// * `radius_px` – at least 1 and at most some thousand.
    pub fn of_radius(radius_px: usize) -> Self {
        let side = 2 * radius_px + 1;
        let width = ((side + LANES / 2) / LANES * LANES).max(LANES);
        let height = ((side * side) as f64 / width as f64).round() as usize;
        Self { width, height: height.max(3) }
    }

    pub fn num_pixels(self) -> usize {
        self.width * self.height
    }

    /// Offset from the first pixel's center to the middle of the window.
    pub fn half(self) -> [f32; 2] {
        [(self.width - 1) as f32 / 2.0, (self.height - 1) as f32 / 2.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_have_whole_vectors_and_about_the_pixels_of_the_square() {
        let of = |radius| (Window::of_radius(radius).width, Window::of_radius(radius).height);
        assert_eq!([1, 2, 3, 5, 7, 10].map(of), [(8, 3), (8, 3), (8, 6), (8, 15), (16, 14), (24, 18)]);
        for radius in 3..=100usize {
            let ((width, height), square) = (of(radius), (2 * radius + 1).pow(2));
            assert!(width % LANES == 0 && (width * height).abs_diff(square) <= width / 2 + 1, "{radius}");
        }
    }
}
