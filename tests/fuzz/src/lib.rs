//! What all fuzz targets do: a reader's files are written, one of them is replaced by the fuzzer's bytes, and all are
//! read.

#[path = "../../common/readers.rs"]
pub mod readers;

use std::cell::RefCell;
use std::fs;
use std::path::PathBuf;

use tempfile::TempDir;

/// A reader's files, each with its whole content.
struct Corpus {
    _folder: TempDir,
    files: Vec<(PathBuf, Vec<u8>)>,
}

thread_local! {
    static CORPUS: RefCell<Option<Corpus>> = const { RefCell::new(None) };
}

impl Corpus {
    fn new(reader: &str) -> Self {
        let folder = TempDir::new().expect("a folder for the files");
        let places = readers::written(reader, folder.path()).expect("the reader's files are written");
        let files = places.into_iter().map(|place| (place.clone(), fs::read(&place).expect("it was just written")));
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
        let (place, whole) = &corpus.files[at];
        fs::write(place, bytes).expect("the folder can be written to");
        readers::read(reader, &corpus.files[0].0);
        fs::write(place, whole).expect("the folder can be written to");
    });
}
