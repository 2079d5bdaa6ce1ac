#!/usr/bin/env bash
# A registry in a bucket, against a server of its own (moto): tests/s3/run.sh [FLOWSERVO]
#
# FLOWSERVO is the program, built with --features s3; by default the one that was built last. Needs Python 3.11 or newer with
# venv and, the first time, the Python package index; what it installs is in target/s3. Where one of them is not to be had it
# says "skipped: ..." and succeeds, unless FLOWSERVO_REQUIRE_S3=1. FLOWSERVO_RACES says how many rounds of 16 publishers there
# are, 3 by default.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
target="${CARGO_TARGET_DIR:-$here/../../target}"
venv="$target/s3"

. "$here/../python/environment.sh"
required="${FLOWSERVO_REQUIRE_S3:-0}"
flowservo="${1:-$(ls -t "$target"/{debug,release}/flowservo 2>/dev/null | head -n 1)}"
[ -x "$flowservo" ] || skip "$required" "flowservo is not built; cargo build --features s3"
case "$("$flowservo" model list --registry s3:// 2>&1)" in
    *"built without S3"*) skip "$required" "$flowservo was built without S3; cargo build --features s3" ;;
esac

environment "$venv" "$here/requirements.txt" "$required"
PYTHONDONTWRITEBYTECODE=1 "$venv/bin/python" "$here/bucket.py" "$(realpath "$flowservo")"
