#!/usr/bin/env bash
# Installs the Debian packages that trem needs and that are missing. Quick when nothing is missing: one dpkg-query.
# usage: deploy/bootstrap.sh [PACKAGE_LIST...]      default: deploy/packages.txt
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

fail() {
  echo "bootstrap: $*" >&2
  exit 1
}

lists=("$@")
[ ${#lists[@]} -gt 0 ] || lists=("$here/packages.txt")
for list in "${lists[@]}"; do
  [ -r "$list" ] || fail "no package list '$list'; expected a file with one package name a line"
done
if ! command -v dpkg-query >/dev/null || ! command -v apt-get >/dev/null; then
  fail "this is not a Debian-like system (dpkg-query and apt-get not found). Install the equivalents of these packages by hand:" \
    "$(sed -e 's/#.*//' "${lists[@]}" | xargs)"
fi

mapfile -t wanted < <(sed -e 's/#.*//' "${lists[@]}" | xargs -n1)
[ ${#wanted[@]} -gt 0 ] || fail "the package list names no package: ${lists[*]}"

# dpkg-query exits 1 when it knows nothing of some package; what it prints is all that counts.
installed=$(dpkg-query -W -f='${db:Status-Status} ${Package}\n' "${wanted[@]}" 2>/dev/null || true)
missing=()
for package in "${wanted[@]}"; do
  grep -qxF "installed $package" <<<"$installed" || missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then
  echo "bootstrap: all ${#wanted[@]} packages are installed"
  exit 0
fi

as_root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || fail "packages are missing (${missing[*]}); run this as root or install sudo"
  as_root=(sudo)
  [ -t 0 ] || as_root=(sudo -n)
fi
apt() {
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -y -q -o DPkg::Lock::Timeout=300 -o Acquire::Retries=3 "$@"
}

echo "bootstrap: installing ${#missing[@]} packages: ${missing[*]}"
# A failing update alone is no reason to stop: the lists at hand, or one mirror of several, may be good enough.
apt update -o APT::Update::Error-Mode=any >/dev/null || echo "bootstrap: apt-get update failed; trying with the package lists at hand" >&2
apt install --no-install-recommends "${missing[@]}" ||
  fail "apt-get could not install: ${missing[*]}. Its messages are above; check that this machine reaches a Debian 12 mirror" \
    "(network, proxy, /etc/apt/sources.list), that the disk has 1.5 GB left, and that you may install packages"
echo "bootstrap: done"
