# Sourced by scripts that take minutes: every step says what it is, and how long it took. Where nobody watches a
# terminal, a line every half minute says that it is still at work; on a terminal cargo's own bar does.

duration() {
  if [ "$1" -ge 60 ]; then echo "$(($1 / 60)) min $(($1 % 60)) s"; else echo "$1 s"; fi
}

heartbeat() {
  while sleep 30 </dev/null >/dev/null 2>&1; do
    echo "   ... $1: still at work after $(duration $((SECONDS - $2)))"
  done
}

# step TITLE COMMAND...: runs the command, an external one; ends the script with its status if it fails.
step() {
  local title=$1 start=$SECONDS status=0 pulse=
  shift
  echo "== $title"
  if ! [ -t 1 ]; then
    heartbeat "$title" "$start" &
    pulse=$!
    trap "kill $pulse 2>/dev/null" EXIT
  fi
  "$@" || status=$?
  if [ -n "$pulse" ]; then
    kill "$pulse" 2>/dev/null || true
    wait "$pulse" 2>/dev/null || true
    trap - EXIT
  fi
  if [ "$status" -ne 0 ]; then
    echo "== $title: failed after $(duration $((SECONDS - start)))" >&2
    exit "$status"
  fi
  echo "== $title: $(duration $((SECONDS - start)))"
}
