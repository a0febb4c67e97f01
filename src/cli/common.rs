//! Flags that `run`, the commands that do a part of it, and `benchmark` have in common.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::de::value::{Error as ValueError, StrDeserializer};
use serde::de::{DeserializeOwned, IntoDeserializer};

use super::output::Failure;
use crate::ffi::onnx::Provider;
use crate::files;
use crate::memory::MemoryLimit;
use crate::pipeline::{Method, Options};
use crate::scene::ScaleMethod;

#[derive(Clone, Debug, clap::Args)]
pub(super) struct CommonArgs {
    /// Method: default, paper (the published method without additions, docs/paper.md), or paper-baseline
    ///
    /// Sets options before --options, --set and flags. Needs ground labels, except for default.
    #[arg(long, value_parser = method, conflicts_with = "scale_method", help_heading = "Geometry")]
    pub(super) method: Option<Method>,
    /// Scale method: joint, least-squares, constant-distance, intersection, or a reference method of docs/estimators.md
    /// [default: joint]
    #[arg(long, value_name = "METHOD", value_parser = named::<ScaleMethod>, help_heading = "Geometry")]
    pub(super) scale_method: Option<ScaleMethod>,

    /// Threads [default: one per core]
    #[arg(long, value_name = "N", help_heading = "General")]
    pub(super) threads: Option<usize>,
    /// Implementation and device that run networks: cpu, cuda, tensorrt, migraphx, openvino, xnnpack, acl (of ONNX
    /// Runtime, if the library has them), or rust (without ONNX Runtime) [default: cpu]
    #[arg(long, value_name = "NAME", help_heading = "General")]
    pub(super) provider: Option<Provider>,
    /// Memory limit for input files, images and networks, such as 2GiB [default: 80 % of the memory]
    #[arg(long, value_name = "SIZE", help_heading = "General")]
    pub(super) memory_limit: Option<MemoryLimit>,
    /// Seed of the random number generator [default: 0]
    #[arg(long, value_name = "N", help_heading = "General")]
    pub(super) seed: Option<u64>,
    /// JSON file with options, or a run.json, whose options are used; missing ones keep their default
    #[arg(long, value_name = "FILE", help_heading = "General")]
    pub(super) options: Option<PathBuf>,
    /// One option by its path, for example ground.max_error_px=3; may be repeated (see `tractrix options --all`)
    ///
    /// The value is JSON or a word. Overrides the --options file; dedicated flags override both.
    #[arg(long, value_name = "KEY=VALUE", value_parser = assignment, help_heading = "General")]
    pub(super) set: Vec<(String, String)>,
}

impl CommonArgs {
    /// The defaults, over them the method, over that the file, over that --set, and over all these flags.
    pub(super) fn options(&self) -> Result<Options, Failure> {
        self.over(Options::default())
    }

    /// As [`Self::options`], over others than the defaults.
    pub(super) fn over(&self, mut options: Options) -> Result<Options, Failure> {
        if let Some(method) = self.method {
            options = method.applied(&options).map_err(|error| Failure::Usage(error.to_string()))?;
        }
        if let Some(path) = &self.options {
            options = read_options(path, &options)?;
        }
        for (key, value) in &self.set {
            options = options.with_value(key, value).map_err(|error| Failure::Usage(error.to_string()))?;
        }
        options.threads = self.threads.or(options.threads);
        options.provider = self.provider.unwrap_or(options.provider);
        options.memory_limit = self.memory_limit.or(options.memory_limit);
        options.seed = self.seed.unwrap_or(options.seed);
        options.scale.method = self.scale_method.unwrap_or(options.scale.method);
        Ok(options)
    }
}

fn read_options(path: &Path, below: &Options) -> Result<Options, Failure> {
    let shown = path.display().to_string();
    let text = files::read_text(path).with_context(|| format!("{shown}: cannot be read; check --options"))?;
    let given: serde_json::Value = serde_json::from_slice(&text)
        .with_context(|| format!("{shown}: not a JSON tree of options; check --options"))?;
    // A run.json has more than options.
    let options = given.get("options").filter(|_| given.get("stages").is_some()).unwrap_or(&given);
    Ok(below.with_tree(options).map_err(|error| anyhow::anyhow!("{shown}: {error}"))?)
}

fn assignment(text: &str) -> Result<(String, String), String> {
    let (key, value) = text.split_once('=').ok_or_else(|| format!("'{text}': expected KEY=VALUE"))?;
    Ok((key.trim().to_owned(), value.trim().to_owned()))
}

fn method(text: &str) -> Result<Method, String> {
    let found = Method::ALL.into_iter().find(|method| method.name() == text);
    found.ok_or_else(|| format!("'{text}': expected one of {}", Method::ALL.map(Method::name).join(", ")))
}

/// The words of a command line, for people.
pub(super) fn lossy(arguments: &[OsString]) -> Vec<String> {
    arguments.iter().map(|argument| argument.to_string_lossy().into_owned()).collect()
}

/// Parses a value by its name in options and files.
pub(super) fn named<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let name: StrDeserializer<'_, ValueError> = text.into_deserializer();
    T::deserialize(name).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::{MaskChoice, MotionChoice};

    #[test]
    fn values_are_parsed_by_their_names() {
        assert_eq!(named::<ScaleMethod>("least-squares"), Ok(ScaleMethod::RobustLeastSquares));
        assert_eq!(named::<MaskChoice>("small"), Ok(MaskChoice::Small));
        assert!(named::<MotionChoice>("maybe").unwrap_err().contains("`on`"));
    }
}
