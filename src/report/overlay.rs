//! Masks drawn over images, and the thumbnails of the frame strip.

use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage};
use serde::{Deserialize, Serialize};

use super::ReportError;
use crate::image::{ImageError, resize_rgb_quickly};
use crate::scene::{BoundingBox, FrameId, Mask, ObjectId};

/// Opacity of the object's color inside a mask.
const TINT: f32 = 0.38;

/// Ten hues distinguishable from each other and from asphalt, grass and sky, on dark and on light backgrounds.
const PALETTE: [[u8; 3]; 10] = [
    [0xf2, 0x5c, 0x2e],
    [0x1e, 0x9b, 0xe8],
    [0xe0, 0x3f, 0x94],
    [0x16, 0xa8, 0x6b],
    [0xe3, 0xa0, 0x08],
    [0x8b, 0x6c, 0xf6],
    [0x12, 0xa5, 0xb0],
    [0xd9, 0x3b, 0x3b],
    [0x84, 0x9e, 0x12],
    [0xb5, 0x5e, 0xd1],
];

/// The color of an object in images, charts and the 3D view. Ids that differ by ten share the hue, the second darker
/// and the third lighter; ids that differ by thirty share the color.
pub fn object_colour(id: ObjectId) -> [u8; 3] {
    let number = (id.0.max(1) - 1) as usize;
    let hue = PALETTE[number % PALETTE.len()];
    match number / PALETTE.len() % 3 {
        0 => hue,
        // Shades distinguishable from their hue in a legend.
        1 => hue.map(|part| (f32::from(part) * 0.55) as u8),
        _ => hue.map(|part| 255 - (f32::from(255 - part) * 0.5) as u8),
    }
}

/// `#rrggbb`.
pub(super) fn css_colour([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// An image with masks in their objects' colors: a tint inside, a solid outline. A mask of another size than the
/// image is scaled to it. Later masks are drawn over earlier ones.
pub fn overlay(picture: &RgbImage, masks: &[(ObjectId, &Mask)]) -> RgbImage {
    drawn(picture.clone(), &Silhouette::of_all(masks))
}

/// A mask with its bounding box, which limits the visited pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Silhouette<'a> {
    pub id: ObjectId,
    pub mask: &'a Mask,
    pub bounds: BoundingBox,
}

impl<'a> Silhouette<'a> {
    /// The silhouettes of non-empty masks.
    pub fn of_all(masks: &[(ObjectId, &'a Mask)]) -> Vec<Self> {
        masks.iter().filter_map(|&(id, mask)| Some(Self { id, mask, bounds: mask.bounding_box()? })).collect()
    }

    /// Position of the number, above the center of the mask.
    pub fn label(&self) -> Label {
        let Self { id: object, mask, bounds } = *self;
        let x = f64::from(bounds.x0 + bounds.x1) / 2.0 / f64::from(mask.width());
        Label { object, x, y: f64::from(bounds.y0) / f64::from(mask.height()) }
    }
}

/// In-place variant of [`overlay`].
pub(super) fn drawn(mut picture: RgbImage, silhouettes: &[Silhouette]) -> RgbImage {
    let line_px = (picture.width().max(picture.height()) / 360).max(1);
    for silhouette in silhouettes {
        draw(&mut picture, silhouette, line_px);
    }
    picture
}

fn draw(picture: &mut RgbImage, silhouette: &Silhouette, line_px: u32) {
    let Silhouette { id, mask, bounds } = *silhouette;
    let colour = object_colour(id);
    let (width, height) = picture.dimensions();
    // Mask column and row for each of the image, by nearest neighbor: they ascend.
    let nearest = |side: u32, own: u32| -> Vec<u32> {
        let step = f64::from(own) / f64::from(side);
        (0..side).map(|k| ((f64::from(k) + 0.5) * step) as u32).collect()
    };
    let (columns, rows) = (nearest(width, mask.width()), nearest(height, mask.height()));
    let part = |places: &[u32], first: u32, end: u32| {
        // One more on each side: nothing is eroded at the border of a cropped mask.
        let from = places.partition_point(|place| *place < first).saturating_sub(1);
        from..(places.partition_point(|place| *place < end) + 1).min(places.len())
    };
    let (across, down) = (part(&columns, bounds.x0, bounds.x1), part(&rows, bounds.y0, bounds.y1));
    let (columns, rows) = (&columns[across.clone()], &rows[down.clone()]);
    let inside = Mask::from_fn(columns.len() as u32, rows.len() as u32, |x, y| {
        mask.get(columns[x as usize].into(), rows[y as usize].into())
    });
    let core = inside.eroded(line_px);
    for (x, y) in inside.iter() {
        let pixel = picture.get_pixel_mut(across.start as u32 + x, down.start as u32 + y);
        *pixel = if core.get(x.into(), y.into()) { tinted(*pixel, colour) } else { Rgb(colour) };
    }
}

fn tinted(pixel: Rgb<u8>, colour: [u8; 3]) -> Rgb<u8> {
    Rgb(std::array::from_fn(|k| (f32::from(pixel[k]) * (1.0 - TINT) + f32::from(colour[k]) * TINT).round() as u8))
}

/// Position of an object's number in an image of the strip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Label {
    /// The object.
    pub object: ObjectId,
    /// From the left, as a fraction of the width.
    pub x: f64,
    /// From the top, as a fraction of the height.
    pub y: f64,
}

/// An image of the strip: reduced, with masks drawn in, encoded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Thumbnail {
    /// The frame.
    pub frame: FrameId,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// The file.
    pub jpeg: Vec<u8>,
    /// Numbers of the objects, above the top of their masks.
    pub labels: Vec<Label>,
}

impl Thumbnail {
    /// Shrinks a frame's image, draws silhouettes over it and encodes it: the image itself need not be kept.
    ///
    /// # Errors
    /// [`ReportError::Picture`] if the image is empty.
    pub(super) fn new(frame: FrameId, picture: &RgbImage, silhouettes: &[Silhouette]) -> Result<Self, ReportError> {
        // Longer side of an image in the strip, pixels.
        let small = drawn(shrunk(picture, 400)?, silhouettes);
        let (width, height) = small.dimensions();
        let jpeg = jpeg(&small, 74).map_err(|source| ReportError::Picture { frame: frame.0, source })?;
        let labels = silhouettes.iter().map(Silhouette::label).collect();
        Ok(Self { frame, width, height, jpeg, labels })
    }
}

/// A JPEG file of a quality in per cent.
pub(super) fn jpeg(picture: &RgbImage, quality: u8) -> image::ImageResult<Vec<u8>> {
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, quality).encode_image(picture)?;
    Ok(jpeg)
}

