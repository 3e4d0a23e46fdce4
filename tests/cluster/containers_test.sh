#!/usr/bin/env bash
# Goal: the images of deploy/docker hold all that the programs need, run as nobody in particular, with nothing writable but their volumes, and map a
# sortie to the same bytes as `trem run`. Method: podman on this machine, with a storage of its own: a Debian made by debootstrap, both images
# built on it, one coordinator and two workers run with keys; the sortie is uploaded.
# usage: containers_test.sh BIN_FOLDER SOURCE_FOLDER CACHE_FOLDER        exit code 77: skipped
# The programs of BIN_FOLDER go into the images; TREM_BUILD_PROGRAMS=1 builds them in a container instead, by Dockerfile.build.
set -euo pipefail
bin=$1
source_folder=$2
cache=$3
# shellcheck source=tests/cluster/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
for program in podman buildah runc debootstrap python3; do
  command -v "$program" >/dev/null || skip "no $program (Debian: podman buildah runc debootstrap)"
done
[ "$(id -u)" -eq 0 ] || skip "debootstrap needs root"
cat >"$work/containers.conf" <<CONF
[containers]
default_ulimits = ["nofile=4096:4096", "nproc=4096:4096"]
[engine]
cgroup_manager = "cgroupfs"
events_logger = "file"
CONF
cat >"$work/storage.conf" <<CONF
[storage]
driver = "vfs"
graphroot = "$work/graph"
runroot = "$work/run"
CONF
export CONTAINERS_CONF=$work/containers.conf CONTAINERS_STORAGE_CONF=$work/storage.conf
cleanup_more() {
  podman --runtime runc rm --all --force --time 5
  podman rmi --all --force
} >/dev/null 2>&1

# ---- Images -------------------------------------------------------------------------------------------------------------------------
mkdir -p "$cache"
if [ ! -s "$cache/debian.tar" ]; then
  debootstrap --variant=minbase bookworm "$work/debian" >"$work/debootstrap.log" 2>&1 || skip "debootstrap does not get a Debian: $(tail -1 "$work/debootstrap.log")"
  tar -C "$work/debian" -cf "$cache/debian.tar.part" .
  mv "$cache/debian.tar.part" "$cache/debian.tar"
  rm -rf "$work/debian"
fi
podman import "$cache/debian.tar" localhost/debian:bookworm >"$work/import.log" 2>&1
podman --runtime runc run --rm --network=host localhost/debian:bookworm true >"$work/run.log" 2>&1 || skip "podman runs no container here: $(tail -1 "$work/run.log")"
build() { # build TAG OPTIONS...
  local tag=$1
  shift
  buildah --storage-driver vfs bud --isolation chroot --network host --build-arg BASE=localhost/debian:bookworm -t "$tag" "$@" "$source_folder" >"$work/build-$tag.log" 2>&1
}
if [ "${TREM_BUILD_PROGRAMS:-0}" = 1 ]; then
  build trem-programs -f "$source_folder/deploy/docker/Dockerfile.build"
else
  mkdir -p "$work/programs/out"
  for program in trem trem-coordinator trem-worker; do strip -o "$work/programs/out/$program" "$bin/$program"; done
  tar -C "$work/programs" -c out | podman import - localhost/trem-programs >>"$work/import.log" 2>&1
fi
for image in coordinator worker; do
  build "trem-$image" --target "$image" -f "$source_folder/deploy/docker/Dockerfile"
  user=$(podman inspect --format '{{.Config.User}}' "localhost/trem-$image")
  say "image trem-$image: $(podman images --format '{{.Size}}' "localhost/trem-$image"), user $user (its Debian alone: $(podman images --format '{{.Size}}' localhost/debian:bookworm))"
  [ "$user" = 10001:10001 ]
done

# ---- A service of containers --------------------------------------------------------------------------------------------------------
mkdir -p "$work"/{keys,allowed,secrets-coordinator,secrets-worker,public,data,cache-1,cache-2}
for role in coordinator worker client; do "$bin/trem" keys "$role" --role "$role" -o "$work/keys" >/dev/null; done
cp "$work/keys/worker.pub" "$work/keys/client.pub" "$work/allowed/"
cp "$work/keys/coordinator.key" "$work/secrets-coordinator/"
cp "$work/keys/worker.key" "$work/secrets-worker/"
cp "$work/keys/coordinator.pub" "$work/public/"
chown -R 10001:10001 "$work"/{secrets-coordinator,secrets-worker,data,cache-1,cache-2}
chmod 755 "$work"
simulate 32
alone
port=$(free_port)
data_port=$(free_port)
run() { # run NAME OPTIONS... IMAGE ARGUMENTS...: with nothing writable but the volumes, and no capability.
  local name=$1
  shift
  start "$name" podman --runtime runc run --rm --name "$name" --network=host --read-only --tmpfs /tmp --cap-drop all --security-opt no-new-privileges "$@"
}
run coordinator -v "$work/data:/var/lib/trem" -v "$work/secrets-coordinator:/run/secrets/trem:ro" -v "$work/allowed:/etc/trem/allowed:ro" \
  localhost/trem-coordinator --state /var/lib/trem/state --store /var/lib/trem/store --bind "tcp://*:$port" --data-bind "tcp://*:$data_port" \
  --key /run/secrets/trem/coordinator.key --allow /etc/trem/allowed --ready-file /var/lib/trem/ready
wait_for 60 "the coordinator" test -s "$work/data/ready"
for number in 1 2; do
  run "worker-$number" -v "$work/cache-$number:/var/cache/trem" -v "$work/secrets-worker:/run/secrets/trem:ro" -v "$work/public:/etc/trem:ro" \
    localhost/trem-worker --coordinator "tcp://127.0.0.1:$port" --cache /var/cache/trem --key /run/secrets/trem/worker.key \
    --coordinator-key /etc/trem/coordinator.pub
done
export TREM_COORDINATOR=tcp://127.0.0.1:$port TREM_KEY=$work/keys/client.key TREM_COORDINATOR_KEY=$work/keys/coordinator.pub
job=$("$bin/trem" submit "$work/sortie/sortie.textproto" "${settings[@]}" --upload)
"$bin/trem" watch "$job" --quiet
"$bin/trem" workers
[ "$("$bin/trem" workers --json | python3 -c 'import json, sys; print(len(json.load(sys.stdin)))')" -eq 2 ]
"$bin/trem" fetch "$job" -o "$work/containers.tif" --quiet
cmp "$work/alone.tif" "$work/containers.tif"
say "mapped by a containerised coordinator and two containerised workers: byte-identical"
grep -c "ended after.*ok" "$work/worker-1.log" "$work/worker-2.log"
say passed
