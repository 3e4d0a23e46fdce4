#!/usr/bin/env bash
# Keeps between MIN and MAX workers under Slurm, by what waits: run it on a node that may sbatch, for example in tmux or as a job of its own.
# usage: scaler.sh MIN MAX [INTERVAL_S]      needs TREM_SERVICE, TREM_BIN, TREM_KEY, TREM_COORDINATOR_KEY (setup.sh prints them)
#
# Wanted are as many workers as there are tasks waiting or running, within the limits. It grows at once and shrinks by a quarter of what is too much at a
# time, only while nothing waits, so that the end of one stage does not throw workers away that the next one needs. Those go first that Slurm has
# not started yet, then those without a task. What every step found is in $TREM_SERVICE/scaler, for `trem doctor`.
set -euo pipefail
usage="usage: scaler.sh MIN MAX [INTERVAL_S]"
min=${1:?$usage}
max=${2:?$usage}
interval=${3:-30}
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
: "${TREM_SERVICE:?set TREM_SERVICE to the service folder}" "${TREM_BIN:?set TREM_BIN to the folder of the programs}"

trem() { "$TREM_BIN/trem" "$@" --coordinator "$(cat "$TREM_SERVICE/endpoint")"; }

# Says it, and leaves it for the doctor; the file appears whole or not at all. "ok" begins what is in order.
note() {
  echo "scaler: $1" >&"${2:-1}"
  printf '%s %s %s\n' "$(date +%s)" "$interval" "$1" >"$TREM_SERVICE/.scaler.$$" && mv "$TREM_SERVICE/.scaler.$$" "$TREM_SERVICE/scaler"
}

# "WAITING RUNNING", tasks of the stages that running jobs are in.
demand() {
  trem list --json | python3 -c '
import json, sys
waiting = running = 0
for job in json.load(sys.stdin):
    if job["state"] != "running":
        continue
    for stage in job["stages"]:
        running += stage["running"]
        if stage["done"] < stage["total"]:
            waiting += max(0, stage["total"] - stage["done"] - stage["running"])
            break
print(waiting, running)'
}

# Ids of array elements in a state.
elements() { squeue --noheader --array --user "$(id -un)" --name trem-worker --states "$1" --format %i; }

# Ids of the array elements whose workers have no task.
idle_elements() {
  trem workers --json | python3 -c '
import json, sys
for worker in json.load(sys.stdin):
    if not worker["running"]:
        print("%s-%d" % (worker["host"], worker["pid"]))' | while read -r worker; do cat "$TREM_SERVICE/workers/$worker" 2>/dev/null || true; done
}

step() {
  local waiting running pending started wanted have surplus
  read -r waiting running <<<"$(demand)" && [ -n "$running" ] || { note "trem list: the coordinator does not answer; nothing is changed" 2; return 0; }
  pending=$(elements PD,CF) && started=$(elements R) || { note "squeue: Slurm does not answer; nothing is changed" 2; return 0; }
  have=$(printf '%s\n' "$pending" "$started" | grep -c . || true)
  wanted=$((waiting + running))
  [ "$wanted" -ge "$min" ] || wanted=$min
  [ "$wanted" -le "$max" ] || wanted=$max
  note "ok: $waiting tasks wait, $running run, $have workers, $wanted wanted"
  if [ "$wanted" -gt "$have" ]; then
    # shellcheck disable=SC2086  # Several options.
    sbatch --parsable --array="1-$((wanted - have))" ${TREM_SBATCH_OPTIONS:-} "$here/workers.sbatch" ||
      note "sbatch refused to start $((wanted - have)) workers; its message is above" 2
  elif [ "$wanted" -lt "$have" ] && [ "$waiting" -eq 0 ]; then
    surplus=$(((have - wanted + 3) / 4))
    mapfile -t leaving < <({ printf '%s\n' "$pending"; idle_elements; } | grep . | head -n "$surplus")
    [ ${#leaving[@]} -eq 0 ] || { echo "scaler: cancels ${leaving[*]}"; scancel "${leaving[@]}" || note "scancel refused" 2; }
  fi
}

while true; do
  step || echo "scaler: this step failed; the next one may not" >&2
  sleep "$interval"
done
