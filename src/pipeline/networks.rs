//! The networks with which the program finds vehicles by itself: which there are, and what stands in for those that are
//! missing.

use std::path::PathBuf;

use super::run::Run;
use super::{DetectorChoice, PipelineError};
use crate::perception::{Detector, Prompter};

/// What is there of what the options choose.
#[derive(Clone, Debug, Default)]
pub(super) struct Networks {
    /// The detector.
    pub(super) detector: Option<PathBuf>,
    /// What is missing, and what that means.
    pub(super) doubts: Vec<String>,
}

impl Networks {
    pub(super) fn of(run: &Run) -> Self {
        let mut networks = Self::default();
        if let DetectorChoice::File(path) = &run.options.vehicles.detector {
            networks.detector = Some(path.clone());
        }
        networks
    }

    pub(super) fn load_detector(&self, _run: &Run) -> Result<Option<Box<dyn Detector>>, PipelineError> {
        Ok(None)
    }

    pub(super) fn load_prompter(&self, _run: &Run) -> Result<Option<Box<dyn Prompter>>, PipelineError> {
        Ok(None)
    }
}
