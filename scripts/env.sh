# Sourced by the other scripts: a Rust toolchain that scripts/setup installed is found wherever it came from.
for bin in "$PWD/target/toolchain" "${CARGO_HOME:-$HOME/.cargo}/bin"; do
  case ":$PATH:" in
    *":$bin:"*) ;;
    *) [ -d "$bin" ] && PATH="$bin:$PATH" ;;
  esac
done
export PATH

# A program that is built into a folder elsewhere finds neither its networks nor their runtime in this source tree.
if [ -n "${CARGO_TARGET_DIR:-}" ]; then
  runtime=$PWD/third_party/onnxruntime/${runs_on:-$(uname -m)}/libonnxruntime.so
  if [ -z "${TRACTRIX_MODELS:-}" ]; then export TRACTRIX_MODELS="$PWD/models"; fi
  if [ -z "${TRACTRIX_ONNXRUNTIME:-}" ] && [ -f "$runtime" ]; then export TRACTRIX_ONNXRUNTIME="$runtime"; fi
fi

# Where rustup has not the toolchain that rust-toolchain.toml names, and may not fetch it, its default serves.
if command -v rustup >/dev/null && ! cargo --version >/dev/null 2>&1; then
  default=$(rustup toolchain list | sed -n 's/ (.*default.*//p')
  if [ -n "$default" ]; then export RUSTUP_TOOLCHAIN="$default"; fi
fi
