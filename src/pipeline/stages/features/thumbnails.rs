//! Small pictures for the report's strip.
//!
//! The stage `features` goes through all pictures; where the report comes after it in the same run, those that the page
//! shows are made small on the way, and the video is not decoded again for them. Where they are not kept, they are
//! decoded. The page is the same.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::image::RgbImage;
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::features;
use crate::pipeline::{PipelineError, Stage};
use crate::report;
use crate::scene::{Frame, FrameId};

const FILE: &str = "strip.bin";

/// Makes pictures small and keeps them.
pub(in crate::pipeline) struct Keeper {
    wanted: BTreeSet<FrameId>,
    kept: Vec<Small>,
}

/// A small picture.
#[derive(Serialize, Deserialize)]
struct Small {
    frame: FrameId,
    width: u32,
    height: u32,
    /// Red, green and blue, row by row.
    bytes: Vec<u8>,
}

impl Keeper {
    /// One that works next to the stage `features`, if the report comes after it in this run.
    pub(in crate::pipeline) fn beside_features(run: &Run) -> Result<Option<Self>, PipelineError> {
        let keeper = Self { wanted: wanted(run)?, kept: Vec::new() };
        Ok((run.goal == Stage::Report).then_some(keeper))
    }

    pub(in crate::pipeline) fn push(&mut self, frame: &Frame, picture: &RgbImage) {
        if self.wanted.contains(&frame.id) {
            let small = report::shrunk(picture);
            let (width, height) = small.dimensions();
            self.kept.push(Small { frame: frame.id, width, height, bytes: small.into_raw() });
        }
    }

    /// Writes them into a folder of the stage.
    pub(in crate::pipeline) fn write(&self, folder: &Path) -> Result<(), PipelineError> {
        intermediate::write(&folder.join(FILE), &self.kept)
    }
}

/// The pictures that the page shows, ascending, small or as they are. A frame that cannot be decoded is left out: the
/// stage that needed it has reported it.
pub(in crate::pipeline) fn pictures(run: &Run) -> Result<Vec<(Frame, RgbImage)>, PipelineError> {
    let path = kept_file(run);
    if !path.is_file() {
        let found = run.source.frames_at(wanted(run)?)?.flatten();
        return Ok(found.map(|(frame, picture)| (frame, report::shrunk(&picture))).collect());
    }
    let kept: Vec<Small> = intermediate::read(&path)?;
    let frames = run.frames()?;
    let frame = |id: FrameId| frames.iter().find(|frame| frame.id == id).cloned();
    let picture =
        |small: Small| Some((frame(small.frame)?, RgbImage::from_raw(small.width, small.height, small.bytes)?));
    Ok(kept.into_iter().filter_map(picture).collect())
}

/// Frames of the strip.
fn wanted(run: &Run) -> Result<BTreeSet<FrameId>, PipelineError> {
    let ids: Vec<FrameId> = run.frames()?.iter().map(|frame| frame.id).collect();
    Ok(report::strip_frames(&ids).into_iter().collect())
}

fn kept_file(run: &Run) -> PathBuf {
    let folder = fingerprint::folder_name(features::PREFIX, run.fingerprint(Stage::Features));
    run.workspace.state(&folder).join(FILE)
}
