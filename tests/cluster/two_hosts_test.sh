#!/usr/bin/env bash
# Goal: a worker on another host, which sees neither the coordinator's store nor the sortie, maps the sortie to the same bytes as `trem run`, over an
# encrypted connection that is cut in the middle. Method: two network namespaces joined by a cable; on the workers' side empty file systems
# lie over the coordinator's folders and the sortie, and the workers run as nobody; the cable is pulled for a while.
# usage: two_hosts_test.sh BIN_FOLDER        exit code 77: skipped
set -euo pipefail
bin=$1
# shellcheck source=tests/cluster/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
for program in ip setpriv unshare python3; do
  command -v "$program" >/dev/null || skip "no $program"
done
[ "$(id -u)" -eq 0 ] || skip "network namespaces need root"
near=trem-near-$$
far=trem-far-$$
cleanup_more() {
  for namespace in "$near" "$far"; do ip netns del "$namespace" 2>/dev/null; done
}
ip netns add "$near" 2>/dev/null || skip "network namespaces are not permitted here"
ip netns add "$far"
ip link add "near$$" netns "$near" type veth peer name "far$$" netns "$far"
ip -n "$near" address add 10.77.0.1/24 dev "near$$"
ip -n "$far" address add 10.77.0.2/24 dev "far$$"
for side in "$near near$$" "$far far$$"; do
  read -r namespace device <<<"$side"
  ip -n "$namespace" link set lo up
  ip -n "$namespace" link set "$device" up
done

chmod 755 "$work"
mkdir -p "$work/far/bin" "$work/far/empty" "$work/service" "$work/keys" "$work/allowed"
cp "$bin/trem-worker" "$work/far/bin/"
for role in coordinator worker client; do "$bin/trem" keys "$role" --role "$role" -o "$work/keys" >/dev/null; done
cp "$work/keys/worker.pub" "$work/keys/client.pub" "$work/allowed/"
cp "$work/keys/worker.key" "$work/keys/coordinator.pub" "$work/far/"
chown -R 65534:65534 "$work/far"
simulate 32
alone

start coordinator ip netns exec "$near" "$bin/trem-coordinator" --state "$work/service/state" --store "$work/service/store" --bind 'tcp://*:7411' \
  --data-bind 'tcp://*:7412' --key "$work/keys/coordinator.key" --allow "$work/allowed" --ready-file "$work/service/ready"
wait_for 20 "the coordinator" test -s "$work/service/ready"
export TREM_COORDINATOR=tcp://10.77.0.1:7411 TREM_KEY=$work/keys/client.key TREM_COORDINATOR_KEY=$work/keys/coordinator.pub
trem() { ip netns exec "$near" "$bin/trem" "$@"; }

# The far host: an empty working folder, no way to the near host's files, no privileges.
far_worker() {
  cd "$work/far/empty"
  exec ip netns exec "$far" unshare --mount bash -ec '
    for folder in service sortie keys; do mount -t tmpfs -o ro none "$1/$folder"; done
    [ -z "$(ls "$1/service" "$1/sortie" | grep -v :)" ]
    exec setpriv --reuid=65534 --regid=65534 --clear-groups --no-new-privs env -i PATH=/usr/bin:/bin TMPDIR="$1/far" "$1/far/bin/trem-worker" serve \
      --coordinator tcp://10.77.0.1:7411 --key "$1/far/worker.key" --coordinator-key "$1/far/coordinator.pub"' bash "$work"
}
job=$(trem submit "$work/sortie/sortie.textproto" "${settings[@]}" --upload)
start far-1 far_worker
start far-2 far_worker
wait_for 120 "some of the job" eval 'p=$(trem status "$job" --json | python3 -c "import json, sys; print(int(json.load(sys.stdin)[\"fraction\"] * 100))") && [ "$p" -ge 20 ]'
say "pulling the cable for 8 s at $(trem status "$job" --json | python3 -c 'import json, sys; print(round(json.load(sys.stdin)["fraction"] * 100))') %"
ip -n "$far" link set "far$$" down
sleep 8
ip -n "$far" link set "far$$" up
trem watch "$job" --quiet
trem fetch "$job" -o "$work/far.tif" --quiet
cmp "$work/alone.tif" "$work/far.tif"
say "byte-identical; the far host holds $(find "$work/far" -type f -path '*/objects/*' | wc -l) objects in its cache, and its own copy of the sortie"
[ "$(find "$work/far" -path '*inputs*' -type f | wc -l)" -gt 0 ]

# Told to stop, the workers leave nothing behind.
for pid in "${pids[@]:1}"; do kill -TERM "$pid"; done
for pid in "${pids[@]:1}"; do wait "$pid" || { say "a worker that was told to stop left with exit code $?"; exit 1; }; done
[ -z "$(find "$work/far" -name 'trem-worker-*')" ]
say passed
