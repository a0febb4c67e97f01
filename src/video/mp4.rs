//! Boxes of MP4 and MOV files (ISO/IEC 14496-12).

use std::io::{Read, Seek, SeekFrom};

/// Head of a box.
pub(super) struct BoxHead {
    /// Box type.
    pub(super) kind: [u8; 4],
    /// Size of the head, bytes.
    pub(super) num_bytes: u64,
    /// Declared size of the box, bytes, head included; `None` if it extends to the end.
    pub(super) size: Option<u64>,
}

/// Reads the head of the box at an offset in a file; `None` if it is truncated or cannot be read.
pub(super) fn head_at(file: &mut (impl Read + Seek), at: u64) -> Option<BoxHead> {
    let (mut head, mut size) = ([0; 8], [0; 8]);
    file.seek(SeekFrom::Start(at)).ok()?;
    file.read_exact(&mut head).ok()?;
    let [a, b, c, d, kind @ ..] = head;
    Some(match u32::from_be_bytes([a, b, c, d]) {
        0 => BoxHead { kind, num_bytes: 8, size: None },
        1 => {
            file.read_exact(&mut size).ok()?;
            BoxHead { kind, num_bytes: 16, size: Some(u64::from_be_bytes(size)) }
        }
        size => BoxHead { kind, num_bytes: 8, size: Some(u64::from(size)) },
    })
}
