//! Values after the header in sequence, for any encoding.

use std::path::Path;

use super::header::{Encoding, Kind, Property, Scalar};
use crate::io::IoError;

/// Position in the values of a file.
pub struct Values<'a> {
    path: &'a Path,
    encoding: Encoding,
    body: &'a [u8],
    /// Bytes of the file before `body`.
    header_bytes: usize,
    /// Offset of the next value in `body`.
    offset: usize,
}

impl<'a> Values<'a> {
    pub fn new(path: &'a Path, encoding: Encoding, body: &'a [u8], header_bytes: usize) -> Self {
        Self { path, encoding, body, header_bytes, offset: 0 }
    }

    /// Creates an error near the value read last.
    pub fn error(&self, field: &str, problem: &str) -> IoError {
        IoError::Byte {
            path: self.path.into(),
            offset: self.header_bytes + self.offset,
            field: field.into(),
            problem: problem.into(),
        }
    }

    /// Reads one property and passes each of its values to `take`.
    pub fn property(&mut self, property: &Property, mut take: impl FnMut(f64)) -> Result<(), IoError> {
        match property.kind {
            Kind::Single(scalar) => take(self.scalar(scalar, &property.name)?),
            Kind::List { count, item } => {
                let count = self.scalar(count, &property.name)?;
                if count < 0.0 || count.fract() != 0.0 {
                    return Err(self.error(&property.name, "list length is not a whole number from 0"));
                }
                // Each item must be read before the next, so a length beyond the file ends with the file.
                for _ in 0..count as u64 {
                    take(self.scalar(item, &property.name)?);
                }
            }
        }
        Ok(())
    }

    fn scalar(&mut self, scalar: Scalar, field: &str) -> Result<f64, IoError> {
        match self.encoding {
            Encoding::Ascii => self.word(field),
            Encoding::LittleEndian | Encoding::BigEndian => self.binary(scalar, field),
        }
    }

    fn word(&mut self, field: &str) -> Result<f64, IoError> {
        let rest = &self.body[self.offset..];
        let start = rest.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(rest.len());
        let word = rest[start..].split(u8::is_ascii_whitespace).next().unwrap_or_default();
        self.offset += start;
        let value = std::str::from_utf8(word).ok().and_then(|text| text.parse().ok());
        let problem = if word.is_empty() { "the file ends here" } else { "not a number" };
        let value = value.ok_or_else(|| self.error(field, problem))?;
        self.offset += word.len();
        Ok(value)
    }

    fn binary(&mut self, scalar: Scalar, field: &str) -> Result<f64, IoError> {
        let length = scalar.num_bytes();
        let Some(bytes) = self.body[self.offset..].get(..length) else {
            return Err(self.error(field, "the file ends here"));
        };
        self.offset += length;
        // Little-endian, in the low bytes of eight.
        let mut low = [0; 8];
        low[..length].copy_from_slice(bytes);
        if self.encoding == Encoding::BigEndian {
            low[..length].reverse();
        }
        let bits = u64::from_le_bytes(low);
        Ok(match scalar {
            Scalar::I8 => f64::from(bits as i8),
            Scalar::U8 => f64::from(bits as u8),
            Scalar::I16 => f64::from(bits as i16),
            Scalar::U16 => f64::from(bits as u16),
            Scalar::I32 => f64::from(bits as i32),
            Scalar::U32 => f64::from(bits as u32),
            Scalar::F32 => f64::from(f32::from_bits(bits as u32)),
            Scalar::F64 => f64::from_bits(bits),
        })
    }
}
