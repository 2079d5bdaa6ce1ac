#!/usr/bin/env bash
# Opens small datasets with the usual tools and recomputes their numbers: tests/python/run.sh [FLOWSERVO]
#
# FLOWSERVO is the program, by default the most recent build. Needs Python 3.11 or newer with venv and, the first time, the
# Python package index; it installs into target/python.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
. "$here/../environment.sh"
find_flowservo "$@"
python_environment python "$here/requirements.txt"

work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
# Three files, two of them with two row groups.
for dataset in c avoid; do
    "$flowservo" dataset generate "$repository/configs/datasets/$dataset.toml" --out "$work/$dataset" --set count=300 \
        --set rows_per_shard=140 --set world.camera.width=160 --set world.camera.height=120 >/dev/null 2>"$work/errors" \
        || { cat "$work/errors" >&2; exit 1; }
done
export HF_HUB_OFFLINE=1 HF_HOME="$work/huggingface" HF_DATASETS_DISABLE_PROGRESS_BARS=1
"$python" "$here/matrix.py" "$work/c" "$work/avoid"
