#!/usr/bin/env bash
# Installs what is missing, builds everything and runs all tests.
# usage: deploy/test.sh [CTEST OPTION...]           for example: deploy/test.sh -L unit, deploy/test.sh -R Hints
# TREM_PRESET: release (default), dev, asan or tsan. TREM_JOBS: parallel compilations and tests.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/.."
preset=${TREM_PRESET:-release}
jobs=${TREM_JOBS:-$(nproc)}

"$here/build.sh" "$preset" all
# Every test states its own time limit; --timeout bounds one that forgot. Tests labelled e2e run alone (see trem_test).
exec ctest --test-dir "build/$preset" --output-on-failure --no-tests=error -j "$jobs" --timeout 600 "$@"
