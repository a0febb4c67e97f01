//! Networks that come with the program, and the search for their folder.
//!
//! They are files of a folder `models` that is searched when a network is needed: at the environment variable
//! TRACTRIX_MODELS; next to the executable; in the data folders of packages; and in the source tree whose `target`
//! contains the executable. Their descriptions, licences and hashes are in `models/models.toml`, which is compiled in.

use std::env;
use std::path::{Path, PathBuf};

use super::PerceptionError;
use super::description::{ModelDescription, known};
use crate::ffi::environment;

/// The networks that come with the program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DefaultModels {
    /// Box detector: for [`load_detector`](super::load_detector).
    pub detector: PathBuf,
    /// Encoder of the box segmenter: for [`load_box_segmenter`](super::load_box_segmenter).
    pub mask_encoder: PathBuf,
    /// Decoder of the box segmenter.
    pub mask_decoder: PathBuf,
    /// Small box segmenter: for [`load_small_box_segmenter`](super::load_small_box_segmenter).
    pub small_masks: PathBuf,
}

impl DefaultModels {
    fn of(folder: &Path) -> Self {
        Self {
            detector: folder.join("yolox_nano.onnx"),
            mask_encoder: folder.join("mobile_sam_encoder.onnx"),
            mask_decoder: folder.join("mobile_sam_decoder.onnx"),
            small_masks: folder.join("box_masks.onnx"),
        }
    }

    /// All files.
    pub fn files(&self) -> [&Path; 4] {
        [&self.detector, &self.mask_encoder, &self.mask_decoder, &self.small_masks]
    }

    /// First missing file.
    fn missing(&self) -> Option<&Path> {
        self.files().into_iter().find(|file| !file.is_file())
    }
}

/// Finds the networks that come with the program: the first folder that contains them all.
///
/// # Errors
/// [`PerceptionError::NoModels`] lists the folders and the missing files. If TRACTRIX_MODELS names a folder, no other
/// one is searched: [`PerceptionError::NamedModels`].
pub fn default_models() -> Result<DefaultModels, PerceptionError> {
    match env::var_os("TRACTRIX_MODELS").filter(|value| !value.is_empty()).map(PathBuf::from) {
        Some(named) => whole(&named).map_err(|reason| PerceptionError::NamedModels { reason }),
        None => first_whole(&folders(env::current_exe().ok().as_deref())),
    }
}

/// Descriptions of the networks that come with the program; each names its file.
///
/// # Errors
/// [`PerceptionError::Description`] if the table that is compiled in is not valid.
pub fn default_descriptions() -> Result<Vec<ModelDescription>, PerceptionError> {
    Ok(known()?.into_iter().filter(|description| !description.file.is_empty()).collect())
}

/// Candidate folders of the networks, in order of search.
fn folders(executable: Option<&Path>) -> Vec<PathBuf> {
    let Some((executable, folder)) = executable.and_then(|path| Some((path, path.parent()?))) else {
        return Vec::new();
    };
    let beside = ["models", "../share/tractrix/models", "../lib/tractrix/models"];
    let in_tree = environment::source_tree(executable).map(|tree| tree.join("models"));
    beside.into_iter().map(|path| folder.join(path)).chain(in_tree).collect()
}

/// The networks in a folder; the error names the missing file.
fn whole(folder: &Path) -> Result<DefaultModels, String> {
    let models = DefaultModels::of(folder);
    match models.missing() {
        None => Ok(models),
        Some(_) if !folder.is_dir() => Err(format!("{} (folder not found)", folder.display())),
        Some(file) => Err(format!("{} (file not found)", file.display())),
    }
}

fn first_whole(folders: &[PathBuf]) -> Result<DefaultModels, PerceptionError> {
    let mut tried = Vec::new();
    for folder in folders {
        match whole(folder) {
            Ok(models) => return Ok(models),
            Err(reason) => tried.push(reason),
        }
    }
    Err(PerceptionError::NoModels { tried })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_installed_program_searches_its_own_folder_and_a_built_one_its_source_tree() {
        let installed = folders(Some(Path::new("/opt/tractrix/bin/tractrix")));
        let expected = [
            "/opt/tractrix/bin/models",
            "/opt/tractrix/bin/../share/tractrix/models",
            "/opt/tractrix/bin/../lib/tractrix/models",
        ];
        assert_eq!(installed, expected.map(PathBuf::from));
        let tree = tempfile::tempdir().unwrap();
        std::fs::write(tree.path().join("Cargo.toml"), "").unwrap();
        let built = folders(Some(&tree.path().join("target/release/deps/tests")));
        assert!(built.contains(&tree.path().join("models")), "{built:?}");
        let copied = folders(Some(&tree.path().join("bin/tractrix")));
        assert!(!copied.contains(&tree.path().join("models")), "{copied:?}");
    }

    #[test]
    fn the_first_complete_folder_is_used_and_others_are_listed() {
        let folder = tempfile::tempdir().unwrap();
        let (half, whole) = (folder.path().join("half"), folder.path().join("whole"));
        for (place, num_files) in [(&half, 1), (&whole, 4)] {
            std::fs::create_dir(place).unwrap();
            DefaultModels::of(place).files()[..num_files].iter().for_each(|file| std::fs::write(file, "").unwrap());
        }
        let none = folder.path().join("none");
        let found = first_whole(&[none.clone(), half.clone(), whole.clone()]).unwrap();
        assert_eq!(found, DefaultModels::of(&whole));
        let said = first_whole(&[none, half]).unwrap_err().to_string();
        assert!(said.contains("none (folder not found)") && said.contains("half/mobile_sam_encoder.onnx"), "{said}");
        assert!(said.contains("TRACTRIX_MODELS"), "{said}");
    }

    #[test]
    fn every_file_has_a_description() {
        let described = default_descriptions().unwrap();
        let mut files: Vec<&str> = described.iter().map(|d| d.file.as_str()).collect();
        files.sort_unstable();
        assert_eq!(files, ["box_masks.onnx", "mobile_sam_decoder.onnx", "mobile_sam_encoder.onnx", "yolox_nano.onnx"]);
        assert!(described.iter().all(|d| d.sha256.len() == 64 && !d.changes.is_empty()));
    }
}
