//! Reading of binary fields from a file in memory, with errors that name the position.

use std::path::{Path, PathBuf};

use crate::files;
use crate::io::IoError;

/// Bytes of a file.
pub struct Bytes {
    path: PathBuf,
    content: Vec<u8>,
}

/// Position in the bytes of a file; each reader advances it.
pub struct Cursor<'a> {
    path: &'a Path,
    content: &'a [u8],
    /// Start of the next field.
    offset: usize,
    /// Start of the last field, for errors about its value.
    last: usize,
}

impl Bytes {
    pub fn read_file(path: &Path) -> Result<Self, IoError> {
        let content = files::read(path).map_err(IoError::system("read", path))?;
        Ok(Self { path: path.to_path_buf(), content })
    }

    pub fn cursor(&self) -> Cursor<'_> {
        Cursor { path: &self.path, content: &self.content, offset: 0, last: 0 }
    }
}

impl<'a> Cursor<'a> {
    /// Creates an error about the field read last.
    pub fn error(&self, field: &str, problem: impl Into<String>) -> IoError {
        IoError::Byte { path: self.path.into(), offset: self.last, field: field.into(), problem: problem.into() }
    }

    pub fn u8(&mut self, field: &str) -> Result<u8, IoError> {
        Ok(self.array::<1>(field)?[0])
    }

    pub fn u32(&mut self, field: &str) -> Result<u32, IoError> {
        Ok(u32::from_le_bytes(self.array(field)?))
    }

    pub fn i32(&mut self, field: &str) -> Result<i32, IoError> {
        Ok(i32::from_le_bytes(self.array(field)?))
    }

    pub fn u64(&mut self, field: &str) -> Result<u64, IoError> {
        Ok(u64::from_le_bytes(self.array(field)?))
    }

    /// Reads a double that is neither infinite nor NaN.
    pub fn finite(&mut self, field: &str) -> Result<f64, IoError> {
        let value = f64::from_le_bytes(self.array(field)?);
        if value.is_finite() { Ok(value) } else { Err(self.error(field, format!("{value} is not a finite number"))) }
    }

    /// Reads a 64-bit count of records of at least `min_bytes` each, bounded by the rest of the file, so that it is
    /// safe to allocate for.
    pub fn count(&mut self, field: &str, min_bytes: usize) -> Result<usize, IoError> {
        let count = self.u64(field)?;
        let room = (self.content.len() - self.offset) / min_bytes;
        match usize::try_from(count) {
            Ok(count) if count <= room => Ok(count),
            _ => Err(self.error(
                field,
                format!(
                    "{count} entries do not fit in the rest of the file; it is truncated or \
                 damaged"
                ),
            )),
        }
    }

    /// Reads text up to a zero byte.
    pub fn c_string(&mut self, field: &str) -> Result<String, IoError> {
        self.last = self.offset;
        let rest = &self.content[self.offset..];
        let Some(length) = rest.iter().position(|&b| b == 0) else {
            return Err(self.error(field, "the file ends here"));
        };
        self.offset += length + 1;
        String::from_utf8(rest[..length].to_vec()).map_err(|_| self.error(field, "not UTF-8"))
    }

    /// Returns an error if any bytes follow.
    pub fn end(&mut self) -> Result<(), IoError> {
        self.last = self.offset;
        match self.content.len() - self.offset {
            0 => Ok(()),
            rest => Err(self.error("end of file", format!("{rest} bytes follow the last record"))),
        }
    }

    /// The next `N` bytes.
    pub fn array<const N: usize>(&mut self, field: &str) -> Result<[u8; N], IoError> {
        self.last = self.offset;
        match self.content[self.offset..].first_chunk::<N>() {
            Some(chunk) => {
                self.offset += N;
                Ok(*chunk)
            }
            None => Err(self.error(field, "the file ends here")),
        }
    }
}
