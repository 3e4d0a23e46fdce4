#!/usr/bin/env bash
# Goal: systemd takes the units of deploy/systemd without a word, and finds them locked down. Method: systemd's own verification, with the
# built programs in the place of installed ones; no service is started. usage: units_test.sh BIN_FOLDER SOURCE_FOLDER        exit code 77: skipped
set -euo pipefail
bin=$1
# shellcheck source=tests/cluster/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
command -v systemd-analyze >/dev/null || skip "no systemd-analyze"
cp "$2"/deploy/systemd/*.service "$work/"
sed -i "s|/usr/local/bin|$bin|" "$work"/*.service
# What systemd says of the units; whether man pages or other units of this machine are in order is not the question.
complaints() {
  systemd-analyze verify "$@" >"$work/verify.txt" 2>&1 || echo "exit code $?" >>"$work/verify.txt"
  grep -E 'trem-(coordinator|worker)' "$work/verify.txt"
}
if complaints "$work"/trem-coordinator.service "$work"/trem-worker@.service; then exit 1; fi
# Negative control: a line that no unit may have is found.
mkdir "$work/wrong"
sed 's/^ExecStart=/NoSuchDirective=1\n&/' "$work/trem-coordinator.service" >"$work/wrong/trem-coordinator.service"
complaints "$work/wrong/trem-coordinator.service" >/dev/null || { say "systemd-analyze verify finds nothing here"; exit 1; }
# Every option that a unit gives is one of the program's.
for unit in coordinator worker@; do
  line=$(grep ^ExecStart= "$work/trem-$unit.service")
  program=${line#ExecStart=}
  for option in $(grep -oE -- '--[a-z-]+' <<<"$line" | sort -u); do
    case $unit in coordinator) help=$("${program%% *}" --help) ;; *) help=$("${program%% *}" serve --help) ;; esac
    grep -q -- "$option" <<<"$help" || { say "trem-$unit.service: there is no $option"; exit 1; }
  done
done
# Exposure in tenths, 0 to 100; a unit that locks nothing down has 96.
for unit in trem-coordinator trem-worker@; do
  systemd-analyze security --offline=true --no-pager --threshold=45 "$work/$unit.service" >"$work/exposure.txt" 2>/dev/null ||
    { say "$unit is exposed by more than 4.5"; cat "$work/exposure.txt"; exit 1; }
  say "$unit: $(grep -i 'overall exposure' "$work/exposure.txt")"
done
say passed
