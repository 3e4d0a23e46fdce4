# What the scripts of tests/cluster share; sourced by them after `bin` (the folder of the programs) was set.
# A folder $work that is removed at the end with everything that was started by `start`.
work=$(mktemp -d /tmp/trem-cluster-XXXXXX)
pids=()
log_lines=${log_lines:-15}
cleanup_more() { :; }
cleanup() {
  local status=$?
  set +e
  cleanup_more
  # Only what was started here, by id.
  for pid in "${pids[@]}"; do kill "$pid" 2>/dev/null; done
  for pid in "${pids[@]}"; do
    for _ in $(seq 50); do
      kill -0 "$pid" 2>/dev/null || break
      sleep 0.1
    done
    kill -9 "$pid" 2>/dev/null
  done
  if [ "$status" -ne 0 ] && [ "$status" -ne 77 ]; then tail -n "$log_lines" "$work"/*.log 2>/dev/null; fi
  rm -rf "$work"
  exit "$status"
}
trap cleanup EXIT
say() { echo "$(basename "$0" .sh): $*"; }
skip() {
  echo "SKIPPED: $*"
  exit 77
}
# start LOG COMMAND...: in the background; its id is in $! afterwards.
start() {
  local log=$work/$1.log
  shift
  "$@" >>"$log" 2>&1 &
  pids+=($!)
}
# wait_for SECONDS WHAT COMMAND...
wait_for() {
  local seconds=$1 what=$2
  shift 2
  for _ in $(seq $((seconds * 5))); do
    if "$@" >/dev/null 2>&1; then return 0; fi
    sleep 0.2
  done
  say "gave up on: $what"
  return 1
}
free_port() { python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'; }
# simulate FRAMES [TRUTH_CELLS]: a small sortie in $work/sortie; `settings` cuts it into many tasks. alone: $work/alone.tif, what `trem run` makes of it.
simulate() { "$bin/trem" simulate -o "$work/sortie" --quiet --width 128 --height 100 --frames "$1" --speed-px 2 --terrain-width "${2:-800}" --terrain-height 800; }
settings=(--set windows.roi_px=81 --set windows.roi_overlap_px=30 --set windows.frames=16 --set windows.frame_overlap=6 --set mosaic.tile_px=256)
alone() { "$bin/trem" run "$work/sortie/sortie.textproto" -o "$work/alone.tif" --quiet "${settings[@]}"; }
# percent JOB: how much of it is done.
percent() { "$bin/trem" status "$1" --json | python3 -c 'import json, sys; print(int(json.load(sys.stdin)["fraction"] * 100))'; }
at_least_done() { [ "$(percent "$1")" -ge "$2" ]; }
