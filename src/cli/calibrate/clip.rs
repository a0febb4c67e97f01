//! A real clip in a variant, next to the clip as it is.

use std::fs;
use std::path::Path;

use super::case::{Setting, apply};
use super::degrade;
use super::variant::{Kind, Variant};
use crate::eval::calibration::Case;
use crate::eval::spread::{RunResult, Spread, spreads};
use crate::io::RunFolder;
use crate::pipeline::{FrameOrder, Instances};
use crate::video::{Options as VideoOptions, Source};

/// Returns true if a variant is possible with a clip: one that changes masks needs a sequence.
pub(super) fn is_possible(variant: Variant) -> bool {
    use Kind::{Blur, Compression, Frames, Noise, Scale, Seed, Window};
    matches!(variant.kind, Blur | Compression | Frames | Noise | Scale | Seed | Window)
}

impl Setting<'_> {
    /// A clip in a variant.
    ///
    /// # Errors
    /// What stands in the way of the run.
    pub(super) fn clip_run(&self, clip: &Path, variant: Variant) -> anyhow::Result<RunResult> {
        let mut options = self.options.clone();
        options.instances = Instances::Vehicles;
        apply(variant, &mut options);
        let name = name(clip);
        let made = self.made(&name, variant, |place| degrade::write_clip(clip, variant, place, self.options.seed))?;
        if made.is_some() {
            // The pictures of a clip follow one another as its frames do.
            let fps = Source::open(clip, &VideoOptions::default())?.info().fps;
            options.video.fps = options.video.fps.or(fps);
            options.order = FrameOrder::Time;
        }
        let output = self.results.subfolder(&name)?.join(variant.to_string());
        let input = made.as_ref().map_or(clip.to_owned(), |made| made.join("images"));
        let done = self.work(&input, &output, &options, Vec::new());
        if let Some(made) = &made {
            fs::remove_dir_all(made)?;
        }
        done?;
        found(&output)
    }
}

/// The vehicles that the clip in a variant and the clip as it is both have.
pub(super) fn spreads_of(clip: &Path, variant: Variant, found: &RunResult, as_it_is: &RunResult) -> Vec<Spread> {
    let named = |spread| Spread { clip: name(clip), variant: variant.to_string(), ..spread };
    spreads(as_it_is, found).into_iter().map(named).collect()
}

/// Ratios of stationary vehicles against those by the camera path.
pub(super) fn stationary_cases(clip: &Path, variant: Variant, found: &RunResult) -> Vec<Case> {
    let (clip, variant) = (name(clip), variant.to_string());
    found.trajectories.objects.iter().filter_map(|vehicle| Case::of_stationary(&clip, &variant, vehicle)).collect()
}

/// The name of a clip without its ending: that of its folder of results.
fn name(clip: &Path) -> String {
    clip.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn found(output: &Path) -> anyhow::Result<RunResult> {
    let folder = RunFolder::at(output);
    let background = folder.read_background()?;
    let cameras = background.images.iter().map(|(id, image)| (id.frame(), image.cam_from_world));
    Ok(RunResult { cam_from_world: cameras.collect(), trajectories: folder.read_trajectories()? })
}
