#!/usr/bin/env bash
# Installs what is missing, configures and builds.
# usage: deploy/build.sh [PRESET [TARGET...]]       default: release, the three programs. TARGET all: tests and benchmarks too.
# TREM_JOBS: parallel compilations (default: as many as there are processors).
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/.."

preset=${1:-release}
[ $# -eq 0 ] || shift
case $preset in
  release | dev | asan | tsan | fuzz) ;;
  *)
    echo "build: no preset '$preset'; expected release, dev, asan, tsan or fuzz" >&2
    exit 2
    ;;
esac
targets=("$@")
if [ ${#targets[@]} -eq 0 ]; then
  targets=(trem trem-coordinator trem-worker)
  [ "$preset" != fuzz ] || targets=(all)
fi

lists=("$here/packages.txt")
[ "$preset" != fuzz ] || lists+=("$here/packages-fuzz.txt")
"$here/bootstrap.sh" "${lists[@]}"
# Lets ccache recognise the same source in another clone.
export CCACHE_BASEDIR=${CCACHE_BASEDIR:-$PWD}
cmake --preset "$preset"
cmake --build "build/$preset" -j "${TREM_JOBS:-$(nproc)}" --target "${targets[@]}"

for program in trem trem-coordinator trem-worker; do
  [ ! -x "build/$preset/bin/$program" ] || echo "build: $PWD/build/$preset/bin/$program"
done
