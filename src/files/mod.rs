//! Which files are opened: those that end, and that memory holds.
//!
//! Behind a name that the user gives, or that lies in a folder of his, may be a pipe that nobody writes into, or a
//! device that never ends. Only regular files are opened, by whatever links they are reached, and only those that fit
//! into memory are read whole.

mod growth;

use std::fs::{self, File, FileType, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

pub use growth::Growth;

use super::memory;

/// UTF-8's byte order mark, which some editors put before a text.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
/// The same as a character.
pub const BYTE_ORDER_CHAR: char = '\u{feff}';

/// Opens a regular file.
///
/// # Errors
/// What the system says; [`io::ErrorKind::InvalidInput`] names what it is that is no regular file.
pub fn open(path: &Path) -> io::Result<File> {
    check(path)?;
    open_at_once(OpenOptions::new().read(true), path, OFlags::empty())
}

/// Opens a regular file or a named pipe, for input that is read once; of a pipe it waits for the writer.
///
/// # Errors
/// As [`open`].
pub fn open_stream(path: &Path) -> io::Result<File> {
    match fs::metadata(path)?.file_type().is_fifo() {
        true => File::open(path),
        false => open(path),
    }
}

/// Opens a file of the program's own for writing, or makes it; leaves its content. It must be no link.
///
/// # Errors
/// As [`open`].
pub fn open_own(path: &Path) -> io::Result<File> {
    match fs::symlink_metadata(path) {
        Ok(found) if !found.is_symlink() => check_type(found.file_type())?,
        _ => {}
    }
    open_at_once(OpenOptions::new().write(true).create(true).truncate(false), path, OFlags::NOFOLLOW)
}

/// Opens a regular file. Should it have become a pipe since it was looked at, this does not wait for its other end.
fn open_at_once(how: &mut OpenOptions, path: &Path, flags: OFlags) -> io::Result<File> {
    let flags = i32::try_from((flags | OFlags::NONBLOCK).bits()).unwrap_or(0);
    let file = how.custom_flags(flags).open(path)?;
    check_type(file.metadata()?.file_type())?;
    Ok(file)
}

/// Looks whether a path leads to a regular file, for those that are opened by foreign libraries.
///
/// # Errors
/// As [`open`].
pub fn check(path: &Path) -> io::Result<()> {
    check_type(fs::metadata(path)?.file_type())
}

/// Opens a regular file that memory would hold.
///
/// # Errors
/// As [`open`]; [`io::ErrorKind::FileTooLarge`] for a file that this machine's memory does not hold.
pub fn open_within_memory(path: &Path) -> io::Result<File> {
    let file = open(path)?;
    let (size, limit) = (file.metadata()?.len(), memory::of_machine());
    if size > limit {
        let (size, limit) = (memory::in_words(size), memory::in_words(limit));
        let reason = format!("file of {size}, memory limit {limit}; raise --memory-limit");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, reason));
    }
    Ok(file)
}

/// Reads a regular file whole.
///
/// # Errors
/// As [`open_within_memory`].
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = open_within_memory(path)?;
    let size = file.metadata()?.len();
    let mut content = Vec::new();
    content.try_reserve_exact(usize::try_from(size).unwrap_or(usize::MAX)).map_err(io::Error::from)?;
    file.read_to_end(&mut content)?;
    Ok(content)
}

/// As [`read`], of a text: without its byte order mark.
///
/// # Errors
/// As [`read`].
pub fn read_text(path: &Path) -> io::Result<Vec<u8>> {
    read(path).map(without_mark)
}

/// A text's bytes without its byte order mark.
pub fn without_mark(mut text: Vec<u8>) -> Vec<u8> {
    if text.starts_with(BYTE_ORDER_MARK) {
        text.drain(..BYTE_ORDER_MARK.len());
    }
    text
}

fn check_type(found: FileType) -> io::Result<()> {
    match in_words(found) {
        "a file" => Ok(()),
        "a folder" => Err(io::ErrorKind::IsADirectory.into()),
        other => Err(io::Error::new(io::ErrorKind::InvalidInput, format!("expected a regular file, found {other}"))),
    }
}

/// Kind of a folder's entry, in words.
pub fn in_words(found: FileType) -> &'static str {
    if found.is_file() {
        "a file"
    } else if found.is_dir() {
        "a folder"
    } else if found.is_fifo() {
        "a pipe"
    } else if found.is_socket() {
        "a socket"
    } else if found.is_symlink() {
        "a broken link"
    } else {
        "a device"
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;

    use super::*;

    #[test]
    fn only_regular_files_are_opened() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link, socket) = ["file", "link", "socket"].map(|name| folder.path().join(name)).into();
        fs::write(&file, "text").unwrap();
        symlink(&file, &link).unwrap();
        assert_eq!(read(&link).unwrap(), b"text");
        let _listener = UnixListener::bind(&socket).unwrap();
        let said = |path: &Path| read(path).unwrap_err().to_string();
        assert!(said(&socket).contains("a socket"), "{}", said(&socket));
        assert!(said(Path::new("/dev/zero")).contains("a device"));
        assert_eq!(read(folder.path()).unwrap_err().kind(), io::ErrorKind::IsADirectory);
        assert_eq!(read(&folder.path().join("none")).unwrap_err().kind(), io::ErrorKind::NotFound);
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        assert!(said(&pipe).contains("a pipe"));
        for (other, word) in [(&pipe, "a pipe"), (&socket, "a socket")] {
            let error = open_own(other).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        assert!(open_own(&link).is_err() && open_own(&folder.path().join("new")).is_ok());
    }

    #[test]
    fn a_byte_order_mark_is_no_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        fs::write(&path, b"\xef\xbb\xbfone\xef\xbb\xbf").unwrap();
        assert_eq!(read_text(&path).unwrap(), b"one\xef\xbb\xbf");
    }

    #[test]
    fn a_file_larger_than_memory_is_refused_before_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sparse");
        // A file of holes, where the file system has such.
        if File::create(&path).unwrap().set_len(1 << 43).is_ok() {
            assert_eq!(read(&path).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
        }
    }
}
