#!/usr/bin/env bash
# Opens small datasets with the tools that people use, and recomputes their numbers: tests/python/run.sh [FLOWSERVO]
#
# FLOWSERVO is the program; by default the one that was built last. Needs Python 3.11 or newer with venv and, the first time,
# the Python package index; everything it installs is in target/python. Where that is not to be had it says "skipped: ..."
# and succeeds, unless FLOWSERVO_REQUIRE_PYTHON=1.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
repository="$here/../.."
target="${CARGO_TARGET_DIR:-$repository/target}"
venv="$target/python"
requirements="$here/requirements.txt"

skip() {
    echo "skipped: $1"
    [ "${FLOWSERVO_REQUIRE_PYTHON:-0}" != 1 ]
    exit
}

if ! cmp -s "$requirements" "$venv/requirements.txt"; then
    python3 -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
        || skip "no Python 3.11 or newer with venv"
    mkdir -p "$target"
    python3 -m venv --clear "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check --retries 1 --timeout 20 --requirement "$requirements" \
        >"$venv/pip.log" 2>&1 || skip "the packages cannot be installed; $venv/pip.log says why"
    cp "$requirements" "$venv/requirements.txt"
fi

if [ $# -gt 0 ]; then
    flowservo=("$1")
else
    built="$(ls -t "$target"/{debug,release}/flowservo 2>/dev/null | head -n 1)" || true
    flowservo=("$built")
    [ -n "$built" ] || flowservo=(cargo run --quiet --locked --manifest-path "$repository/Cargo.toml" --)
fi

work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
# Three files, two of them with two groups of rows.
for dataset in c avoid; do
    "${flowservo[@]}" dataset generate "$repository/configs/datasets/$dataset.toml" --out "$work/$dataset" --set count=300 \
        --set rows_per_shard=140 --set world.camera.width=160 --set world.camera.height=120 >/dev/null 2>"$work/errors" \
        || { cat "$work/errors" >&2; exit 1; }
done
export HF_HUB_OFFLINE=1 HF_HOME="$work/huggingface" HF_DATASETS_DISABLE_PROGRESS_BARS=1 PYTHONDONTWRITEBYTECODE=1
"$venv/bin/python" "$here/matrix.py" "$work/c" "$work/avoid"
