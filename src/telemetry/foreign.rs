//! Log formats that need a converter: recognized, so that the error names the program.

use super::csv;

/// Unsupported format.
pub(super) struct Foreign {
    /// Name in messages.
    pub(super) name: &'static str,
    /// Command that converts it to a readable file.
    pub(super) cure: &'static str,
    recognizes: fn(&[u8], &str) -> bool,
}

/// Table of unsupported formats; a new one is a row.
const FORMATS: [Foreign; 7] = [
    Foreign {
        name: "a FIT file",
        cure: "convert it: gpsbabel -i garmin_fit -f IN -o gpx -F OUT.gpx",
        recognizes: |bytes, _| bytes.get(8..12) == Some(b".FIT"),
    },
    Foreign {
        name: "a TCX file",
        cure: "convert it: gpsbabel -i gtrnctr -f IN -o gpx -F OUT.gpx",
        recognizes: |_, text| text.contains("<TrainingCenterDatabase"),
    },
    Foreign {
        name: "a Magellan log",
        cure: "convert it: gpsbabel -i magellan -f IN -o gpx -F OUT.gpx",
        recognizes: |_, text| text.lines().any(|line| line.starts_with("$PMGNTRK,")),
    },
    Foreign {
        name: "an archive (a KMZ file?)",
        cure: "unpack it, and give the file in it",
        recognizes: |bytes, _| bytes.starts_with(b"PK\x03\x04"),
    },
    Foreign {
        name: "PX4's ULog",
        cure: "convert it: ulog2csv -m sensor_gps IN (pip install pyulog), and give the table",
        recognizes: |bytes, _| bytes.starts_with(b"ULog\x01\x12\x35"),
    },
    Foreign {
        name: "ArduPilot's binary log",
        cure: "convert it: mavlogdump.py --types GPS --format csv IN > OUT.csv (pip install pymavlink)",
        recognizes: |bytes, _| bytes.starts_with(&[0xa3, 0x95, 0x80]),
    },
    Foreign {
        name: "a geo.txt with projected coordinates",
        cure: "convert its coordinates to longitude and latitude: gdaltransform -s_srs EPSG:CODE -t_srs EPSG:4326",
        recognizes: |_, text| csv::is_projected(text),
    },
];

/// Recognizes an unsupported format by the content of a file.
pub(super) fn recognize(bytes: &[u8], text: &str) -> Option<&'static Foreign> {
    FORMATS.iter().find(|format| (format.recognizes)(bytes, text))
}