/// An image whose longer side is at most `longer` pixels; a smaller one stays unchanged.
pub(super) fn shrunk(picture: &RgbImage, longer: u32) -> Result<RgbImage, ImageError> {
    let (width, height) = shrunk_size(picture.dimensions(), longer);
    resize_rgb_quickly(picture, width, height)
}

fn shrunk_size((width, height): (u32, u32), longer: u32) -> (u32, u32) {
    let side = width.max(height);
    if side <= longer || side == 0 {
        return (width, height);
    }
    let scaled = |length: u32| (f64::from(length) * f64::from(longer) / f64::from(side)).round().max(1.0) as u32;
    (scaled(width), scaled(height))
}

/// The frames of the strip: all of a short clip, evenly spread ones of a longer one, always the
/// first and the last.
pub fn strip_frames(frames: &[FrameId]) -> Vec<FrameId> {
    // The strip is the overview; the film shows the frames between.
    spread(frames.len(), 16).into_iter().map(|i| frames[i]).collect()
}

/// At most `limit` indices out of `0..len`, evenly spread, with the first and the last.
pub(super) fn spread(len: usize, limit: usize) -> Vec<usize> {
    if len <= limit {
        return (0..len).collect();
    }
    match limit {
        0 => Vec::new(),
        1 => vec![0],
        _ => (0..limit).map(|k| (k * (len - 1) + (limit - 1) / 2) / (limit - 1)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thirty_vehicles_have_colors_of_their_own() {
        let colors: std::collections::BTreeSet<_> = (1..=30).map(|id| object_colour(ObjectId(id))).collect();
        assert_eq!((colors.len(), object_colour(ObjectId(31))), (30, object_colour(ObjectId(1))));
    }

    #[test]
    fn masks_are_tinted_and_outlined_at_any_size() {
        let grey = RgbImage::from_pixel(40, 20, Rgb([100, 100, 100]));
        let mask = Mask::from_fn(80, 40, |x, y| (20..60).contains(&x) && (10..30).contains(&y));
        let drawn = overlay(&grey, &[(ObjectId(1), &mask)]);
        let colour = object_colour(ObjectId(1));
        assert_eq!(drawn.get_pixel(10, 5).0, colour, "the outline is solid");
        assert_eq!(*drawn.get_pixel(20, 10), tinted(Rgb([100; 3]), colour), "the inside is tinted");
        assert_eq!(drawn.get_pixel(9, 5).0, [100; 3], "the rest is left alone");
        assert_eq!(overlay(&grey, &[(ObjectId(2), &Mask::empty(40, 20))]), grey);
    }

    #[test]
    fn thumbnails_are_small_and_know_where_the_objects_are() {
        let picture = RgbImage::from_pixel(1920, 1080, Rgb([30, 60, 90]));
        let mask = Mask::from_fn(1920, 1080, |x, y| (960..1920).contains(&x) && y >= 540);
        let silhouettes = Silhouette::of_all(&[(ObjectId(3), &mask)]);
        let thumbnail = Thumbnail::new(FrameId(7), &picture, &silhouettes).unwrap();
        assert_eq!((thumbnail.width, thumbnail.height), (400, 225));
        assert_eq!(thumbnail.labels, [Label { object: ObjectId(3), x: 0.75, y: 0.5 }]);
        let decoded = image::load_from_memory(&thumbnail.jpeg).unwrap().to_rgb8();
        assert_eq!(decoded.dimensions(), (400, 225));
        assert!(Thumbnail::new(FrameId(0), &RgbImage::new(0, 0), &[]).is_err());
    }

    #[test]
    fn the_strip_is_thinned_and_keeps_both_ends() {
        let frames: Vec<_> = (0..1000).map(FrameId).collect();
        let chosen = strip_frames(&frames);
        assert_eq!((chosen.len(), chosen[0], chosen[15]), (16, FrameId(0), FrameId(999)));
        assert!(chosen.windows(2).all(|w| w[0] < w[1]));
        assert_eq!(strip_frames(&frames[..5]).len(), 5);
        assert!(strip_frames(&[]).is_empty());
    }
}
