//! `doctor`: what is installed, what is missing, and how to get it.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::json;
use sha2::{Digest, Sha256};

use super::output::{Failure, Form, show};
use crate::ffi::onnx::{OnnxError, Provider, Resources};
use crate::ffi::{ffmpeg, onnx};
use crate::files;
use crate::networks::{
    GroundOptions, ModelDescription, PerceptionError, SegmentationOptions, default_descriptions, default_models,
    load_flow, load_ground_segmenter, load_segmenter,
};

/// Check installed libraries and networks
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Instance segmentation model to check
    #[arg(long, value_name = "FILE")]
    segmentation_model: Option<PathBuf>,
    /// Semantic segmentation model to check
    #[arg(long, value_name = "FILE")]
    ground_model: Option<PathBuf>,
    /// Optical flow model to check
    #[arg(long, value_name = "FILE")]
    flow_model: Option<PathBuf>,
    /// Implementation and device that run networks, as for `run`
    #[arg(long, value_name = "NAME")]
    provider: Option<Provider>,
}

impl Args {
    fn provider(&self) -> Provider {
        self.provider.unwrap_or_default()
    }

    fn resources(&self) -> Resources {
        Resources { provider: self.provider(), ..Resources::from(0) }
    }
}

/// State of a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum State {
    /// In order.
    Ok,
    /// Nobody named one: what to do about it.
    NotGiven,
    /// Not there.
    Missing,
    /// There, and no use.
    Wrong,
}

/// One thing that was looked at.
#[derive(Debug, Serialize)]
struct Finding {
    name: &'static str,
    ok: bool,
    state: State,
    found: String,
    /// Consequence of its absence, and the remedy.
    #[serde(skip_serializing_if = "Option::is_none")]
    cure: Option<String>,
}

impl Finding {
    fn good(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, ok: true, state: State::Ok, found: found.into(), cure: None }
    }

    fn bad(name: &'static str, state: State, found: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { name, ok: false, state, found: found.into(), cure: Some(cure.into()) }
    }

    fn not_given(name: &'static str, found: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { ok: true, ..Self::bad(name, State::NotGiven, found, cure) }
    }
}

pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let mut findings = vec![
        Finding::good("tractrix", format!("{} ({})", crate::VERSION, std::env::consts::ARCH)),
        processors(),
        memory(),
        opencv_library(),
        video_decoder(),
        runtime(args.provider()),
    ];
    findings.extend(own_networks());
    findings.extend(models(args));
    let failure = failure(&findings);
    let error = failure.as_ref().map(Failure::as_json);
    show(form, &json!({ "findings": findings, "error": error }), || as_text(&findings))?;
    failure.map_or(Ok(()), Err)
}

/// Without ONNX Runtime everything but networks works, so that its absence alone is no failure; a runtime or a model
/// that was named and cannot be used is.
fn failure(findings: &[Finding]) -> Option<Failure> {
    let broken: Vec<&Finding> = findings.iter().filter(|finding| !finding.ok).collect();
    let fails = broken.iter().any(|finding| finding.name != ONNX || finding.state == State::Wrong);
    let broken: Vec<&str> = broken.iter().map(|finding| finding.name).collect();
    fails.then(|| Failure::Partial(anyhow::anyhow!("problems found: {}", broken.join(", "))))
}

const ONNX: &str = "ONNX Runtime";

fn processors() -> Finding {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    Finding::good("processors", format!("{cores} available to this process"))
}

