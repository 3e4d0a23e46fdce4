#!/usr/bin/env bash
# Goal: a whole job with its input and its artefacts in an object store makes the same bytes as `trem run`; an object that is damaged there is made
# again; wrong credentials are an error in words that names no secret. Method: a local S3 server (npm @20minutes/s3rver), which the workers reach by
# GDAL's /vsis3/; coordinator, workers and client share no folder.
# usage: s3_test.sh BIN_FOLDER MODULES_FOLDER        exit code 77: skipped
set -euo pipefail
bin=$1
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
# shellcheck source=tests/cluster/common.sh
source "$here/common.sh"
command -v curl >/dev/null || skip "no curl"
modules=$("$here/node_modules.sh" "$2") || exit $?
start_server() { # start_server PORT [strict]
  start "s3-$1" node "$here/s3_server.js" "$modules" "$1" "$work/buckets" "${2:-}"
  wait_for 30 "the S3 server" grep -q ready "$work/s3-$1.log"
}
mkdir -p "$work/buckets"
port=$(free_port)
start_server "$port"
export AWS_S3_ENDPOINT=127.0.0.1:$port AWS_VIRTUAL_HOSTING=FALSE AWS_HTTPS=NO AWS_ACCESS_KEY_ID=S3RVER AWS_SECRET_ACCESS_KEY=S3RVER AWS_REGION=us-east-1
# Nothing of this machine's own credentials.
export AWS_CONFIG_FILE=/dev/null AWS_SHARED_CREDENTIALS_FILE=/dev/null CPL_AWS_CREDENTIALS_FILE=/dev/null

simulate 16
alone
put() { # put FILE KEY
  curl --silent --show-error --fail --header "x-amz-content-sha256: UNSIGNED-PAYLOAD" --user S3RVER:S3RVER --aws-sigv4 aws:amz:us-east-1:s3 --upload-file "$1" "http://127.0.0.1:$port/$2"
}
# Telemetry one folder above the frames, where the search for it has to bring it from.
for file in "$work"/sortie/frames/*.png; do put "$file" "flights/leg/frames/$(basename "$file")"; done
put "$work/sortie/frames/telemetry.csv" flights/leg/telemetry.csv
# The sortie's own spec, with the frames in the bucket.
sed -e 's|path: "frames"|path: "/vsis3/flights/leg/frames"|' -e '/telemetry.csv/d' "$work/sortie/sortie.textproto" >"$work/in-s3.textproto"
grep -q vsis3 "$work/in-s3.textproto"

start_service() { # start_service NAME
  start "$1" "$bin/trem-coordinator" --state "$work/$1-state" --store "/vsis3/store/$1" --bind 'tcp://127.0.0.1:*' --ready-file "$work/$1-ready"
  wait_for 20 "the coordinator" test -s "$work/$1-ready"
  TREM_COORDINATOR=$(head -1 "$work/$1-ready")
  export TREM_COORDINATOR
}
start_worker() { # start_worker SERVICE NUMBER
  start "$1-worker-$2" "$bin/trem-worker" serve --coordinator "$TREM_COORDINATOR" --store "/vsis3/store/$1" --source-root /vsis3/flights/
}
start_service whole
start_worker whole 1
start_worker whole 2
"$bin/trem" submit "$work/in-s3.textproto" "${settings[@]}" --job-id from-s3
"$bin/trem" watch from-s3 --quiet
"$bin/trem" fetch from-s3 -o "$work/s3.tif" --quiet
cmp "$work/alone.tif" "$work/s3.tif"
objects() { find "$work/buckets/store" -type f -name '*_object' | wc -l; }
say "input and artefacts in S3, mosaic byte-identical ($(objects) objects)"
[ "$(objects)" -gt 10 ]

# Another job with the same windows finds a damaged object instead of one of its inputs: it is made anew, and the mosaic is right.
find "$work/buckets/store" -type f -name '*_object' -size +2k | while read -r object; do
  printf 'damage' | dd of="$object" bs=1 seek=700 conv=notrunc status=none
done
for pid in "${pids[@]:2}"; do kill -TERM "$pid"; wait "$pid" || true; done
start_worker whole 3
"$bin/trem" submit "$work/in-s3.textproto" "${settings[@]}" --set mosaic.estimator=median --job-id damaged
"$bin/trem" run "$work/sortie/sortie.textproto" -o "$work/median.tif" --quiet "${settings[@]}" --set mosaic.estimator=median
"$bin/trem" watch damaged --quiet
"$bin/trem" fetch damaged -o "$work/s3-median.tif" --quiet
cmp "$work/median.tif" "$work/s3-median.tif"
say "every larger object was damaged: made anew, mosaic byte-identical"

# What only removed jobs had leaves the bucket, and nothing else does: the job that stays is fetched again.
find "$work/buckets/store" -type f -exec touch -d '2 hours ago' {} +
"$bin/trem" doctor --json | python3 -c '
import json, sys
found = [finding for finding in json.load(sys.stdin) if finding["subject"] == "object store"]
sys.exit(0 if found and found[0]["good"] else "trem doctor finds fault: %s" % found)'
before=$(objects)
"$bin/trem" remove from-s3
say "after the removal of a job: $("$bin/trem" sweep --older-than-s 3600)"
[ "$(objects)" -lt "$before" ]
"$bin/trem" fetch damaged -o "$work/swept.tif" --quiet
cmp "$work/median.tif" "$work/swept.tif"

port=$(free_port)
start_server "$port" strict
export AWS_S3_ENDPOINT=127.0.0.1:$port AWS_SECRET_ACCESS_KEY=not-the-secret
start_service refused
if timeout 60 "$bin/trem-worker" serve --coordinator "$TREM_COORDINATOR" --store /vsis3/store/refused 2>"$work/no-store.txt"; then
  say "a worker whose secret is wrong serves"
  exit 1
fi
say "a store with a wrong secret: $(tail -1 "$work/no-store.txt")"
"$bin/trem" doctor --json >"$work/doctor.txt" && { say "the doctor finds nothing wrong with it"; exit 1; }
grep -q 'signature.*credentials' "$work/doctor.txt"
grep -q 'signature.*credentials' "$work/no-store.txt"
# Artefacts streamed, input in the bucket.
start refused-streaming "$bin/trem-coordinator" --state "$work/streaming-state" --store "$work/streaming-store" --bind 'tcp://127.0.0.1:*' \
  --ready-file "$work/streaming-ready"
wait_for 20 "the coordinator" test -s "$work/streaming-ready"
TREM_COORDINATOR=$(head -1 "$work/streaming-ready")
start refused-worker "$bin/trem-worker" serve --coordinator "$TREM_COORDINATOR" --source-root /vsis3/flights/
"$bin/trem" submit "$work/in-s3.textproto" "${settings[@]}" --job-id wrong-secret
if "$bin/trem" watch wrong-secret --quiet 2>"$work/refused.txt"; then
  say "a job with a wrong secret was done"
  exit 1
fi
say "input with a wrong secret: $(tail -1 "$work/refused.txt")"
grep -q 'signature.*credentials' "$work/refused.txt"
if grep -rq "not-the-secret" "$work"/*.log "$work"/*.txt "$work"/*-state; then
  say "the secret is in a log"
  exit 1
fi
say passed
