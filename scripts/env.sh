# Sourced by the other scripts: a Rust toolchain that scripts/setup installed is found wherever it came from.
for bin in "$PWD/target/toolchain" "${CARGO_HOME:-$HOME/.cargo}/bin"; do
  case ":$PATH:" in
    *":$bin:"*) ;;
    *) [ -d "$bin" ] && PATH="$bin:$PATH" ;;
  esac
done
export PATH

# Where rustup has not the toolchain that rust-toolchain.toml names, and may not fetch it, its default serves.
if command -v rustup >/dev/null && ! cargo --version >/dev/null 2>&1; then
  default=$(rustup toolchain list | sed -n 's/ (.*default.*//p')
  if [ -n "$default" ]; then export RUSTUP_TOOLCHAIN="$default"; fi
fi
