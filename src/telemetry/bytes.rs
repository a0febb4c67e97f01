//! Content of a telemetry file.

use std::io::Read;
use std::path::Path;

use super::error::TelemetryError;
use crate::files;
use crate::memory::MemoryLimit;

/// Ten hours of a drone that writes at 60 Hz.
const MAX_MIB: u64 = 512;

/// Reads a file of at most the size of a telemetry log. It may take a quarter of the memory limit, since its text takes
/// memory again.
pub(super) fn bytes_of(path: &Path, limit: MemoryLimit) -> Result<Vec<u8>, TelemetryError> {
    let file = files::open(path).map_err(TelemetryError::system(path))?;
    let metadata = file.metadata().map_err(TelemetryError::system(path))?;
    let most = (MAX_MIB << 20).min(limit.bytes() / 4);
    let too_large =
        |size: u64| TelemetryError::TooLarge { path: path.to_path_buf(), size_mib: size >> 20, most_mib: most >> 20 };
    if metadata.len() >= most {
        return Err(too_large(metadata.len()));
    }
    // A growing file reports too small a size: the limit also applies to the bytes read.
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes).map_err(TelemetryError::system(path))?;
    if bytes.len() as u64 >= most { Err(too_large(most)) } else { Ok(bytes) }
}
