//! The window of Lucas-Kanade.

use opencv::core::Size;

/// Pixels of a row that OpenCV's Lucas-Kanade works on at once; what is left of a row takes it as long as these.
const AT_ONCE: i32 = 8;

/// The window that stands for a square of `2 radius + 1` pixels a side: about as many pixels, in rows of whole vectors.
/// Its following takes half the time, and finds as much.
///
/// * `radius_px` – at least 1 and at most some thousand.
pub fn window_of_radius(radius_px: i32) -> Size {
    let side = 2 * radius_px + 1;
    let width = ((side + AT_ONCE / 2) / AT_ONCE * AT_ONCE).max(AT_ONCE);
    let height = (f64::from(side * side) / f64::from(width)).round() as i32;
    Size::new(width, height.max(3))
}

/// The border that a pyramid needs for the windows of all radii up to one: a smaller one may be higher.
pub fn border_for_radius(radius_px: i32) -> Size {
    let windows = (1..=radius_px.max(1)).map(window_of_radius);
    windows.fold(Size::default(), |border, one| Size::new(border.width.max(one.width), border.height.max(one.height)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_have_whole_vectors_and_about_the_pixels_of_the_square() {
        let of = |radius| (window_of_radius(radius).width, window_of_radius(radius).height);
        assert_eq!([1, 2, 3, 5, 7, 10].map(of), [(8, 3), (8, 3), (8, 6), (8, 15), (16, 14), (24, 18)]);
        for radius in 3..=100 {
            let ((width, height), square) = (of(radius), (2 * radius + 1).pow(2));
            assert!(width % AT_ONCE == 0 && (width * height - square).abs() <= width / 2 + 1, "{radius}");
        }
    }

    #[test]
    fn a_border_has_room_for_the_windows_of_smaller_targets() {
        for radius in 1..=40 {
            let border = border_for_radius(radius);
            let windows = (1..=radius).map(window_of_radius);
            assert!(
                windows.into_iter().all(|one| one.width <= border.width && one.height <= border.height),
                "{radius}"
            );
        }
        assert_eq!(border_for_radius(7), Size::new(16, 15));
    }
}
