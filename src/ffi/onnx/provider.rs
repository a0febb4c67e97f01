//! Implementation and device that run networks.

use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::OnnxError;

/// Implementation and device that run networks. All but `rust` are execution providers of ONNX Runtime; but for `cpu`,
/// the library must have been built with them (`TRACTRIX_ONNXRUNTIME` names another one).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Provider {
    /// Processor.
    Cpu,
    /// NVIDIA graphics processor through CUDA.
    Cuda,
    /// NVIDIA graphics processor through TensorRT, which compiles a network at its first use.
    Tensorrt,
    /// AMD graphics processor through MIGraphX.
    Migraphx,
    /// Intel processors and graphics through OpenVINO.
    Openvino,
    /// Processor through XNNPACK.
    Xnnpack,
    /// Arm processor through the Arm Compute Library.
    Acl,
    /// Processor, without ONNX Runtime (crate `rten`).
    Rust,
}

with_names!(Provider {
    Cpu = "cpu",
    Cuda = "cuda",
    Tensorrt = "tensorrt",
    Migraphx = "migraphx",
    Openvino = "openvino",
    Xnnpack = "xnnpack",
    Acl = "acl",
    Rust = "rust",
});

impl Provider {
    /// Error of a build without the implementation.
    pub(super) fn not_built(self) -> OnnxError {
        let feature = if self == Self::Rust { "networks-rust" } else { "onnxruntime" };
        let other = Self::default().name();
        let reason =
            format!("this program was built without it; build with --features {feature}, or give --provider {other}");
        OnnxError::Provider { provider: self, reason }
    }
}

impl Default for Provider {
    /// ONNX Runtime on the processor; `rust` in builds without it.
    fn default() -> Self {
        if cfg!(feature = "onnxruntime") { Self::Cpu } else { Self::Rust }
    }
}

impl FromStr for Provider {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|provider| provider.name() == text);
        found.ok_or_else(|| format!("'{text}': expected one of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_options_files() {
        for provider in Provider::ALL {
            assert_eq!(provider.name().parse(), Ok(provider));
            assert_eq!(serde_json::json!(provider), provider.name());
        }
        assert!("gpu".parse::<Provider>().unwrap_err().contains("tensorrt, migraphx"));
    }
}
