//! Camera, focal length, orientation and time of a photograph from its EXIF block.

use std::io::BufReader;
use std::ops::RangeInclusive;
use std::path::Path;

use ::image::metadata::Orientation;
use exif::{DateTime, Exif, In, Tag, Value};

use crate::files;

/// Longer side of the film frame to which `FocalLengthIn35mmFilm` refers, millimeters.
///
/// Focal lengths are equivalent if they have the same field of view over the diagonal of the sensor as over that of a
/// film frame, 43.27 mm. The longer side of a 3:2 sensor, the shape of film, corresponds to 36 mm, that of a 4:3 sensor
/// to 34.61 mm. An image of another shape was cropped from one or the other: 35.3 mm, between them.
fn film_side_mm(width: u32, height: u32) -> f64 {
    let aspect = f64::from(width.max(height)) / f64::from(width.min(height).max(1));
    let is_near = |shape: f64| (aspect / shape - 1.0).abs() < SHAPE_TOLERANCE;
    if is_near(4.0 / 3.0) {
        34.61
    } else if is_near(3.0 / 2.0) {
        36.0
    } else {
        35.3
    }
}

/// Plausible focal lengths, in units of the longer image side: from 4 mm on film to 3.6 m.
const LENSES: RangeInclusive<f64> = 0.1..=100.0;

/// Tolerance of the aspect ratio: above the effect of rounding the sides of small images.
const SHAPE_TOLERANCE: f64 = 0.02;

/// Reads the EXIF block of an image file; `None` without one.
///
/// Many cameras write blocks with flaws: their readable fields are returned.
///
/// # Errors
/// The reason why a block cannot be read at all.
pub(super) fn read(path: &Path) -> Result<Option<Exif>, String> {
    let Ok(file) = files::open_within_memory(path) else { return Ok(None) };
    let read = exif::Reader::new().continue_on_error(true).read_from_container(&mut BufReader::new(file));
    match read.or_else(|error| error.distill_partial_result(|_| {})) {
        Ok(exif) => Ok(Some(exif)),
        Err(exif::Error::NotFound(_)) => Ok(None),
        Err(error) => Err(error.to_string()),
    }
}

/// Rotation that turns the stored image upright.
pub(super) fn orientation(exif: &Exif) -> Orientation {
    exif.get_field(Tag::Orientation, In::PRIMARY)
        .and_then(|field| field.value.get_uint(0))
        .and_then(|value| Orientation::from_exif(u8::try_from(value).ok()?))
        .unwrap_or(Orientation::NoTransforms)
}

/// Camera and settings from the block. Images with equal values were taken with the same focal length.
pub(super) fn camera(exif: &Exif) -> Vec<String> {
    const TAGS: [Tag; 5] = [Tag::Make, Tag::Model, Tag::LensModel, Tag::FocalLength, Tag::FocalLengthIn35mmFilm];
    let said = |tag| exif.get_field(tag, In::PRIMARY).map(|field| field.display_value().to_string());
    TAGS.map(|tag| said(tag).unwrap_or_default()).to_vec()
}

/// Focal length in pixels of an image of `width` × `height`; `None` if the block has none.
///
/// The value comes from `FocalLengthIn35mmFilm`, else from `FocalLength` and the sensor's pixel pitch, provided that
/// the image still has the size that the camera wrote. A cropped image, recognized by its aspect ratio, gives `None`,
/// and so does an implausible focal length.
pub(super) fn focal_px(exif: &Exif, width: u32, height: u32) -> Option<f64> {
    let longer_px = f64::from(width.max(height));
    stated_px(exif, width, height).filter(|focal_px| LENSES.contains(&(focal_px / longer_px)))
}

/// Focal length in pixels of an image of `width` × `height`, from its 35 mm equivalent, millimeters.
pub fn focal_px_of_equivalent(equivalent_mm: f64, width: u32, height: u32) -> f64 {
    equivalent_mm / film_side_mm(width, height) * f64::from(width.max(height))
}

fn stated_px(exif: &Exif, width: u32, height: u32) -> Option<f64> {
    let longer_px = f64::from(width.max(height));
    if was_cut(exif, width, height) {
        return None;
    }
    if let Some(equivalent_mm) = number(exif, Tag::FocalLengthIn35mmFilm) {
        return Some(focal_px_of_equivalent(equivalent_mm, width, height));
    }
    let focal_mm = number(exif, Tag::FocalLength)?;
    let pixels_per_unit = number(exif, Tag::FocalPlaneXResolution)?;
    let unit_mm = match exif.get_field(Tag::FocalPlaneResolutionUnit, In::PRIMARY).and_then(|f| f.value.get_uint(0)) {
        Some(3) => 10.0,
        Some(4) => 1.0,
        _ => 25.4,
    };
    let original_px = recorded_px(exif).map(|[x, y]| x.max(y))?;
    Some(focal_mm * pixels_per_unit / unit_mm * longer_px / original_px)
}