fn memory() -> Finding {
    let meminfo = fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let gib = |key: &str| -> Option<f64> {
        let line = meminfo.lines().find_map(|line| line.strip_prefix(key))?;
        Some(line.split_whitespace().next()?.parse::<f64>().ok()? / 1024.0 / 1024.0)
    };
    match (gib("MemTotal:"), gib("MemAvailable:")) {
        (Some(total), Some(available)) => {
            Finding::good("memory", format!("{total:.1} GiB, {available:.1} GiB available"))
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
    Finding::good("video decoding", format!("FFmpeg {}", ffmpeg::version()))
}

fn runtime(provider: Provider) -> Finding {
    let runtime = match onnx::probe(provider) {
        Ok(runtime) => runtime,
        Err(error) => {
            let is_named = matches!(error, OnnxError::NamedRuntime { .. } | OnnxError::Provider { .. });
            let state = if is_named { State::Wrong } else { State::Missing };
            return Finding::bad(
                ONNX,
                state,
                error.to_string(),
                "required by networks; install it with scripts/fetch-onnxruntime, or give --provider rust or --masks",
            );
        }
    };
    let version = runtime.version.unwrap_or_else(|| "version unknown".to_owned());
    let place = runtime.library.map(|library| format!("{version} at {}", library.display()));
    Finding::good(ONNX, format!("{}; provider {}", place.unwrap_or_else(|| "not used".to_owned()), provider.name()))
}

/// The networks that come with the program: where they lie, their licences, and whether they are whole.
fn own_networks() -> Vec<Finding> {
    let cure = "reinstall the program with its folder `models`; models/make has the scripts that make each file";
    let found = default_models().and_then(|models| Ok((models, default_descriptions()?)));
    let (models, descriptions) = match found {
        Ok(found) => found,
        Err(error) => return vec![Finding::bad(OWN, State::Missing, error.to_string(), cure)],
    };
    let of_file = |path: &Path| {
        let description = descriptions.iter().find(|d| path.ends_with(&d.file));
        description.map(|description| own_network(path, description, cure))
    };
    models.files().into_iter().filter_map(of_file).collect()
}

fn own_network(path: &Path, description: &ModelDescription, cure: &str) -> Finding {
    let ModelDescription { name, licence, sha256, .. } = description;
    match hash(path) {
        Ok(found) if found == *sha256 => Finding::good(OWN, format!("{name} at {}; {licence}", path.display())),
        Ok(found) => {
            let said = format!("{name} at {}: sha256 {found}, expected {sha256}", path.display());
            Finding::bad(OWN, State::Wrong, said, cure)
        }
        Err(error) => {
            Finding::bad(OWN, State::Wrong, format!("{name} at {}: cannot be read: {error}", path.display()), cure)
        }
    }
}

/// SHA-256 of a file in hexadecimal digits.
fn hash(path: &Path) -> std::io::Result<String> {
    let mut hasher = Sha256::new();
    std::io::copy(&mut files::open(path)?, &mut hasher)?;
    Ok(format!("{:x}", hasher.finalize()))
}

/// The models that were named, and what to do without.
fn models(args: &Args) -> [Finding; 3] {
    let segmentation = |path: &Path| load_segmenter(path, &SegmentationOptions::default(), args.resources()).map(drop);
    let ground = |path: &Path| load_ground_segmenter(path, &GroundOptions::default(), args.resources()).map(drop);
    let flow = |path: &Path| load_flow(Some(path), args.resources()).map(drop);
    let no_segmentation = Finding::good(
        "segmentation model",
        "none given: the bundled networks are used; --segmentation-model FILE selects another one, --masks DIR gives \
         masks (docs/perception.md)",
    );
    let no_ground = Finding::not_given(
        "ground model",
        "none given: the dominant plane below the camera is used",
        "for uneven roads give --ground-model FILE, or run with --ground-masks DIR: one 8-bit PNG per frame, 0 = no \
         ground",
    );
    let no_flow = Finding::good("flow model", "none given: OpenCV's DIS is used");
    [
        model(args, args.segmentation_model.as_deref(), segmentation, no_segmentation),
        model(args, args.ground_model.as_deref(), ground, no_ground),
        model(args, args.flow_model.as_deref(), flow, no_flow),
    ]
}

const OWN: &str = "bundled network";

/// A model that was named; `absent` where none was.
fn model(
    args: &Args,
    path: Option<&Path>,
    load: impl FnOnce(&Path) -> Result<(), PerceptionError>,
    absent: Finding,
) -> Finding {
    let Some(path) = path else { return absent };
    let name = absent.name;
    match load(path) {
        Ok(()) => Finding::good(name, format!("{}: recognised", path.display())),
        Err(_) if !path.exists() => {
            Finding::bad(name, State::Missing, format!("{}: not found", path.display()), "check the path")
        }
        Err(error) if onnx::probe(args.provider()).is_err() => {
            Finding::bad(name, State::Missing, error.to_string(), "a model can only be checked with ONNX Runtime")
        }
        Err(error) => {
            let cure = "give a model of a supported family; see docs/perception.md";
            Finding::bad(name, State::Wrong, error.to_string(), cure)
        }
    }
}

fn as_text(findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        let mark = match finding.state {
            State::Ok => "ok",
            State::NotGiven => "-",
            State::Missing => "MISSING",
            State::Wrong => "WRONG",
        };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{mark:<7}  {:<18}  {}", finding.name, finding.found);
        if let Some(cure) = &finding.cure {
            let _ = writeln!(text, "         {:<18}  {cure}", "");
        }
    }
    text
}
