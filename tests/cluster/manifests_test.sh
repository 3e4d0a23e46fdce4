#!/usr/bin/env bash
# Runs manifests_test.js with the npm packages that it needs. usage: manifests_test.sh SOURCE_FOLDER MODULES_FOLDER      exit code 77: skipped.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
modules=$("$here/node_modules.sh" "$2") || exit $?
node "$here/manifests_test.js" "$1" "$modules"