/// Returns true if the aspect ratio differs from the one that the camera wrote, if it wrote one.
fn was_cut(exif: &Exif, width: u32, height: u32) -> bool {
    let aspect = |a: f64, b: f64| a.max(b) / a.min(b);
    let Some([x, y]) = recorded_px(exif) else { return false };
    (aspect(x, y) / aspect(f64::from(width), f64::from(height)) - 1.0).abs() > SHAPE_TOLERANCE
}

/// Image width and height according to the camera.
fn recorded_px(exif: &Exif) -> Option<[f64; 2]> {
    Some([number(exif, Tag::PixelXDimension)?, number(exif, Tag::PixelYDimension)?])
}

/// Capture time of a photograph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptureTime {
    /// Local date and time: `2014-05-01T10:00:00.25`.
    pub local: String,
    /// Local time minus UTC, as written in the block: `+02:00`.
    pub utc_offset: Option<String>,
}

/// Capture time of a photograph; `None` if its EXIF block has none.
///
/// Uses `DateTimeOriginal`, `SubSecTimeOriginal` and `OffsetTimeOriginal`.
pub fn capture_time(path: &Path) -> Option<CaptureTime> {
    capture_time_of(&read(path).ok()??)
}

fn capture_time_of(exif: &Exif) -> Option<CaptureTime> {
    let ascii = |tag| match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Ascii(texts) => Some(texts.first()?.as_slice()),
        _ => None,
    };
    let stated = DateTime::from_ascii(ascii(Tag::DateTimeOriginal)?).ok()?;
    let DateTime { year, month, day, hour, minute, second, .. } = stated;
    let small = |value: u8| i8::try_from(value).ok();
    let date = jiff::civil::Date::new(i16::try_from(year).ok()?, small(month)?, small(day)?).ok()?;
    // A leap second counts as the preceding second.
    let time = jiff::civil::Time::new(small(hour)?, small(minute)?, small(second)?.min(59), 0).ok()?;
    let digits = ascii(Tag::SubSecTimeOriginal).map(|text| String::from_utf8_lossy(text).trim().to_owned());
    let fraction = digits.filter(|digits| !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit()));
    let fraction = fraction.map_or_else(String::new, |digits| format!(".{digits}"));
    let utc_offset = ascii(Tag::OffsetTimeOriginal).map(|text| String::from_utf8_lossy(text).trim().to_owned());
    Some(CaptureTime { local: format!("{date}T{time}{fraction}"), utc_offset })
}

/// A positive number.
fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first()?.to_f64(),
        Value::Float(values) => f64::from(*values.first()?),
        Value::Double(values) => *values.first()?,
        other => f64::from(other.get_uint(0)?),
    };
    (value.is_finite() && value > 0.0).then_some(value)
}

#[cfg(test)]
mod tests {
    use exif::experimental::Writer;
    use exif::{Field, Rational};
    use rand::Rng as _;

    use super::*;
    use crate::math::seeded_rng;

    fn block(fields: &[(Tag, Value)]) -> Exif {
        let fields: Vec<Field> =
            fields.iter().map(|(tag, value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() }).collect();
        let mut writer = Writer::new();
        for field in &fields {
            writer.push_field(field);
        }
        let mut bytes = std::io::Cursor::new(Vec::new());
        writer.write(&mut bytes, false).unwrap();
        exif::Reader::new().read_raw(bytes.into_inner()).unwrap()
    }

