//! Drawing of lines and text labels into an image.

use ::image::RgbImage;
use nalgebra::Point2;
use opencv::core::{Mat, Point, Rect, Scalar};
use opencv::imgproc::{self, FILLED, FONT_HERSHEY_SIMPLEX, LINE_8, LINE_AA};

use super::{ImageError, mat_from_rgb, rgb_from_mat};

/// An image to draw into.
pub struct Canvas {
    mat: Mat,
    width: f64,
    height: f64,
}

/// Background rectangle of a text label, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plate {
    /// Its left edge.
    pub left: f64,
    /// Its upper edge.
    pub top: f64,
    /// From left to right.
    pub width: f64,
    /// From top to bottom.
    pub height: f64,
}

impl Plate {
    /// Returns true if it overlaps another one.
    pub fn overlaps(&self, other: &Self) -> bool {
        let apart = |a: f64, a_size: f64, b: f64, b_size: f64| a + a_size <= b || b + b_size <= a;
        !apart(self.left, self.width, other.left, other.width) && !apart(self.top, self.height, other.top, other.height)
    }
}

/// Fractional bits of line coordinates: a sixteenth of a pixel.
const SUBPIXEL_BITS: i32 = 4;
/// Sign that the font lacks.
const PLUS_MINUS: char = '±';
/// Height of a capital letter of the font at scale 1, pixels.
const CAPITAL_PX: f64 = 22.0;
/// Margin of a plate around its text, as a fraction of a capital's height.
const MARGIN: f64 = 0.45;

impl Canvas {
    /// Canvas with a copy of an image.
    ///
    /// # Errors
    /// [`ImageError`] if OpenCV fails; the same for all drawing methods.
    pub fn new(picture: &RgbImage) -> Result<Self, ImageError> {
        let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
        Ok(Self { mat: mat_from_rgb(picture)?, width, height })
    }

    /// Draws a straight line between two positions, pixels with the first center at (0.5, 0.5).
    ///
    /// A line with an end far outside the image is skipped.
    pub fn line(
        &mut self,
        from: Point2<f64>,
        to: Point2<f64>,
        colour: [u8; 3],
        width_px: i32,
    ) -> Result<(), ImageError> {
        if !self.is_near(from) || !self.is_near(to) {
            return Ok(());
        }
        let fixed = |value: f64| ((value - 0.5) * f64::from(1 << SUBPIXEL_BITS)).round() as i32;
        let point = |place: Point2<f64>| Point::new(fixed(place.x), fixed(place.y));
        let (from, to) = (point(from), point(to));
        Ok(imgproc::line(&mut self.mat, from, to, scalar(colour), width_px.max(1), LINE_AA, SUBPIXEL_BITS)?)
    }

    /// Returns true if a position is in the image or outside by no more than its size.
    fn is_near(&self, place: Point2<f64>) -> bool {
        (-self.width..=2.0 * self.width).contains(&place.x) && (-self.height..=2.0 * self.height).contains(&place.y)
    }

    /// Plate that fits a text, shifted into the image.
    ///
    /// * `lower_left` – corner of the plate, pixels.
    /// * `capital_px` – height of a capital letter.
    pub fn plate(&self, text: &str, lower_left: Point2<f64>, capital_px: f64) -> Result<Plate, ImageError> {
        let margin = MARGIN * capital_px;
        let width = self.text_width(text, capital_px)? + 2.0 * margin;
        let height = capital_px + 2.2 * margin;
        let left = lower_left.x.min(self.width - width).max(0.0);
        let bottom = lower_left.y.min(self.height).max(height);
        Ok(Plate { left, top: bottom - height, width, height })
    }

    /// Draws text on a plate. Characters outside ASCII become `?`, except `±`.
    pub fn words(&mut self, text: &str, plate: &Plate, capital_px: f64, colour: [u8; 3]) -> Result<(), ImageError> {
        let (width, height) = (plate.width.ceil() as i32, plate.height.ceil() as i32);
        let rect = Rect::new(plate.left as i32, plate.top as i32, width, height);
        imgproc::rectangle(&mut self.mat, rect, scalar(colour), FILLED, LINE_8, 0)?;
        let ink = if is_light(colour) { [20; 3] } else { [255; 3] };
        let margin = MARGIN * capital_px;
        let base = Point2::new(plate.left + margin, plate.top + plate.height - 1.1 * margin);
        self.text(text, base, capital_px, ink)
    }

    fn text_width(&self, text: &str, capital_px: f64) -> Result<f64, ImageError> {
        let (scale, thickness, mut base_line) = (capital_px / CAPITAL_PX, thickness(capital_px), 0);
        let shown = shown(text).replace(PLUS_MINUS, "+");
        let size = imgproc::get_text_size(&shown, FONT_HERSHEY_SIMPLEX, scale, thickness, &mut base_line)?;
        Ok(f64::from(size.width))
    }

