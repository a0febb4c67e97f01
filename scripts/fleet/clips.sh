# Sourced by the scripts beside it: short clips, a list of them, and what is expected of them.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
demo=$root/dataset/demo

needs() {
  local tool
  for tool in "$@"; do
    if ! command -v "$tool" >/dev/null; then
      echo "$0: needs $tool; $cure" >&2
      exit 2
    fi
  done
}

# make_clips FOLDER: six videos, of which one is none, and FOLDER/list.txt. A clip is eight frames of the demo, so that
# a job takes seconds.
make_clips() {
  local folder=$1 k
  mkdir -p "$folder"
  : >"$folder/list.txt"
  for k in 0 1 2 3 4 5; do
    cp "$demo/video.mp4" "$folder/flight $k.mp4"
    printf '%s\t--seed %s\n' "flight $k.mp4" "$k" >>"$folder/list.txt"
  done
  echo "a text, no video" >"$folder/flight 3.mp4"
}

# What all clips have in common.
clip_options() {
  echo --masks "$demo/masks" --intrinsics "$(cat "$demo/intrinsics.txt")" --end 8f --max-dimension 480
}

# How many jobs of a list are in a state: number LIST OUTPUT STATE
number() {
  # shellcheck disable=SC2046
  "$program" batch "$1" --output "$2" --status --json --quiet $(clip_options) 2>/dev/null |
    python3 -c 'import json, sys; print(json.load(sys.stdin)["counts"][sys.argv[1]])' "$3"
}

failures=0
# expect WHAT FOUND WANTED: a line of the log; a wrong one counts.
expect() {
  if [ "$2" = "$3" ]; then
    echo "ok    $1: $2"
  else
    echo "WRONG $1: $2 instead of $3"
    failures=$((failures + 1))
  fi
}

conclude() {
  echo "$failures of what was expected came otherwise"
  [ "$failures" -eq 0 ]
}
