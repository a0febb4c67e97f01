//! Networks for vehicle detection: available ones, and the substitutes for missing ones.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::ffi::onnx::{self, Provider};
use crate::networks::{
    BoxSegmenter, BySize, DefaultModels, GrabCut, PerceptionError, Yolox, default_descriptions, default_models,
    load_box_segmenter, load_detector, load_small_box_segmenter,
};
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::background::hovers;
use crate::pipeline::{DetectorChoice, MaskChoice, Options, Result};

/// Available networks among those that the options select.
#[derive(Clone, Debug, Default)]
pub(in crate::pipeline) struct Networks {
    /// The detector.
    pub(in crate::pipeline) detector: Option<PathBuf>,
    /// Files of the mask networks: the small one, and the two parts of `MobileSAM` unless only the small one is used.
    pub(in crate::pipeline) masks: Vec<PathBuf>,
    /// Missing networks, with the consequence.
    pub(in crate::pipeline) doubts: Vec<String>,
}

impl Networks {
    /// Finds the available networks among those that the options of a run select.
    ///
    /// # Errors
    /// An environment variable or an option names a runtime or networks that are needed and cannot be used.
    pub(in crate::pipeline) fn of(run: &Run) -> Result<Self> {
        Ok(Self::chosen(run.options, shipped(run.options.provider))?)
    }

    /// * `shipped` – the networks that come with the program, or the reason why they cannot be used.
    fn chosen(options: &Options, shipped: Result<DefaultModels, PerceptionError>) -> Result<Self, PerceptionError> {
        let is_needed = matches!(options.vehicles.detector, DetectorChoice::Default)
            || options.vehicles.mask_network != MaskChoice::None;
        let shipped = match shipped {
            Err(error) if is_needed && error.is_of_choice() => return Err(error),
            shipped => shipped.map_err(|error| error.to_string()),
        };
        let mut networks = Self::default();
        let mut default = |means: &str| {
            shipped.as_ref().map_err(|reason| networks.doubts.push(format!("{means}: {reason}"))).ok().cloned()
        };
        let detector = match &options.vehicles.detector {
            DetectorChoice::None => None,
            DetectorChoice::File(path) => Some(path.clone()),
            DetectorChoice::Default => {
                default("no detector: vehicles are detected by motion only").map(|found| found.detector)
            }
        };
        let mut of_masks = || default("no mask network: masks are by color only");
        let masks = match options.vehicles.mask_network {
            MaskChoice::None => None,
            MaskChoice::Small => of_masks().map(|found| vec![found.small_masks]),
            MaskChoice::Default => {
                of_masks().map(|found| vec![found.small_masks, found.mask_encoder, found.mask_decoder])
            }
        };
        Ok(Self { detector, masks: masks.unwrap_or_default(), ..networks })
    }

    /// The detector, if available.
    pub(in crate::pipeline) fn load_detector(&self, run: &Run) -> Result<Option<Yolox>> {
        let load = |path: &Path| load_detector(path, &run.options.detector, run.options.resources());
        Ok(self.detector.as_deref().map(load).transpose()?)
    }

    /// Box segmenter: mask networks, or colors alone.
    pub(in crate::pipeline) fn load_box_segmenter(&self, run: &Run) -> Result<Box<dyn BoxSegmenter>> {
        let (options, resources) = (&run.options.prompt, run.options.resources());
        Ok(match self.serving_masks(run) {
            [small] => load_small_box_segmenter(small, options, resources)?,
            [small, encoder, decoder] => Box::new(BySize {
                small: load_small_box_segmenter(small, options, resources)?,
                large: load_box_segmenter(encoder, decoder, options, resources)?,
            }),
            _ => Box::new(GrabCut::new(options)),
        })
    }

    /// Files of the mask networks used for this run's masks.
    pub(in crate::pipeline) fn serving_masks(&self, run: &Run) -> &[PathBuf] {
        serving(&self.masks, hovers(run))
    }

    /// Checks that the detector can be used.
    ///
    /// # Errors
    /// As [`Self::load_detector`].
    pub(in crate::pipeline) fn check_detector(&self, run: &Run) -> Result<()> {
        let is_known = came_with_the_program(self.detector.as_slice(), "boxes")?;
        if is_known { Ok(()) } else { self.load_detector(run).map(drop) }
    }

    /// Checks that the mask networks can be used.
    ///
    /// # Errors
    /// As [`Self::load_box_segmenter`].
    pub(in crate::pipeline) fn check_prompter(&self, run: &Run) -> Result<()> {
        let is_known = came_with_the_program(&self.masks, "box-masks")?;
        if is_known { Ok(()) } else { self.load_box_segmenter(run).map(drop) }
    }
}

/// Cache key of networks without their options: contents of the files and the provider.
pub(in crate::pipeline) fn of_networks(run: &Run, files: &[PathBuf]) -> Result<Value> {
    let hashes = files.iter().map(|path| fingerprint::of_content(path)).collect::<Result<Vec<_>, _>>()?;
    let provider = (!files.is_empty()).then_some(run.options.provider);
    Ok(json!({ "files": hashes, "provider": provider }))
}

/// SHA-256 of networks by their file names, for `run.json`.
pub(in crate::pipeline) fn hashes_by_name<'a>(files: impl IntoIterator<Item = &'a PathBuf>) -> Result<Value> {
    let hash = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok((name, json!(fingerprint::of_content(path)?)))
    };
    Ok(Value::Object(files.into_iter().map(hash).collect::<Result<_>>()?))
}