    fn text(&mut self, text: &str, base: Point2<f64>, capital_px: f64, ink: [u8; 3]) -> Result<(), ImageError> {
        let (scale, thickness) = (capital_px / CAPITAL_PX, thickness(capital_px));
        let at = |x: f64, y: f64| Point::new(x.round() as i32, y.round() as i32);
        let shown = shown(text);
        let plain = shown.replace(PLUS_MINUS, "+");
        let (font, ink) = (FONT_HERSHEY_SIMPLEX, scalar(ink));
        imgproc::put_text(&mut self.mat, &plain, at(base.x, base.y), font, scale, ink, thickness, LINE_AA, false)?;
        // The bar below each plus sign that represents `±`.
        for (index, _) in shown.match_indices(PLUS_MINUS) {
            let before = self.text_width(&shown[..index], capital_px)?;
            let sign = self.text_width("+", capital_px)?;
            let (left, right) = (base.x + before + 0.16 * sign, base.x + before + 0.78 * sign);
            let y = base.y + 0.08 * CAPITAL_PX * scale;
            imgproc::line(&mut self.mat, at(left, y), at(right, y), ink, thickness, LINE_AA, 0)?;
        }
        Ok(())
    }

    /// The resulting image.
    pub fn finish(self) -> Result<RgbImage, ImageError> {
        rgb_from_mat(&self.mat)
    }
}

/// Stroke thickness of letters, pixels.
fn thickness(capital_px: f64) -> i32 {
    (capital_px / 9.0).round().max(1.0) as i32
}

/// Text with characters missing from the font replaced.
fn shown(text: &str) -> String {
    text.chars().map(|c| if c == PLUS_MINUS || c == ' ' || c.is_ascii_graphic() { c } else { '?' }).collect()
}

fn scalar([r, g, b]: [u8; 3]) -> Scalar {
    Scalar::new(f64::from(r), f64::from(g), f64::from(b), 0.0)
}

/// Returns true if dark letters are more legible on a color than light ones, by its luma (ITU-R BT.601).
fn is_light([r, g, b]: [u8; 3]) -> bool {
    0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b) > 150.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changed(draw: impl FnOnce(&mut Canvas)) -> usize {
        let grey = RgbImage::from_pixel(200, 100, ::image::Rgb([100; 3]));
        let mut canvas = Canvas::new(&grey).unwrap();
        draw(&mut canvas);
        let drawn = canvas.finish().unwrap();
        drawn.pixels().zip(grey.pixels()).filter(|(a, b)| a != b).count()
    }

    #[test]
    fn lines_are_drawn_where_they_belong() {
        let mut canvas = Canvas::new(&RgbImage::new(40, 20)).unwrap();
        canvas.line(Point2::new(0.5, 10.5), Point2::new(39.5, 10.5), [255, 0, 0], 1).unwrap();
        let drawn = canvas.finish().unwrap();
        assert!(drawn.get_pixel(20, 10).0[0] > 200, "smooth lines are a little wider and paler than one pixel");
        assert_eq!(drawn.get_pixel(20, 5).0, [0; 3]);
        let far = |canvas: &mut Canvas| {
            canvas.line(Point2::new(1e9, f64::NAN), Point2::new(3.0, 3.0), [255; 3], 2).unwrap();
        };
        assert_eq!(changed(far), 0);
    }

    #[test]
    fn words_stay_in_the_picture_and_the_sign_has_its_bar() {
        let words = |text: &'static str, x: f64, y: f64| {
            changed(|canvas| {
                let plate = canvas.plate(text, Point2::new(x, y), 11.0).unwrap();
                canvas.words(text, &plate, 11.0, [0, 0, 90]).unwrap();
            })
        };
        let inside = words("54 km/h", 20.0, 60.0);
        assert!(inside > 500, "{inside}");
        assert_eq!(words("54 km/h", 190.0, -5.0), inside);
        let drawn = |text: &str| {
            let mut canvas = Canvas::new(&RgbImage::new(200, 100)).unwrap();
            let plate = canvas.plate(text, Point2::new(20.0, 60.0), 22.0).unwrap();
            canvas.words(text, &plate, 22.0, [0; 3]).unwrap();
            canvas.finish().unwrap()
        };
        assert_ne!(drawn("4 ± 1"), drawn("4 + 1"));
        assert_eq!(drawn("Škoda"), drawn("?koda"));
    }

    #[test]
    fn plates_overlap_where_they_share_a_part() {
        let plate = |left: f64, top: f64| Plate { left, top, width: 10.0, height: 4.0 };
        assert!(plate(0.0, 0.0).overlaps(&plate(9.0, 3.0)));
        assert!(!plate(0.0, 0.0).overlaps(&plate(10.0, 0.0)) && !plate(0.0, 4.0).overlaps(&plate(0.0, 0.0)));
    }
}
