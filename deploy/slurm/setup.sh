#!/usr/bin/env bash
# Makes a service folder with keys. usage: setup.sh SERVICE_FOLDER [CLIENT_NAME]
set -euo pipefail
service=${1:?usage: setup.sh SERVICE_FOLDER [CLIENT_NAME]}
client=${2:-$(id -un | tr -c 'a-z0-9\n' '-')}
trem=${TREM_BIN:?set TREM_BIN to the folder of the programs}/trem
umask 077
mkdir -p "$service/keys" "$service/allowed"
"$trem" keys coordinator --role coordinator -o "$service/keys" >&2
"$trem" keys worker --role worker -o "$service/keys" >&2
"$trem" keys "$client" --role admin -o "$service/keys" >&2
cp "$service/keys/worker.pub" "$service/keys/$client.pub" "$service/allowed/"
printf 'export TREM_SERVICE=%q TREM_KEY=%q TREM_COORDINATOR_KEY=%q\n' "$service" "$service/keys/$client.key" "$service/keys/coordinator.pub"
