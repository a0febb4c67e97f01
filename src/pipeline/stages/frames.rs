//! Stage `frames`: the list of frames that all other stages use.

use serde_json::{Value, json};

use crate::pipeline::Result;
use crate::pipeline::driver::run::{FRAMES, Outcome, Run};
use crate::pipeline::inputs::{cameras, order};
use crate::scene::{TimeBase, Topic};
use crate::video::Kind;

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    Ok(json!({ "input": run.content, "video": run.options.video, "in_time": order::stated(run) }))
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let scan = run.source.scan()?;
    let order = order::find(run, &scan.frames, outcome)?;
    let (frames, left_out) = match order.in_time {
        true => cameras::of_one_size(run.source, scan.frames),
        false => (scan.frames, Vec::new()),
    };
    run.keep(FRAMES, &frames, outcome)?;
    for warning in scan.warnings.into_iter().chain(left_out) {
        outcome.warn(warning);
    }
    if order.in_time && run.info().time_base() == TimeBase::Frames {
        let text = "frame rate unknown: times are frame numbers; give --fps RATE for seconds";
        outcome.warn(Topic::NoFrameRate.warning(text));
    }
    if run.info().kind == Kind::Video && run.options.video.fps.is_some() {
        let text = "--fps ignored: it is for folders of images; a video has its own time stamps";
        outcome.warn(Topic::FrameRateIgnored.warning(text));
    }
    if let Some(remark) = order.remark() {
        tracing::info!("{remark}");
        outcome.note(Topic::ImageOrderDetected.warning(remark));
    }
    outcome.figure("num_frames", frames.len());
    outcome.figure("num_repeated", scan.num_repeated);
    outcome.figure("width", run.info().width);
    outcome.figure("height", run.info().height);
    outcome.figure("in_time", order.in_time);
    if let Some(share) = order.followed_share {
        outcome.figure("followed_share", share);
    }
    Ok(())
}