/// Mask networks in use: below a camera that does not translate only the small one
/// (docs/decisions/043-masks-below-a-hovering-camera.md).
fn serving(masks: &[PathBuf], hovers: bool) -> &[PathBuf] {
    if hovers { &masks[..masks.len().min(1)] } else { masks }
}

/// Returns true if files are identical to the networks for a task that come with the program. These are known to work,
/// and loading them for a check would take half a second.
fn came_with_the_program(files: &[PathBuf], task: &str) -> Result<bool> {
    let shipped = default_descriptions()?;
    for file in files {
        let hash = fingerprint::of_content(file)?;
        if !shipped.iter().any(|description| description.task == task && description.sha256 == hash) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The networks that come with the program, if they and the runtime are available.
fn shipped(provider: Provider) -> Result<DefaultModels, PerceptionError> {
    match (default_models(), onnx::probe(provider).map_err(PerceptionError::from)) {
        // Networks that the user has named take precedence.
        (Err(error), _) | (_, Err(error)) if error.is_of_choice() => Err(error),
        (Err(error), _) | (_, Err(error)) => Err(error),
        (Ok(models), Ok(_)) => Ok(models),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ffi::onnx::OnnxError;

    fn there() -> DefaultModels {
        let [detector, mask_encoder, mask_decoder, small_masks] = ["d", "e", "f", "s"].map(PathBuf::from);
        DefaultModels { detector, mask_encoder, mask_decoder, small_masks }
    }

    fn missing() -> PerceptionError {
        PerceptionError::NoModels { tried: vec!["folder not found".into()] }
    }

    #[test]
    fn a_variable_that_names_nothing_is_an_error_where_networks_are_needed() {
        let models = || PerceptionError::NamedModels { reason: "none".into() };
        let runtime =
            || PerceptionError::from(OnnxError::NamedRuntime { variable: "ORT_DYLIB_PATH", reason: "none".into() });
        let provider =
            || PerceptionError::from(OnnxError::Provider { provider: Provider::Acl, reason: "not built in".into() });
        let mut options = Options::default();
        let said = |options: &Options, error| Networks::chosen(options, Err(error)).map_err(|error| error.to_string());
        assert!(said(&options, models()).unwrap_err().contains("TRACTRIX_MODELS"));
        assert!(said(&options, provider()).unwrap_err().contains("provider acl"));
        options.vehicles.detector = DetectorChoice::None;
        assert!(said(&options, runtime()).unwrap_err().contains("ORT_DYLIB_PATH"));
        options.vehicles.mask_network = MaskChoice::None;
        assert!(said(&options, models()).is_ok() && said(&options, runtime()).is_ok(), "no network is needed");
    }

    #[test]
    fn missing_networks_are_reported_and_substituted() {
        let networks = Networks::chosen(&Options::default(), Err(missing())).unwrap();
        assert!(networks.detector.is_none() && networks.masks.is_empty());
        let [detector, masks] = &networks.doubts[..] else { panic!("two doubts: {:?}", networks.doubts) };
        assert!(detector.contains("motion only") && masks.contains("color only"));
        assert!(networks.doubts.iter().all(|doubt| doubt.ends_with("folder not found")));
    }

    #[test]
    fn a_shipped_network_is_known_for_its_own_task_alone() {
        let Ok(DefaultModels { detector, mask_encoder, mask_decoder, small_masks }) = default_models() else {
            println!("skipped: no networks beside the program");
            return;
        };
        let known = |file: &PathBuf, task| came_with_the_program(std::slice::from_ref(file), task).unwrap();
        assert!(known(&detector, "boxes") && known(&mask_encoder, "box-masks") && known(&mask_decoder, "box-masks"));
        assert!(known(&small_masks, "box-masks"));
        assert!(!known(&mask_decoder, "boxes") && !known(&detector, "box-masks"));
    }

    #[test]
    fn the_small_network_serves_alone_below_a_camera_that_does_not_translate() {
        let masks = Networks::chosen(&Options::default(), Ok(there())).unwrap().masks;
        assert_eq!((serving(&masks, false), serving(&masks, true)), (&masks[..], &["s".into()][..]));
        assert!(serving(&[], true).is_empty());
    }

    #[test]
    fn unneeded_networks_are_not_reported() {
        let mut options = Options::default();
        options.vehicles.detector = DetectorChoice::None;
        let networks = Networks::chosen(&options, Ok(there())).unwrap();
        assert!(networks.detector.is_none() && networks.masks.len() == 3 && networks.doubts.is_empty());
        for (choice, files) in [(MaskChoice::Small, &["s"][..]), (MaskChoice::Default, &["s", "e", "f"])] {
            options.vehicles.mask_network = choice;
            let found = Networks::chosen(&options, Ok(there())).unwrap().masks;
            assert_eq!(found, files.iter().map(PathBuf::from).collect::<Vec<_>>());
        }
        options.vehicles.detector = DetectorChoice::File("mine.onnx".into());
        options.vehicles.mask_network = MaskChoice::None;
        let networks = Networks::chosen(&options, Err(missing())).unwrap();
        assert_eq!(networks.detector, Some("mine.onnx".into()));
        assert!(networks.masks.is_empty() && networks.doubts.is_empty());
    }
}
