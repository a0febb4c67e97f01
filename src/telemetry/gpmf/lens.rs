//! Settings of camera and lens.

use serde::Serialize;

use super::devices;
use super::klv::Entry;

/// Camera and lens as stated by the camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Lens {
    /// Name of the camera.
    pub camera: Option<String>,
    /// Name of the field of view, such as `wide` or `linear`.
    pub field_of_view: Option<String>,
    /// Diagonal field of view of the lens before any crop by stabilization, degrees.
    pub diagonal_deg: Option<f64>,
    /// True if the image is stabilized, hence cropped and warped.
    pub is_stabilized: Option<bool>,
    /// Time between the first and the last row of an image, seconds.
    pub readout_s: Option<f64>,
    /// Coefficients of the angle from the axis (radians) as a polynomial of the radius, lowest first (`POLY`).
    pub polynomial: Vec<f64>,
    /// Factor of the radius (over half the diagonal of `size`) before it enters the polynomial (`ZMPL`).
    pub radius_factor: Option<f64>,
    /// Width and height of the images of the polynomial, pixels.
    pub size: Option<[f64; 2]>,
}

/// Reads the container's settings; `None` if they contain no camera or lens.
pub(super) fn read(settings: &[u8]) -> Option<Lens> {
    let mut lens = Lens::default();
    for entry in devices(settings).flat_map(|device| device.nested()) {
        match &entry.key {
            b"MINF" => lens.camera = name(&entry),
            b"VFOV" => lens.field_of_view = name(&entry).map(|letter| field_of_view(&letter).to_owned()),
            b"ZFOV" => lens.diagonal_deg = positive(&entry),
            b"EISE" => lens.is_stabilized = name(&entry).map(|letter| letter == "Y"),
            b"SROT" => lens.readout_s = positive(&entry).map(|milliseconds| milliseconds * 1e-3),
            // Cameras write seven.
            b"POLY" => lens.polynomial = entry.numbers(16),
            b"ZMPL" => lens.radius_factor = positive(&entry),
            b"VRES" => lens.size = entry.numbers(2).try_into().ok(),
            _ => {}
        }
    }
    if lens.polynomial.iter().any(|coefficient| !coefficient.is_finite()) {
        lens.polynomial.clear();
    }
    (lens != Lens::default()).then_some(lens)
}

fn name(entry: &Entry) -> Option<String> {
    Some(entry.text()).filter(|text| !text.is_empty())
}

fn positive(entry: &Entry) -> Option<f64> {
    entry.number().filter(|value| *value > 0.0)
}

fn field_of_view(letter: &str) -> &str {
    match letter {
        "W" => "wide",
        "S" => "superview",
        "H" => "hyperview",
        "L" => "linear",
        "M" => "medium",
        "N" => "narrow",
        other => other,
    }
}

impl Lens {
    /// Formats camera and lens as one line.
    pub(in crate::telemetry) fn as_text(&self) -> String {
        let degrees = self.diagonal_deg.map(|degrees| format!("diagonal field of view {degrees:.1}°"));
        let stabilized = self.is_stabilized.map(|is| if is { "stabilized" } else { "not stabilized" }.to_owned());
        let readout = self.readout_s.map(|readout_s| format!("readout {:.1} ms", 1e3 * readout_s));
        let polynomial = (!self.polynomial.is_empty()).then(|| "lens polynomial".to_owned());
        let parts = [self.camera.clone(), self.field_of_view.clone(), degrees, polynomial, stabilized, readout];
        parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::super::made;
    use super::*;

    #[test]
    fn settings_of_the_lens() {
        let lens = read(&made::settings()).unwrap();
        assert_eq!(
            lens.as_text(),
            "HERO12 Black, wide, diagonal field of view 151.5°, lens polynomial, stabilized, readout 15.5 ms"
        );
        assert_eq!((lens.size, lens.polynomial.len()), (Some([3840.0, 2160.0]), 5));
        assert_eq!((read(&[]), read(&made::nest(b"DEVC", &[]))), (None, None));
        let infinite = made::entry(b"POLY", b'f', 4, &f32::INFINITY.to_be_bytes());
        assert_eq!(read(&made::nest(b"DEVC", &[infinite])), None);
    }
}
