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

. "$here/environment.sh"
environment "$venv" "$here/requirements.txt" "${FLOWSERVO_REQUIRE_PYTHON:-0}"

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
