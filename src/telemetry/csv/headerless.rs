//! Tables without a header, recognized by their first row; a new one is a row of [`DIALECTS`].

use super::super::text::number;

/// Table format without a header.
pub(super) struct Headerless {
    /// Its name in reports.
    pub(super) name: &'static str,
    /// Equivalent header, with commas.
    pub(super) header: &'static str,
    /// Cell separator.
    pub(super) delimiter: u8,
    /// Returns true if a row with this separator is of this format.
    recognizes: fn(&[&str]) -> bool,
}

pub(super) const DIALECTS: [Headerless; 3] = [
    // Dash cameras: 1714827906,A,12.345000,-34.567000,...: seconds after 1970, A for a valid fix.
    Headerless {
        name: "csv-dashcam",
        header: "utc,fix,latitude,longitude",
        delimiter: b',',
        recognizes: |cells| matches!(cells, [time, "A" | "V", lat, lon, ..] if is_clock(time) && is_place(lon, lat)),
    },
    // OpenDroneMap's geo.txt below its line with the projection: name, x, y, height, angles, accuracies.
    Headerless {
        name: "geo.txt",
        header: "image,longitude,latitude,altitude,yaw,pitch,roll,hacc,vacc",
        delimiter: b' ',
        recognizes: |cells| matches!(cells, [image, lon, lat, ..] if is_image(image) && is_place(lon, lat)),
    },
    // Pix4D's geolocation file: name, latitude, longitude, height.
    Headerless {
        name: "pix4d",
        header: "image,latitude,longitude,altitude",
        delimiter: b',',
        recognizes: |cells| matches!(cells, [image, lat, lon, ..] if is_image(image) && is_place(lon, lat)),
    },
];

/// Recognizes the format of a text, and the number of lines before the first row.
pub(super) fn recognize(text: &str) -> Option<(&'static Headerless, usize)> {
    // A program version or a projection may precede the first row.
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).take(2);
    lines.find_map(|(before, line)| {
        let is_row = |dialect: &&Headerless| {
            let cells: Vec<&str> = line.split(char::from(dialect.delimiter)).map(str::trim).collect();
            (dialect.recognizes)(&cells)
        };
        Some((DIALECTS.iter().find(is_row)?, before))
    })
}

/// Returns true if a text is a `geo.txt` of images with coordinates in a projection.
pub(in crate::telemetry) fn is_projected(text: &str) -> bool {
    let mut lines = text.lines();
    let projection = lines.next().unwrap_or_default().trim().to_ascii_lowercase();
    let is_stated = ["epsg:", "+proj=", "wgs84 utm"].iter().any(|start| projection.starts_with(start));
    let is_geographic = projection == "epsg:4326" || projection.contains("longlat");
    let first = lines.find(|line| !line.trim().is_empty()).unwrap_or_default();
    let cells: Vec<&str> = first.split_whitespace().collect();
    let is_row =
        matches!(cells[..], [image, x, y, ..] if is_image(image) && number(x).is_some() && number(y).is_some());
    is_stated && !is_geographic && is_row
}

fn is_clock(text: &str) -> bool {
    number(text).is_some_and(|time| time > 1e8)
}

fn is_place(longitude: &str, latitude: &str) -> bool {
    // A number without decimals is a counter or a projected coordinate.
    let within = |text: &str, most: f64| text.contains('.') && number(text).is_some_and(|value| value.abs() <= most);
    within(longitude, 180.0) && within(latitude, 90.0)
}

fn is_image(text: &str) -> bool {
    let Some((_, extension)) = text.rsplit_once('.') else { return false };
    ["jpg", "jpeg", "png", "tif", "tiff", "dng"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}
