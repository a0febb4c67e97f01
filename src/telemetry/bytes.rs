//! Content of a file of telemetry.

use std::io::Read;
use std::path::Path;

use super::error::TelemetryError;
use crate::files;
use crate::memory::MemoryLimit;

/// Ten hours of a drone that writes at 60 Hz.
const MOST_MIB: u64 = 512;

/// The content of a file of a size that can be telemetry. It may have a quarter of the memory limit: as text it is in
/// memory again.
pub(super) fn bytes_of(path: &Path, limit: MemoryLimit) -> Result<Vec<u8>, TelemetryError> {
    let file = files::open(path).map_err(TelemetryError::system(path))?;
    let metadata = file.metadata().map_err(TelemetryError::system(path))?;
    let most = (MOST_MIB << 20).min(limit.bytes() / 4);
    let too_large =
        |size: u64| TelemetryError::TooLarge { path: path.to_path_buf(), size_mib: size >> 20, most_mib: most >> 20 };
    if metadata.len() >= most {
        return Err(too_large(metadata.len()));
    }
    // A file that grows states too little: the limit holds for it as well.
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes).map_err(TelemetryError::system(path))?;
    if bytes.len() as u64 >= most { Err(too_large(most)) } else { Ok(bytes) }
}
