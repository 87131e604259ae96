#!/usr/bin/env bash
# What only a release needs: release.sh dist | deb | lock
set -euo pipefail
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}

# Makes an environment build/$1 from a lock.
environment() {
  "$PYTHON" -m venv "build/$1"
  build/"$1"/bin/pip install --quiet --disable-pip-version-check --require-hashes -r "locks/$2.txt"
}

# Wheel and source distribution. Two builds of one commit are the same, byte by byte.
dist() {
  [ -x build/release/bin/hatchling ] || environment release build
  rm -rf dist
  SOURCE_DATE_EPOCH=$(git log -1 --format=%ct) build/release/bin/hatchling build -d dist
}

# A Debian package of that wheel and its locked dependencies, for the machines whose Python is DEB_PYTHON: 3.12 on Ubuntu
# 24.04 (ROS 2 Jazzy, Kilted), 3.11 on Debian 12, 3.13 on Debian 13.
deb() {
  dist
  local here=amd64
  [ "$(uname -m)" != aarch64 ] || here=arm64
  SOURCE_DATE_EPOCH=$(git log -1 --format=%ct) build/release/bin/python deb/build.py --python "${DEB_PYTHON:-3.12}" \
    --architecture "${DEB_ARCHITECTURE:-$here}" dist/*.whl
}

# The versions and hashes of all that is installed, for every Python and machine at once (docs/install.md).
lock() {
  environment lock checks
  "$PYTHON" -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")' > build/lock/build.in
  locked() {
    build/lock/bin/uv pip compile --quiet --universal --python-version 3.11 --upgrade --generate-hashes --no-annotate \
      --custom-compile-command 'make lock' --output-file "locks/$1.txt" "${@:2}"
  }
  locked build build/lock/build.in
  locked checks --group checks
  local all=(pyproject.toml build/lock/build.in)
  locked run "${all[@]}"
  locked fleet "${all[@]}" --extra zenoh --extra metrics
  locked ros "${all[@]}" --extra ros --extra zenoh --extra metrics --extra look --extra record
  locked dev "${all[@]}" --extra ros --extra ros-test --extra zenoh --extra metrics --extra look --extra record --extra mcp --extra dev
}

"$1"
