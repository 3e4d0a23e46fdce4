#!/usr/bin/env bash
# From a fresh machine to a mosaic: installs, builds, simulates a sortie when none is given, and runs it with two workers.
# usage: deploy/quickstart.sh [SORTIE]    SORTIE: a video, a folder of images, a glob or a spec file. Results: build/quickstart/
set -euo pipefail
start_folder=$PWD
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/.."

"$here/build.sh" release
bin=$PWD/build/release/bin
out=$PWD/build/quickstart
mkdir -p "$out"

if [ $# -ge 1 ]; then
  sortie=$1
else
  sortie=$out/sortie/sortie.textproto
  if [ -f "$sortie" ]; then
    echo "quickstart: using the simulated sortie of an earlier run; remove $out/sortie for a new one"
  else
    echo "quickstart: simulating a sortie over procedural ground in $out/sortie"
    "$bin/trem" simulate -o "$out/sortie"
  fi
fi

# A relative SORTIE is relative to where the user stands.
cd "$start_folder"
status=0
"$bin/trem" run "$sortie" -o "$out/mosaic.tif" --workers 2 || status=$?
# 5: done in part; there is a mosaic, with holes.
if [ "$status" -ne 0 ] && [ "$status" -ne 5 ]; then
  echo "quickstart: trem run ended with exit code $status; its message is above" >&2
  exit "$status"
fi
echo
echo "quickstart: the mosaic:           $out/mosaic.tif"
echo "quickstart: a picture of it:      $out/mosaic_preview.png"
echo "quickstart: report with pictures: $out/mosaic_report.html"
echo "quickstart: beside it:"
(cd "$out" && ls -1 mosaic_* | sed 's|^|  |')
exit "$status"
