//! Reading, decoding and writing of media files with FFmpeg: the system's libavformat, libavcodec and libswscale.
//!
//! A [`MediaFile`] is a container with its streams, from which packets are read; a [`Decoder`] decodes the packets of
//! one video stream to images; an [`RgbConverter`] converts the images to RGB. Time stamps are those of the file:
//! integers, in the time base of their stream. An [`Encoder`] writes images to a file.
//!
//! A container is read from one opened file. Playlists are rejected, and so is every other file or address that a
//! container names. FFmpeg has to cope with damaged input; input that it rejects gives an [`FfmpegError`]. Nothing is
//! printed after [`silence`].

mod colour;
mod decoder;
mod encoder;
mod formats;
mod input;
mod luma;
mod media_file;

use std::ffi::{CStr, CString, c_int};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use ffmpeg_sys_the_third as sys;
use rustix::io::Errno;

pub use self::colour::RgbConverter;
pub use self::decoder::{Decoder, Purpose};
pub use self::encoder::Encoder;
pub use self::luma::Luma;
pub use self::media_file::{MediaFile, Packet, Stream, StreamKind, TextCoding, TimeBase};

/// Errors of FFmpeg.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FfmpegError {
    /// The container is unknown to FFmpeg, or its header is damaged.
    #[error("{0}")]
    Open(String),
    /// A list of other files, in a format of this name.
    #[error("a playlist ({0})")]
    Playlist(String),
    /// The installed FFmpeg has no decoder for a stream.
    #[error("no decoder for {0}")]
    NoDecoder(String),
    /// A decoder does not start.
    #[error("the decoder cannot be started: {0}")]
    Decoder(String),
    /// An image cannot be converted to RGB.
    #[error("image of {width}x{height} pixels cannot be converted: {reason}")]
    Convert {
        /// Width, pixels.
        width: i32,
        /// Height, pixels.
        height: i32,
        /// Reason.
        reason: &'static str,
    },
    /// The installed FFmpeg has no encoder for videos.
    #[error("the installed FFmpeg has no encoder for H.264 or MPEG-4; install one that has (Debian: libavcodec59)")]
    NoEncoder,
    /// An encoder does not start, or rejects an image.
    #[error("the encoder failed: {0}")]
    Encoder(String),
    /// A file cannot be written.
    #[error("cannot be written: {0}")]
    Write(String),
    /// Memory is exhausted.
    #[error("out of memory")]
    Memory,
}

/// Silences the log output of FFmpeg.
#[allow(unsafe_code)]
pub fn silence() {
    // SAFETY: sets an atomic number.
    unsafe { sys::av_log_set_level(sys::AV_LOG_QUIET) }
}

/// Version of the loaded libraries, such as `5.1.9-0+deb12u1`.
#[allow(unsafe_code)]
pub fn version() -> String {
    // SAFETY: returns a string constant of the library.
    let version = unsafe { CStr::from_ptr(sys::av_version_info()) };
    version.to_string_lossy().into_owned()
}

/// FFmpeg's message for one of its error codes.
#[allow(unsafe_code)]
fn words(code: c_int) -> String {
    let mut text = [0; 128];
    // SAFETY: writes a null-terminated string into the buffer, whose size it receives.
    let text = unsafe {
        sys::av_strerror(code, text.as_mut_ptr(), text.len());
        CStr::from_ptr(text.as_ptr())
    };
    text.to_string_lossy().into_owned()
}

/// Available memory below which decoding cannot continue, bytes: a 4K image, and the additional memory of its decoder.
const SPARE_BYTES: usize = 64 << 20;

/// Returns true if FFmpeg failed because the machine has no memory.
///
/// Its error code does not show it. Decoders continue with the next image if memory was short at a lower level, and
/// damaged files, which request impossible amounts, fail with the code for it. The test is whether memory is short.
fn is_short_of_memory(code: c_int) -> bool {
    code != sys::AVERROR_EOF && code != sys::AVERROR(Errno::AGAIN.raw_os_error()) && lacks_memory()
}

/// Returns true if there is too little memory to continue decoding.
fn lacks_memory() -> bool {
    !has_memory(SPARE_BYTES)
}

fn has_memory(bytes: usize) -> bool {
    // An allocation that is not observed is optimized away.
    let mut trial = Vec::<u8>::new();
    std::hint::black_box(&mut trial).try_reserve_exact(bytes).is_ok()
}

/// FFmpeg's URL of a file, never mistaken for another protocol's address; `None` if the path has a zero byte.
fn url_of(path: &Path) -> Option<CString> {
    CString::new([b"file:".as_slice(), path.as_os_str().as_bytes()].concat()).ok()
}

/// Result of a call of FFmpeg, whose errors are negative.
fn checked(code: c_int) -> Result<c_int, c_int> {
    if code < 0 { Err(code) } else { Ok(code) }
}

/// Time stamp, or `None` for FFmpeg's value for none.
fn stated(ticks: i64) -> Option<i64> {
    (ticks != sys::AV_NOPTS_VALUE).then_some(ticks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damage_is_not_taken_for_a_lack_of_memory() {
        assert!(has_memory(1 << 20) && !has_memory(isize::MAX as usize));
        assert!(!is_short_of_memory(sys::AVERROR(Errno::NOMEM.raw_os_error())), "there is enough");
        assert!(!is_short_of_memory(sys::AVERROR_EOF));
    }
}
