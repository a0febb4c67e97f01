//! Table columns by name and unit.

use super::super::text::{KNOT_M_S, MPH_M_S, shown};

/// Quantity of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Column {
    Longitude,
    Latitude,
    VideoTime,
    Clock,
    /// Time of day next to a date in `Clock`.
    TimeOfDay,
    Image,
    GpsHeight,
    RelativeHeight,
    HorizontalStd,
    VerticalStd,
    Speed,
    Receiver,
    Yaw,
    Pitch,
    Roll,
    GimbalYaw,
    GimbalPitch,
    GimbalRoll,
}

/// Dimension of a unit, or of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dimension {
    Length,
    Time,
    Speed,
    Angle,
    Text,
}

impl Column {
    fn dimension(self) -> Dimension {
        match self {
            Self::VideoTime => Dimension::Time,
            Self::GpsHeight | Self::RelativeHeight | Self::HorizontalStd | Self::VerticalStd => Dimension::Length,
            Self::Speed => Dimension::Speed,
            Self::Clock | Self::TimeOfDay | Self::Image | Self::Receiver => Dimension::Text,
            _ => Dimension::Angle,
        }
    }
}

/// Names of columns without blanks and punctuation.
const NAMES: [(Column, &[&str]); 18] = [
    (Column::Longitude, &["longitude", "lon", "lng", "long"]),
    (Column::Latitude, &["latitude", "lat"]),
    (
        Column::VideoTime,
        &["time", "videotime", "elapsed", "elapsedtime", "secondselapsed", "flytime", "flighttime", "cts", "t"],
    ),
    (
        Column::Clock,
        &["utc", "datetime", "timestamp", "date", "clock", "datetimeutc", "timeutc", "utctime", "timestamputc"],
    ),
    (Column::TimeOfDay, &["updatetime", "timeofday", "localtime"]),
    (Column::Image, &["label", "image", "imagename", "filename", "file", "photo", "photoname", "sourcefile"]),
    (
        Column::GpsHeight,
        &[
            "gpsheight",
            "altitude",
            "alt",
            "ele",
            "elevation",
            "altitudeabovesealevel",
            "absalt",
            "gpsaltitude",
            "hmsl",
            "altitudemsl",
        ],
    ),
    (
        Column::RelativeHeight,
        &[
            "relativeheight",
            "height",
            "relalt",
            "heightabovetakeoff",
            "relativealtitude",
            "ascent",
            "barometricheight",
            "barometricaltitude",
        ],
    ),
    (Column::HorizontalStd, &["horizontalstd", "horizontalaccuracy", "hacc", "accuracy"]),
    (Column::VerticalStd, &["verticalstd", "verticalaccuracy", "vacc"]),
    (Column::Speed, &["speed", "groundspeed", "horizontalspeed", "hspeed", "velocity"]),
    (Column::Receiver, &["fix", "fixtype", "receiver"]),
    (Column::Yaw, &["yaw", "heading", "compassheading"]),
    (Column::Pitch, &["pitch"]),
    (Column::Roll, &["roll"]),
    (Column::GimbalYaw, &["gimbalyaw", "gimbalheading"]),
    (Column::GimbalPitch, &["gimbalpitch"]),
    (Column::GimbalRoll, &["gimbalroll"]),
];

/// Prefixes of names that state the source of a value, not its quantity (`OSD.latitude`, `Aircraft Latitude`,
/// Metashape's `X/Longitude`). `home`, `max` and similar words are not among them: they state another quantity.
const PREFIXES: [&str; 14] = [
    "gps", "gnss", "rtk", "osd", "custom", "aircraft", "drone", "uav", "vehicle", "position", "location", "x", "y", "z",
];

/// Units by dimension, and their values in meters, seconds, meters per second or degrees.
const UNITS: [(Dimension, f64, &[&str]); 12] = [
    (Dimension::Length, 1.0, &["m", "meter", "meters", "metres"]),
    (Dimension::Length, 0.3048, &["ft", "feet"]),
    (Dimension::Length, 1000.0, &["km"]),
    (Dimension::Time, 1.0, &["s", "sec", "seconds"]),
    (Dimension::Time, 1e-3, &["ms", "millisecond", "milliseconds"]),
    (Dimension::Time, 1e-6, &["us"]),
    (Dimension::Speed, 1.0, &["m/s", "mps"]),
    (Dimension::Speed, 1.0 / 3.6, &["km/h", "kmh"]),
    (Dimension::Speed, MPH_M_S, &["mph"]),
    (Dimension::Speed, KNOT_M_S, &["kn", "kt", "knots"]),
    // Some logs write the range of an angle, 0 to 360, in place of its unit.
    (Dimension::Angle, 1.0, &["deg", "degrees", "°", "360"]),
    (Dimension::Angle, 180.0 / std::f64::consts::PI, &["rad"]),
];

/// A used column of the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct KnownColumn {
    pub(super) column: Column,
    pub(super) index: usize,
    /// Factor from its numbers to meters, seconds, meters per second or degrees.
    pub(super) unit: f64,
}

/// Unit of a column as stated in its header.
#[derive(Clone, Debug, PartialEq)]
enum Unit {
    Unstated,
    Known(Dimension, f64),
    Unknown(String),
}

