//! FFmpeg's view of one opened file.
//!
//! FFmpeg gets a descriptor to read and seek, not a name to open: whatever a container says, no other file can be
//! reached.

use std::ffi::{c_char, c_int, c_void};
use std::fs::File;
use std::io::{Seek, SeekFrom};
use std::mem::MaybeUninit;
use std::path::Path;
use std::ptr;

use ffmpeg_sys_the_third as sys;
use rustix::io::Errno;

use super::FfmpegError;
use crate::files;

/// Bytes that are read at once, as many as FFmpeg's own reader of files takes.
const BUFFER_BYTES: usize = 32 << 10;

/// A regular file behind FFmpeg's interface for input.
pub(super) struct Input {
    pub(super) context: *mut sys::AVIOContext,
    file: *mut File,
}

#[allow(unsafe_code)]
impl Input {
    /// Opens a regular file.
    ///
    /// # Errors
    /// [`FfmpegError::Open`] with the system's words, [`FfmpegError::Memory`].
    pub(super) fn open(path: &Path) -> Result<Self, FfmpegError> {
        let file = files::open(path).map_err(|error| FfmpegError::Open(error.to_string()))?;
        let mut input = Self { context: ptr::null_mut(), file: Box::into_raw(Box::new(file)) };
        // SAFETY: the buffer is FFmpeg's own; it becomes the context's, or is freed here. The file lives until `drop`,
        // which is after the last call of the functions.
        unsafe {
            let buffer = sys::av_malloc(BUFFER_BYTES).cast::<u8>();
            if !buffer.is_null() {
                let (size, file) = (BUFFER_BYTES as c_int, input.file.cast());
                input.context = sys::avio_alloc_context(buffer, size, 0, file, Some(read), None, Some(seek));
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
            drop(Box::from_raw(self.file));
        }
    }
}

/// Refuses to open a second file on behalf of a container.
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
unsafe extern "C" fn read(file: *mut c_void, buffer: *mut u8, size: c_int) -> c_int {
    // SAFETY: `file` is the one of `open`, and `buffer` has room for `size` bytes.
    let (file, buffer) = unsafe {
        let size = usize::try_from(size).unwrap_or(0);
        (&*file.cast::<File>(), std::slice::from_raw_parts_mut(buffer.cast::<MaybeUninit<u8>>(), size))
    };
    loop {
        match rustix::io::read(file, &mut *buffer) {
            Ok(([], _)) => return sys::AVERROR_EOF,
            Ok((read, _)) => return c_int::try_from(read.len()).unwrap_or(0),
            Err(Errno::INTR) => {}
            Err(error) => return sys::AVERROR(error.raw_os_error()),
        }
    }
}

#[allow(unsafe_code)]
unsafe extern "C" fn seek(file: *mut c_void, offset: i64, whence: c_int) -> i64 {
    /// Of `<stdio.h>`, as are the next two.
    const SEEK_SET: c_int = 0;
    const SEEK_CUR: c_int = 1;
    const SEEK_END: c_int = 2;
    // SAFETY: `file` is the one of `open`; FFmpeg calls from one thread at a time.
    let file = unsafe { &mut *file.cast::<File>() };
    let found = match whence & !sys::AVSEEK_FORCE {
        sys::AVSEEK_SIZE => file.metadata().map(|found| found.len()),
        SEEK_SET => file.seek(SeekFrom::Start(u64::try_from(offset).unwrap_or(u64::MAX))),
        SEEK_CUR => file.seek(SeekFrom::Current(offset)),
        SEEK_END => file.seek(SeekFrom::End(offset)),
        _ => return sys::AVERROR(Errno::INVAL.raw_os_error()).into(),
    };
    let code = |error: std::io::Error| error.raw_os_error().unwrap_or(Errno::IO.raw_os_error());
    match found {
        Ok(at) => i64::try_from(at).unwrap_or(i64::MAX),
        Err(error) => sys::AVERROR(code(error)).into(),
    }
}
