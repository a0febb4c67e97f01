//! `doctor`: what is installed, what is missing, and how to get it.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use opencv::videoio;
use serde::Serialize;

use super::output::{Failure, print, print_json};
use crate::ffi::onnx;
use crate::perception::{
    FlowOptions, GroundOptions, SegmentationOptions, load_flow, load_ground_segmenter, load_segmenter,
};

/// Models to look at.
#[derive(Debug, clap::Args)]
pub(super) struct DoctorArgs {
    /// Try this instance segmentation model
    #[arg(long, value_name = "FILE")]
    segmentation_model: Option<PathBuf>,
    /// Try this semantic segmentation model
    #[arg(long, value_name = "FILE")]
    ground_model: Option<PathBuf>,
    /// Try this optical flow model
    #[arg(long, value_name = "FILE")]
    flow_model: Option<PathBuf>,
}

/// One thing that was looked at.
#[derive(Debug, Serialize)]
struct Finding {
    name: &'static str,
    ok: bool,
    found: String,
    /// What does not work without it, and how to get it.
    #[serde(skip_serializing_if = "Option::is_none")]
    cure: Option<String>,
}

impl Finding {
    fn good(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, ok: true, found: found.into(), cure: None }
    }

    fn bad(name: &'static str, found: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { name, ok: false, found: found.into(), cure: Some(cure.into()) }
    }
}

pub(super) fn run(args: &DoctorArgs, json: bool) -> Result<(), Failure> {
    let mut findings = vec![
        Finding::good("tractrix", format!("{} ({})", env!("CARGO_PKG_VERSION"), std::env::consts::ARCH)),
        processors(),
        memory(),
        opencv_library(),
        video_decoder(),
        onnx_runtime(),
    ];
    findings.extend(models(args));
    match json {
        true => print_json(&findings)?,
        false => print(&as_text(&findings))?,
    }
    let broken: Vec<&str> = findings.iter().filter(|finding| !finding.ok).map(|finding| finding.name).collect();
    // Without ONNX Runtime everything but networks works, so that alone is no failure; a model that was named is.
    match broken.iter().any(|name| *name != ONNX) {
        true => Err(Failure::Input(anyhow::anyhow!("not in order: {}", broken.join(", ")))),
        false => Ok(()),
    }
}

const ONNX: &str = "ONNX Runtime";

fn processors() -> Finding {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    Finding::good("processors", format!("{cores} that this process may use"))
}

fn memory() -> Finding {
    let meminfo = fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let gib = |key: &str| -> Option<f64> {
        let line = meminfo.lines().find_map(|line| line.strip_prefix(key))?;
        Some(line.split_whitespace().next()?.parse::<f64>().ok()? / 1024.0 / 1024.0)
    };
    match (gib("MemTotal:"), gib("MemAvailable:")) {
        (Some(total), Some(available)) => {
            Finding::good("memory", format!("{total:.1} GiB, {available:.1} GiB of it available"))
        }
        _ => Finding::good("memory", "unknown"),
    }
}

fn opencv_library() -> Finding {
    let version = opencv::core::get_version_string().unwrap_or_else(|error| error.to_string());
    let threads = opencv::core::get_num_threads().unwrap_or(0);
    Finding::good("OpenCV", format!("{version}, {threads} threads"))
}

fn video_decoder() -> Finding {
    let information = opencv::core::get_build_information().unwrap_or_default();
    let line = |key: &str| {
        information.lines().map(str::trim).find_map(|line| line.strip_prefix(key)).map(|rest| rest.trim().to_owned())
    };
    let registered = videoio::get_backends()
        .is_ok_and(|backends| backends.iter().any(|backend| backend == videoio::VideoCaptureAPIs::CAP_FFMPEG));
    let codec = line("avcodec:").map_or(String::new(), |version| format!(", avcodec {version}"));
    match registered {
        true => Finding::good("video decoding", format!("FFmpeg behind OpenCV{codec}")),
        false => Finding::bad(
            "video decoding",
            "OpenCV was built without FFmpeg",
            "only folders of images can be read; install an OpenCV with FFmpeg (Debian and Ubuntu: libopencv-videoio-dev)",
        ),
    }
}

fn onnx_runtime() -> Finding {
    match onnx::probe() {
        Ok(runtime) => Finding::good(ONNX, format!("{} at {}", runtime.version, runtime.library.display())),
        Err(error) => Finding::bad(
            ONNX,
            error.to_string(),
            "needed for --segmentation-model, --ground-model and --flow-model only; scripts/fetch-onnxruntime gets it",
        ),
    }
}

fn models(args: &DoctorArgs) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut add = |name, path: &PathBuf, result: Result<(), String>| {
        findings.push(match result {
            Ok(()) => Finding::good(name, format!("{}: recognised", path.display())),
            Err(reason) => Finding::bad(name, reason, "give a model of a supported family; see docs/perception.md"),
        });
    };
    if let Some(path) = &args.segmentation_model {
        let loaded = load_segmenter(path, &SegmentationOptions::default()).map(drop).map_err(|e| e.to_string());
        add("segmentation model", path, loaded);
    }
    if let Some(path) = &args.ground_model {
        let loaded = load_ground_segmenter(path, &GroundOptions::default()).map(drop).map_err(|e| e.to_string());
        add("ground model", path, loaded);
    }
    if let Some(path) = &args.flow_model {
        let loaded = load_flow(Some(path), &FlowOptions::default()).map(drop).map_err(|e| e.to_string());
        add("flow model", path, loaded);
    }
    findings
}

fn as_text(findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        let mark = if finding.ok { "ok     " } else { "MISSING" };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{mark}  {:<18}  {}", finding.name, finding.found);
        if let Some(cure) = &finding.cure {
            let _ = writeln!(text, "         {:<18}  {cure}", "");
        }
    }
    text
}