    #[test]
    fn focal_length_from_the_film_equivalent() {
        let exif =
            block(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![24])), (Tag::Orientation, Value::Short(vec![6]))]);
        assert_eq!(focal_px(&exif, 3000, 4000), Some(24.0 / 34.61 * 4000.0));
        assert_eq!(focal_px(&exif, 3000, 2000), Some(24.0 / 36.0 * 3000.0));
        assert_eq!(focal_px(&exif, 1600, 900), Some(24.0 / 35.3 * 1600.0));
        assert_eq!(orientation(&exif), Orientation::Rotate90);
    }

    #[test]
    fn focal_length_from_the_pixel_pitch() {
        let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
        let exif = block(&[
            (Tag::FocalLength, rational(88, 10)),
            (Tag::FocalPlaneXResolution, rational(4000, 1)),
            (Tag::FocalPlaneResolutionUnit, Value::Short(vec![3])),
            (Tag::PixelXDimension, Value::Long(vec![4000])),
            (Tag::PixelYDimension, Value::Long(vec![3000])),
        ]);
        // 4000 pixels per centimeter: 8.8 mm are 3520 pixels, half of that in the image of half the size.
        assert!((focal_px(&exif, 2000, 1500).unwrap() - 1760.0).abs() < 1e-9);
    }

    #[test]
    fn a_cropped_image_has_no_focal_length() {
        let exif = block(&[
            (Tag::FocalLengthIn35mmFilm, Value::Short(vec![36])),
            (Tag::PixelXDimension, Value::Long(vec![4000])),
            (Tag::PixelYDimension, Value::Long(vec![3000])),
        ]);
        assert_eq!(focal_px(&exif, 2000, 1500), Some(36.0 / 34.61 * 2000.0));
        assert_eq!(focal_px(&exif, 1500, 2000), Some(36.0 / 34.61 * 2000.0));
        assert_eq!(focal_px(&exif, 2000, 1000), None);
    }

    #[test]
    fn readable_fields_of_a_flawed_block_are_read() {
        let fields = [(Tag::FocalLengthIn35mmFilm, Value::Short(vec![24])), (Tag::Orientation, Value::Short(vec![6]))];
        let mut bytes = block(&fields).buf().to_vec();
        let number = |bytes: &[u8], at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let count = |bytes: &[u8], at: usize| usize::from(u16::from_be_bytes([bytes[at], bytes[at + 1]]));
        let first = number(&bytes, 4);
        let mut entries = (0..count(&bytes, first)).map(|k| first + 2 + 12 * k);
        let pointer = entries.find(|&at| bytes[at..at + 2] == [0x87, 0x69]).unwrap();
        // A further directory is announced after the one of the camera's data, where none is allowed.
        let directory = number(&bytes, pointer + 8);
        let next = directory + 2 + 12 * count(&bytes, directory);
        bytes[next..next + 4].copy_from_slice(&0x4000_0000u32.to_be_bytes());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        std::fs::write(&path, &bytes).unwrap();
        let exif = read(&path).unwrap().unwrap();
        assert_eq!(orientation(&exif), Orientation::Rotate90);
        assert_eq!(focal_px(&exif, 3000, 4000), Some(24.0 / 34.61 * 4000.0));
        std::fs::write(&path, &bytes[..6]).unwrap();
        assert!(read(&path).is_err());
    }

    #[test]
    fn values_of_damaged_blocks_are_numbers() {
        let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
        let fields = [
            (Tag::Make, Value::Ascii(vec![b"maker".to_vec()])),
            (Tag::Orientation, Value::Short(vec![6])),
            (Tag::FocalLength, rational(88, 10)),
            (Tag::FocalPlaneXResolution, rational(4000, 1)),
            (Tag::PixelXDimension, Value::Long(vec![4000])),
            (Tag::PixelYDimension, Value::Long(vec![3000])),
        ];
        let whole = block(&fields).buf().to_vec();
        let (mut rng, mut num_read) = (seeded_rng(4, 0), 0);
        for _ in 0..20_000 {
            let mut bytes = whole.clone();
            for _ in 0..rng.random_range(1..=3) {
                let at = rng.random_range(0..bytes.len());
                bytes[at] = if rng.random() { rng.random() } else { [0, 255][rng.random_range(0..2)] };
            }
            bytes.truncate(rng.random_range(0..8 * whole.len()));
            let Ok(exif) = exif::Reader::new().read_raw(bytes) else { continue };
            num_read += 1;
            assert!(focal_px(&exif, 4000, 3000).is_none_or(|focal| focal.is_finite() && focal > 0.0));
            let _ = (orientation(&exif), camera(&exif), capture_time_of(&exif));
        }
        assert!(num_read > 1000, "{num_read}");
    }

    #[test]
    fn the_time_of_a_photograph_is_local_and_has_its_offset() {
        let text = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
        let original = (Tag::DateTimeOriginal, text("2014:05:01 10:00:07"));
        let found = capture_time_of(&block(std::slice::from_ref(&original))).unwrap();
        assert_eq!((found.local.as_str(), found.utc_offset), ("2014-05-01T10:00:07", None));
        let more = [(Tag::SubSecTimeOriginal, text("25 ")), (Tag::OffsetTimeOriginal, text("+02:00"))];
        let found = capture_time_of(&block(&[&[original][..], &more].concat())).unwrap();
        assert_eq!((found.local.as_str(), found.utc_offset.as_deref()), ("2014-05-01T10:00:07.25", Some("+02:00")));
        for wrong in
            ["", "    :  :     :  :  ", "0000:00:00 00:00:00", "2014:13:01 10:00:00", "2014:02:30 10:00:00", "x"]
        {
            assert_eq!(capture_time_of(&block(&[(Tag::DateTimeOriginal, text(wrong))])), None, "{wrong}");
        }
    }

    #[test]
    fn nonsense_is_nothing() {
        let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
        assert_eq!(focal_px(&block(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![0]))]), 10, 10), None);
        assert_eq!(focal_px(&block(&[(Tag::FocalLength, rational(1, 0))]), 10, 10), None);
        assert!(read(Path::new("no such file")).unwrap().is_none());
    }
}
