//! FFmpeg's input interface to one opened file.
//!
//! FFmpeg gets functions to read and seek, not a name to open: no other file can be accessed, whatever a container
//! contains.

use std::ffi::{c_char, c_int, c_void};
use std::fs::File;
use std::io::{Seek, SeekFrom};
use std::mem::MaybeUninit;
use std::path::Path;
use std::ptr;
use std::sync::Arc;

use ffmpeg_sys_the_third as sys;
use rustix::io::Errno;

use super::FfmpegError;
use crate::files::{self, Growth};

/// Bytes per read, the same number as in FFmpeg's own file protocol.
const BUFFER_BYTES: usize = 32 << 10;

/// A regular file behind FFmpeg's interface for input.
pub(super) struct Input {
    pub(super) context: *mut sys::AVIOContext,
    opened: *mut Opened,
}

/// File that the callbacks of FFmpeg receive.
struct Opened {
    file: File,
    /// Growth of a file that is still being written, whose end is not yet known.
    growth: Option<Arc<Growth>>,
}

#[allow(unsafe_code)]
impl Input {
    /// Opens a regular file. A growing one is read once, from beginning to end, without seeking.
    ///
    /// # Errors
    /// [`FfmpegError::Open`] with the system's message, [`FfmpegError::Memory`].
    pub(super) fn open(path: &Path, growth: Option<Arc<Growth>>) -> Result<Self, FfmpegError> {
        let file = files::open(path).map_err(|error| FfmpegError::Open(error.to_string()))?;
        let seek = if growth.is_some() { None } else { Some(seek as SeekFunction) };
        let mut input = Self { context: ptr::null_mut(), opened: Box::into_raw(Box::new(Opened { file, growth })) };
        // SAFETY: the buffer is FFmpeg's own; it becomes the context's, or is freed here. The file lives until `drop`,
        // which is after the last call of the functions.
        unsafe {
            let buffer = sys::av_malloc(BUFFER_BYTES).cast::<u8>();
            if !buffer.is_null() {
                let (size, opened) = (BUFFER_BYTES as c_int, input.opened.cast());
                input.context = sys::avio_alloc_context(buffer, size, 0, opened, Some(read), None, seek);
                if input.context.is_null() {
                    sys::av_free(buffer.cast());
                }
            }
        }
        if input.context.is_null() { Err(FfmpegError::Memory) } else { Ok(input) }
    }
}

#[allow(unsafe_code)]
impl Drop for Input {
    fn drop(&mut self) {
        // SAFETY: the buffer may have been replaced by FFmpeg and belongs to the context; both are freed once, or are
        // null. The file was boxed by `open`.
        unsafe {
            if !self.context.is_null() {
                sys::av_freep((&raw mut (*self.context).buffer).cast());
                sys::avio_context_free(&mut self.context);
            }
            drop(Box::from_raw(self.opened));
        }
    }
}

/// Signature of [`seek`].
#[allow(unsafe_code)]
type SeekFunction = unsafe extern "C" fn(*mut c_void, i64, c_int) -> i64;

/// Rejects every further file that a container names.
///
/// # Safety
/// None is needed: the arguments are not read.
#[allow(unsafe_code)]
pub(super) unsafe extern "C" fn refuse(
    _context: *mut sys::AVFormatContext,
    _opened: *mut *mut sys::AVIOContext,
    _url: *const c_char,
    _flags: c_int,
    _options: *mut *mut sys::AVDictionary,
) -> c_int {
    sys::AVERROR(Errno::PERM.raw_os_error())
}

#[allow(unsafe_code)]
unsafe extern "C" fn read(opened: *mut c_void, buffer: *mut u8, size: c_int) -> c_int {
    // SAFETY: `opened` is the one of `open`, and `buffer` has room for `size` bytes.
    let (Opened { file, growth }, buffer) = unsafe {
        let size = usize::try_from(size).unwrap_or(0);
        (&*opened.cast::<Opened>(), std::slice::from_raw_parts_mut(buffer.cast::<MaybeUninit<u8>>(), size))
    };
    loop {
        // Checked before reading: data written before the end are read.
        let growing = growth.as_deref().filter(|growth| !growth.is_finished());
        match (rustix::io::read(file, &mut *buffer), growing) {
            (Ok(([], _)), Some(growth)) => growth.wait(),
            (Ok(([], _)), None) => return sys::AVERROR_EOF,
            (Ok((read, _)), _) => return c_int::try_from(read.len()).unwrap_or(0),
            (Err(Errno::INTR), _) => {}
            (Err(error), _) => return sys::AVERROR(error.raw_os_error()),
        }
    }
}

#[allow(unsafe_code)]
unsafe extern "C" fn seek(opened: *mut c_void, offset: i64, whence: c_int) -> i64 {
    // SAFETY: `opened` is the one of `open`; FFmpeg calls from one thread at a time.
    let file = unsafe { &mut (*opened.cast::<Opened>()).file };
    let found = match whence & !sys::AVSEEK_FORCE {
        sys::AVSEEK_SIZE => file.metadata().map(|found| found.len()),
        // SEEK_SET, SEEK_CUR and SEEK_END of `<stdio.h>`.
        0 => file.seek(SeekFrom::Start(u64::try_from(offset).unwrap_or(u64::MAX))),
        1 => file.seek(SeekFrom::Current(offset)),
        2 => file.seek(SeekFrom::End(offset)),
        _ => return sys::AVERROR(Errno::INVAL.raw_os_error()).into(),
    };
    let code = |error: std::io::Error| error.raw_os_error().unwrap_or(Errno::IO.raw_os_error());
    match found {
        Ok(at) => i64::try_from(at).unwrap_or(i64::MAX),
        Err(error) => sys::AVERROR(code(error)).into(),
    }
}
