#!/usr/bin/env bash
# Compares rendering by flowservo with PyBullet and MuJoCo on this machine, in speed and side by side. Options:
# datagen/benches/simulators.sh --help
# Requires Python 3.11 or newer, a release build of flowservo, EGL with a CPU driver (Debian: libegl1 and libgl1-mesa-dri),
# taskset, and, on the first run, the Python package index. It installs into target/simulators only.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)/simulators"
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$here/../../../target}" PYTHONDONTWRITEBYTECODE=1
venv="$CARGO_TARGET_DIR/simulators"
requirements="$here/requirements.txt"

if ! cmp -s "$requirements" "$venv/requirements.txt"; then
    mkdir -p "$CARGO_TARGET_DIR"
    python3 -m venv --clear "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check --requirement "$requirements"
    cp "$requirements" "$venv/requirements.txt"
fi
exec "$venv/bin/python" "$here/simulators.py" "$@"
