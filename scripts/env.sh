# Sourced by the other scripts: a Rust toolchain that scripts/setup installed is found wherever it came from.
for bin in "$PWD/target/toolchain" "${CARGO_HOME:-$HOME/.cargo}/bin"; do
  case ":$PATH:" in
    *":$bin:"*) ;;
    *) [ -d "$bin" ] && PATH="$bin:$PATH" ;;
  esac
done
export PATH