impl Unit {
    fn of(text: &str) -> Self {
        let text = text.trim().trim_matches(['(', ')', '[', ']', '"']).trim().to_lowercase();
        let known = UNITS.iter().find(|(.., names)| names.contains(&text.as_str()));
        match known {
            _ if text.is_empty() => Self::Unstated,
            Some((dimension, value, _)) => Self::Known(*dimension, *value),
            None => Self::Unknown(text),
        }
    }

    /// Returns true if a numeric column can have this unit; for text columns it is a time zone or similar.
    fn suits(&self, column: Column) -> bool {
        match self {
            Self::Unstated => true,
            Self::Known(dimension, _) => column.dimension() == Dimension::Text || column.dimension() == *dimension,
            Self::Unknown(_) => column.dimension() == Dimension::Text,
        }
    }
}

/// Selects the used columns of a header: for each quantity the one with the plainest name and a fitting unit.
///
/// # Errors
/// The problem of a unit, if a quantity has no other column.
pub(super) fn columns<'a>(names: impl Iterator<Item = &'a str>) -> Result<Vec<KnownColumn>, String> {
    let names: Vec<&str> = names.collect();
    let is_of_receiver = has(names.iter().copied(), Column::VerticalStd);
    let mut candidates: Vec<(Column, [usize; 4], &str, Unit)> = Vec::new();
    for (index, full) in names.into_iter().enumerate() {
        let (name, unit) = split_unit(full);
        let (column, num_dropped) = match column_of(&name) {
            // A height with an accuracy is the receiver's (phyphox, u-blox), unless another column has that quantity
            // explicitly.
            Some((Column::RelativeHeight, _)) if is_of_receiver && name == "height" => (Column::GpsHeight, 1),
            Some(found) => found,
            None => continue,
        };
        // GoPro's extractors count in milliseconds without stating it.
        let unit = if unit == Unit::Unstated && name == "cts" { Unit::Known(Dimension::Time, 1e-3) } else { unit };
        let order = [usize::from(!unit.suits(column)), num_dropped, usize::from(unit == Unit::Unstated), index];
        candidates.push((column, order, full, unit));
    }
    candidates.sort_by_key(|(_, order, ..)| *order);
    let mut found: Vec<KnownColumn> = Vec::new();
    for (column, [.., index], full, unit) in candidates {
        if found.iter().any(|known| known.column == column) {
            continue;
        }
        match unit {
            Unit::Unknown(unit) if column.dimension() != Dimension::Text => return Err(unknown_unit(full, &unit)),
            // An accuracy in degrees is a bug of the writing program: the column is ignored.
            Unit::Known(..) if !unit.suits(column) => {}
            Unit::Known(_, unit) if column.dimension() != Dimension::Text => {
                found.push(KnownColumn { column, index, unit });
            }
            _ => found.push(KnownColumn { column, index, unit: 1.0 }),
        }
    }
    Ok(found)
}

/// Returns true if one of the names denotes a quantity.
pub(super) fn has<'a>(mut names: impl Iterator<Item = &'a str>, column: Column) -> bool {
    names.any(|name| column_of(&split_unit(name).0).is_some_and(|(found, _)| found == column))
}

fn unknown_unit(full: &str, unit: &str) -> String {
    let known: Vec<&str> = UNITS.iter().flat_map(|(.., names)| names.iter().copied()).collect();
    format!("column {}: unknown unit {}; expected {}", shown(full), shown(unit), known.join(", "))
}

/// Units in a row below the header, by column; `None` if a cell is not a unit.
pub(super) fn units_row<'a>(cells: impl Iterator<Item = &'a str>) -> Option<Vec<Option<f64>>> {
    let mut any = false;
    let units = cells.map(|cell| match Unit::of(cell) {
        Unit::Unstated => Some(None),
        Unit::Known(_, unit) if unit_in_brackets(cell) => {
            any = true;
            Some(Some(unit))
        }
        Unit::Unknown(_) if unit_in_brackets(cell) => Some(None),
        _ => None,
    });
    let units: Option<Vec<_>> = units.collect();
    units.filter(|_| any)
}

fn unit_in_brackets(cell: &str) -> bool {
    cell.trim().trim_matches('"').starts_with(['(', '['])
}

pub(super) fn normalized(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Splits a name from its unit, which is in the last brackets or after the last `_`.
fn split_unit(name: &str) -> (String, Unit) {
    let name = name.trim().trim_matches('"').trim_end();
    if let Some((before, unit)) = name.strip_suffix([')', ']']).and_then(|open| open.rsplit_once(['(', '['])) {
        return (normalized(before), Unit::of(unit));
    }
    let lower = name.to_lowercase();
    for (suffix, unit) in [("_m_s", "m/s"), ("_km_h", "km/h")] {
        if let Some(before) = lower.strip_suffix(suffix) {
            return (normalized(before), Unit::of(unit));
        }
    }
    match lower.rsplit_once('_').map(|(before, unit)| (before, Unit::of(unit))) {
        Some((before, unit @ Unit::Known(..))) => (normalized(before), unit),
        _ => (normalized(name), Unit::Unstated),
    }
}

/// Quantity of a name, and the number of dropped prefixes.
fn column_of(name: &str) -> Option<(Column, usize)> {
    let mut rest = name;
    for num_dropped in 0..3 {
        if let Some((column, _)) = NAMES.iter().find(|(_, names)| names.contains(&rest)) {
            return Some((*column, num_dropped));
        }
        rest = PREFIXES.iter().find_map(|prefix| rest.strip_prefix(prefix))?;
    }
    None
}
