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
systemd-analyze verify "$work"/trem-coordinator.service "$work"/trem-worker@.service >"$work/verify.txt" 2>&1 || true
# Whether man pages or other units of this machine are in order is not the question.
if grep -E 'trem-(coordinator|worker)' "$work/verify.txt"; then exit 1; fi
# Every option that a unit gives is one of the program's.
for unit in coordinator worker@; do
  line=$(grep ^ExecStart= "$work/trem-$unit.service")
  program=${line#ExecStart=}
  for option in $(grep -oE -- '--[a-z-]+' <<<"$line" | sort -u); do
    case $unit in coordinator) help=$("${program%% *}" --help) ;; *) help=$("${program%% *}" serve --help) ;; esac
    grep -q -- "$option" <<<"$help" || { say "trem-$unit.service: there is no $option"; exit 1; }
  done
done
for unit in trem-coordinator trem-worker@; do
  exposure=$(systemd-analyze security --offline=true --no-pager "$work/$unit.service" 2>/dev/null | grep -i 'overall exposure' || true)
  [ -z "$exposure" ] || say "$unit: $exposure"
done
say passed
