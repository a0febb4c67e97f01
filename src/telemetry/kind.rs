//! Detection of the format of a file by its content.

use super::text::decode;
use super::{ardupilot, csv, dji, gpmf, igc, nmea, srt};

/// File format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Subtitles of a drone, DJI's or Autel's.
    Dji,
    /// GPX.
    Gpx,
    /// KML.
    Kml,
    /// IGC.
    Igc,
    /// ArduPilot's log as text.
    ArduPilot,
    /// NMEA 0183.
    Nmea,
    /// A table with a header.
    Csv,
    /// A photograph.
    Photograph,
    /// Telemetry of a GoPro camera, extracted from its video.
    Gpmf,
}

with_names!(Kind {
    Dji = "drone subtitles",
    Gpx = "GPX",
    Kml = "KML",
    Igc = "IGC",
    ArduPilot = "ArduPilot log",
    Nmea = "NMEA 0183",
    Csv = "CSV",
    Photograph = "a photograph",
    Gpmf = "GPMF",
});

/// Start of a file, by which formats are recognized.
pub(super) fn head_of(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(1 << 16)]
}

impl Kind {
    /// Recognizes the format of a file by its content.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        let head = head_of(bytes);
        if matches!(
            head,
            [0xff, 0xd8, 0xff, ..] | [0x89, b'P', b'N', b'G', ..] | [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..]
        ) {
            return Some(Self::Photograph);
        }
        if gpmf::is_gpmf(head) {
            return Some(Self::Gpmf);
        }
        let text = decode(head);
        let kinds = [
            (Self::Gpx, text.contains("<gpx")),
            (Self::Kml, text.contains("<kml")),
            (Self::Igc, igc::is_igc(&text)),
            (Self::ArduPilot, text.lines().take(20).any(ardupilot::is_message)),
            (Self::Nmea, text.lines().any(nmea::is_sentence)),
            (Self::Csv, csv::is_table(&text)),
        ];
        if let Some((kind, _)) = kinds.into_iter().find(|(_, is_kind)| *is_kind) {
            return Some(kind);
        }
        let mut is_dji = false;
        srt::blocks(&text, |block| {
            is_dji |= block.is_ok_and(|block| dji::recognize(&block.lines.join(" ")).is_some());
        });
        is_dji.then_some(Self::Dji)
    }
}
