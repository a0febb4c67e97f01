//! Which format a file has, by its content.

use super::text::decode;
use super::{csv, dji, gpmf, nmea, srt};

/// A format of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// DJI's subtitles.
    Dji,
    /// GPX.
    Gpx,
    /// NMEA 0183.
    Nmea,
    /// A table with a header.
    Csv,
    /// A photograph.
    Photograph,
    /// Telemetry of a GoPro camera, taken out of its video.
    Gpmf,
}

/// So much of a file is looked at, bytes.
const HEAD: usize = 1 << 16;

impl Kind {
    /// The format of a file with this content.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        let head = &bytes[..bytes.len().min(HEAD)];
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
        if text.contains("<gpx") {
            return Some(Self::Gpx);
        }
        if text.lines().any(nmea::is_sentence) {
            return Some(Self::Nmea);
        }
        if text.lines().next().is_some_and(csv::is_header) {
            return Some(Self::Csv);
        }
        let mut is_dji = false;
        srt::blocks(&text, |block| {
            is_dji |= block.is_ok_and(|block| dji::recognize(&block.lines.join(" ")).is_some());
        });
        is_dji.then_some(Self::Dji)
    }

    /// Name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dji => "DJI subtitles",
            Self::Gpx => "GPX",
            Self::Nmea => "NMEA 0183",
            Self::Csv => "CSV",
            Self::Photograph => "a photograph",
            Self::Gpmf => "GPMF",
        }
    }
}
