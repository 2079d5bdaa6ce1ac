#!/usr/bin/env bash
# Compares speed and numbers of flowservo's networks with PyTorch on this machine: train/benches/pytorch.sh --help
# Requires Python 3.10 or newer and, on the first run, the Python package index. It installs into target/pytorch only.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
target="${CARGO_TARGET_DIR:-$here/../../target}"
venv="$target/pytorch"
requirements="$here/requirements.txt"

if ! cmp -s "$requirements" "$venv/requirements.txt"; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --requirement "$requirements"
    cp "$requirements" "$venv/requirements.txt"
fi
exec "$venv/bin/python" "$here/pytorch.py" "$@"
