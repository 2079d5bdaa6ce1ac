#!/usr/bin/env bash
# Our networks against PyTorch's on this machine, in speed and in numbers: train/benches/pytorch.sh --help
# Needs Python 3.10 or newer and, the first time, the Python package index. Everything it installs is in target/pytorch.
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
