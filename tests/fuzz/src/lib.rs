//! What all fuzz targets do: a reader's files are written, one of them is replaced by the fuzzer's bytes, and all are
//! read.

#[path = "../../common/readers.rs"]
pub mod readers;

use std::cell::RefCell;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;

use tempfile::TempDir;

/// A reader's files.
struct Corpus {
    _folder: TempDir,
    files: Vec<Place>,
}

/// A file that stays open, with its whole content.
struct Place {
    path: PathBuf,
    file: File,
    whole: Vec<u8>,
}

impl Place {
    fn new(path: PathBuf) -> io::Result<Self> {
        let (file, whole) = (File::options().write(true).open(&path)?, fs::read(&path)?);
        Ok(Self { path, file, whole })
    }

    fn put(&self, content: &[u8]) {
        let put = self.file.write_all_at(content, 0).and_then(|()| self.file.set_len(content.len() as u64));
        put.expect("the file can be written to");
    }
}

thread_local! {
    static CORPUS: RefCell<Option<Corpus>> = const { RefCell::new(None) };
}

impl Corpus {
    fn new(reader: &str) -> Self {
        let folder = TempDir::new().expect("a folder for the files");
        let places = readers::written(reader, folder.path()).expect("the reader's files are written");
        let files = places.into_iter().map(|path| Place::new(path).expect("it was just written"));
        Self { files: files.collect(), _folder: folder }
    }
}

/// Reads the bytes in the place of one of the reader's files; which one, the first byte says where there are several.
pub fn once(reader: &str, bytes: &[u8]) {
    CORPUS.with_borrow_mut(|corpus| {
        let corpus = corpus.get_or_insert_with(|| Corpus::new(reader));
        let several = corpus.files.len() > 1;
        let (at, bytes) = match bytes.split_first() {
            Some((first, rest)) if several => (usize::from(*first) % corpus.files.len(), rest),
            _ => (0, bytes),
        };
        corpus.files[at].put(bytes);
        readers::read(reader, &corpus.files[0].path);
        if several {
            corpus.files[at].put(&corpus.files[at].whole);
        }
    });
}
